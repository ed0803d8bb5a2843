"""Compute the corrections of all targets of a program, or the reason why a target has none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.cell.programs.constants import pose_matrix, pose_numbers
from cellapp.cell.programs.correction import (
    aim,
    branches,
    controller_chain,
    flange_of,
    moved_by,
    nearest,
    nearest_vector,
    orientation_spread,
    outside,
    position_spread,
)
from cellapp.cell.programs.records import CorrectedTarget
from cellapp.cell.programs.script_targets import six
from cellapp.cell.programs.targets import ProgramTarget
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array, invert, rotation_from_vector, rotation_vectors
from cellapp.robot.model import ArmModel

_RESIDUAL = 1e-6
"""Largest residual of the model [m, rad] at a corrected target."""
_LARGEST_TURN = 0.2
"""Correction of a joint [rad] above which a posture counts as singular. Away from singularities the deviations of an
arm, millimetres and milliradians, rotate its joints by some milliradians, a fortieth of this."""
_SAME = 1e-9
"""A correction below this [m, rad] is rounding; the text is not changed."""


@dataclass(frozen=True)
class Workplace:
    """Arm and conditions of a program.

    Attributes
    ----------
    arm : ArmModel
    limits : array, shape (N, 2)
        Joint limits [rad].
    home : array, shape (N,)
        Assumed position of the arm at the beginning [rad].
    measured : array, shape (m, N)
        Joint positions of the readings [rad].
    seed : int
    payload_kg : float or None
        None if that of the model.
    extrapolate : bool
        Whether targets outside the joint ranges of the readings are corrected.
    """

    arm: ArmModel
    limits: Array
    home: Array
    measured: Array
    seed: int
    payload_kg: float | None
    extrapolate: bool

    def conditions(self, count: int) -> MeasurementConditions:
        """Return the known conditions of ``count`` targets: the payload."""
        payload = None if self.payload_kg is None else np.full(count, self.payload_kg)
        return MeasurementConditions(payload_kg=payload)


def solve_targets(place: Workplace, targets: Sequence[ProgramTarget]) -> list[CorrectedTarget]:
    """Return the correction of each target, in order."""
    if not targets:
        return []
    chain = controller_chain(place.arm)
    meant, chosen = _meant(place, chain, targets)
    found = [k for k, (q, _) in enumerate(chosen) if q is not None]
    refused = [_refused(target, chosen[k][1]) for k, target in enumerate(targets)]
    if not found:
        return refused
    q_old = np.array([chosen[k][0] for k in found])
    conditions = place.conditions(len(found))
    arm = moved_by(place.arm)
    solved = aim(arm, arm.nominal.T_M_B() @ meant[found], q_old, conditions)
    told = flange_of(chain, solved.q)
    angles = orientation_spread(place.arm, solved.q)
    tcps = [np.eye(4) if (tcp := targets[k].tcp) is None else pose_matrix(tcp) for k in found]
    spreads = _spreads(place, solved.q, np.array(tcps)[:, :3, 3])
    results = list(refused)
    for row, k in enumerate(found):
        residual = max(solved.residual_m[row], solved.residual_rad[row])
        if reason := _why_not(place, q_old[row], solved.q[row], residual):
            results[k] = _refused(targets[k], reason)
            continue
        results[k] = _corrected(
            targets[k],
            q_new=solved.q[row],
            meant=meant[k] @ tcps[row],
            told=told[row] @ tcps[row],
            nearest_to=chosen[k][1],
            spread_mm=None if spreads is None else float(spreads[row]) * 1e3,
            spread_mrad=None if angles is None else float(angles[row]) * 1e3,
        )
    return results


# -- inside -----------------------------------------------------------------------------------------------------------


def _meant(
    place: Workplace, chain: Geometry, targets: Sequence[ProgramTarget]
) -> tuple[Array, list[tuple[Array | None, str]]]:
    """Return the flange poses (n, 4, 4) in the base frame that targets mean, and a plain controller's joint positions.

    Each position comes with the name of what its solution is nearest to; None with the reason if there is none.
    """
    meant = np.tile(np.eye(4), (len(targets), 1, 1))
    poses = [k for k, target in enumerate(targets) if target.kind == "pose"]
    for k in poses:
        meant[k] = _wanted_tcp(targets[k]) @ invert(pose_matrix(targets[k].tcp or (0.0,) * 6))
    near = np.array([targets[k].near or place.home.tolist() for k in poses]).reshape(-1, len(place.home))
    solutions = dict(zip(poses, branches(chain, meant[poses], place.limits, near, place.seed), strict=True))
    chosen: list[tuple[Array | None, str]] = []
    last, function, line = place.home, None, 0
    for k, target in enumerate(targets):
        if target.function != function:
            last, function, line = place.home, target.function, 0
        if target.kind == "joints":
            q: Array | None = np.array(target.numbers)
            meant[k] = flange_of(chain, np.array([target.numbers]))[0]
            why = ""
        else:
            why = "qnear" if target.near is not None else f"line {line}" if line else "home"
            to = last if target.near is None else np.array(target.near)
            q = nearest(solutions[k], place.limits, to)
        chosen.append((q, why if q is not None else "out of reach, or only beyond a joint's limits"))
        if q is not None:
            last, line = q, target.line
    return meant, chosen


def _spreads(place: Workplace, q: Array, tcps: Array) -> Array | None:
    """Return the standard deviation (n,) [m] of a coordinate of the TCPs (n, 3) at ``q`` (n, N); None if unknown."""
    spreads = np.zeros(len(q))
    for tcp in np.unique(tcps, axis=0):
        same = np.all(tcps == tcp, axis=1)
        found = position_spread(place.arm, q[same], tcp, place.conditions(int(same.sum())))
        if found is None:
            return None
        spreads[same] = found
    return spreads


def _wanted_tcp(target: ProgramTarget) -> Array:
    """Return the TCP pose (4, 4) that a pose target means."""
    wanted = pose_matrix(target.numbers)
    if target.position_only and target.facing is not None:
        wanted[:3, :3] = rotation_from_vector(target.facing[3:])
    return wanted


def _why_not(place: Workplace, q_old: Array, q_new: Array, residual: float) -> str:
    """Return why a solution is not written; empty if it is."""
    low, high = place.limits[:, 0], place.limits[:, 1]
    for name, q in (("the program's", q_old), ("the corrected", q_new)):
        beyond = np.flatnonzero((q < low) | (q > high))
        if len(beyond):
            joint = int(beyond[0])
            return (
                f"{name} position of joint {joint + 1}, {np.degrees(q[joint]):.3f} deg, is beyond its limits"
                f" {np.degrees(low[joint]):.1f} to {np.degrees(high[joint]):.1f} deg"
            )
    turn = np.abs(q_new - q_old)
    joint = int(turn.argmax())
    if turn[joint] > _LARGEST_TURN:
        return f"singular posture: its correction would turn joint {joint + 1} by {np.degrees(turn[joint]):.1f} deg"
    if not residual < _RESIDUAL:
        return f"singular posture or edge of the reach: the calibrated arm stays {residual * 1e3:.3f} mm or mrad away"
    if not place.extrapolate and (joints := outside(q_new, place.measured)):
        joint = joints[0]
        low, high = place.measured.min(axis=0), place.measured.max(axis=0)
        return (
            f"outside the calibrated range: joint {joint + 1} at {np.degrees(q_new[joint]):.1f} deg, measured from"
            f" {np.degrees(low[joint]):.1f} to {np.degrees(high[joint]):.1f} deg (--extrapolate corrects it too)"
        )
    return ""


def _refused(target: ProgramTarget, reason: str) -> CorrectedTarget:
    return CorrectedTarget(
        line=target.line, command=target.command, kind=target.kind, old=target.numbers, reason=reason
    )


def _corrected(
    target: ProgramTarget,
    *,
    q_new: Array,
    meant: Array,
    told: Array,
    nearest_to: str,
    spread_mm: float | None,
    spread_mrad: float | None,
) -> CorrectedTarget:
    shift = float(np.linalg.norm(told[:3, 3] - meant[:3, 3]))
    turn = float(np.linalg.norm(rotation_vectors((meant[:3, :3].T @ told[:3, :3])[None])[0]))
    new = six(q_new.tolist())
    if target.kind == "pose":
        pose = pose_numbers(told)
        rotation = target.numbers[3:] if target.position_only else nearest_vector(pose[3:], target.numbers[3:]).tolist()
        new = six([*pose[:3], *rotation])
    if shift < _SAME and turn < _SAME:
        new = target.numbers
    return CorrectedTarget(
        line=target.line,
        command=target.command,
        kind=target.kind,
        old=target.numbers,
        new=new,
        correction_mm=shift * 1e3,
        correction_mrad=turn * 1e3,
        q_new=six(q_new.tolist()),
        uncertainty_mm=spread_mm,
        uncertainty_mrad=spread_mrad,
        nearest_to=nearest_to,
    )
