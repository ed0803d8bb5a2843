"""The side from which each joint comes to a command: a command holds for one, and says which.

Play, hysteresis and friction move the SMR by where a joint came from. A target may state the side. Where it does not,
and the side matters to the model, the command is for the way from home: signs that an operator can drive by, and that
stand beside the command wherever it is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.targets.invert import Inverted, invert
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.cell.targets.unknown_conditions import OneUnknown, approach_sides
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel


@dataclass(frozen=True, eq=False)
class SidedCommands:
    """Commands of n targets for the side that each row holds for.

    Attributes
    ----------
    found : Inverted
    conditions : MeasurementConditions
        Those that the commands are for: what targets state, and the sides.
    signs : array, shape (n, N), int
        Sign of each joint's last motion, as stated or as on the way from home; 0 where none matters.
    others : OneUnknown or None
        What other sides would do; None where no effect depends on them.
    """

    found: Inverted
    conditions: MeasurementConditions
    signs: Array
    others: OneUnknown | None

    def approach(self, row: int) -> tuple[int, ...] | None:
        """The signs of one command; None where any side will do."""
        signs = tuple(int(sign) for sign in self.signs[row])
        return signs if any(signs) else None


def sided_commands(
    arm: ArmModel,
    position_M: Array,
    rotation_M: Array,
    found: Inverted,
    conditions: MeasurementConditions,
    home: Array,
    ranges: ConditionRanges,
) -> SidedCommands:
    """Invert the model again for the sides from which joints come to n commands ``found`` for the middle of them.

    ``position_M`` (n, 3) and ``rotation_M`` (n, 3, 3) are as in ``invert``; the way begins at ``home`` (N,) [rad].
    """
    q = found.q
    stated = np.zeros(q.shape) if conditions.approach is None else np.asarray(conditions.approach, dtype=np.float64)
    sides = approach_sides(arm, q, conditions, ranges) if len(q) else None
    if sides is None:
        return SidedCommands(found, conditions, stated, None)
    step = q - home
    offered = np.where(step < 0.0, -1.0, 1.0) * sides.matter
    signs = np.where(stated != 0.0, stated, offered)
    rows = np.flatnonzero(offered.any(axis=1))
    if not len(rows):
        return SidedCommands(found, conditions, signs, sides.other_sides(signs))
    usual = np.full(q.shape[1], np.nan) if ranges.step is None else ranges.step
    sizes = np.where(stated != 0.0, usual, np.abs(step))
    made = replace(conditions, approach=signs, step=sizes * signs)
    again = invert(arm, position_M[rows], rotation_M[rows], q[rows], made.take(rows))
    kept = Inverted(q.copy(), found.residual_m.copy(), found.residual_rad.copy())
    kept.put(rows[again.reached], again, again.reached)
    lost = np.setdiff1d(rows, rows[again.reached])  # such a command stays at the middle, and says no side
    signs[lost] = stated[lost]
    if len(lost):
        made = replace(made, approach=signs, step=np.where(signs == 0.0, np.nan, sizes * signs))
    return SidedCommands(kept, made, signs, sides.other_sides(signs))


def holds_for(command_signs: Sequence[int] | None, *, payload_kg: float | None, stated: Sequence[str]) -> str:
    """For what a row of a command holds, in words: sides of the last motions, payload, what the target states."""
    parts = ["any side of approach"]
    if command_signs is not None and any(command_signs):
        parts = [f"joints that arrive with the signs {signs_words(command_signs)}"]
    if payload_kg is not None:
        parts.append(f"payload {payload_kg:g} kg")
    return "; ".join([*parts, *stated])


def signs_words(signs: Sequence[int]) -> str:
    """Signs of last motions as columns have them: ``-1 +1 0``."""
    return " ".join(f"{sign:+d}" if sign else "0" for sign in signs)


def from_home(conditions: MeasurementConditions, q: Array, home: Array) -> MeasurementConditions:
    """The conditions with joints of unknown approach coming straight from home."""
    step = q - home
    approach = np.sign(step)
    if conditions.approach is not None:
        stated = np.asarray(conditions.approach, dtype=np.float64)
        approach = np.where(stated == 0.0, approach, stated)
    return replace(conditions, approach=approach, step=np.abs(step) * approach)
