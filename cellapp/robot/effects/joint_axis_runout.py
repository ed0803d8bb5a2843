"""Joint axes that shift while the joint rotates."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.robot.effects.context import EffectColumn, EffectContext
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, Meaning
from cellapp.robot.effects.joint_axis_wobble import (
    BEARING_CYCLES,
    MOTION_CYCLES,
    MOTION_LENGTHS,
    error_motions,
    smooth_motions,
)
from cellapp.robot.effects.law import AMPLITUDE, CYCLES, LENGTH, DriverVariable, Law, LawForm, SmoothLaw
from cellapp.robot.effects.modulation import FreeDriver

_MOST_SHIFT = 5e-4
"""Bound of each amplitude [m]: ten times the run-out of a cross-roller bearing of this size."""

RUNOUT = LawForm("", "radial and axial, with the cycles per revolution that each joint needs")
SMOOTH = LawForm("smooth", "a free smooth shift, radial and axial", (AMPLITUDE, LENGTH, CYCLES))


class JointAxisRunout(Effect):
    """The axis shifts with its own angle: ``d_j = sum_n (a_n cos n q_j + b_n sin n q_j) e`` [m], e along x, y and z.

    The radial shifts, along x and y of the D-H frame before the joint, are one block for each joint and n from 1 to 6,
    the axial ones, along the joint's axis z, another. One cycle per revolution of a radial shift is in part a length of
    the arm, which is geometry, and only refines; one cycle of the axial shift is the face run-out of a bearing.

    The law ``smooth`` has all n from 1 to ``cycles`` under a prior; it is not scanned.

    Size: 10 to 50 µm for bearings of this size, 8 to 27 µm on a real UR10 (measured); some 80 % visible, with
    most of a turn of the joint. Look-alikes: wobble of the same axis, as only the lever to the target distinguishes
    them; errors of the angle, where the arm beyond the joint hardly moves.
    """

    slug = "joint_axis_runout"
    title = "run-out of joint axes"
    arm_bound = True
    meaning = Meaning.of(
        """cause: The axis of {place} shifts with its angle: run-out of its bearing, or a seat out of round.
        size (estimate): 10 to 50 µm; 8 to 27 µm were found on a real UR10
        check: Put a dial gauge to the flange side of {place} and move it: its reading is the run-out.
        check: Check that the bolts of the bearing ring of {place} are tightened evenly.
        settle: Move {place} alone through a whole revolution, folded and stretched: a run-out stays the same."""
    )
    look_alikes = ("joint_axis_wobble", "transmission_error", "encoder_eccentricity")
    variables = frozenset({DriverVariable.JOINT_ANGLE})
    forms = (RUNOUT, SMOOTH)
    free_drivers = (FreeDriver(Quantity.JOINT_ANGLE),)

    def smooth_laws(self, context: EffectContext) -> list[SmoothLaw]:
        """Against the axis' own angle: one amplitude and one length scale for all joints."""
        return [SmoothLaw("smooth", 1e-5, {CYCLES.name: float(MOTION_CYCLES)}, MOTION_LENGTHS)]

    def laws(self, context: EffectContext) -> list[Law]:
        """Any cycles, radial or axial."""
        return [RUNOUT.law(tried=2 * len(BEARING_CYCLES))]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """For each joint and cycle count four radial columns and two axial ones."""
        columns = []
        for j in range(context.joints):
            for letter, axis in zip("xyz", np.eye(3), strict=True):
                name, moved = f"runout_{letter}{j + 1}", context.twist_shift(j, axis, None)
                if law.form == SMOOTH:
                    columns += smooth_motions(context, law, j, name, "m", moved, _MOST_SHIFT)
                    continue
                way, refining = ("axial", ()) if letter == "z" else ("radial", (1,))
                blocks = {n: f"joint {j + 1} {way} {n} cycles" for n in BEARING_CYCLES}
                columns += error_motions(context, j, name, "m", moved, blocks, _MOST_SHIFT, refining, names)
        return columns
