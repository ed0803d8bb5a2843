"""Export commands at targets: CSV of joint positions, uncertainty and verdict; a URScript program that moves there.

Export planned paths: joint positions over time as a table (CSV), and as a URScript program.

``servoj(q, a, v, t, lookahead_time, gain)`` leads all joints of a controller towards ``q`` [rad] for ``t`` [s]; ``a``
and ``v`` have no meaning (URScript Manual, Universal Robots, "Module motion").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.cell.exports.arm_export import hashed
from cellapp.cell.exports.export_format import ArmCommands, CommandFormat, first_rates
from cellapp.cell.run.csv_text import quoted_text, table_text
from cellapp.cell.targets.path import PathPlan
from cellapp.cell.targets.ranges import signs_words
from cellapp.cell.targets.records import TargetCommand
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import CORRECTED
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array

_NOTES = (
    "q1..qN are the compensated joint positions [rad], nominal_q1..N those of the published geometry. q1..qN hold for",
    "what holds_for says: let the last motion of each joint have the sign in approach (0: any side), play or friction",
    "moves the SMR else. uncertainty_mm is the standard uncertainty of a measured coordinate of the SMR there,",
    "within_mm what a measured error stays below with 95 % probability: both of geometry, effects, network,",
    "extrapolation, noise, and conditions that nobody stated. A refused target has no positions.",
    CORRECTED,
)
_ROTATION_NOTES = (
    "nominal_mrad is by what angle nominal_q1..N has the flange off the target's rotation, by the calibrated model;",
    "orientation_... say of the rotation at q1..qN what uncertainty_mm to verdict say of the position.",
)


def command_table(commands: ArmCommands, sentences: Sequence[str]) -> str:
    """Return the CSV text: comment lines, a header row, a row per target; floats in the shortest exact form."""
    rotated = any(command.record.orientation is not None for command in commands.commands)
    rows = [_row(command.record, len(commands.home), rotated=rotated) for command in commands.commands]
    table = table_text([*rows[0]], ([*row.values()] for row in rows), "\n")
    return hashed([*sentences, *_NOTES, *(_ROTATION_NOTES if rotated else ())]) + table


def _row(one: TargetCommand, joints: int, *, rotated: bool) -> dict[str, str]:
    """Return the cells of a target by the names of their columns; with those of its rotation if ``rotated``."""
    cells = {
        "name": quoted_text(one.name),
        "arm": one.arm,
        **_joints("q", one.q_compensated, joints),
        **_joints("nominal_q", one.q_nominal, joints),
        "approach": "" if one.approach is None else signs_words(one.approach),
        "holds_for": one.holds_for,
        "uncertainty_mm": _number(one.uncertainty_mm),
        "within_mm": _number(one.within_mm),
        "tolerance_mm": _number(one.tolerance_mm),
        "verdict": one.verdict,
        "refusal": quoted_text(one.refusal),
    }
    if not rotated:
        return cells
    rotation = one.orientation
    return cells | {
        "nominal_mrad": _number(None if rotation is None else rotation.nominal_mrad),
        "orientation_uncertainty_mrad": _number(None if rotation is None else rotation.uncertainty_mrad),
        "orientation_within_mrad": _number(None if rotation is None else rotation.within_mrad),
        "orientation_tolerance_mrad": _number(one.orientation_tolerance_mrad),
        "orientation_verdict": "" if rotation is None else rotation.verdict,
    }


def _joints(name: str, q: Sequence[float] | None, joints: int) -> dict[str, str]:
    return {f"{name}{j + 1}": _number(None if q is None else q[j]) for j in range(joints)}


def _number(value: float | None) -> str:
    return "" if value is None else repr(value)


def commanded(commands: ArmCommands) -> int:
    """Return the number of targets that have joint positions."""
    return sum(command.record.q_compensated is not None for command in commands.commands)


COMMAND_TABLE = CommandFormat("commands", "compensated commands at targets (CSV)", ".csv", command_table, commanded)


# -- Export commands at targets as a URScript program: from home to each target and back, in joint space --------------
#
# ``movej(q, a, v)`` moves all joints of a controller to ``q`` [rad], the leading one with at most ``v`` [rad/s] and
# ``a`` [rad/s^2] (URScript Manual, Universal Robots, "Module motion").


JOINTS = 6
_DIGITS = 9
"""Decimals of a joint position: a nanoradian moves the SMR by some nanometres at most."""
_PROGRAM_NOTES = (
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
    return hashed([*sentences, *_PROGRAM_NOTES]) + "\n".join([*lines, "end", f"# {CORRECTED}", ""])


def driven(commands: ArmCommands) -> int:
    """Return the number of targets that the program drives to."""
    return sum(bool(command.way) for command in commands.commands)


def vector(q: Array) -> str:
    """Return joint positions (N,) [rad] as a list of URScript."""
    return "[" + ", ".join(f"{value:.{_DIGITS}f}" for value in q.tolist()) + "]"


URSCRIPT = CommandFormat(
    "urscript", "compensated commands at targets as URScript", ".script", urscript, driven, drives=True
)


_SERVO = "0.03, 300"
"""Look-ahead time [s] and gain of ``servoj``: a longer one only adds lag, the positions are smooth already."""
_HELD_S = 0.3
"""How long the end is held [s]: a controller is late by less."""
_PATH_NOTES = (
    "CHECK IT BEFORE USE. Each path, with the way from home and back, was checked alone, with all other arms at home.",
    _PROGRAM_NOTES[1],
    f"{_PROGRAM_NOTES[2]} A controller follows the stream late.",
)


def path_csv(plans: Sequence[PathPlan]) -> str:
    """Return the positions of every path that is not refused: path, arm, time [s], arc length [m], q1..qN [rad]."""
    most = max((plan.trajectory.q.shape[1] for plan in plans if plan.trajectory is not None), default=0)
    driven = [(plan.spec, plan.trajectory) for plan in plans if plan.trajectory is not None and not plan.refusal]
    rows = (
        [quoted_text(spec.name), spec.arm, *map(repr, row)]
        for spec, its in driven
        for row in np.column_stack([its.time_s, its.s, its.q]).tolist()
    )
    return table_text(["path", "arm", "time_s", "s_m", *(f"q{j + 1}" for j in range(most))], rows, "\n")


def path_script(plans: Sequence[PathPlan], profile: Profile, sentences: Sequence[str]) -> str:
    """Return a URScript program that drives the paths of one arm that are not refused, each from home and back.

    Raise ``InputError`` for an arm without six joints.
    """
    name = plans[0].spec.arm
    arm = profile.arms[name]
    home = np.array(arm.home)
    if len(home) != JOINTS:
        raise InputError(
            f"compensate: arm '{name}' has {len(home)} joints, a program for UR controllers six; nothing was written."
            " Take a file .csv"
        )
    speed, acceleration = first_rates(profile, arm)
    rates = f"a={acceleration:.3f}, v={speed:.3f}"
    lines = ["def compensated_paths():", "  # home", f"  movej({vector(home)}, {rates})"]
    for plan in plans:
        words = " ".join(plan.spec.name.splitlines())
        if plan.trajectory is None or plan.run_up is None:
            lines.append(f"  # path {words}: left out: {' '.join(plan.refusal.splitlines())}")
            continue
        first, *others = plan.trajectory.q
        others += others[-1:] * round(_HELD_S / plan.trajectory.period_s)
        lines.append(f"  # path {words}")
        lines += [f"  movej({vector(q)}, {rates})" for q in (plan.run_up, first)]
        lines += [f"  servoj({vector(q)}, 0, 0, {plan.trajectory.period_s:g}, {_SERVO})" for q in others]
        lines += [f"  stopj({acceleration:.3f})", "  # home", f"  movej({vector(home)}, {rates})"]
    return hashed([*sentences, *_PATH_NOTES]) + "\n".join([*lines, "end", f"# {CORRECTED}", ""])
