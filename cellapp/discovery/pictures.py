"""Pictures with a meaning: what a part of the model explains, in its own channel against what it depends on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellapp.discovery.data import ArmData, Fit
from cellapp.effects import EFFECTS
from cellapp.kinematics.transforms import Array

_MOST_POINTS = 600
_MOST_JOINTS = 6


@dataclass(frozen=True)
class Picture:
    """Points (x, measured) and what the model says there, for one part and one place that it acts on.

    ``measured`` is what the readings show in the part's channel once everything else in the model is taken away,
    ``computed`` the part itself; both in the unit of ``y_label``. ``band`` is the standard deviation of a free curve.
    """

    title: str
    effect: str
    x_label: str
    y_label: str
    x: tuple[float, ...]
    measured: tuple[float, ...]
    computed: tuple[float, ...]
    band: tuple[float, ...] = ()

    def as_dict(self) -> Mapping[str, Any]:
        """For JSON."""
        return {
            "title": self.title,
            "effect": self.effect,
            "x_label": self.x_label,
            "y_label": self.y_label,
            "x": list(self.x),
            "measured": list(self.measured),
            "computed": list(self.computed),
            "band": list(self.band),
        }


def pictures(data: ArmData, fit: Fit) -> tuple[Picture, ...]:
    """One picture for each joint that a part turns, or one for the part's shift of the SMR."""
    shown: list[Picture] = []
    n = len(data)
    begin = 0
    for place, part in enumerate(fit.choice):
        columns = fit.columns[begin : begin + len(part.names)]
        values = fit.identification.effect_values[begin : begin + len(part.names)]
        begin += len(part.names)
        title = EFFECTS[part.slug].title
        joints = sorted({column.joint for column in columns if column.joint is not None})[:_MOST_JOINTS]
        for joint in joints:
            computed = np.zeros(n)
            for column, value in zip(columns, values.tolist(), strict=True):
                if column.joint == joint and column.offset is not None:
                    computed += value * column.offset
            lever = fit.by_joint[:, joint]
            square = np.maximum(np.einsum("cn,cn->n", lever, lever), 1e-300)
            left = np.einsum("cn,cn->n", lever, fit.residual.reshape(3, n)) / square
            # where the joint has no lever its offset shows nowhere
            seen = square > 0.04 * np.median(square)
            x_label, x = _against(data, part.slug, joint)
            band: Array | None = None
            spread = fit.model.effects[place].spread.get(joint)
            if spread is not None:
                around = np.linspace(-np.pi, np.pi, len(spread), endpoint=False)
                band = np.interp(data.readings.q[:, joint], around, spread, period=2.0 * np.pi) * 1e6
            shown.append(
                _picture(
                    f"{title}, joint {joint + 1}",
                    part.slug,
                    x_label,
                    f"offset of joint {joint + 1} [urad]",
                    x[seen],
                    (left + computed)[seen] * 1e6,
                    computed[seen] * 1e6,
                    None if band is None else band[seen],
                )
            )
        if not joints:
            shift = np.zeros((n, 3))
            for column, value in zip(columns, values.tolist(), strict=True):
                if column.shift_M is not None:
                    shift += value * column.shift_M
            length = np.linalg.norm(shift, axis=1)
            way = shift / np.maximum(length, 1e-12)[:, None]
            left = np.einsum("nc,nc->n", way, fit.identification.residuals)
            x_label, x = _against(data, part.slug, None)
            seen = length > 1e-9
            shown.append(
                _picture(
                    title,
                    part.slug,
                    x_label,
                    "shift of the SMR along the effect [um]",
                    x[seen],
                    (left + length)[seen] * 1e6,
                    length[seen] * 1e6,
                    None,
                )
            )
    return tuple(picture for picture in shown if picture.x)


def _picture(
    title: str, effect: str, x_label: str, y_label: str, x: Array, measured: Array, computed: Array, band: Array | None
) -> Picture:
    order = np.argsort(x, kind="stable")
    if len(order) > _MOST_POINTS:
        order = order[np.linspace(0, len(order) - 1, _MOST_POINTS).astype(np.intp)]

    def told(values: Array) -> tuple[float, ...]:
        return tuple(float(f"{value:.5g}") for value in values[order])

    return Picture(
        title, effect, x_label, y_label, told(x), told(measured), told(computed), () if band is None else told(band)
    )


def _against(data: ArmData, slug: str, joint: int | None) -> tuple[str, Array]:
    """What an effect is best looked at against: label and values (n,)."""
    context, known = data.context, data.known
    variables = EFFECTS[slug].variables
    if joint is not None:
        if "step" in variables and known.step is not None:
            return f"last step of joint {joint + 1} [deg]", np.degrees(context.step[:, joint])
        if "torque" in variables:
            sign = context.approach[:, joint] if "approach" in variables else 1.0
            return (
                f"gravity torque on joint {joint + 1} [Nm]" + (", signed by the approach" if "approach" in variables else ""),
                np.asarray(context.torques[:, joint] * sign),
            )
        if "approach" in variables:
            return f"approach direction of joint {joint + 1}", context.approach[:, joint]
    if "time" in variables and known.time_s is not None:
        return "time [h]", known.time_s / 3600.0
    if "other_arm" in variables and known.other_moment_M is not None:
        return "moment of the other arm [Nm]", np.linalg.norm(known.other_moment_M, axis=1)
    if "beam" in variables:
        return "distance from the tracker [m]", context.beam[0]
    if "incidence" in variables and context.smr_normal is not None:
        back = -np.einsum("na,na->n", context.frames[0][-1] @ context.smr_normal, context.beam[1])
        return "incidence [deg]", np.degrees(np.arccos(np.clip(back, -1.0, 1.0)))
    if joint is None and "torque" in variables:
        return "gravity torque on joint 2 [Nm]", context.torques[:, min(1, context.joints - 1)]
    number = 0 if joint is None else joint
    return f"joint {number + 1} [deg]", np.degrees(data.readings.q[:, number])
