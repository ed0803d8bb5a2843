"""Joint axes that shift while the joint rotates."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.effects.column import EffectColumn
from cellapp.effects.context import EffectContext
from cellapp.effects.data_driven import Quantity
from cellapp.effects.effect import Effect
from cellapp.effects.joint_axis_wobble import CYCLES, axis_columns
from cellapp.effects.law import DriverVariable, Law, LawForm
from cellapp.effects.modulation import FreeDriver

_MOST_SHIFT = 5e-4
"""Bound of each amplitude [m]: ten times the run-out of a cross-roller bearing of this size."""

RUNOUT = LawForm("", "radial and axial, with the cycles a turn that each joint needs")


class JointAxisRunout(Effect):
    """The axis shifts with its own angle: ``d_j = sum_n (a_n cos n q_j + b_n sin n q_j) e`` [m], e along x, y and z.

    The radial shifts, along x and y of the D-H frame before the joint, are one block for each joint and n from 1 to 6,
    the axial ones, along the joint's axis z, another. One cycle a turn of a radial shift is in part a length of the
    arm, which is geometry, and only refines; one cycle of the axial shift is the face run-out of a bearing.

    Size: 10 to 50 um for bearings of this size, 8 to 27 um were seen on a real UR10 (measured); some 80 % visible, with
    most of a turn of the joint. Look-alikes: wobble of the same axis, as only the lever to the target distinguishes
    them; errors of the angle, where the arm beyond the joint hardly moves.
    """

    slug = "joint_axis_runout"
    title = "run-out of joint axes"
    look_alikes = ("joint_axis_wobble", "transmission_error", "encoder_eccentricity")
    variables = frozenset({DriverVariable.JOINT_ANGLE})
    forms = (RUNOUT,)
    free_drivers = (FreeDriver(Quantity.JOINT_ANGLE),)

    def laws(self, context: EffectContext) -> list[Law]:
        """Any cycles, radial or axial."""
        return [RUNOUT.law(tried=2 * len(CYCLES))]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """For each joint and cycle count four radial columns and two axial ones."""
        columns = []
        for j in range(context.joints):
            for letter, axis in zip("xyz", np.eye(3), strict=True):
                axial = letter == "z"
                columns += axis_columns(
                    context,
                    j,
                    f"runout_{letter}{j + 1}",
                    "m",
                    context.twist_shift(j, axis, None),
                    CYCLES,
                    _MOST_SHIFT,
                    " axial" if axial else " radial",
                    refining=() if axial else (1,),
                )
        return columns
