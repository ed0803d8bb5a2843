"""Results of ``trials targets``: errors of every arm and of the pair at new targets, and their bars."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from cellapp.ground.grouping import grouped
from cellapp.ground.results import Record, Result

LEAST_RATIO = 15.0
"""Bar: least ratio of nominal to compensated mean error."""
MOST_OF_FLOOR = 1.5
"""Bar: largest ratio of compensated mean error to what measuring and repeatability leave of a perfect model."""
LEAST_GAIN = 0.4
"""Bar: least share of the cooperative error of the paper's proposed method that compensation removes."""
COVERAGE = (0.93, 0.97)
"""Bar: range of the share of measurements within the stated 95 % limits."""
CALIBRATED, RELOCATED = "calibrated", "tracker moved"
"""States of the cell: as calibrated, and after the tracker was moved and located again from 4 points."""


class ArmFigures(Record):
    """One arm at its targets; errors are mean distances of the measured SMR from the target [mm].

    Attributes
    ----------
    targets, refused : int
        Measured targets, and those without a measurement.
    nominal_mm, compensated_mm : float
    floor_mm : float
        Mean distance of a measurement from the point that it measures: the tracker's noise and the arm's repeatability,
        drawn at the same joint positions. A perfect model does no better.
    changed_mm : float
        Mean displacement there by effects of time, from the last reading, or point of locating, to the last target.
    paper_mm : float or None
        Mean distance of the same measurements from the prediction of the paper's proposed method; None where the
        tracker was moved, which that method does not cover.
    within_95, coordinates_95 : float or None
        Share of measurements within their stated distance, and of coordinates within their stated interval.
    """

    targets: int
    refused: int
    nominal_mm: float
    compensated_mm: float
    floor_mm: float
    changed_mm: float
    paper_mm: float | None
    within_95: float | None
    coordinates_95: float | None


class PairFigures(Record):
    """Cooperative targets; errors are mean absolute errors of the distance between both SMRs [mm].

    ``paper_mm`` is the error of the paper's proposed method: the measured distance less its prediction for the same
    joint positions.
    """

    targets: int
    refused: int
    nominal_mm: float
    compensated_mm: float
    floor_mm: float
    paper_mm: float | None


class StateFigures(Record):
    """All arms and the pair in one state of the cell."""

    arms: Mapping[str, ArmFigures]
    pair: PairFigures | None = None


class HiddenEffects(Record):
    """What is hidden in one arm, by the plant's names, and what discovery accepted."""

    hidden: tuple[str, ...]
    laws: str
    found: tuple[str, ...]
    verdict: str


class TargetTrial(Record):
    """One cell.

    Attributes
    ----------
    states : mapping
        ``CALIBRATED`` and ``RELOCATED`` -> the figures; the second is missing where the tracker was not located.
    location : str
        Verdict of locating the moved tracker.
    seconds, push_seconds : float
        What all of it took, and compensating and pushing the targets as calibrated.
    """

    seed: int
    effects: Mapping[str, HiddenEffects]
    states: Mapping[str, StateFigures]
    location: str
    seconds: float
    push_seconds: float


class TargetTrialsResult(Result, schema="cellapp-trials-targets"):
    """``trials targets``: every cell."""

    profile: str
    trials: tuple[TargetTrial, ...]
    failed: tuple[str, ...] = ()
    """Cells that failed, and why."""

    def complaints(self) -> list[str]:
        """Say what failed, and bars that the means over all cells miss."""
        found = list(self.failed)
        for state in self.states():
            for name, arms in self.by_arm(state).items():
                found += [f"{state}, arm {name}: {text}" for text in _arm_complaints(arms)]
            pairs = self.pairs(state)
            if pairs:
                found += [f"{state}, pair: {text}" for text in _pair_complaints(pairs)]
        return found

    def states(self) -> list[str]:
        """Return states that were measured, in their order."""
        return list(dict.fromkeys(state for trial in self.trials for state in trial.states))

    def by_arm(self, state: str) -> dict[str, list[ArmFigures]]:
        """Return figures of every arm in one state, a cell each."""
        return grouped(of for one in self.trials if state in one.states for of in one.states[state].arms.items())

    def pairs(self, state: str) -> list[PairFigures]:
        """Return figures of the pair in one state, a cell each."""
        found = (trial.states[state].pair for trial in self.trials if state in trial.states)
        return [pair for pair in found if pair is not None]


def mean_of(values: Iterable[float | None]) -> float | None:
    """Return the mean of the values that are not None; None if there are none."""
    there = [value for value in values if value is not None]
    return float(np.mean(there)) if there else None


# -- inside -----------------------------------------------------------------------------------------------------------


def _arm_complaints(arms: list[ArmFigures]) -> list[str]:
    ours = float(np.mean([arm.compensated_mm for arm in arms]))
    ratio = float(np.mean([arm.nominal_mm for arm in arms])) / ours
    of_floor = ours / float(np.mean([arm.floor_mm for arm in arms]))
    found = []
    if not ratio >= LEAST_RATIO:
        found.append(f"mean error {ratio:.1f} times below nominal, bar {LEAST_RATIO:g}")
    if not of_floor <= MOST_OF_FLOOR:
        found.append(f"mean error {of_floor:.2f} times the floor, bar {MOST_OF_FLOOR:g}")
    for what, share in (
        ("measurements", mean_of(arm.within_95 for arm in arms)),
        ("coordinates", mean_of(arm.coordinates_95 for arm in arms)),
    ):
        if share is not None and not COVERAGE[0] <= share <= COVERAGE[1]:
            low, high = COVERAGE
            found.append(f"{share:.1%} of {what} within the stated 95 %, bar {low:.0%} to {high:.0%}")
    return found


def _pair_complaints(pairs: list[PairFigures]) -> list[str]:
    paper = mean_of(pair.paper_mm for pair in pairs)
    if paper is None:
        return []
    gain = 1.0 - float(np.mean([pair.compensated_mm for pair in pairs])) / paper
    return [] if gain >= LEAST_GAIN else [f"cooperative error {gain:.0%} below the paper's, bar {LEAST_GAIN:.0%}"]
