"""Sequential test: it takes stops one by one and ends as soon as it is sure."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from cellapp.estimation.calibration.station_location import FEWEST_POINTS
from cellapp.estimation.monitoring.check.alternatives import alternatives_of, directions_of
from cellapp.estimation.monitoring.check.conclusion import concluded
from cellapp.estimation.monitoring.check.linear import Moments, StopRows, calibration_motions, stop_rows, visibility
from cellapp.estimation.monitoring.check.model import FALSE_ALARM, MISS, CheckBelief, Conclusion, SequentialState
from cellapp.estimation.monitoring.check.naming import Design, explain, with_station
from cellapp.estimation.monitoring.check.statistics import MinPValueTest, looks
from cellapp.estimation.readings import Readings, joined
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import Array

_FEWEST_STOPS = 6
"""Fewest stops to name a change: six parameters of a moved base, and as many data to show whether they explain it."""


class SequentialTest:
    """Sequential test of a calibration: add stops until ``state.sure``, then ask for the conclusion.

    The probability of a false alarm is at most ``FALSE_ALARM`` over all stops, that of calling a visible change valid
    at most ``MISS``.
    """

    def __init__(self, belief: CheckBelief, planned: int) -> None:
        """Prepare the test; it ends after ``planned`` stops at the latest."""
        self._design = design_of(belief)
        self._planned = planned
        self._readings: dict[str, Readings] = {}
        self._standing = SequentialState(0, False, False, False, 0.0, 0.0, 1.0)
        self._stops: StopRows | None = None

    @property
    def state(self) -> SequentialState:
        """State after the stops so far."""
        return self._standing

    def add(self, readings: Mapping[str, Readings]) -> SequentialState:
        """Add one or more stops: arm -> its readings (same ``configuration`` at the same stop) in the order of
        measurement, with approach signs, steps, temperatures and covariance as logged by collection. An arm that was
        not measured may be missing.

        Raises
        ------
        InputError
            If a reading is not finite or of an unknown arm.
        """
        for name, its in readings.items():
            if name not in self._design.belief.arms:
                raise InputError(
                    f"check: the calibration has no arm '{name}'; it has {', '.join(self._design.belief.arms)}"
                )
            if not (np.isfinite(its.p_M).all() and np.isfinite(its.q).all()):
                raise InputError(f"check: a reading of arm '{name}' is not finite; measure the stop again")
            if len(its):
                before = self._readings.get(name)
                self._readings[name] = its if before is None else joined([before, its])
        if self._readings:
            self._stops = stop_rows(self._design.belief, self._readings, self._design.directions)
            self._standing = judged(self._design, self._stops, self._planned)
        return self._standing

    def conclusion(self) -> Conclusion:
        """Return the verdict from all stops so far, with the change that explains them.

        Raises
        ------
        InputError
            If there is no stop.
        """
        if self._stops is None:
            raise InputError("check: no stop was measured; there is nothing to conclude from")
        return concluded(self._design, self._stops, self._standing)


def design_of(belief: CheckBelief) -> Design:
    """Define what a check of a cell tests: directions, alternatives, visibility."""
    directions = tuple(directions_of(belief))
    motions = calibration_motions(belief, directions)
    moved, visible = visibility(belief, directions, motions)
    alternatives = tuple(alternatives_of(belief, directions))
    return Design(belief, directions, alternatives, motions, moved, visible, FALSE_ALARM, MISS)


def judged(design: Design, stops: StopRows, planned: int) -> SequentialState:
    """Evaluate the test after some stops."""
    here, _ = with_station(design, stops)
    moments = Moments.of(here)
    if stops.free and np.sum(stops.points) < FEWEST_POINTS:  # too few points to locate the tracker
        return SequentialState(len(stops.stop_ends), len(stops.stop_ends) >= planned, False, False, 0.0, 0.0, 1.0)
    seen = looks(moments, design.alternatives, design.visible)
    count = len(seen.log_evidence)
    changed_at = _first(seen.log_evidence, design.early_alarm)
    valid_at = _first(seen.log_valid, design.early_miss)
    changed, valid = changed_at < count and changed_at <= valid_at, valid_at < changed_at
    if not changed and not valid and count >= planned:
        test = MinPValueTest.of(moments, design.alternatives)
        changed = test.significant(float(test.p_values(moments.white[:, None]).min()), design.last_alarm)
    sure = valid or count >= planned or (changed and count >= _FEWEST_STOPS and _named(design, here))
    return SequentialState(
        stops=valid_at + 1 if valid else count,
        sure=sure,
        changed=changed,
        valid=valid,
        log_evidence=float(seen.log_evidence[-1]),
        log_valid=float(seen.log_valid[-1]),
        p_value=float(seen.p_values[-1]),
    )


def _first(values: Array, chance: float) -> int:
    """Return the first index with a logarithm of at least log(1 / ``chance``); the number of values if none."""
    reached = np.flatnonzero(values >= -math.log(chance))
    return int(reached[0]) if len(reached) else len(values)


def _named(design: Design, stops: StopRows) -> bool:
    """Return whether the changes explain the stops and no rivals remain that more stops could exclude."""
    found = explain(design, stops)
    return found.holds and not any(cause.open_rivals for cause in found.causes)
