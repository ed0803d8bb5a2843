"""Expanded uncertainties of the characteristics hold what they state."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cellapp.estimation.iso9283.characteristics import (
    Cycles,
    accuracy_value,
    directional_value,
    distance_values,
    drift_values,
    path_values,
    repeatability_value,
)
from cellapp.estimation.iso9283.records import IsoValue

pytestmark = pytest.mark.fast

SIGMA = 20e-6
"""Of a coordinate [m]."""
TRACKER = np.diag([4e-6, 15e-6, 15e-6]) ** 2
NOTHING = np.zeros((3, 3))
OFF = np.array([80e-6, -50e-6, 20e-6])


def cycles(rng: np.random.Generator, n: int, off: NDArray[np.float64] = OFF, sigma: float = SIGMA) -> Cycles:
    """Cycles at ``off`` from the commanded position, with one error of the tracker that all of them share."""
    shared = rng.multivariate_normal(np.zeros(3), TRACKER)
    return Cycles(off + shared + sigma * rng.standard_normal((n, 3)), np.zeros(3), TRACKER, NOTHING)


def covered(values: list[IsoValue], true_m: float) -> float:
    """Share of the values whose uncertainty holds the true one."""
    off = [abs(one.value_mm - true_m * 1e3) <= (one.expanded_mm or 0.0) for one in values]
    return float(np.mean(off))


@pytest.mark.parametrize("n", [5, 30])
def test_accuracy_holds_the_truth_in_95_of_100_tests(n: int) -> None:
    rng = np.random.default_rng(n)
    values = [accuracy_value(cycles(rng, n), rng) for _ in range(60)]
    assert covered(values, float(np.linalg.norm(OFF))) >= 0.88


@pytest.mark.slow
def test_repeatability_and_distance_hold_the_truth() -> None:
    rng = np.random.default_rng(7)
    many = np.linalg.norm(SIGMA * rng.standard_normal((100_000, 3)), axis=1)
    repeatabilities = [repeatability_value(cycles(rng, 30), rng)[0] for _ in range(40)]
    assert covered(repeatabilities, float(many.mean() + 3.0 * many.std())) >= 0.88
    away = np.array([0.0, 0.5, 0.0])
    pairs = [(cycles(rng, 30, np.zeros(3)), cycles(rng, 30, away)) for _ in range(40)]
    pairs = [(one, Cycles(two.attained, away, TRACKER, NOTHING)) for one, two in pairs]
    found = [distance_values(one, two, rng) for one, two in pairs]
    assert covered([one[0] for one in found], 0.0) >= 0.88
    assert covered([one[1] for one in found], 3.0 * np.sqrt(2.0) * SIGMA) >= 0.88


def test_a_repeatability_says_how_much_of_it_may_be_the_trackers() -> None:
    rng = np.random.default_rng(2)
    still = Cycles(rng.multivariate_normal(np.zeros(3), TRACKER, size=30), np.zeros(3), TRACKER, NOTHING)
    value, tracker = repeatability_value(still, rng)
    assert tracker * 1e3 == pytest.approx(value.value_mm, rel=0.3)
    assert value.expanded_mm is not None
    assert value.expanded_mm > 0.5 * value.value_mm
    coarse = Cycles(50.0 * still.attained, np.zeros(3), TRACKER, NOTHING)
    value, tracker = repeatability_value(coarse, rng)
    assert value.expanded_mm is not None
    assert value.expanded_mm < 0.4 * value.value_mm


def test_an_uncertain_base_makes_accuracy_uncertain_and_repeatability_not() -> None:
    rng = np.random.default_rng(3)
    known = cycles(rng, 30)
    unknown = Cycles(known.attained, known.commanded, TRACKER, 0.3e-3**2 * np.eye(3))
    first, second = (accuracy_value(one, np.random.default_rng(1)) for one in (known, unknown))
    assert (first.expanded_mm or 0.0) < 0.05
    assert 0.3 < (second.expanded_mm or 0.0) < 1.0
    assert repeatability_value(known, np.random.default_rng(1)) == repeatability_value(
        unknown, np.random.default_rng(1)
    )


def test_variation_drift_and_path_of_an_arm_without_either_are_within_their_uncertainty() -> None:
    rng = np.random.default_rng(4)
    shared = rng.multivariate_normal(np.zeros(3), TRACKER)
    same = [
        Cycles(OFF + shared + SIGMA * rng.standard_normal((30, 3)), np.zeros(3), TRACKER, NOTHING) for _ in range(3)
    ]
    values = [directional_value(same, rng), *drift_values(same, rng)]
    assert all(one.value_mm <= 2.0 * (one.expanded_mm or 0.0) for one in values)
    places = np.linspace(0.0, 0.5, 20)[:, None] * np.array([1.0, 0.0, 0.0])
    attained = places[:, None] + SIGMA * rng.standard_normal((20, 10, 3))
    accuracy, repeatability = path_values(attained, places, TRACKER, NOTHING, rng)
    assert 0.0 < accuracy.value_mm < 0.05
    assert 0.06 < repeatability.value_mm < 0.15
    assert accuracy.n == repeatability.n == 10
