"""Export commands at targets as a URScript program: from home to each target and back, in joint space.

``movej(q, a, v)`` moves all joints of a controller to ``q`` [rad], the leading one with at most ``v`` [rad/s] and ``a``
[rad/s^2] (URScript Manual, Universal Robots, "Module motion").
"""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.cell.exports.arm_commands import ArmCommands
from cellapp.cell.exports.arm_export import hashed
from cellapp.cell.exports.export_format import CommandFormat
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import Array

JOINTS = 6
_DIGITS = 9
"""Decimals of a joint position: a nanoradian moves the SMR by some nanometres at most."""
_NOTES = (
    "CHECK IT BEFORE USE. The way from home to each target and back was checked alone, with all other arms at home.",
    "Nothing is checked for a start elsewhere, another order, or an obstacle that the profile does not have.",
    "Begin with the arm at home, and try the program at reduced speed first.",
)


def urscript(commands: ArmCommands, sentences: Sequence[str]) -> str:
    """Return the program. Raise ``InputError`` for an arm without six joints, or if no target may be driven."""
    if len(commands.home) != JOINTS:
        raise InputError(
            f"export: arm '{commands.name}' has {len(commands.home)} joints, a program for UR controllers six; nothing"
            " was written. Take --as commands"
        )
    if not driven(commands):
        first = commands.commands[0]
        raise InputError(
            f"export: arm '{commands.name}': none of its targets can be driven from home; nothing was written. Target"
            f" '{first.record.name}': {first.refusal}"
        )
    rates = f"a={commands.acceleration:.3f}, v={commands.speed:.3f}"
    home = f"  movej({vector(commands.home)}, {rates})"
    lines = ["def compensated_targets():", "  # home", home]
    for command in commands.commands:
        name = " ".join(command.record.name.splitlines())
        if not command.way:
            lines.append(f"  # target {name}: left out: {' '.join(command.refusal.splitlines())}")
            continue
        *before, target = command.way
        lines += [f"  # side from which target {name} is approached" for _ in before[:1]]
        lines += [f"  movej({vector(q)}, {rates})" for q in before]
        held = " ".join(command.record.holds_for.splitlines())
        lines += [f"  # target {name}", *([f"  # holds for {held}"] if held else [])]
        lines += [f"  movej({vector(target)}, {rates})", "  # home", home]
    return hashed([*sentences, *_NOTES]) + "\n".join([*lines, "end", ""])


def driven(commands: ArmCommands) -> int:
    """Return the number of targets that the program drives to."""
    return sum(bool(command.way) for command in commands.commands)


def vector(q: Array) -> str:
    """Return joint positions (N,) [rad] as a list of URScript."""
    return "[" + ", ".join(f"{value:.{_DIGITS}f}" for value in q.tolist()) + "]"


URSCRIPT = CommandFormat(
    "urscript", "compensated commands at targets as URScript", ".script", urscript, driven, drives=True
)
