"""Cooperative targets made from stops of a run's plan: safe and visible for both arms at once."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.compensation.targets import Partner, Target
from cellapp.kinematics.transforms import Array, invert, transform, zyx_angles
from cellapp.model import ArmModel, CellModel
from cellapp.run import RunFile


def pair_targets(
    run: RunFile, model: CellModel, stops: Sequence[int], tolerance: float | None = None
) -> tuple[Target, ...]:
    """One target for each stop, wanted where the model expects the SMRs there."""
    plan = run.read_plan()
    assert plan is not None
    targets = []
    for stop in stops:
        left, right = (_pose(model.arms[name], plan[name][stop]) for name in ("left", "right"))
        between = invert(left) @ right
        partner = Partner(arm="right", position=_point(between), rpy=zyx_angles(between[:3, :3])[::-1])
        targets.append(
            Target(
                name=f"pair-{stop}",
                arm="left",
                position=_point(left),
                rpy=zyx_angles(left[:3, :3])[::-1],
                frame="tracker",
                tolerance=tolerance,
                partner=partner,
            )
        )
    return tuple(targets)


def _pose(arm: ArmModel, q: Array) -> Array:
    """SMR position and flange rotation that the model expects (4, 4)."""
    rotation_M, _ = arm.flange(q[None])
    return transform(rotation_M[0], arm.predict(q[None])[0])


def _point(T: Array) -> tuple[float, float, float]:
    x, y, z = T[:3, 3].tolist()
    return (x, y, z)
