"""What the figures ask of an estimate or a check, and no step of a cell does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.monitoring.check.belief import SequentialState
from cellapp.estimation.monitoring.check.linear import Moments, StopRows
from cellapp.estimation.monitoring.check.naming import Design, looks
from cellapp.estimation.monitoring.check.sequential import judged
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array


def merged_values(parameters: ParameterSet, geometry: Geometry, nominal: Geometry) -> Array:
    """Compute the values (k,) that act like ``geometry`` with the dropped parameters at ``nominal``."""
    vector, columns, dropped = geometry.vector(), list(parameters.columns), list(parameters.dropped)
    return np.asarray(vector[columns] + parameters.shares @ (vector - nominal.vector())[dropped])


def first_stops(stops: StopRows, count: int) -> StopRows:
    """Select the first ``count`` stops."""
    d = int(stops.stop_ends[count - 1])
    return replace(
        stops,
        measured=stops.measured[: d // 3],
        expected=stops.expected[: d // 3],
        stop_ends=stops.stop_ends[:count],
        arm_of=stops.arm_of[: d // 3],
        rows=stops.rows[:, :d],
        factor=stops.factor[:d, :d],
        turned=None if stops.turned is None else stops.turned[: d // 3],
    )


def decided_prefix(design: Design, stops: StopRows) -> tuple[StopRows, SequentialState]:
    """Find the shortest prefix of the planned ``stops`` at which the sequential test decides, and its state there."""
    planned = len(stops.stop_ends)
    first = 1
    if not design.belief.station_free:  # then the looks at fewer stops are those at all of them
        seen = looks(Moments.of(stops), design.alternatives, design.visible)
        first = min(_reached(seen.log_evidence, design.early_alarm), _reached(seen.log_valid, design.early_miss))
    for count in range(min(first, planned), planned + 1):
        some = first_stops(stops, count)
        state = judged(design, some, planned)
        if state.sure:
            break
    return some, state


def _reached(values: Array, chance: float) -> int:
    """Return the number of looks to the first of at least log(1 / ``chance``); one more than all if none."""
    reached = np.flatnonzero(values >= -np.log(chance))
    return int(reached[0]) + 1 if len(reached) else len(values) + 1
