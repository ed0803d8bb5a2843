"""The geometry uses all parameters with priors, as good as a plain reference; the table states what is determined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from cellapp.estimation.calibration.identification import identify, identify_with_excess, start_from_nominal
from cellapp.estimation.calibration.parameters import auto_set, full_set
from cellapp.robot.kinematics.chain import parallel_rows, parameter_names, parameter_unit, smr_positions
from tests.arms import HALF_TURN, OFF_AXIS, SEVEN, UR5, UR10, at_station, dh, true_geometry

# an elbow arm with offsets whose axes 2 and 3 are anti-parallel, as tables of some makers have it
ELBOW = dh(
    [0.0] * 6,
    [0.4, 0.0, 0.0, 0.35, 0.0, 0.1],
    [0.18, 0.6, 0.12, 0.0, 0.0, 0.0],
    [-HALF_TURN, np.pi, -HALF_TURN, HALF_TURN, -HALF_TURN, 0.0],
)
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
@pytest.mark.parametrize(("n", "sigma"), [(60, 30e-6), pytest.param(300, 15e-6, marks=pytest.mark.long)])
@pytest.mark.parametrize(("length", "angle"), [(LENGTH, ANGLE), (1e-3, 10e-3)], ids=["usual errors", "large errors"])
def test_on_narrow_ranges_it_is_as_good_as_a_reference_that_knows_noise_and_priors(rows, n, sigma, length, angle):
    ratios = []
    for seed in range(4):
        data = Narrow(rows, seed, n, sigma, length, angle)
        found = identify(data.start, data.q, data.p_M)
        assert found.converged
        ratios.append(data.error(found.geometry) / data.error(reference(data, sigma, length, angle)))
    assert np.exp(np.mean(np.log(ratios))) < 1.05


@pytest.mark.fast
@settings(max_examples=15, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), make=st.sampled_from(sorted(ARMS)))
def test_all_parameters_predict_no_worse_than_the_determined_ones(seed, make):
    data = Narrow(ARMS[make], seed, 100, 20e-6)
    found = identify(data.start, data.q, data.p_M)
    fewer = identify(data.start, data.q, data.p_M, parameter_set=found.parameter_set)
    assert data.error(found.geometry) < 1.05 * data.error(fewer.geometry)


@pytest.mark.fast
def test_anti_parallel_axes_have_a_hayati_angle_and_their_rank():
    geometry = at_station(ELBOW, OFF_AXIS)
    assert parallel_rows(geometry) == (1,)
    q = np.random.default_rng(0).uniform(-3, 3, (200, 6))
    assert len(auto_set(geometry, q).columns) == 27  # four numbers an axis and three of the point
    assert "beta2" in auto_set(geometry, q).names


@pytest.mark.fast
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


@pytest.mark.fast
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


@pytest.mark.fast
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


def test_the_uncertainty_of_predictions_covers_what_the_table_does_not_state():
    squares = []
    for seed in range(12):
        data = Narrow(UR5, seed, 60, 20e-6)
        found = identify(data.start, data.q, data.p_M)
        from_all = _prediction_covariance(found, data.new)
        off = data.true_M - smr_positions(found.geometry, data.new)
        squares.append(np.mean(np.einsum("na,nab,nb->n", off, np.linalg.inv(from_all), off)) / 3.0)
    assert 0.6 < np.mean(squares) < 1.6


def _prediction_covariance(found, q):
    """Covariance (n, 3, 3) of computed positions by differences."""
    vector, columns = found.geometry.vector(), found.estimated.columns
    J = []
    for column in columns:
        step = np.zeros(len(vector))
        step[column] = 1e-6
        ahead, behind = (smr_positions(found.geometry.with_vector(vector + sign * step), q) for sign in (1, -1))
        J.append((ahead - behind) / 2e-6)
    return np.einsum("kna,kl,lnb->nab", J, found.estimated_covariance, J, optimize=True)


@pytest.mark.fast
def test_of_two_minima_on_either_side_of_the_wrist_the_better_one_is_returned():
    # the last axis keeps its direction, and curves of the joints stand for unmodelled physics
    rng = np.random.default_rng(2)
    nominal = at_station(UR10, np.array([0.0, 0.0, 0.1]))
    q = rng.uniform(-1.0, 1.0, (60, 6)) * [1.0, 0.6, 0.6, 0.0, 0.0, 0.0] + [0.9, -1.2, 1.4, 0.0, 0.0, -HALF_TURN]
    q[:, 3], q[:, 4] = -q[:, 1] - q[:, 2], q[:, 0]
    truth = true_geometry(nominal, rng, 0.5e-3, 1e-3)
    p_M = smr_positions(truth, q + 0.5e-3 * np.sin(5.0 * q)) + rng.normal(0.0, 30e-6, (60, 3))
    plain = [identify(at_station(UR10, np.array([0.0, 0.0, z])), q, p_M) for z in (0.1, -0.3)]
    both, _ = identify_with_excess(nominal, q, p_M, sigma=None)
    assert all(found.converged for found in (both, *plain))
    assert abs(both.geometry.tool[2] - plain[0].geometry.tool[2]) > 0.05
    rms = [np.sqrt(np.mean(found.residuals**2)) for found in (both, *plain)]
    assert rms[0] <= min(rms[1:]) * 1.001


@pytest.mark.fast
def test_a_set_by_name_has_no_priors_of_its_own():
    data = Narrow(UR10, 4, 60, 20e-6)
    full = identify(data.start, data.q, data.p_M, parameter_set="full")
    same = identify(data.start, data.q, data.p_M, parameter_set=full_set(data.start))
    np.testing.assert_array_equal(full.values, same.values)
    assert full.names == full.estimated.names
