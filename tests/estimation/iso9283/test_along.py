"""Velocity and cornering along a path, against worked numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellapp.estimation.iso9283 import along
from cellapp.estimation.iso9283.along import Corner

pytestmark = pytest.mark.fast


def test_velocity_of_two_cycles_worked_by_hand() -> None:
    """Places 10 mm apart; 0.04, 0.05 s in the first cycle (250, 200 mm/s), 0.05, 0.05 s in the second."""
    times = np.array([[0.0, 0.04, 0.09], [1.0, 1.05, 1.10]])
    found = along.speeds(times, np.array([0.0, 0.01, 0.02]))
    np.testing.assert_allclose(found, [[0.25, 0.2], [0.2, 0.2]])
    assert along.velocity_accuracy(found, 0.25) == pytest.approx((0.225 + 0.2) / 2.0 / 0.25 - 1.0)
    assert along.velocity_repeatability(found, 0.25) == pytest.approx(3.0 * 0.025 / math.sqrt(2.0) / 0.25)
    assert along.velocity_fluctuation(found) == pytest.approx(0.05)


def test_a_repeatability_of_one_cycle_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 2 cycles, not 1"):
        along.velocity_repeatability(np.array([[0.2, 0.2]]), 0.2)


CORNER = Corner("P3", np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), 0.5)


def test_a_rounded_corner_has_a_rounding_and_no_overshoot() -> None:
    """A quarter circle of radius r misses its corner by (sqrt(2) - 1) r."""
    r, angle = 0.1, np.linspace(-0.5 * np.pi, 0.0, 400)
    arc = np.stack([1.0 - r + r * np.cos(angle), r + r * np.sin(angle), np.zeros(400)], axis=1)
    points = np.concatenate([[[0.0, 0.0, 0.0]], arc, [[1.0, 1.0, 0.0]]])
    assert along.corner_rounding(points, CORNER) == pytest.approx((math.sqrt(2.0) - 1.0) * r, rel=1e-4)
    assert along.corner_overshoot(points, CORNER) == pytest.approx(0.0, abs=1e-12)


def test_a_path_that_goes_on_beyond_its_corner_overshoots() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.003, 0.01, 0.0], [1.0, 0.1, 0.0], [1.0, 1.0, 0.0]])
    assert along.corner_rounding(points, CORNER) == pytest.approx(0.0, abs=1e-12)
    assert along.corner_overshoot(points, CORNER) == pytest.approx(0.003)


def test_a_path_that_does_not_come_near_says_nothing() -> None:
    far = np.array([[5.0, 5.0, 0.0], [6.0, 5.0, 0.0]])
    assert math.isnan(along.corner_rounding(far, CORNER))
    assert math.isnan(along.corner_overshoot(far, CORNER))
