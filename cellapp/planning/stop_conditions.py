"""Conditions of a planned stop besides its joint positions: direction of approach and dwell time.

A run stores them as the document ``factors``: ``{stop: {arm: {"via": [q1, ...], "dwell_s": s}}}``. Stops count from 0;
a stop that is listed was proposed by discovery; both keys are optional.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.run import RunFile

STOP_CONDITIONS_RESULT = "factors"
"""Name of the document; it is part of the file format."""
LONGEST_DWELL_S = 600.0
"""Longest dwell time that is accepted: ten minutes, some time constants of an arm that settles."""


@dataclass(frozen=True, eq=False)
class StopConditions:
    """How one arm approaches a stop and how long it rests there.

    Attributes
    ----------
    via : array, shape (N,), or None
        Joint positions before the last motion [rad], which determine its direction and length. None: straight from the
        stop before.
    dwell_s : float
        Least time from standstill to the measurement [s].
    """

    via: Array | None = None
    dwell_s: float = 0.0


def read_stop_conditions(run: RunFile) -> dict[int, dict[str, StopConditions]]:
    """Conditions of the proposed stops: stop -> arm -> conditions; empty without proposed stops.

    Raises
    ------
    InputError
        If the document is not one that ``write_stop_conditions`` writes.
    """
    text = run.read_result(STOP_CONDITIONS_RESULT)
    if text is None:
        return {}
    try:
        content = json.loads(text)
        return {
            int(stop): {arm: _from_json(run, arm, entry) for arm, entry in arms.items()}
            for stop, arms in content.items()
        }
    except (ValueError, TypeError, AttributeError, KeyError) as error:
        raise InputError(
            f"{run.path}: the factors of its proposed stops are damaged ({error}); propose them again with"
            " 'cellapp discover DIR --propose N'"
        ) from None


def write_stop_conditions(run: RunFile, conditions: Mapping[int, Mapping[str, StopConditions]]) -> None:
    """Store the conditions of all proposed stops in place of those stored before."""
    content = {str(stop): {arm: as_dict(one) for arm, one in arms.items()} for stop, arms in conditions.items()}
    run.write_result(STOP_CONDITIONS_RESULT, json.dumps(content))


def as_dict(conditions: StopConditions) -> dict[str, Any]:
    """The JSON object: only conditions that differ from the default."""
    entry: dict[str, Any] = {}
    if conditions.via is not None:
        entry["via"] = conditions.via.tolist()
    if conditions.dwell_s > 0.0:
        entry["dwell_s"] = conditions.dwell_s
    return entry


def _from_json(run: RunFile, arm: str, entry: Mapping[str, Any]) -> StopConditions:
    joints = len(run.profile.arms[arm].type.joints)
    via = None if "via" not in entry else np.array(entry["via"], dtype=np.float64)
    if via is not None and (via.shape != (joints,) or not np.isfinite(via).all()):
        raise ValueError(f"arm {arm}: 'via' must be {joints} finite joint positions")
    dwell_s = float(entry.get("dwell_s", 0.0))
    if not (math.isfinite(dwell_s) and 0.0 <= dwell_s <= LONGEST_DWELL_S):
        raise ValueError(f"arm {arm}: 'dwell_s' must lie between 0 and {LONGEST_DWELL_S:g} s")
    return StopConditions(via, dwell_s)
