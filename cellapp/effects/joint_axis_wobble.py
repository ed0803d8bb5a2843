"""Joint axes that do not stand still while the joint turns."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.effects.effect import PLAIN, EffectColumn, EffectContext, Law, shift_column


class JointAxisWobble:
    """The axis tilts twice a turn: ``w_j = (a cos 2 q_j + b sin 2 q_j) x + (c cos 2 q_j + d sin 2 q_j) y``, all in rad.

    x and y are those of the D-H frame before the joint, both square to its axis; the tilt is about the frame's origin,
    and all beyond the joint follows. Bearing runout and ovality of raceways. One cycle a turn is a fixed tilt of the
    axis, which is geometry. Size: 5 to 20 urad, 5 to 25 um (estimate, not sourced); 79 % visible, with most of a turn
    of the joint. Look-alikes: no close one; a little of two cycles a turn of a neighbouring joint.
    """

    slug = "joint_axis_wobble"
    title = "wobble of joint axes (two cycles a turn)"
    look_alikes: tuple[str, ...] = ("transmission_error",)
    variables = frozenset({"q"})

    def untestable(self, context: EffectContext) -> str:
        """Joint positions are always there."""
        return ""

    def laws(self, context: EffectContext) -> list[Law]:
        """One."""
        return [PLAIN]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """Four columns a joint."""
        columns = []
        for j in range(context.joints):
            waves = (("cos", np.cos(2.0 * context.q[:, j])), ("sin", np.sin(2.0 * context.q[:, j])))
            for letter, axis in (("x", np.array([1.0, 0.0, 0.0])), ("y", np.array([0.0, 1.0, 0.0]))):
                tilted = context.twist_shift(j, None, axis)
                columns += [
                    shift_column(
                        f"wobble_{letter}{j + 1}_{name}", "rad", f"joint {j + 1}", tilted * wave[:, None], -1e-3, 1e-3
                    )
                    for name, wave in waves
                ]
        return columns
