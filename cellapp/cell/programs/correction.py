"""Compute what to command a plain controller so that the real flange takes the pose that a program means.

A plain controller computes with the published chain, or with its own calibration if the profile states it. A program's
pose T is meant in the base frame of that chain, which is located in the cell by registration to the readings. With the
calibrated model's true flange pose ``F(q)``:

    q_new:  F(q_new) = T_M_base T_base_tcp inverse(T_flange_tcp)
    T_new = K(q_new) T_flange_tcp                              K: forward kinematics of the controller

Joint targets mean the pose that the controller computes for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellapp.cell.targets.invert import Inverted
from cellapp.robot.effects import EFFECTS, MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry, flange_poses
from cellapp.robot.kinematics.closed_form import closed_form_solutions
from cellapp.robot.kinematics.inverse import solve_pose
from cellapp.robot.kinematics.transforms import Array, rotation_vectors, transform
from cellapp.robot.model import ArmModel

_STARTS = 48
"""Random starts of the inverse per pose, for a chain without a closed form: six joints have at most 16 solutions."""
_ROUNDS = 12
"""Maximum number of fixed-point iterations of ``aim``: each gains two decades, as model corrections vary slowly."""
_SAME = 1e-10
"""Residual [m, rad] at which that iteration ends: far below any controller's resolution."""
_MARGIN = np.radians(2.0)
"""Margin [rad] of the joint ranges of the readings. Model corrections vary over tens of degrees, and a correction alone
may move a program's posture beyond the outermost reading."""
_TWIN = 1e-6
"""Solutions that agree to this in every joint [rad] are the same: 1 µrad."""


def controller_chain(arm: ArmModel) -> Geometry:
    """Return the chain of a plain controller: nominal rows from its base to its flange."""
    return replace(arm.nominal.with_T_M_B(np.eye(4)), tool=np.zeros(3))


def flange_of(chain: Geometry, q: Array) -> Array:
    """Return flange poses (n, 4, 4) of a chain at ``q`` (n, N) [rad]."""
    rotations, origins = flange_poses(chain, q)
    return _poses(rotations, origins)


def moved_by(arm: ArmModel) -> ArmModel:
    """Return the model without effects that change only the tracker's reading."""
    effects = tuple(term for term in arm.effects if not EFFECTS[term.slug].of_reading)
    return replace(arm, effects=effects, posterior=None)


def true_flange(arm: ArmModel, q: Array, conditions: MeasurementConditions) -> Array:
    """Return true flange poses (n, 4, 4) in the tracker frame if the controller reads ``q`` (n, N) [rad].

    Effects state displacements of points on the flange. Four points, the flange's origin and 1 m along each axis,
    give its rotation, too. The network knows only the SMR: it shifts the flange equally and does not rotate it.
    """
    points = np.vstack([np.zeros(3), np.eye(3)])
    at = np.array([_with_tool(arm, point).predict(q, conditions=conditions) for point in points])
    rotations = np.stack([at[k + 1] - at[0] for k in range(3)], axis=2)
    u, _, vt = np.linalg.svd(rotations)  # the nearest rotations
    return _poses(u @ vt, at[0])


def aim(arm: ArmModel, wanted_M: Array, start: Array, conditions: MeasurementConditions) -> Inverted:
    """Find joint positions near ``start`` (n, N) at which the model puts the flange at ``wanted_M`` (n, 4, 4)."""
    chain = replace(arm.geometry, tool=np.zeros(3))
    aimed, q = wanted_M.copy(), start
    shift = turn = np.full(len(start), np.inf)
    for _ in range(_ROUNDS):
        q = solve_pose(chain, aimed[:, :3, 3], aimed[:, :3, :3], q).q
        reached = true_flange(arm, q, conditions)
        off = wanted_M[:, :3, 3] - reached[:, :3, 3]
        rotation = wanted_M[:, :3, :3] @ reached[:, :3, :3].transpose(0, 2, 1)
        shift, turn = np.linalg.norm(off, axis=1), np.linalg.norm(rotation_vectors(rotation), axis=1)
        if max(shift.max(initial=0.0), turn.max(initial=0.0)) < _SAME:
            break
        aimed = _poses(rotation @ aimed[:, :3, :3], aimed[:, :3, 3] + off)
    return Inverted(q, shift, turn)


def branches(chain: Geometry, poses: Array, limits: Array, near: Array, seed: int) -> list[Array]:
    """Return for each of n flange poses (n, 4, 4) all joint positions (k, N) [rad] within limits (N, 2) that reach it.

    ``near`` (n, N) is an additional start per pose, besides closed-form or random ones.
    """
    n, joints = len(poses), chain.joints
    starts = closed_form_solutions(chain, poses[:, :3, 3], poses[:, :3, :3], near)
    if starts is None:
        random = np.random.default_rng([seed, 0x9A0]).uniform(-np.pi, np.pi, (_STARTS, joints))
        starts = np.tile(random, (n, 1, 1))
    starts = np.concatenate([near[:, None], starts], axis=1).reshape(-1, joints)
    which = np.repeat(np.arange(n), len(starts) // max(n, 1))
    which, starts = which[np.isfinite(starts[:, 0])], starts[np.isfinite(starts[:, 0])]
    solved = solve_pose(chain, poses[which, :3, 3], poses[which, :3, :3], starts)
    q = np.mod(solved.q + np.pi, 2.0 * np.pi) - np.pi
    within = np.all(_turned_into(q, limits, np.zeros(joints))[1], axis=1)
    good = solved.reached & within
    return [_distinct(q[(which == k) & good]) for k in range(n)]


def nearest(solutions: Array, limits: Array, to: Array) -> Array | None:
    """Return the solution (k, N) [rad], with whole turns within limits, nearest to ``to`` (N,) by the sum of squares.

    So does the controller (forum.universal-robots.com, "Get_inverse_kin closest solution criteria"). None without any.
    """
    if len(solutions) == 0:
        return None
    turned, within = _turned_into(solutions, limits, to)
    turned = turned[np.all(within, axis=1)]
    if len(turned) == 0:
        return None
    return np.asarray(turned[np.argmin(np.sum((turned - to) ** 2, axis=1))])


def position_spread(arm: ArmModel, q: Array, tcp: Array, conditions: MeasurementConditions) -> Array | None:
    """Return the standard deviation (n,) [m] of a coordinate of the point ``tcp`` (3,) on the flange; None if unknown.

    The uncertainty of the SMR's offset does not affect it and is left out of the posterior draws.
    """
    if arm.posterior is None:
        return None
    of_tool = np.array(arm.posterior.columns) >= 6 + 5 * arm.geometry.joints
    draws = np.where(of_tool, 0.0, arm.posterior.geometry)
    return replace(_with_tool(arm, tcp), posterior=replace(arm.posterior, geometry=draws)).uncertainty(q, conditions)


def orientation_spread(arm: ArmModel, q: Array) -> Array | None:
    """Return the standard deviation (n,) [rad] of the flange's orientation from posterior draws; None without draws.

    It is the root mean square of the angle between drawn and identified orientation, from geometry only.
    """
    if arm.posterior is None:
        return None
    columns = list(arm.posterior.columns)
    own = flange_poses(arm.geometry, q)[0].transpose(0, 2, 1)
    vector, squares = arm.geometry.vector(), np.zeros(len(q))
    for draw in arm.posterior.geometry:
        drawn = vector.copy()
        drawn[columns] += draw
        rotations = flange_poses(arm.geometry.with_vector(drawn), q)[0]
        squares += np.sum(rotation_vectors(rotations @ own) ** 2, axis=1)
    return np.asarray(np.sqrt(squares / len(arm.posterior.geometry)))


def outside(q: Array, measured: Array) -> list[int]:
    """Return the indices of joints whose position in ``q`` (N,) is outside the readings (n, N), modulo whole turns."""
    low, high = measured.min(axis=0) - _MARGIN, measured.max(axis=0) + _MARGIN
    turned = q + 2.0 * np.pi * np.ceil((low - q) / (2.0 * np.pi))
    return np.flatnonzero(turned > high).tolist()


def nearest_vector(vector: Sequence[float], to: Sequence[float]) -> Array:
    """Return the rotation vector (3,) [rad] of the same rotation nearest to ``to``: it may differ by whole turns."""
    here, there = np.array(vector), np.array(to)
    angle = float(np.linalg.norm(here))
    if angle < 1e-9:
        return here
    axis = here / angle
    turns = round((float(axis @ there) - angle) / (2.0 * np.pi))
    return np.asarray(axis * (angle + 2.0 * np.pi * turns))


# -- inside -----------------------------------------------------------------------------------------------------------


def _with_tool(arm: ArmModel, point: Array) -> ArmModel:
    return replace(arm, geometry=replace(arm.geometry, tool=point))


def _poses(rotations: Array, origins: Array) -> Array:
    poses = np.tile(transform(np.eye(3), np.zeros(3)), (len(origins), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations, origins
    return poses


def _turned_into(q: Array, limits: Array, to: Array) -> tuple[Array, np.ndarray]:
    """Move joints of ``q`` (k, N) by whole turns towards ``to`` (N,) within limits; return them and a success mask."""
    turn = 2.0 * np.pi
    fewest, most = np.ceil((limits[:, 0] - q) / turn), np.floor((limits[:, 1] - q) / turn)
    wanted = np.round((to - q) / turn)
    return np.asarray(q + turn * np.clip(wanted, fewest, np.maximum(fewest, most))), fewest <= most


def _distinct(q: Array) -> Array:
    """Return solutions (k, N) without duplicates."""
    kept: list[Array] = []
    for one in q:
        apart = [np.abs(np.mod(one - other + np.pi, 2.0 * np.pi) - np.pi).max() for other in kept]
        if not apart or min(apart) > _TWIN:
            kept.append(one)
    return np.array(kept).reshape(-1, q.shape[1])
