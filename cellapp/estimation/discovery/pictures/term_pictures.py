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

from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.movement import term_movements
from cellapp.estimation.discovery.pictures.axes import axes_of
from cellapp.estimation.discovery.pictures.picture import PictureData, make_picture, rounded
from cellapp.estimation.discovery.records import CurveRecord, Picture
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.robot.effects import EFFECTS, Channel
from cellapp.robot.effects.contradiction import is_borrowed
from cellapp.robot.effects.data_driven import data_driven_form
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
