"""Pictures with a meaning: what a part of the model explains, in its own channel against what it depends on."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.discovery.data import ArmData, Fit, Part
from cellapp.effects import EFFECTS, EffectColumn
from cellapp.effects.unknown import values_of
from cellapp.kinematics.transforms import Array

_MOST_POINTS = 600
_MOST_JOINTS = 6
_FEEBLE = 0.05
"""A joint whose lever is below this share of the longest moves the SMR too little for its offsets to be seen."""
_WAVE = re.compile(r"(cos|sin)(\d+)q(\d+)")
_FAST = 40
"""Lines of more cycles a turn are too dense to be drawn over the whole turn."""
_ONE_WAY = 0.9
"""A shift of which one direction holds this share of the squares is shown along that direction, with its sign."""
_IN_WORDS = {
    "time": ("time [h]", 1.0 / 3600.0),
    "dwell": ("dwell [s]", 1.0),
    "payload": ("payload [kg]", 1.0),
    "temperature": ("air temperature [degC]", 1.0),
    "range": ("distance from the tracker [m]", 1.0),
    "azimuth": ("azimuth seen by the tracker [deg]", np.degrees(1.0)),
    "elevation": ("elevation seen by the tracker [deg]", np.degrees(1.0)),
    "incidence": ("incidence [deg]", np.degrees(1.0)),
}


@dataclass(frozen=True)
class Curve:
    """A periodic curve over a turn or a cycle of it: joint angle [deg], offset and its standard deviation [urad]."""

    x: tuple[float, ...]
    value: tuple[float, ...]
    band: tuple[float, ...]


_Shown = tuple[Sequence[int], str, str, Array, Curve | None]
"""Columns to show together, what they are, the label of x, x (n,), and their curve."""


@dataclass(frozen=True)
class Picture:
    """Points (x, measured) and what the model says there, for one part and one place that it acts on.

    ``measured`` is what the readings show in the part's channel once everything else in the model is taken away,
    ``computed`` the part itself; both in the unit of ``y_label``. ``band`` is the standard deviation of ``computed``,
    geometry included. ``curve`` is there for what is periodic in the joint angle; x is then folded into one turn, or
    into one cycle.
    """

    title: str
    effect: str
    x_label: str
    y_label: str
    x: tuple[float, ...]
    measured: tuple[float, ...]
    computed: tuple[float, ...]
    band: tuple[float, ...] = ()
    curve: Curve | None = None


def cycles(names: Sequence[str], values: Array) -> dict[str, dict[str, float]]:
    """The dominating cycles a turn of each joint (key: its number) of periodic errors named as ``cos12q3``, [rad].

    ``from`` and ``to`` hold the middle 80 % of the power between them, ``peak`` has most of it; ``rms_urad`` is over a
    whole turn.
    """
    power: dict[str, dict[int, float]] = {}
    for name, value in zip(names, values.tolist(), strict=True):
        parsed = _WAVE.fullmatch(name)
        if parsed is not None:
            count, joint = int(parsed[2]), parsed[3]
            of_joint = power.setdefault(joint, {})
            of_joint[count] = of_joint.get(count, 0.0) + 0.5 * value**2
    found = {}
    for joint in sorted(power, key=int):
        counts = sorted(power[joint])
        each = np.array([power[joint][count] for count in counts])
        if not each.any():
            continue
        share = np.cumsum(each) / each.sum()
        first, last = (counts[min(int(np.searchsorted(share, at)), len(counts) - 1)] for at in (0.1, 0.9))
        found[joint] = {
            "from": first,
            "to": last,
            "peak": counts[int(np.argmax(each))],
            "rms_urad": float(np.sqrt(each.sum())) * 1e6,
        }
    return found


def pictures(data: ArmData, fit: Fit) -> tuple[Picture, ...]:
    """One picture for each joint that a part turns and that has a lever, or one for the part's shift of the SMR.

    A data-driven term of two variables has one against each of them.
    """
    shown: list[Picture] = []
    levers = np.sqrt(np.mean(np.einsum("cjn,cjn->jn", fit.by_joint, fit.by_joint), axis=1))
    begin = 0
    for part in fit.choice:
        here = slice(begin, begin + len(part.names))
        begin = here.stop
        seen = _Seen(data, fit, part, here)
        joints = sorted({column.joint for column in seen.columns if column.joint is not None})
        for joint in joints[:_MOST_JOINTS]:
            if levers[joint] > _FEEBLE * levers.max():
                shown += seen.of_joint(joint)
        if not joints:
            # an axis that wobbles is looked at against its own joint; all else shifts the SMR together
            places = dict.fromkeys(one.where if one.where.startswith("joint ") else "" for one in seen.columns)
            for place in places:
                shown += seen.of_shift(place)
    return tuple(picture for picture in shown if picture.x)


class _Seen:
    """One part of a fit, and how its pictures are made."""

    def __init__(self, data: ArmData, fit: Fit, part: Part, here: slice) -> None:
        self.data, self.fit, self.part = data, fit, part
        self.columns: Sequence[EffectColumn] = fit.columns[here]
        self.values = fit.identification.effect_values[here]
        size = len(fit.identification.parameter_set.columns)
        self.covariance = fit.identification.covariance[
            size + here.start : size + here.stop, size + here.start : size + here.stop
        ]
        self.title = EFFECTS[part.slug].title
        channel = part.law.name.partition("|")[0]
        if part.slug == "unknown" and not channel.startswith("joint "):
            self.title += f", {channel}"

    def of_joint(self, joint: int) -> list[Picture]:
        """The offset of a joint, from what the readings show along the way that the joint moves the SMR."""
        n = len(self.data)
        rows = [k for k, column in enumerate(self.columns) if column.joint == joint and column.offset is not None]
        lever = self.fit.by_joint[:, joint]
        square = np.maximum(np.einsum("cn,cn->n", lever, lever), 1e-300)
        left = np.einsum("cn,cn->n", lever, self.fit.residual.reshape(3, n)) / square
        # where the joint has no lever its offset shows nowhere
        seen = square > 0.04 * np.median(square)
        counts = self._counts(rows)
        shown: list[_Shown]
        if counts is None:
            shown = [(rows, "", label, x, None) for label, x in _against(self.data, self.part, joint)]
        else:
            shown = self._periodic(joint, rows, counts)
        found = []
        for own, what, x_label, x, curve in shown:
            B = np.array([self.columns[k].offset for k in own]).reshape(-1, n)
            computed = self.values[own] @ B
            band = _deviation(B, self.covariance[np.ix_(own, own)])
            found.append(
                _picture(
                    f"{self.title}, joint {joint + 1}{what}",
                    self.part.slug,
                    x_label,
                    f"offset of joint {joint + 1} [urad]",
                    x[seen],
                    (left + computed)[seen] * 1e6,
                    computed[seen] * 1e6,
                    band[seen] * 1e6,
                    curve,
                )
            )
        return found

    def _counts(self, rows: Sequence[int]) -> list[int] | None:
        """The cycle counts of columns that are all waves of the joint angle; None where one is not."""
        parsed = [_WAVE.fullmatch(self.columns[k].name) for k in rows]
        counts = [int(match[2]) for match in parsed if match is not None]
        return counts if counts and len(counts) == len(rows) else None

    def _periodic(self, joint: int, rows: Sequence[int], counts: Sequence[int]) -> list[_Shown]:
        """Waves over a whole turn; fast lines, which would be a blur there, with their cycles laid over one another."""
        angle = np.degrees(self.data.readings.q[:, joint])
        fast = [] if self.part.curves is not None else sorted({count for count in counts if count > _FAST})
        slow = [k for k, count in zip(rows, counts, strict=True) if count not in fast]
        shown: list[_Shown] = []
        if slow:
            around = np.linspace(-180.0, 180.0, max(361, 7 * max(c for c in counts if c not in fast) + 1))
            folded = np.remainder(angle + 180.0, 360.0) - 180.0
            shown.append((slow, "", f"joint {joint + 1} [deg]", folded, self._curve(slow, around)))
        while fast:
            base = math.gcd(*fast)
            base = base if base > _FAST else fast[0]
            together = {count for count in fast if count % base == 0}
            own = [k for k, count in zip(rows, counts, strict=True) if count in together]
            turn = 360.0 / base
            label = f"joint {joint + 1}, within a cycle of {turn:.3g} deg [deg]"
            what = f", its {base} cycles a turn laid over one another"
            shown.append((own, what, label, np.remainder(angle, turn), self._curve(own, np.linspace(0.0, turn, 181))))
            fast = [count for count in fast if count not in together]
        return shown

    def of_shift(self, place: str) -> list[Picture]:
        """The shift of the SMR, along its one direction, or its length where it goes every way.

        Of the columns that act on ``place``; of all where that is empty.
        """
        shifting = [k for k, column in enumerate(self.columns) if column.shift_M is not None]
        rows = [k for k in shifting if place in ("", self.columns[k].where)]
        shifts = np.array([self.columns[k].shift_M for k in rows]).reshape(-1, len(self.data), 3)
        shift = np.einsum("k,kna->na", self.values[rows], shifts)
        length = np.linalg.norm(shift, axis=1)
        _, sizes, ways = np.linalg.svd(shift, full_matrices=False)
        if sizes[0] ** 2 >= _ONE_WAY * np.sum(sizes**2) and sizes[0] > 0.0:
            one = ways[0] * np.sign(ways[0][np.argmax(np.abs(ways[0]))])
            way = np.broadcast_to(one, shift.shape)
            # adding zero makes minus zero plain
            direction = ", ".join(f"{round(value, 2) + 0.0:.2f}" for value in one.tolist())
            label, along = "shift of the SMR that way [um]", f", along ({direction}) of the tracker frame"
            seen = np.ones(len(shift), dtype=bool)
        else:
            way = shift / np.maximum(length, 1e-12)[:, None]
            label, along, seen = "shift of the SMR along the effect [um]", "", length > 1e-9
        computed = np.einsum("na,na->n", way, shift)
        left = np.einsum("na,na->n", way, self.fit.identification.residuals)
        band = _deviation(np.einsum("kna,na->kn", shifts, way), self.covariance[np.ix_(rows, rows)])
        joint = int(place.removeprefix("joint ")) - 1 if place else None
        return [
            _picture(
                f"{self.title}, {place}{along}" if place else f"{self.title}{along}",
                self.part.slug,
                x_label,
                label,
                x[seen],
                (left + computed)[seen] * 1e6,
                computed[seen] * 1e6,
                band[seen] * 1e6,
                None,
            )
            for x_label, x in _against(self.data, self.part, None, joint)
        ]

    def _curve(self, rows: Sequence[int], around: Array) -> Curve:
        """The curve of waves over ``around`` [deg], also where no reading was taken."""
        waves = {"cos": np.cos, "sin": np.sin}
        parsed = [_WAVE.fullmatch(self.columns[k].name) for k in rows]
        B = np.array([waves[match[1]](int(match[2]) * np.radians(around)) for match in parsed if match is not None])
        band = _deviation(B, self.covariance[np.ix_(rows, rows)])
        return Curve(_told(around), _told(self.values[rows] @ B * 1e6), _told(band * 1e6))


def _deviation(B: Array, covariance: Array) -> Array:
    """Standard deviation (n,) of what columns (k, n) of uncertain values make together."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("kn,kn->n", B, covariance @ B), 0.0)))


def _told(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{value:.5g}") for value in values)


def _picture(
    title: str,
    effect: str,
    x_label: str,
    y_label: str,
    x: Array,
    measured: Array,
    computed: Array,
    band: Array,
    curve: Curve | None,
) -> Picture:
    order = np.argsort(x, kind="stable")
    order = order[np.isfinite(x[order])]
    if len(order) > _MOST_POINTS:
        order = order[np.linspace(0, len(order) - 1, _MOST_POINTS).astype(np.intp)]
    x, measured, computed, band = x[order], measured[order], computed[order], band[order]
    return Picture(title, effect, x_label, y_label, _told(x), _told(measured), _told(computed), _told(band), curve)


def _against(data: ArmData, part: Part, turned: int | None, beside: int | None = None) -> list[tuple[str, Array]]:
    """What a part is best looked at against: labels and values (n,); of a data-driven term each of its variables.

    ``turned`` is the joint that it turns, ``beside`` one that it moves with without turning it.
    """
    if part.slug != "unknown":
        return [_against_named(data, part, turned, beside)]
    found = []
    for name in part.law.name.split("|")[1:]:
        values = values_of(data.context, name)
        if name in _IN_WORDS:
            label, factor = _IN_WORDS[name]
        elif name.startswith("torque"):
            label, factor = f"gravity torque on joint {name[6:]} [Nm]", 1.0
        elif name.startswith("step"):
            label, factor = f"last step of joint {name[4:]} [deg]", np.degrees(1.0)
        else:
            whose = " of the other arm" if name.startswith("other ") else ""
            label, factor = f"joint {name.rpartition('q')[2]}{whose} [deg]", np.degrees(1.0)
        if np.isfinite(values).any():
            found.append((label, values * factor))
    return found


def _against_named(data: ArmData, part: Part, turned: int | None, beside: int | None) -> tuple[str, Array]:
    """What an effect of the library is best looked at against: label and values (n,)."""
    context, known = data.context, data.known
    variables = EFFECTS[part.slug].variables
    if turned is not None:
        if "step" in variables and known.step is not None:
            return f"last step of joint {turned + 1} [deg]", np.degrees(context.step[:, turned])
        if "torque" in variables:
            sign = context.approach[:, turned] if "approach" in variables else 1.0
            signed = ", signed by the approach" if "approach" in variables else ""
            return f"gravity torque on joint {turned + 1} [Nm]{signed}", np.asarray(context.torques[:, turned] * sign)
        if "approach" in variables:
            return f"approach direction of joint {turned + 1}", context.approach[:, turned]
    if "temperature" in variables and part.law.name.startswith("air") and known.air_c is not None:
        return "air temperature [degC]", known.air_c
    if "temperature" in variables and part.law.name.startswith("joint") and known.joints_c is not None:
        if turned is None:
            return "mean temperature of the joints [degC]", known.joints_c.mean(axis=1)
        return f"temperature of joint {turned + 1} [degC]", known.joints_c[:, turned]
    if "time" in variables and known.time_s is not None and np.isfinite(known.time_s).any():
        return "time [h]", known.time_s / 3600.0
    if "other_arm" in variables and known.other_moment_M is not None:
        return "moment of the other arm [Nm]", np.linalg.norm(known.other_moment_M, axis=1)
    if "beam" in variables:
        return "distance from the tracker [m]", context.beam[0]
    if "incidence" in variables and context.smr_normal is not None:
        return "incidence [deg]", np.degrees(values_of(context, "incidence"))
    if turned is None and "torque" in variables:
        return "gravity torque on joint 2 [Nm]", context.torques[:, min(1, context.joints - 1)]
    number = beside or 0 if turned is None else turned
    return f"joint {number + 1} [deg]", np.degrees(data.readings.q[:, number])
