"""Identification recovers simulated arms within the stated uncertainty and reports failures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.starters import arm_type_files
from cellapp.commands.calibrate.result import arm_result
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.identification import (
    TooFewReadings,
    identify,
    identify_with_excess,
    start_from_nominal,
)
from cellapp.estimation.calibration.least_squares import LeastSquares, Linearised, Minimum, minimise
from cellapp.estimation.calibration.parameters import auto_set, candidate_columns, full_set, paper_set
from cellapp.estimation.calibration.quantities import measured_quantities
from cellapp.estimation.calibration.station_location import better_reading, explained
from cellapp.ground.errors import CheckFailed, InputError, NotConverged, tried, with_not_fitted
from cellapp.interfaces.python.cell import Cell
from cellapp.robot.kinematics.chain import (
    JointAngles,
    jacobian,
    nominal_geometry,
    parallel_rows,
    parameter_names,
    parameter_unit,
    smr_positions,
)
from cellapp.robot.kinematics.transforms import Array, rotation_from_vector, transform
from cellapp.robot.model import CellModel
from cellapp.robot.model.nominal import nominal_arm
from drivers.plant import TrueErrors
from tests.arms import HALF_TURN, OFF_AXIS, ON_AXIS, SEVEN, UR5, UR10, at_station, dh, plant_of, true_geometry
from tests.series import readings_at, series
from tests.sure import sure
from tests.twin import PROFILES, altered, with_arm

SIGMA = 15e-6
# an elbow arm with offsets whose axes 2 and 3 are anti-parallel, as tables of some makers have it
ELBOW = dh(
    [0.0] * 6,
    [0.4, 0.0, 0.0, 0.35, 0.0, 0.1],
    [0.18, 0.6, 0.12, 0.0, 0.0, 0.0],
    [-HALF_TURN, np.pi, -HALF_TURN, HALF_TURN, -HALF_TURN, 0.0],
)


def measured(rows, tool, seed, n, sigma=SIGMA):
    """A true arm, its nominal one, random configurations and noisy points."""
    rng = np.random.default_rng(seed)
    nominal = at_station(rows, tool)
    truth = true_geometry(nominal, rng)
    q = rng.uniform(-3, 3, (n, len(rows)))
    return nominal, truth, q, smr_positions(truth, q) + rng.normal(0.0, sigma, (n, 3))


def distances(geometry, truth, q):
    """From the true positions (n,) [m]."""
    return np.linalg.norm(smr_positions(geometry, q) - smr_positions(truth, q), axis=1)


@pytest.mark.parametrize(
    ("rows", "tool", "rank"),
    [
        (UR10, OFF_AXIS, 27),
        (UR10, ON_AXIS, 25),
        (UR5, OFF_AXIS, 27),
        (UR5, ON_AXIS, 25),
        (SEVEN, OFF_AXIS, 31),
        (ELBOW, OFF_AXIS, 27),
    ],
    ids=["UR10", "UR10 on the axis", "UR5", "UR5 on the axis", "seven joints", "anti-parallel axes"],
)
def test_the_identifiable_set_has_the_rank_of_the_jacobian(rows, tool, rank):
    # 4 numbers a joint axis and 3 of the point; on the last axis the two tilts of that axis about the point vanish
    geometry = at_station(rows, tool)
    q = np.random.default_rng(0).uniform(-3, 3, (200, len(rows)))
    chosen = auto_set(geometry, q)
    columns = candidate_columns(geometry)
    _, J = jacobian(geometry, JointAngles.of(q), columns)
    flat = J.transpose(0, 2, 1).reshape(-1, len(columns))
    assert len(chosen.columns) == np.linalg.matrix_rank(flat, tol=1e-8 * np.linalg.norm(flat)) == rank
    assert set(chosen.columns) | set(chosen.dropped) == set(columns)


def test_a_dropped_parameter_has_the_effect_of_its_shares():
    geometry = at_station(UR10, OFF_AXIS)
    q = np.random.default_rng(0).uniform(-3, 3, (100, 6))
    chosen = auto_set(geometry, q)
    _, kept = jacobian(geometry, JointAngles.of(q), chosen.columns)
    _, gone = jacobian(geometry, JointAngles.of(q), chosen.dropped)
    np.testing.assert_allclose(np.einsum("ckn,kl->cln", kept, chosen.shares), gone, atol=1e-9)
    assert chosen.merged["theta1"] == pytest.approx({"theta0": 1.0})
    assert chosen.merged["d3"] == pytest.approx({"d2": 1.0})
    assert chosen.merged["theta6"] == pytest.approx({"tx": -OFF_AXIS[1], "ty": OFF_AXIS[0]})


def test_the_papers_sets_have_34_and_26_parameters():
    geometry = at_station(UR10, OFF_AXIS)
    assert len(full_set(geometry).columns) == 34
    assert len(paper_set(geometry).columns) == 26
    assert "alpha5" not in paper_set(geometry).names
    with pytest.raises(ValueError, match="use 'auto'"):
        paper_set(at_station(SEVEN, OFF_AXIS))


@pytest.mark.parametrize("rows", [UR10, UR5, SEVEN], ids=["UR10", "UR5", "seven joints"])
def test_an_arm_is_recovered_to_the_noise_in_three_iterations(rows):
    nominal, truth, q, p_M = measured(rows, OFF_AXIS, seed=1, n=400)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    found = identify(start, q, p_M)
    assert found.converged
    assert found.iterations == 3
    assert found.scale == pytest.approx(SIGMA, rel=0.1)
    new = np.random.default_rng(2).uniform(-3, 3, (500, len(rows)))
    k = len(found.names)
    off = distances(found.geometry, truth, new)
    assert np.sqrt(np.mean(off**2)) < 1.5 * SIGMA * np.sqrt(k / 400)  # the error that k parameters of noise leave


def test_anisotropic_covariances_are_used_as_weights():
    rng = np.random.default_rng(0)
    nominal = at_station(UR10, OFF_AXIS)
    truth = true_geometry(nominal, rng)
    q = rng.uniform(-3, 3, (300, 6))
    axes = np.linalg.qr(rng.normal(size=(300, 3, 3)))[0]
    covariance = axes @ (np.diag([5e-6, 5e-6, 200e-6]) ** 2) @ axes.transpose(0, 2, 1)
    p_M = smr_positions(truth, q) + np.einsum("nab,nb->na", np.linalg.cholesky(covariance), rng.normal(size=(300, 3)))
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    weighted, plain = identify(start, q, p_M, sigma=covariance), identify(start, q, p_M)
    assert weighted.scale == pytest.approx(1.0, abs=0.1)
    new = rng.uniform(-3, 3, (300, 6))
    errors = [distances(found.geometry, truth, new).mean() for found in (weighted, plain)]
    assert errors[0] < 0.3 * errors[1]
    isotropic = identify(start, q, p_M, sigma=np.full(300, 7e-6))
    same = identify(start, q, p_M, sigma=np.tile(np.eye(3) * 7e-6**2, (300, 1, 1)))
    np.testing.assert_allclose(isotropic.values, same.values, atol=1e-9)


@pytest.mark.parametrize("robust", ["huber", "tukey"])
def test_robust_weights_reject_outliers(robust):
    nominal, truth, q, p_M = measured(UR10, OFF_AXIS, seed=5, n=200)
    rng = np.random.default_rng(6)
    bad = rng.choice(200, 20, replace=False)
    p_M[bad] += rng.normal(0.0, 1e-3, (20, 3))
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    new = rng.uniform(-3, 3, (300, 6))
    kept, plain = identify(start, q, p_M, robust=robust), identify(start, q, p_M)
    assert kept.converged
    assert distances(kept.geometry, truth, new).mean() < 0.25 * distances(plain.geometry, truth, new).mean()
    assert np.median(kept.weights[bad]) < 0.2 < np.median(np.delete(kept.weights, bad))


def test_too_few_readings_are_refused_with_the_number_needed():
    nominal, _, q, p_M = measured(UR10, OFF_AXIS, seed=12, n=8)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    with pytest.raises(TooFewReadings, match=r"8 readings give 24 coordinates for \d+ parameters; measure at least"):
        identify(start, q, p_M, parameter_set="paper")


def test_the_noise_free_plant_is_fitted_to_below_a_nanometre():
    # the truth is lines in space displaced and tilted, not a table: the model must be complete
    for seed in range(3):
        plant = plant_of(UR5, OFF_AXIS, errors=TrueErrors(0.3e-3, 1e-3, 5e-3, 5e-3, 1e-3), seed=seed)
        q = np.random.default_rng(seed).uniform(-3, 3, (120, 6))
        p_M = plant.smr_positions("arm", q)
        start = start_from_nominal(nominal_geometry(UR5, OFF_AXIS), q, p_M, tool_unknown=False)
        found = identify(start, q, p_M, tolerance=1e-12)
        assert np.abs(found.residuals).max() < 1e-9


@pytest.mark.parametrize("sigma_m", [None, 1e-9])
@pytest.mark.parametrize("offset_m", [0.0, 0.1])
def test_readings_without_noise_determine_the_same_parameters(sigma_m, offset_m):
    # what rounding leaves of a dependent column is more than such a small noise
    nominal, _, q, p_M = measured(UR10, OFF_AXIS, 5, 400, sigma=0.0)
    found = identify(nominal, q, p_M + offset_m, sigma=None if sigma_m is None else np.full(len(q), sigma_m))
    assert len(found.names) == 27
    assert len(found.parameter_set.merged) == len(full_set(nominal).columns) - 27
    assert np.linalg.norm(found.residuals, axis=1).max() < 1e-8  # the tolerance of a step


def test_scatter_beyond_the_stated_uncertainty_enters_the_weights():
    # half of the readings state 2 um, half 40 um; all really scatter by 0.3 mm of unmodelled physics
    nominal, truth, q, p_M = measured(UR10, OFF_AXIS, seed=16, n=300, sigma=0.3e-3)
    sigma = np.where(np.arange(300) % 2 == 0, 2e-6, 40e-6)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    trusting = identify(start, q, p_M, sigma=sigma)
    found, excess = identify_with_excess(start, measured_quantities(readings_at(q, p_M, sigma_m=sigma)))
    assert excess == pytest.approx(0.3e-3, rel=0.1)
    assert found.scale == pytest.approx(1.0, abs=0.02)
    assert found.iterations == len(found.steps) > trusting.iterations
    new = np.random.default_rng(17).uniform(-3, 3, (300, 6))
    assert distances(found.geometry, truth, new).mean() < 0.85 * distances(trusting.geometry, truth, new).mean()
    # where the statement is right, nothing is added
    nominal, _, q, p_M = measured(UR10, OFF_AXIS, seed=18, n=300)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    assert identify_with_excess(start, measured_quantities(readings_at(q, p_M, sigma_m=SIGMA)))[1] == 0.0


def sixty_readings():
    one = series(1, 60)["left"]
    words = ["identify" if k % 3 else "validate" for k in range(60)]
    return readings_at(one.q, one.p_M, time_s=np.arange(60.0), split=words)


def test_fixed_parameters_keep_their_values_and_others_take_their_part():
    profile, readings = load_profile(PROFILES / "twin-small.yaml"), sixty_readings()
    plain = altered(profile, network={"kind": "none"})
    free, *_ = calibrate_arm(plain, "left", readings)
    held, *_ = calibrate_arm(with_arm(plain, "left", fixed=("tx", "ty", "tz", "a2")), "left", readings)
    result = arm_result(held)
    assert np.allclose(held.model.geometry.tool, profile.arms["left"].smr.offset, rtol=0.0, atol=1e-12)
    assert result.fixed == {"a2": -0.612, "tx": 0.045, "ty": 0.02, "tz": 0.06}
    assert not {*result.fixed} & {*result.identified, *result.merged}
    assert {"theta6", "a6", "d6"} <= {*result.identified}
    assert {"theta6", "a6", "d6"} <= {*arm_result(free).merged}
    assert held.validate["geometry"].position_mm.rms < 1.2 * free.validate["geometry"].position_mm.rms


def calibrated_with(**held):
    """A UR10 whose a2 and a3 are both 0.4 mm off, calibrated with further keys of its profile; and these two found."""
    profile = load_profile(PROFILES / "twin-small.yaml")
    arms = {"left": with_arm(profile, "left", **held).arms["left"]}
    plain = {"network": profile.network.model_copy(update={"kind": "none"}), "plant": None}
    nominal, truth, q, _ = measured(UR10, np.array(arms["left"].smr.offset), seed=3, n=80)
    rows = truth.rows.copy()
    rows[1:3, 2] = nominal.rows[1:3, 2] + 0.4e-3
    p_M = smr_positions(replace(truth, rows=rows), q) + np.random.default_rng(3).normal(0.0, SIGMA, (80, 3))
    fit = Cell(profile.model_copy(update={"arms": arms, **plain})).calibrate({"left": {"q": q, "p_M": p_M}})
    return fit, *(fit.result.arms["left"].identified[name] for name in ("a2", "a3"))


def test_tied_parameters_are_corrected_alike_and_known_better():
    (_, *free), (fit, a2, a3) = calibrated_with(), calibrated_with(tied=(("a2", "a3"),))
    assert a2.value - a2.nominal == pytest.approx(a3.value - a3.nominal, abs=1e-15)
    assert a2.value - a2.nominal == pytest.approx(0.4e-3, abs=4.0 * a2.standard_error)
    assert a2.standard_error == a3.standard_error < 0.9 * min(one.standard_error for one in free)
    assert "tied to a2" in fit.report()


def test_a_parameter_that_would_leave_its_bounds_is_held_there_and_says_so():
    fit, a2, a3 = calibrated_with(bounds={"a2": (-0.6121, -0.6118), "a3": (-0.6, -0.5)})
    assert a2.value == pytest.approx(-0.6118, abs=1e-12)  # the truth is -0.6116
    assert (a2.standard_error, a2.at_bound, a3.at_bound) == (None, True, None)
    assert "at its bound" in fit.report()
    found = fit.discover().model
    assert CellModel.from_json(found.to_json()).arms["left"].geometry.at_bound == {"a2"}


def test_a_profile_that_allows_too_few_steps_ends_with_an_error_that_names_the_arm():
    profile, readings = load_profile(PROFILES / "twin-small.yaml"), sixty_readings()
    few = altered(profile, calibration={"max_iterations": 1})
    with pytest.raises(NotConverged, match="arm 'left': the identification did not converge: 1 steps were not enough"):
        calibrate_arm(few, "left", readings)


# -- The geometry uses all parameters with priors, as good as a plain reference; the table states what is determined ---

ARMS = {"UR10": UR10, "UR5": UR5, "anti-parallel axes": ELBOW, "seven joints": SEVEN}
LENGTH, ANGLE = 0.3e-3, 0.5e-3


class Narrow:
    """Readings of a true arm whose joints moved over 10 to 50 degrees; base and tool unknown."""

    def __init__(self, rows, seed, n, sigma, length=LENGTH, angle=ANGLE):
        rng = np.random.default_rng(seed)
        nominal = at_station(rows, rng.normal(0.0, 0.06, 3) + np.array([0.0, 0.0, 0.05]))
        truth = true_geometry(nominal, rng, length, angle)
        width = np.radians(rng.uniform(10.0, 50.0, len(rows)))
        q = rng.uniform(-1.5, 1.5, len(rows)) + rng.uniform(-0.5, 0.5, (n + 400, len(rows))) * width
        self.q, self.new = q[:n], q[n:]
        self.p_M = smr_positions(truth, self.q) + rng.normal(0.0, sigma, (n, 3))
        self.true_M = smr_positions(truth, self.new)
        self.start = start_from_nominal(nominal, self.q, self.p_M, tool_unknown=True)

    def error(self, geometry):
        """Rms distance from the true positions at configurations that were not measured [m]."""
        return np.sqrt(np.mean(np.sum((smr_positions(geometry, self.new) - self.true_M) ** 2, axis=1)))


def reference(data, sigma, length, angle):
    """Plain maximum a posteriori estimate: dense, by differences, all parameters, the priors of the simulation."""
    names = parameter_names(data.start.joints)
    betas = {f"beta{i + 1}" for i in parallel_rows(data.start)}
    free = [c for c, name in enumerate(names) if name in betas | {"beta0"} or not name.startswith("beta")]
    nominal = data.start.vector()
    of_arm = [6 <= c < len(names) - 3 for c in free]
    sd = np.array([angle if parameter_unit(names[c]) == "rad" else length for c in free])

    def rows(step):
        vector = nominal.copy()
        vector[free] += step
        off = (smr_positions(data.start.with_vector(vector), data.q) - data.p_M) / sigma
        return np.concatenate([off.ravel(), (step / sd)[of_arm]])

    x_scale = np.where(of_arm, sd, 1e-3)
    found = least_squares(rows, np.zeros(len(free)), x_scale=x_scale, xtol=1e-12, ftol=1e-12)
    nominal[free] += found.x
    return data.start.with_vector(nominal)


@pytest.mark.parametrize("rows", ARMS.values(), ids=ARMS.keys())
@pytest.mark.parametrize(("n", "sigma"), [(60, 30e-6), pytest.param(300, 15e-6, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("length", "angle"), [(LENGTH, ANGLE), (1e-3, 10e-3)], ids=["usual errors", "large errors"])
def test_on_narrow_ranges_it_is_as_good_as_a_reference_that_knows_noise_and_priors(rows, n, sigma, length, angle):
    ratios = []
    for seed in range(4):
        data = Narrow(rows, seed, n, sigma, length, angle)
        found = identify(data.start, data.q, data.p_M)
        assert found.converged
        ratios.append(data.error(found.geometry) / data.error(reference(data, sigma, length, angle)))
    assert np.exp(np.mean(np.log(ratios))) < 1.05


def test_the_table_states_the_combination_that_the_data_determine():
    # the same arm written in two ways: an offset in d3, or in d2; both shift axis 2's parallel neighbours alike
    q = np.random.default_rng(1).uniform(-2, 2, (100, 6))
    nominal = at_station(UR10, OFF_AXIS)
    tables = []
    for joint in (1, 2):
        rows = nominal.rows.copy()
        rows[joint, 1] += 1e-3
        found = identify(nominal, q, smr_positions(replace(nominal, rows=rows), q))
        assert "d3" not in found.names
        np.testing.assert_allclose(found.geometry.rows[1:4, 1] - nominal.rows[1:4, 1], 1e-3 / 3, atol=1e-7)
        tables.append(dict(zip(found.names, found.values, strict=True)))
    assert tables[0]["d2"] == pytest.approx(1e-3, abs=1e-7)
    assert tables[1] == pytest.approx(tables[0], abs=1e-7)


def test_noise_decides_what_the_table_states():
    rng = np.random.default_rng(2)
    nominal = at_station(UR10, np.array([1e-3, 0.0, 0.06]))  # 1 mm off the last axis, which tells two of its angles
    q = rng.uniform(-3, 3, (200, 6))
    ranks = []
    for noise in (5e-6, 1e-3):
        p_M = smr_positions(nominal, q) + rng.normal(0.0, noise, (200, 3))
        found = identify(nominal, q, p_M)
        ranks.append(len(found.names))
        assert set(found.parameter_set.merged) == set(found.estimated.names) - set(found.names)
    assert ranks == [27, 25]


def test_stated_priors_are_used_as_stated_and_others_take_the_spread_of_the_arm():
    data = Narrow(UR10, 3, 60, 20e-6)
    free = identify(data.start, data.q, data.p_M)
    tight = identify(data.start, data.q, data.p_M, prior_sigma=dict.fromkeys(["a2", "a3"], 1e-9))
    nominal = data.start.rows[1:3, 2]
    np.testing.assert_allclose(tight.geometry.rows[1:3, 2], nominal, atol=1e-8)
    assert np.abs(free.geometry.rows[1:3, 2] - nominal).max() > 1e-5
    assert tight.prior_sigma["a2"] == pytest.approx(1e-9)
    assert free.prior_sigma["a2"] == free.prior_sigma["d5"] == pytest.approx(LENGTH, rel=0.6)
    assert free.prior_sigma["alpha1"] == pytest.approx(ANGLE, rel=0.6)
    assert "x0" not in free.prior_sigma
    again = identify(
        data.start, data.q, data.p_M, parameter_set=free.estimated, prior_sigma=free.prior_sigma, prior_mean=data.start
    )
    np.testing.assert_allclose(again.geometry.vector(), free.geometry.vector(), atol=1e-6)


def test_of_two_minima_on_either_side_of_the_wrist_the_better_one_is_returned():
    # the last axis keeps its direction, and curves of the joints stand for unmodelled physics
    rng = np.random.default_rng(2)
    nominal = at_station(UR10, np.array([0.0, 0.0, 0.1]))
    q = rng.uniform(-1.0, 1.0, (60, 6)) * [1.0, 0.6, 0.6, 0.0, 0.0, 0.0] + [0.9, -1.2, 1.4, 0.0, 0.0, -HALF_TURN]
    q[:, 3], q[:, 4] = -q[:, 1] - q[:, 2], q[:, 0]
    truth = true_geometry(nominal, rng, 0.5e-3, 1e-3)
    p_M = smr_positions(truth, q + 0.5e-3 * np.sin(5.0 * q)) + rng.normal(0.0, 30e-6, (60, 3))
    plain = [identify(at_station(UR10, np.array([0.0, 0.0, z])), q, p_M) for z in (0.1, -0.3)]
    both, _ = identify_with_excess(nominal, measured_quantities(readings_at(q, p_M)))
    assert all(found.converged for found in (both, *plain))
    assert abs(both.geometry.tool[2] - plain[0].geometry.tool[2]) > 0.05
    rms = [np.sqrt(np.mean(found.residuals**2)) for found in (both, *plain)]
    assert rms[0] <= min(rms[1:]) * 1.001


# -- Whether an arm explains recorded readings, and which signs or units do: on simulated arms and on real readings ----

ROOT = Path(__file__).parents[3]
NOMINAL = nominal_geometry(UR10, np.zeros(3))


def readings(seed: int, n: int = 150) -> tuple[Array, Array]:
    """Joint positions and points of a UR10 whose rows are off by millimetres, with an unknown base and tool."""
    rng = np.random.default_rng(seed)
    rows = UR10 + rng.normal(0.0, [2e-3, 1e-3, 1e-3, 2e-3], (6, 4))
    T_M_B = transform(rotation_from_vector(rng.normal(size=3)), rng.uniform(-3.0, 3.0, 3))
    geometry = nominal_geometry(rows, rng.uniform(-0.2, 0.2, 3), T_M_B)
    q = rng.uniform(-2.5, 2.5, (n, 6))
    return q, smr_positions(geometry, q)


@pytest.mark.parametrize("seed", range(4))
def test_the_right_arm_explains_and_a_wrong_unit_does_not(seed: int) -> None:
    q, p_M = readings(seed)
    found = explained(NOMINAL, q, p_M)
    assert found.holds
    assert found.rms_m < 0.02
    assert not explained(NOMINAL, np.degrees(q), p_M).holds
    assert not explained(NOMINAL, q, 1e3 * p_M).holds


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda q: q * [1, -1, 1, 1, 1, 1], "q2 with the opposite sign"),
        (lambda q: q * [1, -1, -1, 1, -1, 1], "q2, q3, q5 with the opposite sign"),
        (lambda q: q - np.outer(q[:, 1], [0, 0, 1, 0, 0, 0]), "q3 + q2 in place of q3"),
    ],
)
def test_the_convention_of_the_controller_is_named(wrong: Callable[[Array], Array], words: str) -> None:
    q, p_M = readings(7)
    assert not explained(NOMINAL, wrong(q), p_M).holds
    found = sure(better_reading(NOMINAL, wrong(q), p_M))
    assert found[0] == words
    assert found[1].holds


def test_points_at_random_fit_no_convention() -> None:
    q, p_M = readings(9)
    assert better_reading(NOMINAL, q, p_M[::-1]) is None


@pytest.mark.parametrize(("series", "arm"), [("ur10-real", "ur10"), ("ur10-real-d", "ur10"), ("ur5-real", "ur5")])
def test_real_readings_fit_their_arm_alone(series: str, arm: str) -> None:
    table = np.genfromtxt(
        ROOT / "tests" / "fixtures" / series / "readings.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    q = np.column_stack([table[f"q{number}"] for number in range(1, 7)])
    p_M = np.column_stack([table[name] for name in ("x_m", "y_m", "z_m")])
    profile = load_profile(ROOT / "profiles" / "ur10-ur5.yaml")
    arms = {"ur10": profile.arms["left"], "ur5": profile.arms["right"]}
    fits = {name: explained(nominal_arm(one), q, p_M).holds for name, one in arms.items()}
    assert fits == {name: name == arm for name in arms}
    assert len(arm_type_files()) > len(arms)


# -- The one least squares: it never ends above its start, and says whether it converged -------------------------------


def valley(x: Array) -> tuple[Array, Array]:
    """Residuals of a bent valley (Rosenbrock) and their derivatives; the minimum is at (1, 1)."""
    return np.array([1.0 - x[0], 10.0 * (x[0] ** 2 - x[1])]), np.array([[1.0, 0.0], [-20.0 * x[0], 10.0]])


def end(problem: LeastSquares[Array], start: list[float], steps: int = 50) -> Minimum[Linearised[Array]]:
    first = problem.reweighted(linearised(problem, start))
    return minimise(problem, first, tolerance=1e-10, max_iterations=steps)


def linearised(problem: LeastSquares[Array], start: list[float]) -> Linearised[Array]:
    return Linearised(np.array(start), *problem.linearised(np.array(start)))


@pytest.mark.parametrize("start", [[-1.2, 1.0], [30.0, -400.0], [-10.0, 10.0], [1.0, 1.0]])
@pytest.mark.parametrize("steps", [1, 2, 3, 500])
def test_the_end_is_never_above_the_start_and_says_whether_it_converged(start: list[float], steps: int) -> None:
    problem = LeastSquares(valley, np.add)
    found = end(problem, start, steps)
    assert problem.objective(found.point) <= problem.objective(linearised(problem, start))
    assert np.allclose(found.point.state, 1.0, atol=1e-8) or not found.converged
    assert found.converged or steps < 500
    assert found.message


def test_a_fit_that_did_not_converge_is_an_error_of_the_program_with_its_name() -> None:
    problem = LeastSquares(valley, np.add)
    with pytest.raises(
        NotConverged, match=r"fit of a valley did not converge: 2 steps .* promises .* no finding"
    ) as error:
        problem.best("fit of a valley", np.array([-1.2, 1.0]), max_iterations=2)
    assert not isinstance(error.value, InputError | CheckFailed)
    assert error.value.exit_code == 1


def test_a_step_that_is_short_by_damping_is_no_convergence() -> None:
    # derivatives of the opposite sign: no step lowers the objective, and damping makes the steps as short as you like
    problem = LeastSquares(lambda x: (x, np.eye(2)), lambda x, step: x + step)
    first = linearised(problem, [1.0, 2.0])
    found = minimise(problem, first, tolerance=1e-5, max_iterations=50)
    assert not found.converged
    assert problem.objective(found.point) <= problem.objective(first)
    assert "no step lowers the objective" in found.message


def test_a_candidate_whose_fit_fails_is_named_and_no_evidence() -> None:
    def fails() -> int:
        raise NotConverged.of("fit", "no reason")

    missed: list[str] = []
    assert tried("first", fails, missed) is None
    assert tried("second", lambda: 2, missed) == 2
    assert with_not_fitted("found nothing", missed) == "found nothing; not judged, as no fit of it converged: first"
    assert with_not_fitted("found nothing", []) == "found nothing"
