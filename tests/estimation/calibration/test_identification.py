"""Identification recovers simulated arms within the stated uncertainty and reports failures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration import normal_equations
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.identification import (
    TooFewReadings,
    identify,
    identify_with_excess,
    start_from_nominal,
)
from cellapp.estimation.calibration.normal_equations import EffectColumns, Observations, with_gradient
from cellapp.estimation.calibration.parameters import ParameterSet, auto_set, candidate_columns, full_set, paper_set
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.calibration.weights import whitener
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import fit_terms
from cellapp.estimation.discovery.terms import ModelTerm
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import NotConverged
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import JointAngles, jacobian, nominal_geometry, smr_positions
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm, up_in_tracker
from drivers.plant import GeometryErrors
from tests.arms import OFF_AXIS, ON_AXIS, SEVEN, UR5, UR10, at_station, dh, plant_of, true_geometry
from tests.series import series
from tests.twin import PROFILES

pytestmark = pytest.mark.fast

SIGMA = 15e-6


def measured(rows, tool, seed, n, sigma=SIGMA):
    """A true arm, its nominal one, random configurations and noisy points."""
    rng = np.random.default_rng(seed)
    nominal = at_station(rows, tool)
    truth = true_geometry(nominal, rng)
    q = rng.uniform(-3, 3, (n, len(rows)))
    return nominal, truth, q, smr_positions(truth, q) + rng.normal(0.0, sigma, (n, 3))


@pytest.mark.parametrize(
    ("rows", "tool", "rank"),
    [(UR10, OFF_AXIS, 27), (UR10, ON_AXIS, 25), (UR5, OFF_AXIS, 27), (UR5, ON_AXIS, 25), (SEVEN, OFF_AXIS, 31)],
    ids=["UR10", "UR10 on the axis", "UR5", "UR5 on the axis", "seven joints"],
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


def test_shares_of_readings_that_determine_less_than_the_columns_are_those_of_least_norm():
    # six readings give 18 coordinates; whether elimination meets an exact zero depends on the linear algebra library
    rows = np.array([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]])
    chosen = ParameterSet("given", 6, (0, 1), (2,), scaled_information=rows.T @ rows, unit=np.ones(3))
    np.testing.assert_allclose(chosen.shares, [[0.5], [0.5]])


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
    off = np.linalg.norm(smr_positions(found.geometry, new) - smr_positions(truth, new), axis=1)
    k = len(found.names)
    assert np.sqrt(np.mean(off**2)) < 1.5 * SIGMA * np.sqrt(k / 400)  # the error that k parameters of noise leave


def test_the_full_set_predicts_as_well_as_the_identifiable_one():
    nominal, _, q, p_M = measured(UR10, OFF_AXIS, seed=3, n=100)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    full, auto = (identify(start, q, p_M, parameter_set=name) for name in ("full", "auto"))
    assert full.converged
    assert auto.converged
    new = np.random.default_rng(4).uniform(-3, 3, (300, 6))
    gap = np.linalg.norm(smr_positions(full.geometry, new) - smr_positions(auto.geometry, new), axis=1)
    assert gap.max() < 2e-6


def test_a_parameter_set_without_alpha5_cannot_reach_the_noise():
    nominal, _, q, p_M = measured(UR10, OFF_AXIS, seed=3, n=400)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    assert identify(start, q, p_M, parameter_set="paper").scale > 1.3 * identify(start, q, p_M).scale


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
    errors = [
        np.linalg.norm(smr_positions(found.geometry, new) - smr_positions(truth, new), axis=1).mean()
        for found in (weighted, plain)
    ]
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

    def error(found):
        return np.linalg.norm(smr_positions(found.geometry, new) - smr_positions(truth, new), axis=1).mean()

    kept, plain = identify(start, q, p_M, robust=robust), identify(start, q, p_M)
    assert kept.converged
    assert error(kept) < 0.25 * error(plain)
    assert np.median(kept.weights[bad]) < 0.2 < np.median(np.delete(kept.weights, bad))


def test_priors_determine_what_the_data_do_not():
    # nine readings, 27 parameters, 27 coordinates: without priors any noise is fitted
    nominal, truth, q, p_M = measured(UR10, OFF_AXIS, seed=7, n=9)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    names = identify(start, *measured(UR10, OFF_AXIS, 7, 60)[2:]).names
    priors = {name: 0.3e-3 if name[0] in "ad" and not name.startswith("alpha") else 1e-3 for name in names}
    for free in ("x0", "y0", "z0", "alpha0", "beta0", "theta0", "tx", "ty", "tz"):
        del priors[free]
    found = identify(start, q, p_M, sigma=np.full(9, SIGMA), prior_sigma=priors, prior_mean=start)
    new = np.random.default_rng(8).uniform(-3, 3, (300, 6))
    error = np.linalg.norm(smr_positions(found.geometry, new) - smr_positions(truth, new), axis=1)
    assert found.converged
    assert error.mean() < 2e-3


def test_the_tool_and_base_are_found_without_a_guess():
    rng = np.random.default_rng(9)
    truth = at_station(UR10, np.array([0.12, -0.07, 0.15]))
    q = rng.uniform(-3, 3, (50, 6))
    unknown = nominal_geometry(UR10, np.zeros(3))
    start = start_from_nominal(unknown, q, smr_positions(truth, q), tool_unknown=True)
    np.testing.assert_allclose(start.tool, truth.tool, atol=1e-7)
    np.testing.assert_allclose(start.T_M_B(), truth.T_M_B(), atol=1e-7)


def test_rows_in_chunks_give_the_same_result(monkeypatch):
    nominal, _, q, p_M = measured(UR10, OFF_AXIS, seed=10, n=700)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    sigma = np.random.default_rng(0).uniform(10e-6, 20e-6, 700)
    whole = identify(start, q, p_M, sigma=sigma)
    monkeypatch.setattr(normal_equations, "_CHUNK", 64)
    chunked = identify(start, q, p_M, sigma=sigma)
    np.testing.assert_allclose(chunked.values, whole.values, atol=1e-10)
    np.testing.assert_allclose(chunked.standard_errors, whole.standard_errors, rtol=1e-6)
    np.testing.assert_allclose(chunked.residuals, whole.residuals, atol=1e-9)


def test_effects_are_identified_with_the_geometry():
    rng = np.random.default_rng(11)
    nominal = at_station(UR10, OFF_AXIS)
    truth = true_geometry(nominal, rng)
    q = rng.uniform(-3, 3, (300, 6))
    offsets, shift = np.stack([np.sin(3.0 * q[:, 1]), np.cos(2.0 * q[:, 2])]), np.zeros((1, 3, 300))
    shift[0, 2, 150:] = 1.0
    turned = q.copy()
    turned[:, 1] += 2e-3 * offsets[0]
    turned[:, 0] -= 1e-3 * offsets[1]
    p_M = smr_positions(truth, turned) + 5e-4 * shift[0].T + rng.normal(0, SIGMA, (300, 3))
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    columns = EffectColumns(("one", "two", "step"), ("rad", "rad", "m"), np.array([1, 0]), offsets, shift)
    found = identify(start, q, p_M, effects=columns)
    assert found.converged
    off = found.effect_values - [2e-3, -1e-3, 5e-4]
    assert np.all(np.abs(off) < 5 * found.standard_errors[-3:])
    assert found.standard_errors[-3:].max() < 5e-6
    assert found.scale == pytest.approx(SIGMA, rel=0.1)


@pytest.mark.parametrize("weights", ["none", "alike", "different", "covariances"])
def test_a_gradient_is_that_of_the_normal_equations(weights):
    rng = np.random.default_rng(14)
    geometry, q, p_M = measured(UR10, OFF_AXIS, seed=14, n=50)[1:]
    sigma = rng.uniform(1e-5, 3e-5, 50) * (weights == "different") + 2e-5
    if weights == "covariances":
        spread = rng.normal(size=(50, 3, 3)) * 1e-5
        sigma = spread @ spread.transpose(0, 2, 1) + 1e-10 * np.eye(3)
    effects = EffectColumns(
        ("one", "two", "step"), ("rad", "rad", "m"), np.array([1, 0]), np.sin(q[:, 1:3].T), rng.normal(size=(1, 3, 50))
    )
    white = None if weights == "none" else whitener(sigma)
    observations = Observations(JointAngles.of(q), q, p_M.T, white, effects)
    parameters = paper_set(geometry)
    near = np.concatenate([geometry.vector()[list(parameters.columns)], np.zeros(3)])
    values = near + 1e-4 * rng.normal(size=len(near))
    at_start = normal_equations.normal_equations(geometry, observations, parameters, near, None)
    wanted = normal_equations.normal_equations(geometry, observations, parameters, values, None)
    found = with_gradient(at_start, geometry, observations, parameters, values)
    np.testing.assert_allclose(found.b, wanted.b, rtol=1e-9, atol=1e-12 * np.abs(wanted.b).max())
    np.testing.assert_allclose(found.residuals, wanted.residuals, atol=1e-15)
    assert found.cost == pytest.approx(wanted.cost)
    assert found.A is at_start.A


def test_too_few_readings_are_refused_with_the_number_needed():
    nominal, _, q, p_M = measured(UR10, OFF_AXIS, seed=12, n=8)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    with pytest.raises(TooFewReadings, match=r"8 readings give 24 coordinates for \d+ parameters; measure at least"):
        identify(start, q, p_M, parameter_set="paper")


def test_failure_to_converge_is_reported():
    nominal, _, q, p_M = measured(UR10, OFF_AXIS, seed=13, n=100)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    found = identify(start, q, p_M, max_iterations=1)
    assert not found.converged
    assert found.message.startswith("1 steps were not enough; the next step, ")


def test_observability_falls_when_a_joint_hardly_moves():
    nominal, _, q, p_M = measured(UR10, OFF_AXIS, seed=14, n=200)
    still = q.copy()
    still[:, 3] = 0.3 + 0.05 * q[:, 3]
    wide, narrow = identify(nominal, q, p_M), identify(nominal, still, smr_positions(nominal, still))
    assert narrow.condition > 3.0 * wide.condition
    for index in ("O1", "O2", "O3", "O4", "O5"):
        assert narrow.observability[index] < wide.observability[index]
    assert 1.0 / wide.observability["O2"] == pytest.approx(wide.condition)


def test_the_scatter_is_that_of_the_noise_for_a_scara_with_two_parallel_axes():
    # all three axes vertical; only three joints: no arm-specific number anywhere
    rows = dh([0.0] * 3, [0.4, 0.0, 0.1], [0.325, 0.225, 0.0], [0.0, 0.0, 0.0])
    nominal, _, q, p_M = measured(rows, np.array([0.05, 0.0, -0.1]), seed=15, n=200)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    found = identify(start, q, p_M)
    assert found.converged
    squares = found.scale**2 / SIGMA**2 * found.degrees_of_freedom
    assert chi2.cdf(squares, found.degrees_of_freedom) == pytest.approx(0.5, abs=0.499)


def test_the_noise_free_plant_is_fitted_to_below_a_nanometre():
    # the truth is lines in space displaced and tilted, not a table: the model must be complete
    for seed in range(3):
        plant = plant_of(UR5, OFF_AXIS, errors=GeometryErrors(0.3e-3, 1e-3, 5e-3, 5e-3, 1e-3), seed=seed)
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
    found, excess = identify_with_excess(start, q, p_M, sigma=sigma)
    assert excess == pytest.approx(0.3e-3, rel=0.1)
    assert found.scale == pytest.approx(1.0, abs=0.02)
    assert found.iterations == len(found.steps) > trusting.iterations
    new = np.random.default_rng(17).uniform(-3, 3, (300, 6))

    def error(geometry):
        return np.linalg.norm(smr_positions(geometry, new) - smr_positions(truth, new), axis=1).mean()

    assert error(found.geometry) < 0.85 * error(trusting.geometry)
    # where the statement is right, nothing is added
    nominal, _, q, p_M = measured(UR10, OFF_AXIS, seed=18, n=300)
    start = start_from_nominal(nominal, q, p_M, tool_unknown=False)
    assert identify_with_excess(start, q, p_M, sigma=np.full(300, SIGMA))[1] == 0.0


def weighted_square(geometry, nominal, q, p_M, prior):
    """The objective of an identification with stated priors and uncertainty."""
    off = (geometry.vector() - nominal.vector()) / prior
    return float(np.sum((p_M - smr_positions(geometry, q)) ** 2) / SIGMA**2 + off @ off)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("steps", [1, 3, 50])
def test_from_a_start_that_is_far_off_it_never_ends_above_it(seed, steps):
    # 0.3 m and 1 rad beside the base, the tool and every length: with steps of any size no end is worse than the start
    nominal, _, q, p_M = measured(UR10, OFF_AXIS, seed=seed, n=60)
    rng = np.random.default_rng(seed)
    chosen = paper_set(nominal)
    prior = np.full(len(nominal.vector()), 0.5)
    vector = nominal.vector()
    vector[list(chosen.columns)] += [rng.normal(0.0, 0.3 if unit == "m" else 1.0) for unit in chosen.units]
    start = nominal.with_vector(vector)
    sigmas = dict.fromkeys(chosen.names, 0.5)
    found = identify(
        start, q, p_M, sigma=np.full(60, SIGMA), parameter_set=chosen, prior_sigma=sigmas, prior_mean=nominal,
        max_iterations=steps,
    )  # fmt: skip
    before, after = (weighted_square(one, nominal, q, p_M, prior) for one in (start, found.geometry))
    assert after <= before
    if found.converged:
        assert found.scale < 3.0
    else:
        with pytest.raises(NotConverged, match=r"the fit did not converge: .*calibration\.max_iterations"):
            found.settled("fit")


def test_a_profile_that_allows_too_few_steps_ends_with_an_error_that_names_the_arm():
    profile = load_profile(PROFILES / "twin-small.yaml")
    one = series(1, 60)["left"]
    readings = Readings(
        configuration=np.arange(60), time_s=np.arange(60.0), q=one.q, approach=np.zeros((60, 6), np.int8), p_M=one.p_M,
        split=tuple("identify" if k % 3 else "validate" for k in range(60)),
    )  # fmt: skip
    few = profile.model_copy(update={"calibration": profile.calibration.model_copy(update={"max_iterations": 1})})
    with pytest.raises(NotConverged, match="arm 'left': the identification did not converge: 1 steps were not enough"):
        calibrate_arm(few, "left", readings)


def test_a_joint_fit_that_did_not_converge_is_no_model():
    profile = load_profile(PROFILES / "twin-small.yaml")
    arm = profile.arms["left"]
    one = series(1, 60)["left"]
    readings = Readings(
        configuration=np.arange(60), time_s=np.arange(60.0), q=one.q, approach=np.zeros((60, 6), np.int8), p_M=one.p_M
    )
    geometry = start_from_nominal(nominal_arm(arm), one.q, one.p_M, tool_unknown=False)
    model = ArmModel(geometry, geometry, bodies_of(arm), up_in_tracker(profile))
    data = ArmData.of(profile, model, readings, measurement_conditions(readings))
    few = profile.model_copy(update={"calibration": profile.calibration.model_copy(update={"max_iterations": 1})})
    law = EFFECTS["joint_compliance"].laws(data.context)[0]
    terms = (ModelTerm("joint_compliance", law, tuple(one.name for one in data.columns("joint_compliance", law))),)
    with pytest.raises(NotConverged, match="the fit of geometry and effects did not converge: 1 steps"):
        fit_terms(replace(data, profile=few), terms)
