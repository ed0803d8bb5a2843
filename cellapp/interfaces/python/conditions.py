"""Conditions for the predictions of a model, with the same names as in readings."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any

import numpy as np

from cellapp.cell.targets.working_conditions import beside
from cellapp.ground.errors import InputError
from cellapp.robot.effects import MeasurementConditions, TemperatureRecord
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.arguments import configurations

_FIELDS = {
    "approach": ("approach", True),
    "step": ("step", True),
    "payload_kg": ("payload_kg", False),
    "dwell_s": ("dwell_s", False),
    "time_s": ("time_s", False),
    "temperature_c": ("air_c", False),
    "joint_temperature_c": ("joints_c", True),
}
"""Name -> field of ``MeasurementConditions``, and whether it has a value for each joint."""
_OTHER = "other_q"


def stated_conditions(
    q: Array,
    given: Mapping[str, Any],
    arm: str,
    other: ArmModel | None,
    record: TemperatureRecord | None,
) -> MeasurementConditions | None:
    """Return the conditions at configurations ``q`` (n, N) [rad]; None if none are given, so that all are unknown.

    Parameters
    ----------
    given : mapping
        ``approach``, ``step`` [rad], ``joint_temperature_c`` (n, N); ``payload_kg``, ``dwell_s``, ``time_s``,
        ``temperature_c`` (n,); ``other_q`` (n, K) [rad], the configurations of the other arm. Values are broadcast.
    other : ArmModel or None
        The other arm of a cell of two.
    record : TemperatureRecord or None
        Temperatures of the readings, to which ``time_s`` refers.

    Raises
    ------
    InputError
        If a condition has another name, or another shape.
    """
    if not given:
        return None
    fields: dict[str, Array] = {}
    for name, value in given.items():
        if name == _OTHER:
            continue
        if name not in _FIELDS:
            known = (*_FIELDS, _OTHER)
            close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            raise InputError(f"arm {arm}: no condition is called '{name}'; known are {', '.join(known)}{hint}")
        field, of_joints = _FIELDS[name]
        fields[field] = _values(f"arm {arm}: {name}", value, q.shape if of_joints else q.shape[:1])
    conditions = MeasurementConditions(**fields, record=record if "time_s" in given else None)
    if _OTHER not in given:
        return conditions
    if other is None:
        raise InputError(f"arm {arm}: {_OTHER} needs a cell of two arms")
    other_q = np.atleast_2d(_values(f"arm {arm}: {_OTHER}", given[_OTHER], None))
    at = configurations(other_q, other.geometry.joints, f"beside {arm}")
    return beside(conditions, other, np.broadcast_to(at, (len(q), at.shape[1])), None)


def _values(where: str, value: Any, shape: tuple[int, ...] | None) -> Array:
    """Return numbers broadcast to ``shape``, or in their own shape if it is None."""
    try:
        array = np.asarray(value, dtype=np.float64)
        return array if shape is None else np.array(np.broadcast_to(array, shape))
    except (TypeError, ValueError):
        words = "numbers" if shape is None else f"shape {shape} or one number for all"
        raise InputError(f"{where}: expected {words}, got {value!r:.60}") from None
