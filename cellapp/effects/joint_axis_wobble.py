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

CYCLES = range(1, 7)
"""Cycles a turn that bearings and raceways show: from a race that sits askew to one of six lobes."""
_MOST_TILT = 1e-3
"""Bound of each amplitude [rad]: fifty times what a bearing's runout gives."""
_AXES = (("x", np.array([1.0, 0.0, 0.0])), ("y", np.array([0.0, 1.0, 0.0])))

TWO = LawForm("", "two cycles a turn")
HARMONICS = LawForm("harmonics", "with the cycles a turn that each joint needs")


class JointAxisWobble(Effect):
    """The axis tilts with its own angle: ``w_j = (a cos n q_j + b sin n q_j) x + (c cos n q_j + d sin n q_j) y`` [rad].

    Laws
    ----
    (no name)
        n = 2, ovality of raceways.
    harmonics
        n from 1 to 6, a block for each joint and n: lobes of races, a seat that is not equally stiff all round. One
        cycle a turn is in part a fixed tilt of the axis, which is geometry, and only refines.

    x and y are those of the D-H frame before the joint, both perpendicular to its axis; the tilt is about the frame's
    origin, and moves everything beyond the joint. With ``joint_axis_runout`` and errors of the angle itself these are
    the six error motions of a rotary axis (ISO 230-7). Size: 5 to 20 urad, 5 to 25 um (estimate, not sourced); 79 %
    visible, with most of a turn of the joint. Look-alikes: run-out of the same axis, as the lever to the target
    distinguishes them; slightly, two cycles a turn of a neighbouring joint.
    """

    slug = "joint_axis_wobble"
    title = "wobble of joint axes"
    look_alikes = ("joint_axis_runout", "transmission_error")
    variables = frozenset({DriverVariable.JOINT_ANGLE})
    forms = (TWO, HARMONICS)
    free_drivers = (FreeDriver(Quantity.JOINT_ANGLE),)

    def laws(self, context: EffectContext) -> list[Law]:
        """Two cycles; any cycles."""
        return [TWO.law(), HARMONICS.law(tried=len(CYCLES))]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Four columns per joint, or per joint and cycle count."""
        columns = []
        for j in range(context.joints):
            for letter, axis in _AXES:
                tilted = context.twist_shift(j, None, axis)
                columns += (
                    axis_columns(context, j, f"wobble_{letter}{j + 1}", "rad", tilted, CYCLES, _MOST_TILT)
                    if law.form == HARMONICS
                    else _two_cycles(context, j, letter, tilted)
                )
        return columns


def _two_cycles(context: EffectContext, joint: int, letter: str, tilted: np.ndarray) -> list[EffectColumn]:
    """Cosine and sine of two cycles a turn of one tilt, in the block of the joint."""
    waves = (("cos", Wave(2, sine=False)), ("sin", Wave(2, sine=True)))
    return [
        shift_column(
            f"wobble_{letter}{joint + 1}_{label}",
            "rad",
            Channel.AXIS,
            tilted * wave(context.q[:, joint])[:, None],
            -_MOST_TILT,
            _MOST_TILT,
            index=joint,
            wave=wave,
        )
        for label, wave in waves
    ]


def axis_columns(
    context: EffectContext,
    joint: int,
    name: str,
    unit: str,
    moved: np.ndarray,
    cycles: range,
    largest: float,
    block: str = "",
    refining: Collection[int] = (1,),
) -> list[EffectColumn]:
    """Cosine and sine of some cycles a turn of a joint (from 0), times an SMR shift ``moved`` (n, 3) per unit.

    ``block`` is appended to the name of the joint and its cycle count. Counts in ``refining`` are no effect alone.
    """
    columns = []
    for n in cycles:
        for wave in (Wave(n, sine=False), Wave(n, sine=True)):
            columns.append(
                shift_column(
                    f"{name}_{'sin' if wave.sine else 'cos'}{n}",
                    unit,
                    Channel.AXIS,
                    moved * wave(context.q[:, joint])[:, None],
                    -largest,
                    largest,
                    f"joint {joint + 1}{block} {n} cycles",
                    index=joint,
                    wave=wave,
                    refines=n in refining,
                )
            )
    return columns
