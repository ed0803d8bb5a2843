"""Export planned paths: joint positions over time as a table (CSV), and as a URScript program.

``servoj(q, a, v, t, lookahead_time, gain)`` leads all joints of a controller towards ``q`` [rad] for ``t`` [s]; ``a``
and ``v`` have no meaning (URScript Manual, Universal Robots, "Module motion").
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

import numpy as np

from cellapp.cell.exports.arm_commands import first_rates
from cellapp.cell.exports.arm_export import hashed
from cellapp.cell.exports.urscript_commands import JOINTS, vector
from cellapp.cell.run.csv_text import quoted_text
from cellapp.cell.targets.plan_path import PathPlan
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile

_SERVO = "0.03, 300"
"""Look-ahead time [s] and gain of ``servoj``: a longer one only adds lag, the positions are smooth already."""
_HELD_S = 0.3
"""How long the end is held [s]: a controller is late by less."""
_NOTES = (
    "CHECK IT BEFORE USE. Each path, with the way from home and back, was checked alone, with all other arms at home.",
    "Nothing is checked for a start elsewhere, another order, or an obstacle that the profile does not have.",
    "Begin with the arm at home, and try the program at reduced speed first. A controller follows the stream late.",
)


def path_csv(plans: Sequence[PathPlan]) -> str:
    """Return the positions of every path that is not refused: path, arm, time [s], arc length [m], q1..qN [rad]."""
    most = max((plan.trajectory.q.shape[1] for plan in plans if plan.trajectory is not None), default=0)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["path", "arm", "time_s", "s_m", *(f"q{j + 1}" for j in range(most))])
    for plan in plans:
        if plan.trajectory is None or plan.refusal:
            continue
        trajectory, head = plan.trajectory, [quoted_text(plan.spec.name), plan.spec.arm]
        table = np.column_stack([trajectory.time_s, trajectory.s, trajectory.q]).tolist()
        writer.writerows([*head, *(repr(value) for value in row)] for row in table)
    return text.getvalue()


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
    return hashed([*sentences, *_NOTES]) + "\n".join([*lines, "end", ""])
