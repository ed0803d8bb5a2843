"""Delay and speed of a moving SMR against its path: what was simulated is found, and stated intervals hold."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.robot.paths.cartesian import cartesian_path
from cellapp.robot.paths.progress import followed
from cellapp.robot.paths.timing import Trajectory

PERIOD_S, SPEED = 0.008, 0.1
CORNERS = np.array([[2.0, 0.0, 0.5], [2.0, 0.5, 0.5], [2.4, 0.5, 0.5]])


@pytest.fixture(scope="module")
def path():
    return cartesian_path(CORNERS, np.broadcast_to(np.eye(3), (3, 3, 3)), [None, None], [0.0] * 3, np.full(2, SPEED))


@pytest.fixture(scope="module")
def sent(path):
    """From rest to rest on either line, with ramps of 0.1 m/s^2."""
    parts = []
    for first, last in zip(path.stops, path.stops[1:], strict=False):
        ramp = SPEED**2 / 0.2
        t = np.arange(0.0, (last - first - 2 * ramp) / SPEED + 2.0, PERIOD_S)
        up, down = 0.05 * t**2, (last - first) - 0.05 * (t[-1] - t) ** 2
        parts.append(first + np.where(t < 1.0, up, np.where(t > t[-1] - 1.0, down, ramp + SPEED * (t - 1.0))))
    s = np.concatenate(parts)
    return Trajectory(np.zeros((len(s), 6)), s, PERIOD_S, "", 0.9)


def points(path, sent, rng, *, delay=0.034, slower=0.0, sigma=15e-6, keep=0.9):
    """Points at 100 Hz: noise of which neighbours are alike."""
    t = np.arange(0.0, sent.duration_s, 0.01)
    s = np.interp((t - delay) * (1.0 - slower), sent.time_s, sent.s)
    noise, fresh = np.zeros((len(t), 3)), rng.normal(0.0, sigma * np.sqrt(1.0 - keep**2), (len(t), 3))
    for row in range(1, len(t)):
        noise[row] = keep * noise[row - 1] + fresh[row]
    return t, path.positions(s) + noise


def test_delay_and_speed_are_those_of_the_motion_and_their_intervals_hold(path, sent):
    delays, speeds = [], []
    for seed in range(60):
        found = followed(path, sent, *points(path, sent, np.random.default_rng(seed)))
        assert found is not None
        assert found.speed is not None
        assert abs(found.delay_s - 0.034) < 3e-4
        assert found.delay_error_s < 1e-4
        assert found.rms_m < 40e-6
        assert found.speed.wanted == SPEED
        delays.append(abs(found.delay_s - 0.034) < 2.0 * found.delay_error_s)
        speeds.append(abs(found.speed.mean - SPEED) < 2.0 * found.speed.standard_error)
    assert np.mean(delays) > 0.85
    assert np.mean(speeds) > 0.85


def test_an_arm_that_is_slower_than_it_should_be_is_seen(path, sent):
    found = followed(path, sent, *points(path, sent, np.random.default_rng(1), slower=0.003))
    assert found is not None
    assert found.speed is not None
    assert found.speed.mean == pytest.approx(0.997 * SPEED, abs=2.0 * found.speed.standard_error)
    assert found.speed.mean < SPEED - 4.0 * found.speed.standard_error
    assert found.largest_m > 1e-3, "it is late at the end, not on average"


def test_speed_that_swings_is_stated_from_its_slowest_to_its_fastest(path, sent):
    t, p = points(path, sent, np.random.default_rng(2), sigma=0.0)
    t = t + 0.003 * np.sin(2.0 * np.pi * t)  # 1 Hz: +- 1.9 mm/s
    found = followed(path, sent, t, p)
    assert found is not None
    assert found.speed is not None
    assert found.speed.fluctuation == pytest.approx(3.7e-3, rel=0.15)


def test_too_few_points_or_a_path_at_rest_give_nothing(path, sent):
    t, p = points(path, sent, np.random.default_rng(3))
    assert followed(path, sent, t[:10], p[:10]) is None
    still = Trajectory(sent.q, np.zeros_like(sent.s), PERIOD_S, "", 0.0)
    assert followed(path, still, t, p) is None
