"""Where a tracker was moved to: the truth comes back, stated uncertainties hold, other motions are told apart."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partialmethod

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.estimation.calibration import pair_calibration
from cellapp.estimation.calibration.calibrate import station_change
from cellapp.estimation.calibration.identification import TooFewReadings, identify
from cellapp.estimation.calibration.least_squares import LeastSquares
from cellapp.estimation.calibration.pair_calibration import distances, identify_pair
from cellapp.estimation.calibration.registration import base_from_points
from cellapp.estimation.calibration.station_location import (
    ArmPoints,
    RoughStation,
    fit_station,
    predicted_points,
)
from cellapp.ground.errors import InputError, NotConverged
from cellapp.robot.effects import EFFECTS, EffectTerm, MeasurementConditions
from cellapp.robot.kinematics.chain import BASE_NAMES, JointAngles, base_twists, jacobian, smr_positions
from cellapp.robot.kinematics.statics import Bodies
from cellapp.robot.kinematics.transforms import (
    apply,
    invert,
    rotation_from_vector,
    rotation_vectors,
    rotation_zyx,
    transform,
)
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.model import PosteriorDraws, ReadingsNoise, relocated
from tests.arms import OFF_AXIS, SEVEN, UR5_CENTERS, UR5_MASSES, UR10, at_station, true_geometry

SIGMA_M = 20e-6
MOVED = transform(rotation_from_vector([0.02, -0.01, 0.3]), [0.4, -0.2, 0.05])
SECOND = transform(rotation_from_vector([0.0, 0.0, -1.2]), [3.1, -0.9, -0.7])
EXCESS = {"left": 0.0, "right": 0.0}
SCALE = EffectTerm(
    "tracker_scale", ("scale",), np.array([5e-5]), np.array([1e-6]), ("m/m",), EFFECTS["tracker_scale"].law()
)


def arm_model(geometry, nominal, posterior=None, effects=()):
    masses, centers = (UR5_MASSES, UR5_CENTERS) if geometry.joints == 6 else (np.ones(7), np.zeros((7, 3)))
    bodies = Bodies(masses, centers, 1.0, np.array([0.0, 0.0, 0.05]))
    return ArmModel(geometry, nominal, bodies, np.array([0.0, 0.0, 1.0]), effects=effects, posterior=posterior)


def truths(rng):
    """The true chains of a cell of two arms, one of them with seven joints."""
    nominals = {"left": at_station(UR10, OFF_AXIS), "right": at_station(SEVEN, OFF_AXIS, SECOND)}
    return nominals, {name: true_geometry(nominal, rng) for name, nominal in nominals.items()}


def identified(nominal, truth, rng, seed):
    """An arm identified from 60 readings, with draws of its uncertainty."""
    q = rng.uniform(-2.5, 2.5, (60, nominal.joints))
    found = identify(
        nominal, q, smr_positions(truth, q) + rng.normal(0.0, SIGMA_M, (60, 3)), sigma=np.full(60, SIGMA_M)
    )
    covariance = found.estimated_covariance
    draws = PosteriorDraws.of_covariance(found.estimated.columns, [], covariance, ReadingsNoise(SIGMA_M), (seed,))
    return arm_model(found.geometry, nominal, draws)


def measured(geometry, q, T, rng=None, sigma_m=SIGMA_M):
    p_M = apply(T, smr_positions(geometry, q))
    if rng is not None:
        p_M = p_M + rng.normal(0.0, sigma_m, p_M.shape)
    return ArmPoints(q, p_M, np.tile(sigma_m**2 * np.eye(3), (len(q), 1, 1)), MeasurementConditions())


def certain_cell(seed=0, effects=()):
    """A cell whose model is the truth."""
    nominals, truth = truths(np.random.default_rng(seed))
    return CellModel({name: arm_model(truth[name], nominals[name], effects=effects) for name in truth})


def drawn_points(model, counts, T, rng, noise=True):
    points = {}
    for name, count in counts.items():
        q = rng.uniform(-2.0, 2.0, (count, model.arms[name].geometry.joints))
        points[name] = measured(model.arms[name].geometry, q, T, rng if noise else None)
    return points


def near(T, rng, m=0.02, rad=0.01):
    return transform(rotation_from_vector(rng.normal(0.0, rad, 3)), rng.normal(0.0, m, 3)) @ T


def twist_of(T):
    return np.concatenate([T[:3, 3], rotation_vectors(T[None, :3, :3])[0]])


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), counts=st.sampled_from([{"left": 3}, {"left": 2, "right": 2}, {"right": 4}]))
def test_exact_points_give_the_true_station(seed, counts):
    rng = np.random.default_rng(seed)
    model = certain_cell()
    T = transform(rotation_from_vector(rng.uniform(-1.5, 1.5, 3)), rng.uniform(-3.0, 3.0, 3))
    points = drawn_points(model, counts, T, rng, noise=False)
    try:
        fit = fit_station(model, points, near(T, rng), excess_m=EXCESS)
    except InputError:  # drawn on one line
        return
    np.testing.assert_allclose(fit.T_new_old, T, atol=1e-8)
    assert fit.chi_squared < 1e-6
    assert fit.explains


def test_the_stated_uncertainty_of_station_and_of_predictions_holds():
    """Over 60 calibrated cells: chi-squared is chi-squared, errors are as large as stated, 95 % intervals hold."""
    chi, normalised, within, without = [], [], [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        nominals, truth = truths(rng)
        model = CellModel({name: identified(nominals[name], truth[name], rng, seed) for name in truth})
        points = {
            name: measured(truth[name], rng.uniform(-2.0, 2.0, (2, truth[name].joints)), MOVED, rng) for name in truth
        }
        fit = fit_station(model, points, near(MOVED, rng), excess_m=EXCESS, seed=(seed,))
        chi.append(fit.chi_squared)
        error = twist_of(MOVED @ invert(fit.T_new_old))
        normalised.append(error @ np.linalg.solve(fit.covariance, error))
        new = relocated(model, fit.T_new_old, fit.twists)
        for name, arm in new.arms.items():
            q = rng.uniform(-2.0, 2.0, (40, arm.geometry.joints))
            off = apply(MOVED, smr_positions(truth[name], q)) - arm.predict(q)
            within.append(np.abs(off) < 1.96 * arm.uncertainty(q)[:, None])
            bare = relocated(model, fit.T_new_old).arms[name]
            without.append(np.abs(off) < 1.96 * bare.uncertainty(q)[:, None])
    # means of 60 values of 6 degrees of freedom: standard deviation sqrt(12 / 60) = 0.45
    assert abs(np.mean(chi) - 6.0) < 1.6
    assert abs(np.mean(normalised) - 6.0) < 1.6
    assert 0.92 < np.mean(within) < 0.975
    assert np.mean(without) < np.mean(within) - 0.05, "the station's own uncertainty is no small part"


def test_the_draws_hold_the_covariance_of_the_station():
    rng = np.random.default_rng(3)
    nominals, truth = truths(rng)
    model = CellModel({name: identified(nominals[name], truth[name], rng, 3) for name in truth})
    points = {name: measured(truth[name], rng.uniform(-2.0, 2.0, (3, truth[name].joints)), MOVED) for name in truth}
    fit = fit_station(model, points, MOVED, excess_m=EXCESS)
    drawn = fit.twists.T @ fit.twists / len(fit.twists)
    scale = np.sqrt(np.diag(fit.covariance))
    assert np.abs((drawn - fit.covariance) / np.outer(scale, scale)).max() < 5.0 * np.sqrt(2.0 / len(fit.twists))


def test_a_moved_model_predicts_the_moved_points_with_the_same_spread():
    rng = np.random.default_rng(4)
    nominals, truth = truths(rng)
    model = CellModel({name: identified(nominals[name], truth[name], rng, 4) for name in truth})
    new = relocated(model, MOVED)
    assert new.T_M_M0 is not None
    back = relocated(new, invert(MOVED)).T_M_M0
    assert back is not None
    np.testing.assert_allclose(back, np.eye(4), atol=1e-12)
    for name, arm in new.arms.items():
        q = rng.uniform(-2.0, 2.0, (20, arm.geometry.joints))
        old = model.arms[name]
        np.testing.assert_allclose(arm.predict(q), apply(MOVED, old.predict(q)), atol=1e-12)
        np.testing.assert_allclose(arm.uncertainty(q), old.uncertainty(q), rtol=1e-6)
        assert arm.posterior is not None
        assert old.posterior is not None
        before = old.posterior.displacements(old.geometry, (), old.context(q))
        after = arm.posterior.displacements(arm.geometry, (), arm.context(q))
        np.testing.assert_allclose(after, before @ MOVED[:3, :3].T, atol=1e-12)
        np.testing.assert_allclose(arm.in_base().predict(q), old.in_base().predict(q), atol=1e-12)


@pytest.mark.parametrize("reference_axis", [0, 1, 2], ids=["x", "y", "z"])
def test_the_twist_of_each_base_parameter_is_what_it_does_to_points(reference_axis):
    rng = np.random.default_rng(reference_axis)
    geometry = replace(at_station(UR10, OFF_AXIS), reference_axis=reference_axis)
    q = rng.uniform(-2.0, 2.0, (5, 6))
    P, J = jacobian(geometry, JointAngles.of(q), tuple(range(len(BASE_NAMES))))
    twists = base_twists(geometry)
    moved = twists[:3, :, None] + np.cross(twists[3:].T[:, None], P.T[None], axis=2).transpose(2, 0, 1)
    np.testing.assert_allclose(J, moved, atol=1e-12)


def test_effects_of_the_tracker_act_in_its_new_frame():
    """A scale error lengthens what is far from the new station: the station comes out, not a mixture of both."""
    rng = np.random.default_rng(6)
    model = certain_cell(effects=(SCALE,))
    there = relocated(model, MOVED)
    points = {}
    for name, arm in there.arms.items():
        q = rng.uniform(-2.0, 2.0, (2, arm.geometry.joints))
        points[name] = ArmPoints(q, arm.predict(q), np.tile(1e-10 * np.eye(3), (2, 1, 1)), MeasurementConditions())
    fit = fit_station(model, points, near(MOVED, rng), excess_m=EXCESS)
    np.testing.assert_allclose(fit.T_new_old, MOVED, atol=1e-8)


def test_a_rough_station_lets_one_point_improve_the_next_prediction():
    rng = np.random.default_rng(7)
    model = certain_cell()
    guess = near(MOVED, rng, 0.05, 0.017)
    rough = RoughStation(guess, np.diag([0.05**2] * 3 + [0.017**2] * 3))
    points = drawn_points(model, {"left": 2}, MOVED, rng)
    one = {"left": ArmPoints(points["left"].q[:1], points["left"].measured_M[:1], *_rest(points["left"], 1))}
    fit = fit_station(model, one, guess, excess_m=EXCESS, rough=rough)
    expected = smr_positions(model.arms["left"].geometry, points["left"].q)
    off = [np.linalg.norm(apply(T, expected) - points["left"].measured_M, axis=1) for T in (guess, fit.T_new_old)]
    assert off[1][0] < 1e-4
    assert off[1][1] < off[0][1]


def _rest(points, count):
    return points.covariance_M[:count], points.conditions


def base_moved(model, name, motion):
    arm = model.arms[name]
    geometry = arm.geometry.with_T_M_B(motion @ arm.geometry.T_M_B())
    return replace(model, arms={**model.arms, name: replace(arm, geometry=geometry)})


def remounted(model, name, shift):
    arm = model.arms[name]
    geometry = replace(arm.geometry, tool=arm.geometry.tool + shift)
    return replace(model, arms={**model.arms, name: replace(arm, geometry=geometry)})


def bent(model, rng):
    left = model.arms["left"]
    other = left.geometry.with_vector(left.geometry.vector() + 2e-3 * rng.normal(size=len(left.geometry.vector())))
    return replace(model, arms={**model.arms, "left": replace(left, geometry=other)})


@pytest.mark.parametrize(
    "changed",
    [
        lambda model, rng: base_moved(model, "right", transform(np.eye(3), np.array([0.5e-3, 0.0, 0.0]))),
        lambda model, rng: remounted(model, "left", np.array([0.4e-3, 0.0, 0.3e-3])),
        bent,
    ],
    ids=["base", "smr", "arm"],
)
def test_no_motion_of_the_tracker_explains_what_moved_besides(changed):
    rng, model = np.random.default_rng(10), certain_cell()
    points = drawn_points(changed(model, rng), {"left": 4, "right": 4}, MOVED, rng)
    assert not fit_station(model, points, MOVED, excess_m=EXCESS).explains


def on_a_line(model, count):
    """Points of the seven-joint arm that lie on the line of its first axis."""
    q = np.zeros((count, 6))
    points = measured(model.arms["left"].geometry, q, MOVED)
    along = np.linspace(0.0, 1.0, count)[:, None] * np.array([0.6, 0.1, 0.2])
    return {"left": replace(points, measured_M=points.measured_M[:1] + along)}


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (lambda model: on_a_line(model, 4), "lie on one line"),
        (lambda model: drawn_points(model, {"left": 2}, MOVED, np.random.default_rng(0)), "2 points do not fix"),
        (lambda model: {"left": measured(model.arms["left"].geometry, np.zeros((4, 6)), MOVED)}, "of one place"),
        (lambda model: {}, "0 points do not fix"),
    ],
    ids=["one line", "two points", "one place", "none"],
)
def test_points_that_fix_no_station_are_refused(points, says):
    model = certain_cell()
    with pytest.raises(InputError, match=says):
        fit_station(model, points(model), MOVED, excess_m=EXCESS)


def test_the_other_arm_is_where_it_was_while_a_point_was_measured():
    model = certain_cell()
    points = drawn_points(model, {"left": 2, "right": 2}, MOVED, np.random.default_rng(1))
    at_home = {name: replace(own, other=("right", np.zeros((2, 7)))) for name, own in points.items() if name == "left"}
    expected = predicted_points(relocated(model, MOVED), {**points, **at_home})
    np.testing.assert_allclose(expected["left"], apply(MOVED, model.predict("left", points["left"].q)), atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_start_that_is_far_off_leads_to_the_same_station(seed):
    model, rng = certain_cell(), np.random.default_rng(seed)
    points = drawn_points(model, {"left": 4, "right": 4}, MOVED, rng)
    one, other = (fit_station(model, points, near(MOVED, rng, *size), excess_m=EXCESS) for size in ((0, 0), (0.3, 1.0)))
    np.testing.assert_allclose(other.T_new_old, one.T_new_old, atol=1e-8)
    assert other.chi_squared <= one.chi_squared * (1.0 + 1e-6)


def test_a_station_that_did_not_converge_is_an_error(monkeypatch):
    model, rng = certain_cell(), np.random.default_rng(0)
    points = drawn_points(model, {"left": 4, "right": 4}, MOVED, rng)
    monkeypatch.setattr(LeastSquares, "best", partialmethod(LeastSquares.best, max_iterations=1))
    far = near(MOVED, rng, 0.3, 1.0)
    with pytest.raises(NotConverged, match="the fit of the tracker's station did not converge: 1 steps"):
        fit_station(model, points, far, excess_m=EXCESS)


# -- Detection of a moved station: found where it moved, no false alarm where it did not -------------------------------


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("at", [60, 200, 333])
def test_a_moved_station_is_found_where_it_moved(seed, at):
    rng = np.random.default_rng(seed)
    nominal = at_station(UR10, OFF_AXIS, np.eye(4))
    q = rng.uniform(-3, 3, (400, 6))
    p_M = smr_positions(true_geometry(nominal, rng), q)
    assert station_change(smr_positions(nominal, q), p_M) is None
    moved = transform(rotation_from_vector(rng.normal(0.0, 0.05, 3)), rng.normal(0.0, 0.1, 3))
    p_M[at:] = apply(moved, p_M[at:])
    assert station_change(smr_positions(nominal, q), p_M) == pytest.approx(at, abs=2)


def test_few_points_are_not_judged():
    p = np.random.default_rng(0).normal(size=(8, 3))
    assert station_change(p, p) is None


# -- The inter-base transform from distances alone ---------------------------------------------------------------------


def cell(seed, n=100, noise=0.0):
    rng = np.random.default_rng(seed)
    T_R_L = transform(rotation_from_vector(rng.normal(0, 1.0, 3)), [0.1, -1.7, 0.2])
    p_L, p_R = rng.uniform(-1, 1, (n, 3)), rng.uniform(-0.8, 0.8, (n, 3))
    return rng, T_R_L, p_L, p_R, distances(T_R_L, p_L, p_R) + rng.normal(0.0, noise, n)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_exact_distances_give_the_exact_transform(seed):
    rng, T_R_L, p_L, p_R, measured = cell(seed)
    start = transform(rotation_from_vector(rng.normal(0, 0.02, 3)) @ T_R_L[:3, :3], T_R_L[:3, 3] + 0.02)
    found = identify_pair(start, p_L, p_R, measured)
    np.testing.assert_allclose(found.T_R_L, T_R_L, atol=1e-9)
    x, y, z, theta, beta, alpha = found.values
    np.testing.assert_allclose(transform(rotation_zyx(theta, beta, alpha), [x, y, z]), T_R_L, atol=1e-8)


def test_standard_errors_are_those_of_repetition():
    errors, stated = [], []
    for k in range(300):
        _, T_R_L, p_L, p_R, _ = cell(0)
        measured = distances(T_R_L, p_L, p_R) + np.random.default_rng(k).normal(0.0, 20e-6, 100)
        found = identify_pair(T_R_L, p_L, p_R, measured)
        errors.append(found.T_R_L[:3, 3] - T_R_L[:3, 3])
        stated.append(found.standard_errors[:3])
        assert found.scale == pytest.approx(20e-6, rel=0.35)
    np.testing.assert_allclose(np.std(errors, axis=0), np.mean(stated, axis=0), rtol=0.15)


def test_six_stops_are_refused():
    _, T_R_L, p_L, p_R, measured = cell(0, n=6)
    with pytest.raises(TooFewReadings, match="at least 7"):
        identify_pair(T_R_L, p_L, p_R, measured)


def square(T_R_L, p_L, p_R, measured):
    return float(np.sum((measured**2 - distances(T_R_L, p_L, p_R) ** 2) ** 2))


@pytest.mark.parametrize("seed", range(10))
def test_from_a_start_that_is_far_off_it_never_ends_above_it(seed, monkeypatch):
    rng, T_R_L, p_L, p_R, measured = cell(seed, noise=2e-5)
    start = transform(rotation_from_vector(rng.normal(0, 1.0, 3)) @ T_R_L[:3, :3], T_R_L[:3, 3] + rng.normal(0, 0.3, 3))
    found = identify_pair(start, p_L, p_R, measured)
    assert square(found.T_R_L, p_L, p_R, measured) <= square(start, p_L, p_R, measured)
    monkeypatch.setattr(pair_calibration, "_MOST_ITERATIONS", 1)
    with pytest.raises(NotConverged, match="inter-base transform from distances did not converge: 1 steps"):
        identify_pair(start, p_L, p_R, measured)


# -- A base from tracker points: the truth comes back, stated uncertainties hold, useless points are refused in words --

CORNERS = np.array([[0.8, 0.1, 0.3], [-0.2, 0.7, 0.9], [-0.6, -0.5, 0.2], [0.1, -0.4, 1.1]])
coordinate = st.floats(-10.0, 10.0)
turn = st.floats(-1.8, 1.8)  # per axis: rotation vectors up to about pi


@settings(max_examples=60, deadline=None)
@given(
    position=st.tuples(coordinate, coordinate, coordinate),
    vector=st.tuples(turn, turn, turn),
    count=st.sampled_from([3, 4]),
)
def test_exact_points_give_the_true_pose(position, vector, count) -> None:
    T = transform(rotation_from_vector(np.array(vector)), position)
    fit = base_from_points(CORNERS[:count], apply(T, CORNERS[:count]))
    assert np.allclose(fit.T_M_B, T, atol=1e-9)
    assert fit.rms < 1e-9
    assert fit.sentence.endswith("; good")


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_base_does_not_depend_on_the_order_of_the_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p_M = apply(transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)), CORNERS)
    p_M += rng.normal(scale=1e-3, size=p_M.shape)
    order = rng.permutation(4)
    fit, other = base_from_points(CORNERS, p_M), base_from_points(CORNERS[order], p_M[order])
    assert np.allclose(fit.T_M_B, other.T_M_B, atol=1e-9)
    assert math.isclose(fit.position_error, other.position_error, rel_tol=1e-6)
    assert order[other.worst] == fit.worst


@pytest.mark.parametrize("noise_m", [20e-6, 1e-3, 5e-3])
def test_errors_are_as_large_as_stated(noise_m: float) -> None:
    """Over many surveys the mean square of the true error is that of the stated one, for position and angle."""
    rng = np.random.default_rng(5)
    T = transform(rotation_from_vector([0.4, -0.2, 2.0]), [3.0, -1.0, 0.6])
    ratios = []
    for _ in range(400):
        p_M = apply(T, CORNERS) + rng.normal(scale=noise_m, size=CORNERS.shape)
        fit = base_from_points(CORNERS, p_M)
        off = invert(T) @ fit.T_M_B
        true = (np.sum((fit.T_M_B[:3, 3] - T[:3, 3]) ** 2), np.sum(rotation_vectors(off[None, :3, :3]) ** 2))
        ratios.append((*true, fit.position_error**2, fit.angle_error**2))
    position, angle, stated_position, stated_angle = np.mean(ratios, axis=0)
    assert position / stated_position == pytest.approx(1.0, abs=0.2)
    assert angle / stated_angle == pytest.approx(1.0, abs=0.2)


def test_a_poor_point_is_named() -> None:
    p_M = CORNERS.copy()
    p_M[2, 1] += 0.05
    fit = base_from_points(CORNERS, p_M)
    assert "poor: check point 3, off by" in fit.sentence


@pytest.mark.parametrize(
    ("p_B", "p_M", "words"),
    [
        (CORNERS[:2], CORNERS[:2], "2 points do not fix a base; measure at least 3"),
        (np.zeros((4, 3)), CORNERS, "lie within 0 mm of one place in the base frame"),
        (CORNERS, np.ones((4, 3)), "of one place in the tracker frame"),
        (np.outer([0.0, 0.3, 0.7, 1.0], [1.0, 2.0, 0.5]), CORNERS, "on one line in the base frame"),
        (CORNERS, CORNERS[[1, 0, 2, 3]], "check units, the order of the points"),
        (CORNERS, CORNERS * 1000.0, "check units"),
        (CORNERS, CORNERS * [1, 1, -1], "check units"),
    ],
)
def test_useless_points_are_refused(p_B, p_M, words: str) -> None:
    with pytest.raises(InputError, match=words):
        base_from_points(p_B, p_M)
