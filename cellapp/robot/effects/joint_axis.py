"""Joint axes that tilt or shift while the joint rotates."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from cellapp.robot.effects.context import ActsOn, EffectColumn, EffectContext, Wave, shift_column
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, Meaning
from cellapp.robot.effects.law import (
    AMPLITUDE,
    CYCLES,
    LENGTH,
    InputVariable,
    Law,
    LawForm,
    LengthRange,
    SmoothLaw,
    circle_variances,
)
from cellapp.robot.effects.modulation import TermInput
from cellapp.robot.kinematics.transforms import Array

BEARING_CYCLES = range(1, 7)
"""Cycles a turn that bearings and raceways show: from a race that sits askew to one of six lobes."""
_MOST_TILT = 1e-3
"""Bound of each amplitude [rad]: fifty times what a bearing's runout gives."""
_AXES = (("x", np.array([1.0, 0.0, 0.0])), ("y", np.array([0.0, 1.0, 0.0])))

TWICE = LawForm("", "two cycles per revolution")
HARMONICS = LawForm("harmonics", "with the cycles per revolution that each joint needs")
_SMOOTH_TILT = LawForm("smooth", "a free smooth tilt", (AMPLITUDE, LENGTH, CYCLES))


MOTION_CYCLES = 10
"""Highest cycle count of the other error motions of an axis, which bearings and raceways make."""
MOTION_LENGTHS = LengthRange(math.radians(40.0), math.radians(20.0), math.radians(120.0))
"""Errors of a bearing's raceways have a few cycles per revolution."""


class JointAxisWobble(Effect):
    """The axis tilts with its own angle: ``w_j = (a cos n q_j + b sin n q_j) x + (c cos n q_j + d sin n q_j) y`` [rad].

    Laws
    ----
    (no name)
        n = 2, ovality of raceways.
    harmonics
        n from 1 to 6, a block for each joint and n: lobes of races, a seat that is not equally stiff all round. One
        cycle per revolution is in part a fixed tilt of the axis, which is geometry, and only refines.
    smooth
        All n from 1 to ``cycles`` under a prior. Not scanned.

    x and y are those of the D-H frame before the joint, both perpendicular to its axis; the tilt is about the frame's
    origin, and moves everything beyond the joint. With ``joint_axis_runout`` and errors of the angle itself these are
    the six error motions of a rotary axis (ISO 230-7). Size: 5 to 20 µrad, 5 to 25 µm (estimate, not sourced); 79 %
    visible, with most of a turn of the joint. Confounded: run-out of the same axis, as the lever to the target
    distinguishes them; slightly, two cycles per revolution of a neighbouring joint. Where the axis of the joint before
    meets this one at a right angle, an error of that joint that depends on this joint's angle is the same motion.
    """

    slug = "joint_axis_wobble"
    title = "wobble of joint axes"
    arm_bound = True
    meaning = Meaning.of(
        """cause: The axis of {place} tilts with its angle: run-out of the bearing or oval raceways.
        size (estimate): 5 to 20 µrad, 5 to 25 µm
        check: Move {place} slowly in jog and feel for a rough or tight spot of its bearing.
        check: Check that the bolts of the bearing ring of {place} are tightened evenly.
        check: Check for a past collision of this arm.
        settle: Move {place} alone through a whole revolution, stretched and folded: a tilt grows with the distance from
          the axis."""
    )
    confounded = ("joint_axis_runout", "transmission_error")
    variables = frozenset({InputVariable.JOINT_ANGLE})
    forms = (TWICE, HARMONICS, _SMOOTH_TILT)
    discrepancy_inputs = (TermInput(Quantity.JOINT_ANGLE),)

    def smooth_laws(self, context: EffectContext) -> list[SmoothLaw]:
        """Against the axis' own angle: one amplitude and one length scale for all joints."""
        return [SmoothLaw("smooth", 3e-5, {CYCLES.name: float(MOTION_CYCLES)}, MOTION_LENGTHS)]

    def laws(self, context: EffectContext) -> list[Law]:
        """Two cycles; any cycles."""
        return [TWICE.law(), HARMONICS.law(tried=len(BEARING_CYCLES))]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Cosine and sine of tilts about x and y of each joint, four columns for each cycle count."""
        columns = []
        for j in range(context.joints):
            for letter, axis in _AXES:
                tilted = context.twist_shift(j, None, axis)
                name = f"wobble_{letter}{j + 1}"
                if law.form == _SMOOTH_TILT:
                    columns += smooth_motions(context, law, j, name, "rad", tilted, _MOST_TILT)
                elif law.form == HARMONICS:
                    blocks = {n: f"joint {j + 1} {n} cycles" for n in BEARING_CYCLES}
                    columns += error_motions(context, j, name, "rad", tilted, blocks, _MOST_TILT, (1,), names)
                else:
                    twice = error_motions(context, j, name, "rad", tilted, {2: f"joint {j + 1}"}, _MOST_TILT)
                    columns += [replace(one, name=one.name.removesuffix("2")) for one in twice]
        return columns


def error_motions(
    context: EffectContext,
    joint: int,
    name: str,
    unit: str,
    moved: Array,
    blocks: Mapping[int, str],
    largest: float,
    refining: Collection[int] = (),
    names: Collection[str] | None = None,
) -> list[EffectColumn]:
    """Cosine and sine of some cycles per revolution of a joint (from 0), times an SMR shift ``moved`` (n, 3) per unit.

    ``blocks`` names the block of each cycle count. Counts in ``refining`` are no effect alone. With ``names``
    only columns of these names are made.
    """
    columns = []
    for n, block in blocks.items():
        for wave in (Wave(n, sine=False), Wave(n, sine=True)):
            own = f"{name}_{'sin' if wave.sine else 'cos'}{n}"
            if names is not None and own not in names:
                continue
            by_angle = moved * wave(context.q[:, joint])[:, None]
            made = shift_column(own, unit, ActsOn.AXIS, by_angle, -largest, largest, block, index=joint, wave=wave)
            columns.append(replace(made, refines=n in refining))
    return columns


def smooth_motions(
    context: EffectContext, law: Law, joint: int, name: str, unit: str, moved: Array, largest: float
) -> list[EffectColumn]:
    """``error_motions`` of one cycle per revolution and up, in the block of the joint, with a smooth prior."""
    cycles = round(law.constants[CYCLES.name])
    sd = law.constants[AMPLITUDE.name] * np.sqrt(circle_variances(law.constants[LENGTH.name], cycles))
    blocks = dict.fromkeys(range(1, cycles + 1), f"joint {joint + 1}")
    columns = error_motions(context, joint, name, unit, moved, blocks, largest)
    return [replace(column, prior_sd=float(sd[(column.cycles or 1) - 1])) for column in columns]


_MOST_SHIFT = 5e-4
"""Bound of each amplitude [m]: ten times the run-out of a cross-roller bearing of this size."""

RUNOUT = LawForm("", "radial and axial, with the cycles per revolution that each joint needs")
_SMOOTH_SHIFT = LawForm("smooth", "a free smooth shift, radial and axial", (AMPLITUDE, LENGTH, CYCLES))


class JointAxisRunout(Effect):
    """The axis shifts with its own angle: ``d_j = sum_n (a_n cos n q_j + b_n sin n q_j) e`` [m], e along x, y and z.

    The radial shifts, along x and y of the D-H frame before the joint, are one block for each joint and n from 1 to 6,
    the axial ones, along the joint's axis z, another. One cycle per revolution of a radial shift is in part a length of
    the arm, which is geometry, and only refines; one cycle of the axial shift is the face run-out of a bearing.

    The law ``smooth`` has all n from 1 to ``cycles`` under a prior; it is not scanned.

    Size: 10 to 50 µm for bearings of this size, 8 to 27 µm on a real UR10 (measured); some 80 % visible, with
    most of a turn of the joint. Confounded: wobble of the same axis, as only the lever to the target distinguishes
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
    confounded = ("joint_axis_wobble", "transmission_error", "encoder_eccentricity")
    variables = frozenset({InputVariable.JOINT_ANGLE})
    forms = (RUNOUT, _SMOOTH_SHIFT)
    discrepancy_inputs = (TermInput(Quantity.JOINT_ANGLE),)

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
                if law.form == _SMOOTH_SHIFT:
                    columns += smooth_motions(context, law, j, name, "m", moved, _MOST_SHIFT)
                    continue
                way, refining = ("axial", ()) if letter == "z" else ("radial", (1,))
                blocks = {n: f"joint {j + 1} {way} {n} cycles" for n in BEARING_CYCLES}
                columns += error_motions(context, j, name, "m", moved, blocks, _MOST_SHIFT, refining, names)
        return columns
