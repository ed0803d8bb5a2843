"""Explain in words why a target is not commanded, one target at a time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.cell.safety.gate import CellBodies, refuse_stop
from cellapp.cell.targets.choice import LARGEST_CORRECTION, Branches, Chosen
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.inverse import errors_and_jacobian, missed_distances, solve_pose
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

_ROUNDS = 25
"""Iterations towards the nearest pose of an unreachable one: enough for a millimetre."""
_TAKES_PART = 0.3
"""Share in the motion that leaves the SMR where it is (null space) above which a joint is named."""
_SAME_POSE = 1e-6
"""Residual [m, rad] below which a pose counts as reachable, although no start of the search reached it."""


def refusal(
    cell: CellBodies,
    homes: Mapping[str, Array],
    arms: Mapping[str, ArmModel],
    branches: Mapping[str, Branches],
    chosen: Chosen,
    row: int,
    missed: Mapping[str, str],
) -> str:
    """Return the reason of the best branch of a target; ``missed`` says how far arms without a solution are off."""
    for name, one in branches.items():
        of = f"arm {name}: " if len(branches) > 1 else ""
        if not one.exists[row].any():
            return of + missed[name]
        if not one.within[row].any():
            return of + _beyond_limits(one, row, cell.arms[name].limits)
    best = {name: q[row] for name, q in chosen.nominal.items()}
    if any(np.isnan(q).any() for q in best.values()):
        best = {name: _nearest(one, row) for name, one in branches.items()}
    if words := refuse_stop(cell, {**homes, **best}):
        return words
    for name, found in chosen.compensated.items():
        of = f"arm {name}: " if len(branches) > 1 else ""
        if words := _singular(arms[name], best[name], found.q[row], reached=bool(found.reached[row])):
            return of + words
    solved = {name: found.q[row] for name, found in chosen.compensated.items()}
    return refuse_stop(cell, {**homes, **solved}) or "the gate does not admit it"


def missed_poses(geometry: Geometry, position_M: Array, rotation_M: Array, home: Array) -> list[str]:
    """Describe how far each of n unreachable poses is from the nearest reachable one."""
    if not len(position_M):
        return []
    free = np.isnan(rotation_M[:, 0, 0])
    wanted = np.where(free[:, None, None], np.eye(3), rotation_M)
    solved = solve_pose(geometry, position_M, wanted, np.tile(home, (len(wanted), 1)), max_iterations=_ROUNDS)
    words = []
    nearest = np.where(free, missed_distances(geometry, position_M, home), solved.position_error)
    for off_m, off_rad, any_rotation in zip(nearest, solved.rotation_error, free, strict=True):
        if any_rotation:
            words.append(f"out of reach with any rotation: the SMR comes within {off_m * 1e3:.1f} mm")
        elif off_m < _SAME_POSE and off_rad < _SAME_POSE:
            words.append("no posture was found that reaches it")
        else:
            words.append(
                f"out of reach: the nearest pose is {off_m * 1e3:.1f} mm and {np.degrees(off_rad):.1f} deg off"
            )
    return words


# -- inside -----------------------------------------------------------------------------------------------------------


def _nearest(branches: Branches, row: int) -> Array:
    """Return the solution nearest to home among those within limits."""
    within = np.flatnonzero(branches.within[row])
    largest, total = branches.motion[:, row, within]
    return np.asarray(branches.q[row, within[np.lexsort((total, largest))[0]]])


def _beyond_limits(branches: Branches, row: int, limits: Array) -> str:
    """Describe the worst joint, and its excess, of the solution that exceeds its limits least."""
    beyond = np.where(branches.exists[row][:, None], branches.beyond[row], np.inf)
    best = int(np.argmin(beyond.max(axis=1)))
    joint = int(np.argmax(beyond[best]))
    low, high = np.degrees(limits[joint])
    return (
        f"beyond limits: joint {joint + 1} would stand {np.degrees(beyond[best, joint]):.3g} deg outside its limits"
        f" {low:.1f} to {high:.1f} deg"
    )


def _singular(arm: ArmModel, nominal: Array, solved: Array, *, reached: bool) -> str:
    """Report that the calibrated solution is lost in a singularity, and of which joints; empty if it is not."""
    moved = np.abs(solved - nominal)
    if reached and moved.max() <= LARGEST_CORRECTION:
        return ""
    _, J = errors_and_jacobian(arm.geometry, np.zeros((1, 3)), np.eye(3)[None], nominal[None])
    idle = np.abs(np.linalg.svd(J[0])[2][-1])
    joints = " and ".join(str(joint + 1) for joint in np.flatnonzero(idle > _TAKES_PART))
    where = f"singular: joints {joints} work against each other there"
    if not reached:
        return f"{where}, and the calibrated model does not reach it"
    worst = int(np.argmax(moved))
    return f"{where}, and joint {worst + 1} would turn by {np.degrees(moved[worst]):.3g} deg"
