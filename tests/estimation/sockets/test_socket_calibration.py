"""Calibration from a ball in sockets finds the true arm, up to what sockets cannot show, and says what that is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.estimation.calibration.calibrate import calibrate_arm, missing_splits
from cellapp.estimation.sockets import Contacts, gauge_errors, measured_positions
from cellapp.robot.kinematics.chain import Geometry, smr_positions
from cellapp.robot.kinematics.transforms import apply, register
from tests.estimation.sockets.led_arm import SEATING_M, Led, led, panda


def away_from_truth(arm: Led, geometry: Geometry) -> float:
    """Mean error [m] at the postures of the readings after the base was put where it fits."""
    computed, true = smr_positions(geometry, arm.readings.q), arm.true(arm.readings.q)
    return float(np.linalg.norm(apply(register(true, computed), computed) - true, axis=1).mean())


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_the_true_arm_is_found(seed: int) -> None:
    arm = led(seed, gauge_m=0.4)
    found, notes = calibrate_arm(panda(), "left", arm.readings)
    assert found.identification.converged
    nominal = found.validate["nominal"].position_mm.mean
    held_out = found.validate["geometry"]
    assert held_out.position_mm.mean < 0.1 < 0.3 * nominal
    assert held_out.gauge_mm is not None
    assert held_out.gauge_mm.mean < 0.1
    assert away_from_truth(arm, found.identification.geometry) < 2.5e-4
    # seating in every coordinate, with a ninth of it lost to the points and the geometry
    assert found.excess_m == pytest.approx(SEATING_M, rel=0.15)
    assert not found.left_out
    assert any("theta1 and d1" in note for note in notes)
    assert any("fix the scale" in note for note in notes)


def test_the_base_is_none_of_the_parameters() -> None:
    found, _ = calibrate_arm(panda(), "left", led(1, gauge_m=0.4).readings)
    assert not {"x0", "y0", "z0", "theta1", "d1"} & set(found.identification.names)
    np.testing.assert_array_equal(found.identification.geometry.T_M_B(), np.eye(4))
    assert np.isfinite(found.identification.standard_errors).all()


def test_without_a_distance_the_scale_is_said_to_be_unseen() -> None:
    arm = led(1, gauge_m=0.4)
    found, notes = calibrate_arm(panda(), "left", replace(arm.readings, distances=()))
    assert any("the scale is not seen" in note for note in notes)
    assert found.validate["geometry"].gauge_mm is None
    assert found.validate["geometry"].position_mm.mean < 0.1


def test_a_longer_distance_fixes_the_scale_better() -> None:
    short, long = (led(1, gauge_m=length) for length in (0.05, 0.4))
    words = []
    for arm in (short, long):
        _, notes = calibrate_arm(panda(), "left", arm.readings)
        (sentence,) = [note for note in notes if "scale" in note]
        words.append(float(sentence.split(" %")[0].rsplit(" ", 1)[1]))
    assert words[1] < 0.5 * words[0]


@pytest.mark.slow
def test_a_bad_row_is_left_out_and_named() -> None:
    arm = led(1, gauge_m=0.4)
    q = arm.readings.q.copy()
    q[40, 3] += 0.004  # the ball was not seated
    found, notes = calibrate_arm(panda(), "left", replace(arm.readings, q=q))
    assert found.left_out == (40,)
    assert any("configuration 40" in note for note in notes)
    assert found.validate["geometry"].position_mm.mean < 0.1


def test_a_loose_socket_is_named() -> None:
    arm = led(2, gauge_m=0.4)
    rng = np.random.default_rng(0)
    q = arm.readings.q + 3e-4 * rng.standard_normal(arm.readings.q.shape) * (
        np.array(arm.readings.point) == "place1_0"
    ).reshape(-1, 1)
    _, notes = calibrate_arm(panda(), "left", replace(arm.readings, q=q))
    assert any("'place1_0'" in note and "is the block fixed" in note for note in notes)


def test_whole_placements_are_held_out() -> None:
    readings = replace(led(1, gauge_m=0.4).readings, split=None)
    words, notes = missing_splits(panda(), {"left": readings})
    held_out = {(readings.point or ())[row] for row, word in enumerate(words["left"]) if word == "validate"}
    learnt = {(readings.point or ())[row] for row, word in enumerate(words["left"]) if word == "identify"}
    assert not notes
    assert len(held_out) == 2
    assert not held_out & learnt
    assert len({str(name).split("_")[0] for name in held_out}) == 1


def test_two_placements_are_too_few_to_hold_one_out_and_it_is_said() -> None:
    readings = led(1, gauge_m=0.4).readings
    some = replace(readings.take(np.arange(100)), split=None)
    words, notes = missing_splits(panda(), {"left": some})
    assert "too few to hold one out" in notes[0]
    assert words["left"].count("validate") == 20


def test_residuals_are_about_the_mean_of_each_point() -> None:
    readings = led(1).readings
    computed = np.random.default_rng(0).normal(size=(len(readings), 3))
    left = measured_positions(readings, computed) - computed
    contacts = Contacts.of(readings)
    np.testing.assert_allclose(contacts.centres(left), 0.0, atol=1e-14)
    centres = contacts.centres(computed)
    expected = np.linalg.norm(centres[0] - centres[1]) - 0.05
    assert gauge_errors(readings, computed)[0] == pytest.approx(expected)
