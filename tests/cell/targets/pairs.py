"""Cooperative targets made from stops of a run's plan: safe and visible for both arms at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import CellBodies, clear_stops, visible_stops
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.targets import Partner, Target
from cellapp.robot.kinematics.transforms import Array, invert, transform, zyx_angles
from cellapp.robot.model import ArmModel, CellModel
from tests.postures import far_from_singular
from tests.sure import sure

_NARROWER_RAD = np.radians(2.0)
"""The true flange is turned by some milliradians against the published one: a stop that is planned at the edge of an
SMR's acceptance may be beyond it for the calibrated arm."""
_FARTHER_M = 0.01
"""The true arms stand and reach some millimetres beside where the published ones do."""


def pair_targets(
    run: RunFile, model: CellModel, stops: Sequence[int], tolerance: float | None = None
) -> tuple[Target, ...]:
    """One target for each stop, wanted where the model expects the SMRs there."""
    plan = sure(run.read_plan())
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


def stops_with_room(run: RunFile, model: CellModel, count: int) -> list[int]:
    """The first stops of a plan that a calibrated cell can repeat with room: SMRs well within sight, arms well apart
    and far from singular postures. Stops that tell most lie at the edges, so that many of a plan have none."""
    plan = sure(run.read_plan())
    q = {name: plan[name] for name in model.arms}
    cell = cell_bodies(run.profile, model)
    arms = {name: replace(arm, acceptance=arm.acceptance - _NARROWER_RAD) for name, arm in cell.arms.items()}
    strict = replace(cell, arms=arms, clearance=cell.clearance + _FARTHER_M)
    good = visible_stops(strict, q) & clear_stops(strict, q)
    for name, arm in model.arms.items():
        good &= far_from_singular(arm.geometry, q[name])
    seen = (stop for stop in np.flatnonzero(good).tolist() if _sees_commands(strict, run, model, stop))
    found = list(islice(seen, count))
    assert len(found) == count, f"of {len(good)} stops only {len(found)} have room"
    return found


def _sees_commands(cell: CellBodies, run: RunFile, model: CellModel, stop: int) -> bool:
    """Whether the tracker also sees both SMRs where commands hold the arms: perhaps not in the posture of the plan."""
    commands = compensate(run.profile, model, pair_targets(run, model, [stop]))
    q = {one.arm: np.array([one.q_compensated]) for one in (its.record for its in commands) if one.q_compensated}
    return len(q) == len(model.arms) and bool(visible_stops(cell, q)[0])


def _pose(arm: ArmModel, q: Array) -> Array:
    """SMR position and flange rotation that the model expects (4, 4)."""
    rotation_M, _ = arm.flange(q[None])
    return transform(rotation_M[0], arm.predict(q[None])[0])


def _point(T: Array) -> tuple[float, float, float]:
    x, y, z = T[:3, 3].tolist()
    return (x, y, z)
