"""Horizontal axis of a term's picture: the variable that the term depends on most plainly, with its label and unit."""

from __future__ import annotations

import numpy as np

from cellapp.discovery.data import ArmData
from cellapp.discovery.terms import UNKNOWN, ModelTerm
from cellapp.effects import EFFECTS
from cellapp.effects.unknown import values_of
from cellapp.kinematics.transforms import Array

Axis = tuple[str, Array]
"""Label and values (n,)."""
_LABELS = {
    "time": ("time [h]", 1.0 / 3600.0),
    "dwell": ("dwell [s]", 1.0),
    "payload": ("payload [kg]", 1.0),
    "temperature": ("air temperature [degC]", 1.0),
    "range": ("distance from the tracker [m]", 1.0),
    "azimuth": ("azimuth seen by the tracker [deg]", np.degrees(1.0)),
    "elevation": ("elevation seen by the tracker [deg]", np.degrees(1.0)),
    "incidence": ("incidence [deg]", np.degrees(1.0)),
}
"""Label of a variable of data-driven terms, and the factor from SI units to those of the label."""
_LOADED_JOINT = 1
"""Joint (from 0) whose gravity torque stands for the load on the whole arm: the shoulder carries it on most arms."""


def axes_of(data: ArmData, term: ModelTerm, joint: int | None, beside: int | None = None) -> list[Axis]:
    """Axes to show a term against; of a data-driven term one for each of its variables.

    ``joint`` (from 0) is the one that the term offsets; ``beside`` is a joint that the term acts at without an offset.
    """
    if term.slug != UNKNOWN:
        return [_axis_of_effect(data, term, joint, beside)]
    found = []
    for name in term.law.name.split("|")[1:]:
        values = values_of(data.context, name)
        label, factor = _label(name)
        if np.isfinite(values).any():
            found.append((label, values * factor))
    return found


def _label(variable: str) -> tuple[str, float]:
    """Label of a variable, and the factor to its unit."""
    if variable in _LABELS:
        return _LABELS[variable]
    if variable.startswith("torque"):
        return f"gravity torque on joint {variable[6:]} [Nm]", 1.0
    if variable.startswith("step"):
        return f"last step of joint {variable[4:]} [deg]", np.degrees(1.0)
    whose = " of the other arm" if variable.startswith("other ") else ""
    return f"joint {variable.rpartition('q')[2]}{whose} [deg]", np.degrees(1.0)


def _axis_of_effect(data: ArmData, term: ModelTerm, joint: int | None, beside: int | None) -> Axis:
    """Axis of an effect of the library: the first that applies of motion, temperature, time, field, load, angle."""
    variables = EFFECTS[term.slug].variables
    axis = None if joint is None else _motion_axis(data, variables, joint)
    axis = axis or _temperature_axis(data, term, joint) or _run_axis(data, variables)
    if axis is not None:
        return axis
    context = data.context
    if joint is None and "torque" in variables:
        loaded = min(_LOADED_JOINT, context.joints - 1)
        return f"gravity torque on joint {loaded + 1} [Nm]", context.torques[:, loaded]
    number = (beside or 0) if joint is None else joint
    return f"joint {number + 1} [deg]", np.degrees(data.readings.q[:, number])


def _motion_axis(data: ArmData, variables: frozenset[str], joint: int) -> Axis | None:
    """Last step, gravity torque or approach direction of a joint."""
    context = data.context
    if "step" in variables and data.known.step is not None:
        return f"last step of joint {joint + 1} [deg]", np.degrees(context.step[:, joint])
    if "torque" in variables:
        label = f"gravity torque on joint {joint + 1} [Nm]"
        if "approach" in variables:
            return f"{label}, signed by the approach", context.torques[:, joint] * context.approach[:, joint]
        return label, context.torques[:, joint]
    if "approach" in variables:
        return f"approach direction of joint {joint + 1}", context.approach[:, joint]
    return None


def _temperature_axis(data: ArmData, term: ModelTerm, joint: int | None) -> Axis | None:
    """Temperature of the air or of joints, whichever the law depends on."""
    known = data.known
    if "temperature" not in EFFECTS[term.slug].variables:
        return None
    if term.law.name.startswith("air") and known.air_c is not None:
        return "air temperature [degC]", known.air_c
    if term.law.name.startswith("joint") and known.joints_c is not None:
        if joint is None:
            return "mean temperature of the joints [degC]", known.joints_c.mean(axis=1)
        return f"temperature of joint {joint + 1} [degC]", known.joints_c[:, joint]
    return None


def _run_axis(data: ArmData, variables: frozenset[str]) -> Axis | None:
    """Time, the other arm's load, or the place in the tracker's field."""
    context, known = data.context, data.known
    if "time" in variables and known.time_s is not None and np.isfinite(known.time_s).any():
        return "time [h]", known.time_s / 3600.0
    if "other_arm" in variables and known.other_moment_M is not None:
        return "moment of the other arm [Nm]", np.linalg.norm(known.other_moment_M, axis=1)
    if "beam" in variables:
        return "distance from the tracker [m]", context.beam[0]
    if "incidence" in variables and context.smr_normal is not None:
        return "incidence [deg]", np.degrees(values_of(context, "incidence"))
    return None
