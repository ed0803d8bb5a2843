"""Joint axes that tilt while the joint rotates."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.effects.column import Channel, EffectColumn, Wave, shift_column
from cellapp.effects.context import EffectContext
from cellapp.effects.data_driven import Quantity
from cellapp.effects.effect import Effect
from cellapp.effects.law import DriverVariable, Law, LawForm
from cellapp.effects.modulation import FreeDriver

_MOST_TILT = 1e-3
"""Bound of each amplitude [rad]: fifty times what a bearing's runout gives."""
_WAVES = (("cos", Wave(2, sine=False)), ("sin", Wave(2, sine=True)))
_AXES = (("x", np.array([1.0, 0.0, 0.0])), ("y", np.array([0.0, 1.0, 0.0])))


class JointAxisWobble(Effect):
    """The axis tilts twice a turn: ``w_j = (a cos 2 q_j + b sin 2 q_j) x + (c cos 2 q_j + d sin 2 q_j) y``, all in rad.

    x and y are those of the D-H frame before the joint, both perpendicular to its axis; the tilt is about the frame's
    origin, and moves everything beyond the joint. Bearing runout and ovality of raceways. One cycle a turn is a fixed
    tilt of the axis, which is geometry. Size: 5 to 20 urad, 5 to 25 um (estimate, not sourced); 79 % visible, with most
    of a turn of the joint. Look-alikes: no close one; slightly, two cycles a turn of a neighbouring joint.
    """

    slug = "joint_axis_wobble"
    title = "wobble of joint axes (two cycles a turn)"
    look_alikes = ("transmission_error",)
    variables = frozenset({DriverVariable.JOINT_ANGLE})
    forms = (LawForm("", "two cycles a turn"),)
    free_drivers = (FreeDriver(Quantity.JOINT_ANGLE),)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Four columns per joint."""
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
