"""Expanded uncertainties hold what they state, and judgements use them as the rule says."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cellapp.iso9283.judgements import judge
from cellapp.iso9283.uncertainty import (
    Cycles,
    accuracy_value,
    directional_value,
    distance_values,
    drift_values,
    path_values,
    repeatability_value,
)
from cellapp.profile.acceptance import Tolerances
from cellapp.results import ArmIso9283, CommandedTests, IsoValue, PoseCharacteristics

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


def arm(accuracy_mm: float, expanded_mm: float | None, n: int) -> ArmIso9283:
    value = IsoValue(value_mm=accuracy_mm, expanded_mm=expanded_mm, n=n)
    small = IsoValue(value_mm=0.01, expanded_mm=0.001, n=n)
    poses = tuple(
        PoseCharacteristics(pose=name, error_mm=(0.0, 0.0, 0.0), accuracy=one, repeatability=small, deviations_mm=())
        for name, one in (("P1", small), ("P2", value))
    )
    nominal = PoseCharacteristics(
        pose="P1",
        error_mm=(9.0, 0.0, 0.0),
        accuracy=IsoValue(value_mm=9.0, expanded_mm=0.1, n=n),
        repeatability=small,
        deviations_mm=(),
    )
    return ArmIso9283(
        payload_kg=0.3, tests={"nominal": CommandedTests(pose=(nominal,)), "calibrated": CommandedTests(pose=poses)}
    )


@pytest.mark.parametrize(
    ("value", "expanded", "verdict"),
    [
        (0.05, 0.04, "conforms"),
        (0.08, 0.04, "cannot say"),
        (0.15, 0.04, "does not conform"),
        (0.05, None, "cannot say"),
    ],
)
def test_the_worst_pose_as_left_is_judged(value: float, expanded: float | None, verdict: str) -> None:
    tolerances = Tolerances(pose_accuracy=0.1e-3)
    (found,) = judge(tolerances, {"left": arm(value, expanded, 30)}, (), 30)
    assert (found.characteristic, found.where, found.value_mm) == ("pose_accuracy", "left", value)
    assert found.conformity == verdict
    assert found.source == "ISO 9283, P2, calibrated commands, 30 cycles"


def test_too_few_cycles_are_not_judged_unless_fewer_were_asked_for() -> None:
    tolerances = Tolerances(pose_accuracy=0.1e-3, pose_repeatability=0.1e-3)
    of_27 = {"left": arm(0.05, 0.01, 27)}
    for one in judge(tolerances, of_27, (), 30):
        assert (one.conformity, one.n) == ("cannot say", 27)
        assert one.source.endswith("27 of 30 cycles, too few to judge")
    for one in judge(tolerances, of_27, (), 27):
        assert one.conformity == "conforms"
        assert one.source.endswith("27 of 30 cycles")
