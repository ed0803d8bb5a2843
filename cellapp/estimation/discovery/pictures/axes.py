"""Horizontal axis of a term's picture: the main variable of the term, with its label and unit."""

from __future__ import annotations

import numpy as np

from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.terms import UNKNOWN, ModelTerm
from cellapp.robot.effects import EFFECTS, DriverVariable
from cellapp.robot.effects.contradiction import is_borrowed
from cellapp.robot.effects.data_driven import Quantity, Variable, data_driven_form
from cellapp.robot.kinematics.transforms import Array

Axis = tuple[str, Array]
"""Label and values (n,)."""
_LABELS = {
    Quantity.JOINT_ANGLE: ("joint {} [deg]", np.degrees(1.0)),
    Quantity.OTHER_JOINT_ANGLE: ("joint {} of the other arm [deg]", np.degrees(1.0)),
    Quantity.TORQUE: ("gravity torque on joint {} [Nm]", 1.0),
    Quantity.STEP: ("last step of joint {} [deg]", np.degrees(1.0)),
    Quantity.TIME: ("time [h]", 1.0 / 3600.0),
    Quantity.DWELL: ("dwell [s]", 1.0),
    Quantity.PAYLOAD: ("payload [kg]", 1.0),
    Quantity.TEMPERATURE: ("air temperature [degC]", 1.0),
    Quantity.RANGE: ("distance from the tracker [m]", 1.0),
    Quantity.AZIMUTH: ("azimuth seen by the tracker [deg]", np.degrees(1.0)),
    Quantity.ELEVATION: ("elevation seen by the tracker [deg]", np.degrees(1.0)),
    Quantity.INCIDENCE: ("incidence [deg]", np.degrees(1.0)),
    Quantity.X: ("x in the base frame [m]", 1.0),
    Quantity.Y: ("y in the base frame [m]", 1.0),
    Quantity.Z: ("z in the base frame [m]", 1.0),
}
"""Label of a variable of data-driven terms, with a placeholder for the joint, and the factor from SI units."""
_LOADED_JOINT = 1
"""Joint (from 0) whose gravity torque represents the load on the whole arm: the shoulder carries it on most arms."""


def axes_of(data: ArmData, term: ModelTerm, joint: int | None, beside: int | None = None) -> list[Axis]:
    """Return the axes to show a term against; for a data-driven term one for each of its variables.

    ``joint`` (from 0) is the joint that the term offsets; ``beside`` a joint on which the term acts without an offset.
    """
    if term.slug != UNKNOWN or is_borrowed(term.law):
        return [_axis_of_effect(data, term, joint, beside)]
    found = []
    for variable in data_driven_form(term.law).drivers:
        values = variable.values(data.context)
        label, factor = _LABELS[variable.quantity]
        if variable.joint is not None:
            label = label.format(variable.joint + 1)
        if np.isfinite(values).any():
            found.append((label, values * factor))
    return found


def _axis_of_effect(data: ArmData, term: ModelTerm, joint: int | None, beside: int | None) -> Axis:
    """Return the axis of a library effect: the first that applies of motion, time, temperature, field, load, angle."""
    variables = term.law.form.variables or EFFECTS[term.slug].variables
    axis = None if joint is None else _motion_axis(data, variables, joint)
    axis = axis or _time_or_temperature_axis(data, variables, joint) or _field_axis(data, variables)
    if axis is not None:
        return axis
    context = data.context
    if joint is None and DriverVariable.TORQUE in variables:
        loaded = min(_LOADED_JOINT, context.joints - 1)
        return f"gravity torque on joint {loaded + 1} [Nm]", context.torques[:, loaded]
    number = (beside or 0) if joint is None else joint
    return f"joint {number + 1} [deg]", np.degrees(data.readings.q[:, number])


def _motion_axis(data: ArmData, variables: frozenset[DriverVariable], joint: int) -> Axis | None:
    """Return last step, gravity torque or approach direction of a joint; None if none applies."""
    context = data.context
    if DriverVariable.STEP in variables and data.conditions.step is not None:
        return f"last step of joint {joint + 1} [deg]", np.degrees(context.step[:, joint])
    if DriverVariable.TORQUE in variables:
        label = f"gravity torque on joint {joint + 1} [Nm]"
        if DriverVariable.APPROACH in variables:
            return f"{label}, signed by the approach", context.torques[:, joint] * context.approach[:, joint]
        return label, context.torques[:, joint]
    if DriverVariable.APPROACH in variables:
        return f"approach direction of joint {joint + 1}", context.approach[:, joint]
    return None


def _time_or_temperature_axis(data: ArmData, variables: frozenset[DriverVariable], joint: int | None) -> Axis | None:
    """Return time, or temperature of the air or of joints; None if none applies."""
    conditions = data.conditions
    if DriverVariable.TIME in variables and conditions.time_s is not None and np.isfinite(conditions.time_s).any():
        return "time [h]", conditions.time_s / 3600.0
    if DriverVariable.AIR_TEMPERATURE in variables and conditions.air_c is not None:
        return "air temperature [degC]", conditions.air_c
    if DriverVariable.JOINT_TEMPERATURE in variables and conditions.joints_c is not None:
        if joint is None:
            return "mean temperature of the joints [degC]", conditions.joints_c.mean(axis=1)
        return f"temperature of joint {joint + 1} [degC]", conditions.joints_c[:, joint]
    return None


def _field_axis(data: ArmData, variables: frozenset[DriverVariable]) -> Axis | None:
    """Return the other arm's load, or the place in the tracker's field; None if none applies."""
    context, conditions = data.context, data.conditions
    if DriverVariable.OTHER_ARM in variables and conditions.other_moment_M is not None:
        return "moment of the other arm [Nm]", np.linalg.norm(conditions.other_moment_M, axis=1)
    if DriverVariable.BEAM in variables:
        return "distance from the tracker [m]", context.beam[0]
    if DriverVariable.INCIDENCE in variables and context.smr_normal is not None:
        return "incidence [deg]", np.degrees(Variable(Quantity.INCIDENCE).values(context))
    return None
