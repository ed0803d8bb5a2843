"""Measurement conditions that effects depend on: last steps, other arm, times, temperatures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.estimation.readings import Readings
from cellapp.robot.effects import MeasurementConditions, TemperatureRecord
from cellapp.robot.kinematics.statics import base_moment
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

_LEAST_AGREEMENT = 0.95
"""Least share of the logged approach signs that match the steps between successive stops, for these to serve as last
steps. Below it the arms took detours; a few logged signs may be wrong, as controllers report tiny corrections."""


def measurement_conditions(readings: Readings, other: tuple[ArmModel, Readings] | None = None) -> MeasurementConditions:
    """Collect the conditions of one arm's readings; ``other`` is the model and the readings of the other arm, if any.

    Steps that were not logged are derived from the order of the stops in time, if they match the approach signs. The
    other arm's values are NaN at stops where it has no reading.
    """
    time_s = readings.time_s if np.isfinite(readings.time_s).any() else None
    approach = readings.approach if np.any(readings.approach) else None
    moment = other_q = None
    if other is not None and len(other[1]):
        model, theirs = other
        rows = {number: row for row, number in enumerate(theirs.configuration.tolist())}
        match = np.array([rows.get(number, -1) for number in readings.configuration.tolist()], dtype=np.intp)
        at = np.full((len(readings), theirs.joints), np.nan) if readings.other_q is None else readings.other_q.copy()
        at[match >= 0] = theirs.q[match[match >= 0]]
        present = np.isfinite(at).all(axis=1)
        if present.any():
            other_q, payload = at, None
            if theirs.payload_kg is not None:  # stops beside recordings have one load
                payload = np.where(match >= 0, theirs.payload_kg[match], theirs.payload_kg[0])[present]
            moment = np.full((len(readings), 3), np.nan)
            moment[present] = base_moment(model.geometry, model.bodies, at[present], model.up_M, payload)
    return MeasurementConditions(
        approach=approach,
        step=_with_derived_steps(readings.step, _steps(readings)),
        dwell_s=readings.dwell_s,
        time_s=time_s,
        order=_order(readings),
        payload_kg=readings.payload_kg,
        payload_center_F=readings.payload_center_F,
        air_c=readings.temperature_c,
        joints_c=readings.joint_temperature_c,
        other_moment_M=moment,
        other_q=other_q,
        record=_record(readings),
    )


def conditions_of_arms(
    models: Mapping[str, ArmModel], readings: Mapping[str, Readings]
) -> dict[str, MeasurementConditions]:
    """Collect the conditions of every arm's readings; in a cell of two arms, with the other arm's pose and load."""
    found = {}
    for name, own in readings.items():
        others = [other for other in readings if other != name]
        other = (models[others[0]], readings[others[0]]) if len(others) == 1 else None
        found[name] = measurement_conditions(own, other)
    return found


def _order(readings: Readings) -> Array | None:
    """Return ranks (n,) in the order of measurement [stops], by sequence, else by time; None if that is incomplete."""
    known = readings.time_s if readings.sequence is None else readings.sequence
    if not len(known) or not np.isfinite(known).all():
        return None
    return np.argsort(np.argsort(known, kind="stable")).astype(np.float64)


def _with_derived_steps(logged: Array | None, derived: Array | None) -> Array | None:
    """Fill rows without logged steps with derived ones (readings of a version that did not log steps)."""
    if logged is None or derived is None:
        return derived if logged is None else logged
    return np.where(np.isnan(logged), derived, logged)


def _record(readings: Readings) -> TemperatureRecord | None:
    """Return the temperature history of the run; None unless times and joint temperatures are complete."""
    joints_c, time_s = readings.joint_temperature_c, readings.time_s
    if joints_c is None or not np.isfinite(joints_c).all() or not np.isfinite(time_s).all():
        return None
    air_c = readings.temperature_c
    if air_c is None or not np.isfinite(air_c).all():
        air_c = joints_c.mean(axis=1)
    return TemperatureRecord(time_s, joints_c, air_c)


def _steps(readings: Readings) -> Array | None:
    """Compute steps (n, N) [rad] between successive stops; None if times or approach signs are missing or disagree."""
    if len(readings) < 2 or not np.isfinite(readings.time_s).all() or not np.any(readings.approach):
        return None
    order = np.argsort(readings.time_s, kind="stable")
    steps = np.zeros_like(readings.q)
    steps[order[1:]] = np.diff(readings.q[order], axis=0)
    known = (readings.approach != 0) & (steps != 0.0)
    known[order[0]] = False
    if not known.any() or np.mean(np.sign(steps[known]) == readings.approach[known]) < _LEAST_AGREEMENT:
        return None
    return steps
