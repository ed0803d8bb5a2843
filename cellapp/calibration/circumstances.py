"""From readings to what effects depend on: the last steps, the other arm, times and temperatures."""

from __future__ import annotations

import numpy as np

from cellapp.effects import Circumstances, TemperatureRecord
from cellapp.kinematics.statics import base_moment
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel
from cellapp.run import Readings

_AGREE = 0.95
"""Share of the known approach signs that the steps between successive stops must have to be taken for the last ones."""


def circumstances(readings: Readings, other: tuple[ArmModel, Readings] | None = None) -> Circumstances:
    """What is known of the stops of one arm; ``other`` is the other arm's model and readings, where there is one.

    Steps that were not logged are taken from the order in time of the stops, if they agree with the approach signs.
    Where the other arm has no reading at a stop its values are NaN.
    """
    time_s = readings.time_s if np.isfinite(readings.time_s).any() else None
    approach = readings.approach if np.any(readings.approach) else None
    moment = other_q = None
    if other is not None and len(other[1]):
        model, theirs = other
        rows = {number: row for row, number in enumerate(theirs.configuration.tolist())}
        match = np.array([rows.get(number, -1) for number in readings.configuration.tolist()], dtype=np.intp)
        there = match >= 0
        if there.any():
            payload = None if theirs.payload_kg is None else theirs.payload_kg[match[there]]
            moment = np.full((len(readings), 3), np.nan)
            moment[there] = base_moment(model.geometry, model.bodies, theirs.q[match[there]], model.up_M, payload)
            other_q = np.full((len(readings), theirs.joints), np.nan)
            other_q[there] = theirs.q[match[there]]
    return Circumstances(
        approach=approach,
        step=_filled(readings.step, _steps(readings)),
        dwell_s=readings.dwell_s,
        time_s=time_s,
        payload_kg=readings.payload_kg,
        air_c=readings.temperature_c,
        joints_c=readings.joint_temperature_c,
        other_moment_M=moment,
        other_q=other_q,
        record=_record(readings),
    )


def _filled(logged: Array | None, derived: Array | None) -> Array | None:
    """Logged steps; where a row has none (a run begun before they were logged), the derived ones."""
    if logged is None or derived is None:
        return derived if logged is None else logged
    return np.where(np.isnan(logged), derived, logged)


def _record(readings: Readings) -> TemperatureRecord | None:
    """The run's temperatures where times and joint temperatures are known throughout."""
    joints_c, time_s = readings.joint_temperature_c, readings.time_s
    if joints_c is None or not np.isfinite(joints_c).all() or not np.isfinite(time_s).all():
        return None
    air_c = readings.temperature_c
    if air_c is None or not np.isfinite(air_c).all():
        air_c = joints_c.mean(axis=1)
    return TemperatureRecord(time_s, joints_c, air_c)


def _steps(readings: Readings) -> Array | None:
    """Last motions from one stop to the next in time; None where times or approach signs are missing or disagree."""
    if len(readings) < 2 or not np.isfinite(readings.time_s).all() or not np.any(readings.approach):
        return None
    order = np.argsort(readings.time_s, kind="stable")
    steps = np.zeros_like(readings.q)
    steps[order[1:]] = np.diff(readings.q[order], axis=0)
    known = (readings.approach != 0) & (steps != 0.0)
    known[order[0]] = False
    if not known.any() or np.mean(np.sign(steps[known]) == readings.approach[known]) < _AGREE:
        return None
    return steps
