"""Joint axes that tilt while the joint rotates."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.effects.column import Channel, EffectColumn, Wave, shift_column
from cellapp.effects.context import EffectContext
from cellapp.effects.data_driven import Quantity
from cellapp.effects.effect import Effect
from cellapp.effects.law import DriverVariable, Law, LawForm
from cellapp.effects.meaning import Meaning
from cellapp.effects.modulation import FreeDriver
from cellapp.effects.smooth import AMPLITUDE, CYCLES, LENGTH, circle_variances

_MOST_TILT = 1e-3
"""Bound of each amplitude [rad]: fifty times what a bearing's runout gives."""
_WAVES = (("cos", Wave(2, sine=False)), ("sin", Wave(2, sine=True)))
_AXES = (("x", np.array([1.0, 0.0, 0.0])), ("y", np.array([0.0, 1.0, 0.0])))


TWICE = LawForm("", "two cycles a turn")
SMOOTH = LawForm("smooth", "a free smooth tilt", (AMPLITUDE, LENGTH, CYCLES))


class JointAxisWobble(Effect):
    """The axis tilts twice a turn: ``w_j = (a cos 2 q_j + b sin 2 q_j) x + (c cos 2 q_j + d sin 2 q_j) y``, all in rad.

    x and y are those of the D-H frame before the joint, both perpendicular to its axis; the tilt is about the frame's
    origin, and moves everything beyond the joint. Bearing runout and ovality of raceways. One cycle a turn is a fixed
    tilt of the axis, which is geometry. Size: 5 to 20 urad, 5 to 25 um (estimate, not sourced); 79 % visible, with most
    of a turn of the joint. Look-alikes: no close one; slightly, two cycles a turn of a neighbouring joint.
    """

    slug = "joint_axis_wobble"
    title = "wobble of joint axes (two cycles a turn)"
    meaning = Meaning(
        cause="The axis of {place} tilts as it turns: run-out of the bearing or ovality of its raceways.",
        size="5 to 20 urad, 5 to 25 um",
        size_source="estimate",
        check=(
            "Turn {place} slowly by hand or in jog and listen and feel for a rough or tight spot of its bearing.",
            "Check the bolts of the bearing ring of {place}: unevenly tightened ones bend the ring oval.",
            "Check for a past collision of this arm: dents of a raceway give this and noise.",
        ),
        settle=(
            "Move {place} alone through a whole turn with the arm stretched, in steps of 10 degrees, forth and back.",
            "Repeat it with the arm folded: a tilt grows with the distance from the axis, a run-out does not.",
        ),
    )
    look_alikes = ("transmission_error",)
    variables = frozenset({DriverVariable.JOINT_ANGLE})
    forms = (TWICE, SMOOTH)

    def laws(self, context: EffectContext) -> list[Law]:
        """Two cycles a turn."""
        return [TWICE.law()]

    free_drivers = (FreeDriver(Quantity.JOINT_ANGLE),)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Cosine and sine of tilts about x and y of each joint."""
        if law.form == SMOOTH:
            return _smooth_tilts(context, law)
        columns = []
        for j in range(context.joints):
            waves = [(label, wave, wave(context.q[:, j])[:, None]) for label, wave in _WAVES]
            for letter, axis in _AXES:
                tilted = context.twist_shift(j, None, axis)
                columns += [
                    shift_column(
                        f"wobble_{letter}{j + 1}_{label}",
                        "rad",
                        Channel.AXIS,
                        tilted * values,
                        -_MOST_TILT,
                        _MOST_TILT,
                        index=j,
                        wave=wave,
                    )
                    for label, wave, values in waves
                ]
        return columns


def _smooth_tilts(context: EffectContext, law: Law) -> list[EffectColumn]:
    """Tilts of one cycle a turn and up, with the prior of a smooth function of the joint angle."""
    cycles = round(law.constants[CYCLES.name])
    sd = law.constants[AMPLITUDE.name] * np.sqrt(circle_variances(law.constants[LENGTH.name], cycles))
    columns = []
    for j in range(context.joints):
        for letter, axis in _AXES:
            tilted = context.twist_shift(j, None, axis)
            for k in range(1, cycles + 1):
                for label, wave in ((f"cos{k}", Wave(k, sine=False)), (f"sin{k}", Wave(k, sine=True))):
                    shift_M = tilted * wave(context.q[:, j])[:, None]
                    columns.append(
                        shift_column(
                            f"wobble_{letter}{j + 1}_{label}",
                            "rad",
                            Channel.AXIS,
                            shift_M,
                            -_MOST_TILT,
                            _MOST_TILT,
                            index=j,
                            wave=wave,
                            prior_sd=float(sd[k - 1]),
                        )
                    )
    return columns
