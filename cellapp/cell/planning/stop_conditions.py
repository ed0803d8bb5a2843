"""Conditions of a planned stop besides its joint positions: direction of approach and dwell time.

A run stores them as the document ``factors``: ``{stop: {arm: {"via": [q1, ...], "dwell_s": s, "proposed": false}}}``.
Stops count from 0; all keys are optional. A stop that is listed was proposed by discovery unless it says otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydantic import TypeAdapter, ValidationError

from cellapp.cell.run import RunFile
from cellapp.ground.errors import InputError
from cellapp.ground.results import Record
from cellapp.robot.kinematics.transforms import Array

STOP_CONDITIONS_RESULT = "factors"
"""Name of the document; it is part of the file format."""
LONGEST_DWELL_S = 600.0
"""Longest dwell time that is accepted: ten minutes, some time constants of an arm that settles."""


@dataclass(frozen=True, eq=False)
class StopConditions:
    """Approach of one arm to a stop, and its dwell time there.

    Attributes
    ----------
    via : array, shape (N,), or None
        Joint positions before the last motion [rad], which determine its direction and length. None: straight from the
        stop before.
    dwell_s : float
        Least time from standstill to the measurement [s].
    proposed : bool
        Whether discovery proposed the stop.
    """

    via: Array | None = None
    dwell_s: float = 0.0
    proposed: bool = True


def read_stop_conditions(run: RunFile) -> dict[int, dict[str, StopConditions]]:
    """Read the conditions of stops that have some, or were proposed: stop -> arm -> conditions.

    Raises
    ------
    InputError
        If the document is not one that ``write_stop_conditions`` writes.
    """
    text = run.read_result(STOP_CONDITIONS_RESULT)
    if text is None:
        return {}
    try:
        stored = _DOCUMENT.validate_json(text)
        return {stop: {arm: _checked(run, arm, one) for arm, one in arms.items()} for stop, arms in stored.items()}
    except (ValueError, KeyError) as error:
        raise InputError(
            f"{run.path}: the document '{STOP_CONDITIONS_RESULT}' with approach and dwell of its stops is damaged"
            f" ({reason_of(error)}); restore the run from a copy, or plan a new one"
        ) from None


def proposed_stops(conditions: Mapping[int, Mapping[str, StopConditions]]) -> frozenset[int]:
    """Return the numbers of the stops that discovery proposed."""
    return frozenset(stop for stop, arms in conditions.items() if any(one.proposed for one in arms.values()))


def stop_conditions_json(conditions: Mapping[int, Mapping[str, StopConditions]]) -> str:
    """Convert conditions to the text of the document."""
    stored = {stop: {arm: _stored(one) for arm, one in arms.items()} for stop, arms in conditions.items()}
    return _DOCUMENT.dump_json(stored, exclude_defaults=True).decode()


class _Stored(Record):
    """Conditions of one arm at one stop as they are stored."""

    via: tuple[float, ...] | None = None
    dwell_s: float = 0.0
    proposed: bool = True


_DOCUMENT = TypeAdapter(dict[int, dict[str, _Stored]])


def _stored(conditions: StopConditions) -> _Stored:
    via = None if conditions.via is None else tuple(conditions.via.tolist())
    return _Stored(via=via, dwell_s=conditions.dwell_s, proposed=conditions.proposed)


def _checked(run: RunFile, arm: str, stored: _Stored) -> StopConditions:
    joints = len(run.profile.arms[arm].type.joints)
    via = None if stored.via is None else np.array(stored.via, dtype=np.float64)
    if via is not None and (via.shape != (joints,) or not np.isfinite(via).all()):
        raise ValueError(f"arm {arm}: 'via' must be {joints} finite joint positions")
    if not (math.isfinite(stored.dwell_s) and 0.0 <= stored.dwell_s <= LONGEST_DWELL_S):
        raise ValueError(f"arm {arm}: 'dwell_s' must lie between 0 and {LONGEST_DWELL_S:g} s")
    return StopConditions(via, stored.dwell_s, stored.proposed)


def reason_of(error: Exception) -> str:
    """Say briefly what is wrong with a document."""
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False)[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    return str(error)
