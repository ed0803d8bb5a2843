"""Pictures of a fit: each term's partial residuals in its own channel, against the variable of the term.

The partial residual is residual + term: the readings minus everything else in the model. A joint offset is estimated
along the direction J_j in which the joint moves the SMR,

    dq_j = J_j^T r / (J_j^T J_j)   (whitened),

a shift of the SMR along its main direction or, if it has none, along the computed shift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.discovery.accepted import term_movements
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.records import CurveRecord, Picture
from cellapp.estimation.discovery.terms import UNKNOWN, ModelTerm
from cellapp.robot.effects import EFFECTS, Channel, DriverVariable
from cellapp.robot.effects.contradiction import is_borrowed
from cellapp.robot.effects.data_driven import Quantity, Variable, data_driven_form
from cellapp.robot.kinematics.transforms import Array

_MOST_JOINTS = 6
"""Most joints of one term that are shown: all joints of the usual arms."""
_LEAST_LEVER = 0.05
"""Share of the longest lever below which a joint is not shown: its offsets hardly move the SMR."""
_LEAST_OWN_LEVER = 0.2
"""Share of a joint's median lever below which a reading is not shown: noise over lever would fill the picture."""
_MOST_DRAWN = 40
"""Most cycles per revolution of a line drawn over a whole turn: more, below 9 degrees a cycle, are too dense."""
_ONE_DIRECTION = 0.9
"""Share of a shift's sum of squares in one direction at which it is shown along that direction, with its sign."""
_NO_SHIFT = 1e-9
"""Length [m] below which a shift has no direction."""
_CYCLE_POINTS = 181
"""Points of a curve over one cycle; twice as many over a turn."""
_POINTS_A_CYCLE = 7
"""Points for each cycle of a curve over a turn."""


def pictures(data: ArmData, fit: JointFit) -> tuple[Picture, ...]:
    """Draw one picture for each joint with a lever that a term offsets, or one for the term's shift of the SMR.

    The term that moves the SMR most comes first, and within a term the joint that moves it most. A data-driven term of
    two variables has one picture against each of them.
    """
    levers = np.sqrt(np.mean(np.einsum("cjn,cjn->jn", fit.by_joint, fit.by_joint), axis=1))
    found: list[Picture] = []
    movements = {number: term_movements(fit, number) for number in range(len(fit.terms))}
    for number in sorted(movements, key=lambda number: -movements[number][0].moves_mm):
        one = _TermPictures(data, fit, number)
        columns = fit.term_columns(number)
        joint_of = {column.where: column.joint for column in columns if column.joint is not None}
        joints = [joint_of[place.where] for place in movements[number] if place.where in joint_of]
        for joint in joints[:_MOST_JOINTS]:
            if levers[joint] > _LEAST_LEVER * levers.max():
                found += one.of_joint(joint)
        if not joints:
            # a tilting joint axis is shown against its own joint; all other columns shift the SMR together
            axis_of = {column.where: column.index if column.channel is Channel.AXIS else None for column in columns}
            for axis in dict.fromkeys(axis_of[place.where] for place in movements[number]):
                found += one.of_shift(axis)
    return tuple(picture for picture in found if picture.x)


@dataclass(frozen=True, eq=False)
class _JointView:
    """Columns of a joint to show together, their horizontal axis, and their curve over a turn or a cycle."""

    columns: Sequence[int]
    x_label: str
    x: Array
    title: str = ""
    curve: CurveRecord | None = None


@dataclass(frozen=True, eq=False)
class _TermPictures:
    """Pictures of one term of a fit."""

    data: ArmData
    fit: JointFit
    number: int

    @property
    def _covariance(self) -> Array:
        """Covariance of the term's parameters."""
        here = self.fit.layout.parameters(self.number)
        return self.fit.identification.covariance[here, here]

    @property
    def _title(self) -> str:
        term = self.fit.terms[self.number]
        title = EFFECTS[term.slug].title
        if term.slug != UNKNOWN or is_borrowed(term.law):
            return title
        channel = data_driven_form(term.law).channel
        return title if channel.channel is Channel.JOINT else f"{title}, {channel.name}"

    def of_joint(self, joint: int) -> list[Picture]:
        """Draw the offset of a joint (from 0)."""
        fit, n = self.fit, len(self.data)
        lever = fit.by_joint[:, joint]
        square = np.maximum(np.einsum("cn,cn->n", lever, lever), 1e-300)
        rest = np.einsum("cn,cn->n", lever, fit.residual.reshape(3, n)) / square
        shown = square > _LEAST_OWN_LEVER**2 * np.median(square)
        columns, values, covariance = fit.term_columns(self.number), fit.term_values(self.number), self._covariance
        found = []
        for view in self._joint_views(joint):
            own = list(view.columns)
            offsets = np.array([columns[k].offset for k in own]).reshape(-1, n)
            band = _standard_deviation(offsets, covariance[np.ix_(own, own)])
            found.append(
                make_picture(
                    f"{self._title}, joint {joint + 1}{view.title}",
                    fit.terms[self.number].slug,
                    view.x_label,
                    f"offset of joint {joint + 1} [urad]",
                    PictureData(view.x, rest, values[own] @ offsets, band, shown),
                    view.curve,
                )
            )
        return found

    def _joint_views(self, joint: int) -> list[_JointView]:
        """Return the views of one joint: waves by cycle count, all other columns together."""
        columns = self.fit.term_columns(self.number)
        own = [k for k, column in enumerate(columns) if column.joint == joint]
        cycles = {k: count for k in own if (count := columns[k].cycles) is not None}
        if not own or len(cycles) < len(own):
            axes = axes_of(self.data, self.fit.terms[self.number], joint)
            return [_JointView(own, label, x) for label, x in axes]
        return self._periodic_views(joint, cycles)

    def _periodic_views(self, joint: int, cycles: dict[int, int]) -> list[_JointView]:
        """Return views of waves over a whole turn; fast lines, which would blur there, have their cycles overlaid."""
        angle = np.degrees(self.data.readings.q[:, joint])
        smooth = self.fit.terms[self.number].smooth is not None
        fast = [] if smooth else sorted({count for count in cycles.values() if count > _MOST_DRAWN})
        slow = [k for k, count in cycles.items() if count not in fast]
        views = []
        if slow:
            points = max(2 * _CYCLE_POINTS - 1, _POINTS_A_CYCLE * max(cycles[k] for k in slow) + 1)
            folded = np.remainder(angle + 180.0, 360.0) - 180.0
            curve = self._curve(slow, np.linspace(-180.0, 180.0, points))
            views.append(_JointView(slow, f"joint {joint + 1} [deg]", folded, curve=curve))
        while fast:
            base = math.gcd(*fast)
            base = base if base > _MOST_DRAWN else fast[0]
            period = 360.0 / base
            own = [k for k, count in cycles.items() if count in fast and count % base == 0]
            label = f"joint {joint + 1}, within a cycle of {period:.3g} deg [deg]"
            title = f", its {base} cycles per revolution laid over one another"
            curve = self._curve(own, np.linspace(0.0, period, _CYCLE_POINTS))
            views.append(_JointView(own, label, np.remainder(angle, period), title, curve))
            fast = [count for count in fast if count % base]
        return views

    def _curve(self, own: Sequence[int], angle_deg: Array) -> CurveRecord:
        """Return the curve of waves, also at angles without readings."""
        columns = self.fit.term_columns(self.number)
        waves = np.array([wave(np.radians(angle_deg)) for k in own if (wave := columns[k].wave) is not None])
        chosen = list(own)
        band = _standard_deviation(waves, self._covariance[np.ix_(chosen, chosen)])
        value = self.fit.term_values(self.number)[chosen] @ waves
        return CurveRecord(x=rounded(angle_deg), value=rounded(value * 1e6), band=rounded(band * 1e6))

    def of_shift(self, axis: int | None) -> list[Picture]:
        """Draw the shift of the SMR by the columns that act on the axis of joint ``axis`` (from 0), by all if None."""
        term, columns, here = self.fit.terms[self.number], self.fit.term_columns(self.number), self.fit.positions
        own = [k for k, one in enumerate(columns) if one.shift_M is not None and axis in (None, one.index)]
        shifts = np.array([columns[k].shift_M for k in own]).reshape(-1, len(self.data), 3)[:, here]
        shift_M = np.einsum("k,kna->na", self.fit.term_values(self.number)[own], shifts)
        direction_M, y_label, along = _shift_direction(shift_M)
        rest = np.einsum("na,na->n", direction_M, self.fit.identification.residuals[here])
        computed = np.einsum("na,na->n", direction_M, shift_M)
        along_columns = np.einsum("kna,na->kn", shifts, direction_M)
        band = _standard_deviation(along_columns, self._covariance[np.ix_(own, own)])
        shown = np.asarray(direction_M.any(axis=1))
        title = f"{self._title}{along}" if axis is None else f"{self._title}, joint {axis + 1}{along}"
        return [
            make_picture(title, term.slug, x_label, y_label, PictureData(x[here], rest, computed, band, shown))
            for x_label, x in axes_of(self.data, term, None, axis)
        ]


def _shift_direction(shift_M: Array) -> tuple[Array, str, str]:
    """Return the unit direction (n, 3) of the shown shifts (zero without one), the axis label and a title suffix.

    One direction serves for all if it holds nearly all of the shifts; else each has its own.
    """
    _, sizes, directions = np.linalg.svd(shift_M, full_matrices=False)
    if sizes[0] ** 2 >= _ONE_DIRECTION * np.sum(sizes**2) and sizes[0] > 0.0:
        one = directions[0] * np.sign(directions[0][np.argmax(np.abs(directions[0]))])
        # adding zero turns minus zero into zero
        text = ", ".join(f"{round(value, 2) + 0.0:.2f}" for value in one.tolist())
        direction = np.broadcast_to(one, shift_M.shape)
        return direction, "shift of the SMR that way [um]", f", along ({text}) of the tracker frame"
    length = np.linalg.norm(shift_M, axis=1)[:, None]
    direction = np.where(length > _NO_SHIFT, shift_M / np.maximum(length, _NO_SHIFT), 0.0)
    return direction, "shift of the SMR along the effect [um]", ""


def _standard_deviation(columns: Array, covariance: Array) -> Array:
    """Return the standard deviation (n,) of the sum of columns (k, n) whose coefficients have ``covariance`` (k, k)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("kn,kn->n", columns, covariance @ columns), 0.0)))


# -- Horizontal axis of a term's picture: the main variable of the term, with its label and unit ----------------------


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


# -- One picture of a term: measured and computed values against the variable of the term, thinned and sorted ---------


_MOST_POINTS = 600
"""Most points of one picture: as many as a figure of that width in pixels can show."""
_DIGITS = 5
"""Significant digits of its numbers: far finer than a figure, and a third of the size in JSON."""


@dataclass(frozen=True, eq=False)
class PictureData:
    """Values (n,) for a picture in the order of the readings, in SI units.

    ``rest`` is the residual, ``band`` the standard deviation of ``computed``, ``shown`` a mask of the readings.
    """

    x: Array
    rest: Array
    computed: Array
    band: Array
    shown: NDArray[np.bool_]


def make_picture(
    title: str, effect: str, x_label: str, y_label: str, data: PictureData, curve: CurveRecord | None = None
) -> Picture:
    """Sort by x, thin out, and convert to micrometres or microradians."""
    places = np.flatnonzero(data.shown & np.isfinite(data.x))
    places = places[np.argsort(data.x[places], kind="stable")]
    if len(places) > _MOST_POINTS:
        places = places[np.linspace(0, len(places) - 1, _MOST_POINTS).astype(np.intp)]
    x, rest, computed, band = data.x[places], data.rest[places], data.computed[places], data.band[places]
    return Picture(
        title=title,
        effect=effect,
        x_label=x_label,
        y_label=y_label,
        x=rounded(x),
        measured=rounded((rest + computed) * 1e6),
        computed=rounded(computed * 1e6),
        band=rounded(band * 1e6),
        curve=curve,
    )


def rounded(values: Array) -> tuple[float, ...]:
    """Round values to the digits that a picture needs."""
    return tuple(float(f"{value:.{_DIGITS}g}") for value in values)
