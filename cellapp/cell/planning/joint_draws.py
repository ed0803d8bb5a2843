"""Random configurations of one arm and how the tracker sees their SMR, without the poses of all frames.

An SMR that may be turned away by some 30 degrees faces the tracker in one of twenty configurations. Whether it does,
and where the SMR is, follows from a few products of the pose of the first joints with that of the wrist. So each of a
group of first joints is combined with each of a group of wrists: the trigonometry is done once for many configurations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.bodies import ArmBodies
from cellapp.cell.safety.gate import CellBodies
from cellapp.cell.safety.visibility import Sight
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import Geometry, frame_poses
from cellapp.robot.kinematics.transforms import Array

_GROUP = 16
"""Number of first joints, and of wrists, in a group: 256 configurations, 2 to 4 of them usable in the twin cell."""
_GROUPS = 48
"""Number of groups drawn at once, some 12 000 configurations: what is computed from them fits in the cache."""


@dataclass(frozen=True, eq=False)
class JointDraws:
    """b groups, in each m positions of the first joints combined with w of the other joints.

    Attributes
    ----------
    first : array, shape (b, m, s)
        Positions of the first s joints [rad].
    wrist : array, shape (b, w, N - s)
        Positions of the other joints [rad].
    sight : Sight
        Their SMRs as the tracker sees them; its arrays have the shape (b, m, w), that of the positions (3, b, m, w).
    """

    first: Array
    wrist: Array
    sight: Sight

    def q(self, chosen: NDArray[np.bool_]) -> Array:
        """Return the configurations ``chosen`` (b, m, w) as (n, N) [rad], in the order of ``array[chosen]``."""
        group, i, k = np.nonzero(chosen)
        return np.concatenate([self.first[group, i], self.wrist[group, k]], axis=1)


def draw_joints(arm: ArmBodies, T_C_M: Array, ranges: Array, rng: np.random.Generator) -> JointDraws:
    """Draw configurations uniformly from ``ranges`` (N, 2) [rad]; the tracker stands at ``T_C_M`` (4, 4).

    Every configuration is uniform; only those of one group depend on each other, as they share positions of joints.
    """
    split = max(1, arm.geometry.joints // 2)
    first, wrist = _uniform(ranges[:split], rng), _uniform(ranges[split:], rng)
    R, o = _end_poses(replace(arm.geometry, rows=arm.geometry.rows[:split]), first)
    identity = Geometry(np.zeros(6), arm.geometry.rows[split:], arm.geometry.tool)
    R_wrist, o_wrist = _end_poses(identity, wrist)
    normal, smr = R_wrist @ arm.normal_F, o_wrist + R_wrist @ arm.geometry.tool  # in the last frame of the first joints
    axes = T_C_M[:3, :3].T @ R
    tracker = np.einsum("bmac,bma->bmc", R, T_C_M[:3, 3] - o)  # (b, m, 3), in the same frame
    away = -np.einsum("bmac,bmc->bma", axes, tracker)
    b, m, w = len(first), first.shape[1], wrist.shape[1]
    smr_T = np.ascontiguousarray(smr.transpose(0, 2, 1))
    smr_M = (axes.transpose(0, 2, 1, 3).reshape(b, 3 * m, 3) @ smr_T).reshape(b, 3, m, w).transpose(1, 0, 2, 3)
    smr_M = smr_M + away.transpose(2, 0, 1)[..., None]
    distance = np.sqrt(smr_M[0] ** 2 + smr_M[1] ** 2 + smr_M[2] ** 2)
    towards = tracker @ normal.transpose(0, 2, 1)
    towards -= np.einsum("bwa,bwa->bw", smr, normal)[:, None]
    return JointDraws(first, wrist, Sight(smr_M, distance, towards / distance))


def _uniform(ranges: Array, rng: np.random.Generator) -> Array:
    """Draw uniform positions (b, m, s) [rad] of s joints; one in each group where no joint can move."""
    group = _GROUP if np.any(ranges[:, 1] > ranges[:, 0]) else 1
    return rng.uniform(ranges[:, 0], ranges[:, 1], size=(_GROUPS, group, len(ranges)))


def _end_poses(geometry: Geometry, q: Array) -> tuple[Array, Array]:
    """Compute rotations (b, m, 3, 3) and origins (b, m, 3) [m] of a chain's last frame at ``q`` (b, m, s) [rad]."""
    b, m, joints = q.shape
    rotations, origins = frame_poses(geometry, q.reshape(b * m, joints))
    return rotations[-1].reshape(b, m, 3, 3), origins[-1].reshape(b, m, 3)


def joint_ranges(cell: CellBodies, profile: Profile, name: str) -> Array:
    """Return the ranges from which the joint positions of an arm are drawn, lowest and highest, shape (N, 2) [rad].

    Raises
    ------
    InputError
        If a range of the plan is outside the arm's limits.
    """
    limits = cell.arms[name].limits
    if profile.plan.ranges is None:  # poses repeat after one turn of a joint: stay as near to zero as the limits allow
        middle = np.clip(0.0, limits[:, 0] + math.pi, limits[:, 1] - math.pi)
        return np.stack(
            [np.maximum(limits[:, 0], middle - math.pi), np.minimum(limits[:, 1], middle + math.pi)], axis=1
        )
    low, high = np.array(profile.plan.ranges).T
    ranges = np.stack([np.maximum(low, limits[:, 0]), np.minimum(high, limits[:, 1])], axis=1)
    for j in np.flatnonzero(ranges[:, 0] > ranges[:, 1]):
        raise InputError(
            f"plan.ranges: joint {j + 1}: no part of [{low[j]:g}, {high[j]:g}] rad is inside the limits of arm {name}"
        )
    return ranges
