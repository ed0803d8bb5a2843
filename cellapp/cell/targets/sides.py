"""Sides of approach: the side from which each joint arrives at a command, which is valid for it and states it.

Backlash, hysteresis and friction make the SMR depend on where a joint came from. A target may state the side. If it
does not, and the side matters to the model, the command is for the way from home; its signs are stated wherever the
command is written, so that an operator can drive accordingly.
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
    """Commands of n targets, each for a side of approach.

    Attributes
    ----------
    found : Inverted
    conditions : MeasurementConditions
        Conditions that the commands are for: as stated by the targets, and the sides.
    signs : array, shape (n, N), int
        Sign of each joint's last motion, as stated or as on the way from home; 0 if it does not matter.
    others : OneUnknown or None
        Effect of other sides; None if no effect depends on them.
    """

    found: Inverted
    conditions: MeasurementConditions
    signs: Array
    others: OneUnknown | None

    def approach(self, row: int) -> tuple[int, ...] | None:
        """Return the signs of one command; None if any side will do."""
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
    """Invert the model again for the sides of arrival, starting from n commands ``found`` for the middle of both sides.

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
    lost = np.setdiff1d(rows, rows[again.reached])  # such a command stays at the middle, without a side
    signs[lost] = stated[lost]
    if len(lost):
        made = replace(made, approach=signs, step=np.where(signs == 0.0, np.nan, sizes * signs))
    return SidedCommands(kept, made, signs, sides.other_sides(signs))


def holds_for(command_signs: Sequence[int] | None, *, payload_kg: float | None, stated: Sequence[str]) -> str:
    """Describe what a row of a command is valid for: sides of the last motions, payload, what the target states."""
    parts = ["any side of approach"]
    if command_signs is not None and any(command_signs):
        parts = [f"joints that arrive with the signs {signs_words(command_signs)}"]
    if payload_kg is not None:
        parts.append(f"payload {payload_kg:g} kg")
    return "; ".join([*parts, *stated])


def signs_words(signs: Sequence[int]) -> str:
    """Format signs of last motions as in columns: ``-1 +1 0``."""
    return " ".join(f"{sign:+d}" if sign else "0" for sign in signs)


def from_home(conditions: MeasurementConditions, q: Array, home: Array) -> MeasurementConditions:
    """Return the conditions with joints of unknown approach arriving straight from home."""
    step = q - home
    approach = np.sign(step)
    if conditions.approach is not None:
        stated = np.asarray(conditions.approach, dtype=np.float64)
        approach = np.where(stated == 0.0, approach, stated)
    return replace(conditions, approach=approach, step=np.abs(step) * approach)
