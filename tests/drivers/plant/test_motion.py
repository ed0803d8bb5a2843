"""Motions over time: braking along the path, and a speed slider that scales a motion in progress."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.plant.motion import Motion, braked, travel

START, END = np.array([0.0, 1.0]), np.array([2.0, 0.0])


def motion() -> Motion:
    made = travel(10.0, START, END, np.full(2, 1.0), np.full(2, 2.0))
    assert made is not None
    return made


def at(moved: Motion, time_s: float) -> np.ndarray:
    return moved.position(np.array([time_s]))[0]


def speed(moved: Motion, time_s: float) -> np.ndarray:
    return moved.velocity(np.array([time_s]))[0]


def test_a_scaled_motion_follows_the_same_path_more_slowly() -> None:
    full = motion()
    slow = full.scaled(11.0, 0.25)
    assert np.array_equal(at(slow, 11.0), at(full, 11.0))
    assert np.allclose(speed(slow, 11.2), 0.25 * speed(full, 11.05))
    assert slow.end_s == pytest.approx(11.0 + (full.end_s - 11.0) / 0.25)
    assert np.array_equal(at(slow, slow.end_s), END)
    assert np.allclose(slow.mean_speed, 0.25 * full.mean_speed)


def test_a_motion_scaled_to_zero_stands_and_goes_on() -> None:
    full = motion()
    stands = full.scaled(11.0, 0.0)
    assert stands.end_s == np.inf
    assert np.array_equal(at(stands, 500.0), at(full, 11.0))
    assert not speed(stands, 12.0).any()
    again = stands.scaled(20.0, 1.0)
    assert again.end_s == pytest.approx(full.end_s + 9.0)
    assert np.allclose(at(again, 20.3), at(full, 11.3))


def test_a_scaled_motion_brakes_from_its_own_speed() -> None:
    slow = motion().scaled(10.8, 0.5)
    stopping = braked(slow, 11.0, np.full(2, 2.0))
    assert stopping is not None
    assert stopping.duration_s == pytest.approx(np.abs(speed(slow, 11.0)).max() / 2.0)
    assert braked(motion().scaled(11.0, 0.0), 12.0, np.full(2, 2.0)) is None


def test_a_stop_brakes_as_gently_as_asked(make_arm, make_plant) -> None:
    rests = []
    for deceleration in (None, np.full(6, 1.0)):
        plant = make_plant(make_arm())
        plant.start_move("left", plant.q("left") + 2.0, np.full(6, 1.0), np.full(6, 3.0))
        plant.advance(1.0)
        assert np.abs(plant.speeds("left")).max() == pytest.approx(1.0)
        plant.stop("left", deceleration)
        rests.append(plant.rest_s("left") - plant.clock_s)
        plant.advance(2.0)
        assert not plant.speeds("left").any()
    assert rests == pytest.approx([1.0 / 3.0, 1.0])
