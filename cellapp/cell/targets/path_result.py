"""Convert planned and driven paths to the object of ``follow --json``, and their joint positions to CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

import numpy as np

from cellapp.cell.run.csv_text import quoted_text
from cellapp.cell.targets.path_records import DrivenPath, PathRecord, PathResult, PathReversal
from cellapp.cell.targets.plan_path import PathPlan
from cellapp.robot.model import CellModel

_UNCERTAIN_AT = 50
"""Number of positions along a path at which the model's uncertainty is evaluated: it changes slowly."""


def path_result(
    model: CellModel, followed: Sequence[tuple[PathPlan, DrivenPath | None]], notes: Sequence[str] = ()
) -> PathResult:
    """Return the result of ``follow``; a path that was only planned has no ``DrivenPath``."""
    return PathResult(paths=tuple(_record(model, plan, driven) for plan, driven in followed), notes=tuple(notes))


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


def _record(model: CellModel, plan: PathPlan, driven: DrivenPath | None) -> PathRecord:
    spec, trajectory, joints = plan.spec, plan.trajectory, plan.joints
    head = PathRecord(
        name=spec.name,
        arm=spec.arm,
        frame=spec.frame,
        tolerance_mm=spec.tolerance * 1e3,
        refusal=plan.refusal,
        length_mm=None if plan.path is None else plan.path.length * 1e3,
    )
    if trajectory is None or joints is None:
        return head
    rows = np.linspace(0, len(trajectory.q) - 1, _UNCERTAIN_AT).astype(int)
    uncertainty_mm = float(model.arms[spec.arm].uncertainty(trajectory.q[rows]).max()) * 1e3
    return head.model_copy(
        update={
            "duration_s": trajectory.duration_s,
            "period_ms": trajectory.period_s * 1e3,
            "samples": len(trajectory.q),
            "deviation_mm": joints.deviation_m * 1e3,
            "deviation_at_mm": joints.deviation_at_m * 1e3,
            "uncertainty_mm": uncertainty_mm or None,
            "at_speed": trajectory.at_speed,
            "slowed": trajectory.slowed,
            "unseen_mm": None if plan.unseen_m is None else plan.unseen_m * 1e3,
            "reversals": tuple(
                PathReversal(
                    joint=one.joint, at_mm=one.at_m * 1e3, jump_mm=one.jump_m * 1e3, window_mm=one.window_m * 1e3
                )
                for one in sorted(joints.reversals, key=lambda one: one.at_m)
            ),
            "driven": driven,
        }
    )
