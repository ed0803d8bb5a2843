"""Where a tracker was moved to: the truth comes back, stated uncertainties hold, other motions are told apart."""

from __future__ import annotations

from dataclasses import replace
from functools import partialmethod

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cellapp.estimation.calibration import pair_calibration
from cellapp.estimation.calibration.calibrate import station_change
from cellapp.estimation.calibration.identification import TooFewReadings, identify
from cellapp.estimation.calibration.least_squares import LeastSquares
from cellapp.estimation.calibration.pair_calibration import distances, identify_pair
from cellapp.estimation.calibration.station_location import (
    NestPoint,
    TooFewNests,
    base_from_points,
    fit_station,
    tie_stations,
)
from cellapp.ground.errors import InputError, NotConverged
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.statics import Bodies
from cellapp.robot.kinematics.transforms import apply, invert, rotation_from_vector, rotation_vectors, transform
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.model import PosteriorSamples, ReadingsNoise, relocated
from tests.arms import OFF_AXIS, SEVEN, UR5_CENTERS, UR5_MASSES, UR10, at_station, true_geometry
from tests.series import readings_at

SIGMA_M = 20e-6
MOVED = transform(rotation_from_vector([0.02, -0.01, 0.3]), [0.4, -0.2, 0.05])
SECOND = transform(rotation_from_vector([0.0, 0.0, -1.2]), [3.1, -0.9, -0.7])
EXCESS = {"left": 0.0, "right": 0.0}


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
    draws = PosteriorSamples.of_covariance(found.estimated.columns, [], covariance, ReadingsNoise(SIGMA_M), (seed,))
    return arm_model(found.geometry, nominal, draws)


def measured(geometry, q, T, rng=None, sigma_m=SIGMA_M):
    p_M = apply(T, smr_positions(geometry, q))
    if rng is not None:
        p_M = p_M + rng.normal(0.0, sigma_m, p_M.shape)
    return readings_at(q, p_M, covariance_M=np.tile(sigma_m**2 * np.eye(3), (len(q), 1, 1)))


def certain_cell(seed=0, effects=()):
    """A cell whose model is the truth."""
    nominals, truth = truths(np.random.default_rng(seed))
    return CellModel({name: arm_model(truth[name], nominals[name], effects=effects) for name in truth})


def sampled_points(model, counts, T, rng, noise=True):
    points = {}
    for name, count in counts.items():
        q = rng.uniform(-2.0, 2.0, (count, model.arms[name].geometry.joints))
        points[name] = measured(model.arms[name].geometry, q, T, rng if noise else None)
    return points


def near(T, rng, m=0.02, rad=0.01):
    return transform(rotation_from_vector(rng.normal(0.0, rad, 3)), rng.normal(0.0, m, 3)) @ T


def twist_of(T):
    return np.concatenate([T[:3, 3], rotation_vectors(T[None, :3, :3])[0]])


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), counts=st.sampled_from([{"left": 3}, {"left": 2, "right": 2}, {"right": 4}]))
def test_exact_points_give_the_true_station(seed, counts):
    rng = np.random.default_rng(seed)
    model = certain_cell()
    T = transform(rotation_from_vector(rng.uniform(-1.5, 1.5, 3)), rng.uniform(-3.0, 3.0, 3))
    points = sampled_points(model, counts, T, rng, noise=False)
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


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("right", lambda true, rng: true.with_T_M_B(transform(np.eye(3), [0.5e-3, 0.0, 0.0]) @ true.T_M_B())),
        ("left", lambda true, rng: replace(true, tool=true.tool + np.array([0.4e-3, 0.0, 0.3e-3]))),
        ("left", lambda true, rng: true.with_vector(true.vector() + 2e-3 * rng.normal(size=len(true.vector())))),
    ],
    ids=["base", "smr", "arm"],
)
def test_no_motion_of_the_tracker_explains_what_moved_besides(name, changed):
    rng, model = np.random.default_rng(10), certain_cell()
    other = replace(model.arms[name], geometry=changed(model.arms[name].geometry, rng))
    now = replace(model, arms={**model.arms, name: other})
    points = sampled_points(now, {"left": 4, "right": 4}, MOVED, rng)
    assert not fit_station(model, points, MOVED, excess_m=EXCESS).explains


def on_a_line(model, count):
    """Points of the seven-joint arm that lie on the line of its first axis."""
    q = np.zeros((count, 6))
    points = measured(model.arms["left"].geometry, q, MOVED)
    along = np.linspace(0.0, 1.0, count)[:, None] * np.array([0.6, 0.1, 0.2])
    return {"left": replace(points, p_M=points.p_M[:1] + along)}


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (lambda model: on_a_line(model, 4), "lie on one line"),
        (lambda model: sampled_points(model, {"left": 2}, MOVED, np.random.default_rng(0)), "2 points do not fix"),
        (lambda model: {"left": measured(model.arms["left"].geometry, np.zeros((4, 6)), MOVED)}, "of one place"),
        (lambda model: {}, "0 points do not fix"),
    ],
    ids=["one line", "two points", "one place", "none"],
)
def test_points_that_fix_no_station_are_refused(points, says):
    model = certain_cell()
    with pytest.raises(InputError, match=says):
        fit_station(model, points(model), MOVED, excess_m=EXCESS)


def test_a_station_that_did_not_converge_is_an_error(monkeypatch):
    model, rng = certain_cell(), np.random.default_rng(0)
    points = sampled_points(model, {"left": 4, "right": 4}, MOVED, rng)
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


# -- The inter-base transform from distances alone ---------------------------------------------------------------------


def cell(seed, n=100, noise=0.0):
    rng = np.random.default_rng(seed)
    T_R_L = transform(rotation_from_vector(rng.normal(0, 1.0, 3)), [0.1, -1.7, 0.2])
    p_L, p_R = rng.uniform(-1, 1, (n, 3)), rng.uniform(-0.8, 0.8, (n, 3))
    return rng, T_R_L, p_L, p_R, distances(T_R_L, p_L, p_R) + rng.normal(0.0, noise, n)


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


# -- Stations tied by reference nests ----------------------------------------------------------------------------------


SIGMA = 2e-5
TRUE = {
    "north": np.eye(4),
    "south": transform(Rotation.from_euler("z", 2.0).as_matrix(), [3.0, 1.0, 0.1]),
    "west": transform(Rotation.from_euler("zx", [-1.0, 0.02]).as_matrix(), [-2.0, 2.0, 0.0]),
}


def points(seed: int, seen: dict[str, range], sigma: float = SIGMA) -> list[NestPoint]:
    rng = np.random.default_rng(seed)
    nests = np.random.default_rng(0).uniform(-2.5, 2.5, (8, 3))
    return [
        NestPoint(name, f"F{k}", apply(invert(TRUE[name]), nests[k : k + 1])[0] + sigma * rng.standard_normal(3), SIGMA)
        for name, numbers in seen.items()
        for k in numbers
    ]


def test_exact_points_give_the_true_poses() -> None:
    seen = {"north": range(5), "south": range(2, 7), "west": range(4, 8)}
    ties = tie_stations("north", points(0, seen, sigma=0.0))
    assert list(ties) == ["south", "west"]
    for name, tie in ties.items():
        np.testing.assert_allclose(tie.T, TRUE[name], atol=1e-9)
        assert tie.residual_m.max() < 1e-9
    assert ties["west"].nests == ("F4", "F5", "F6")


@pytest.mark.parametrize("seen", [{"north": range(2), "south": range(4)}, {"north": range(3), "south": range(4, 8)}])
def test_a_station_that_is_not_tied_is_named(seen: dict[str, range]) -> None:
    with pytest.raises(TooFewNests, match="station south shares fewer than 3 nests"):
        tie_stations("north", points(0, seen))
