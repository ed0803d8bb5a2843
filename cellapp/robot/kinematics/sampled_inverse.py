"""Find inverse solutions of any chain from starts in a table of sampled configurations.

Newton's iteration converges to the solution whose basin contains its start. Samples with a pose near the wanted one lie
in the basins of the different branches, so a few dozen starts find nearly all branches; for a redundant arm, whose
solutions are a continuum, they give a spread of solutions.
"""

from __future__ import annotations

import numpy as np
import scipy

from cellapp.robot.kinematics.chain import Geometry, flange_poses, frame_poses
from cellapp.robot.kinematics.inverse import solve_pose
from cellapp.robot.kinematics.transforms import Array

_SAMPLES = 20_000
"""Configurations in the table: their poses lie some 0.3 rad and 0.2 of the reach apart, from where Newton converges."""
_STARTS = 32
"""Number of starts for each pose: a six-joint arm has at most 16 solutions."""
_POSITION_STARTS, _LIKED_STARTS = 5, 12
"""Numbers of starts for each position with free rotation, from the samples and from ``liked``: different branches."""
_NEAREST = 64
"""Number of samples nearest to a position; the starts are those of them nearest to the preferred configuration."""
_ROUNDS = 40
"""Most iterations of one start; a start that needs more is not near a solution."""
_AT_ONCE = 1000
"""Number of poses in a batch: with their starts some tens of MB."""
_SAME = 1e-5
"""Solutions that agree to 10 µrad in every joint count as one; two branches meet only at a singularity."""
_PULL, _PULL_ROUNDS, _CLOSE_ROUNDS = 0.5, 12, 25
"""Share of the way to the preferred configuration that one iteration moves in the null space of the position, number of
such iterations, and number of later ones that only reduce the position error."""
_DAMPING, _MOST_DAMPING, _DAMPING_SHARE = 1e-9, 1e-2, 1e-2
"""Damping of a position step: its limits [m^2], the lower far below the squared levers of an arm, and its size per
squared error, as in ``solve_pose``."""
_REACHED_M = 1e-9
"""Position error of a solution."""
_LARGEST_STEP = 0.5
"""Limit on the change of any joint in one iteration [rad]."""


def sampled_solutions(
    geometry: Geometry, position_M: Array, rotation_M: Array, limits: Array, near: Array, seed: int
) -> Array:
    """Find joint positions (n, K, N) [rad] that reach n poses, each joint within half a turn of ``near`` (N,).

    Positions (n, 3) [m] of the SMR and rotations (n, 3, 3) of the flange are in the tracker frame. Samples are drawn
    from ``seed`` within ``limits`` (N, 2) [rad]. The result is padded with NaN.
    """
    samples = sampled_configurations(limits, near, seed)
    rotations, _ = flange_poses(geometry, samples)
    at, reach = _positions(geometry, samples)
    tree = scipy.spatial.cKDTree(np.hstack([at / reach, rotations.reshape(-1, 9)]))
    found = []
    for begin in range(0, len(position_M), _AT_ONCE):
        P, R = position_M[begin : begin + _AT_ONCE], rotation_M[begin : begin + _AT_ONCE]
        _, starts = tree.query(np.hstack([P / reach, R.reshape(-1, 9)]), k=_STARTS)
        q = np.concatenate([np.broadcast_to(near, (len(P), 1, len(near))), samples[starts]], axis=1)
        which = np.repeat(np.arange(len(P)), q.shape[1])
        solved = solve_pose(geometry, P[which], R[which], q.reshape(len(which), -1), max_iterations=_ROUNDS)
        reached = np.where(solved.reached[:, None], _around(solved.q, near), np.nan)
        found.append(_distinct(reached.reshape(q.shape)))
    return _stacked(found, len(near))


def position_solutions(
    geometry: Geometry, position_M: Array, samples: Array, near: Array, liked: Array | None = None
) -> Array:
    """Find joint positions (n, K, N) [rad] that put the SMR at n positions (n, 3) [m] with any rotation; NaN pads.

    Starts are ``near`` and those ``samples`` (m, N) with the SMR near the position that are nearest to ``near``; they
    are pulled towards ``near`` within the null space, to a local minimum of the distance from it. Other starts,
    ``near`` and those of ``liked`` (m', N) with the SMR nearest to the position, go to it by the least motion.
    """
    found = []
    for begin in range(0, len(position_M), _AT_ONCE):
        P = position_M[begin : begin + _AT_ONCE]
        own = np.broadcast_to(near, (len(P), 1, len(near)))
        pulled = np.concatenate([own, _starts_near(geometry, P, samples, near, _NEAREST)[:, :_POSITION_STARTS]], axis=1)
        still = own
        if liked is not None and len(liked):
            still = np.concatenate([own, _starts_near(geometry, P, liked, near, _LIKED_STARTS)], axis=1)
        each = []
        for starts, rounds in ((pulled, _PULL_ROUNDS), (still, 0)):
            which = np.repeat(np.arange(len(P)), starts.shape[1])
            q, off = _to_position(geometry, P[which], starts.reshape(len(which), -1), near, rounds)
            each.append(np.where(off[:, None] < _REACHED_M, _around(q, near), np.nan).reshape(starts.shape))
        found.append(_distinct(np.concatenate(each, axis=1)))
    return _stacked(found, len(near))


def missed_distances(geometry: Geometry, position_M: Array, start: Array) -> Array:
    """Return the SMR's remaining distance (n,) [m] from positions (n, 3), any rotation, from one start (N,) [rad]."""
    return _to_position(geometry, position_M, np.tile(start, (len(position_M), 1)), start, 0)[1]


def sampled_configurations(limits: Array, near: Array, seed: int) -> Array:
    """Draw configurations (m, N) [rad] within limits (N, 2), and within half a turn of ``near`` if limits allow."""
    middle = np.clip(near, limits[:, 0] + np.pi, limits[:, 1] - np.pi)
    low, high = np.maximum(limits[:, 0], middle - np.pi), np.minimum(limits[:, 1], middle + np.pi)
    return np.random.default_rng([seed, 0x7A6]).uniform(low, high, size=(_SAMPLES, len(low)))


# -- inside -----------------------------------------------------------------------------------------------------------


def _starts_near(geometry: Geometry, position_M: Array, table: Array, near: Array, among: int) -> Array:
    """Select the ``among`` table entries with the SMR nearest to each of n positions, sorted by closeness to ``near``.

    ``near`` (N,) [rad] is the preferred configuration.
    """
    at, _ = _positions(geometry, table)
    _, rows = scipy.spatial.cKDTree(at).query(position_M, k=min(among, len(table)))
    rows = rows.reshape(len(position_M), -1)
    order = np.argsort(np.abs(table[rows] - near).max(axis=2), axis=1, kind="stable")
    return np.asarray(table[np.take_along_axis(rows, order, axis=1)])


def _positions(geometry: Geometry, samples: Array) -> tuple[Array, float]:
    """Compute SMR positions (m, 3) [m] and the size of the volume that they fill [m]."""
    rotations, origins = flange_poses(geometry, samples)
    at = origins + rotations @ geometry.tool
    return at, max(float(np.linalg.norm(at.std(axis=0))), 1e-9)


def _to_position(
    geometry: Geometry, position_M: Array, start: Array, near: Array, pull_rounds: int
) -> tuple[Array, Array]:
    """Move starts to positions by least motions, the first ``pull_rounds`` iterations with a pull to ``near``.

    Return joint positions (n, N) [rad] and the SMR's distances (n,) [m] from the positions.
    """
    q, active = start.copy(), np.arange(len(start))
    for k in range(pull_rounds + _CLOSE_ROUNDS):
        here = q[active]
        rotations, origins = frame_poses(geometry, here)
        P = origins[-1] + rotations[-1] @ geometry.tool
        axes = rotations[:-1, :, :, 2]
        J = np.cross(axes, P - origins[:-1]).transpose(1, 2, 0)
        error = position_M[active] - P
        pull = np.zeros_like(here)
        if k < pull_rounds:
            pull = _PULL * (near - here)
            error = error - np.einsum("nij,nj->ni", J, pull)  # so that the pull stays within the null space
        damping = np.clip(_DAMPING_SHARE * np.einsum("ni,ni->n", error, error), _DAMPING, _MOST_DAMPING)
        A = J @ J.transpose(0, 2, 1) + damping[:, None, None] * np.eye(3)
        step = pull + np.einsum("nij,ni->nj", J, np.linalg.solve(A, error[:, :, None])[:, :, 0])
        largest = np.maximum(np.abs(step).max(axis=1), 1e-12)
        q[active] += step * np.minimum(1.0, _LARGEST_STEP / largest)[:, None]
        active = active[(k < pull_rounds) | (np.abs(error).max(axis=1) >= 0.1 * _REACHED_M)]
        if not len(active):
            break
    rotations, origins = flange_poses(geometry, q)
    return q, np.linalg.norm(position_M - origins - rotations @ geometry.tool, axis=1)


def _around(q: Array, near: Array) -> Array:
    """Shift joints by whole turns to within half a turn of ``near``."""
    return np.asarray(near + np.pi - np.mod(near + np.pi - q, 2.0 * np.pi))


def _distinct(q: Array) -> Array:
    """Remove repeated solutions from (n, K, N); the kept ones come first, padded with NaN."""
    kept = np.isfinite(q[:, :, 0])
    for k in range(1, q.shape[1]):
        apart = np.abs(np.mod(q[:, :k] - q[:, k : k + 1] + np.pi, 2.0 * np.pi) - np.pi).max(axis=2)
        kept[:, k] &= ~np.any((apart < _SAME) & kept[:, :k], axis=1)
    order = np.argsort(~kept, axis=1, kind="stable")[:, : max(1, int(kept.sum(axis=1).max(initial=1)))]
    front = np.take_along_axis(kept, order, axis=1)
    return np.where(front[:, :, None], np.take_along_axis(q, order[:, :, None], axis=1), np.nan)


def _stacked(parts: list[Array], joints: int) -> Array:
    """Stack blocks (n, K, N) of different K along n, padded with NaN."""
    if not parts:
        return np.empty((0, 1, joints))
    most = max(one.shape[1] for one in parts)
    return np.concatenate(
        [np.pad(one, ((0, 0), (0, most - one.shape[1]), (0, 0)), constant_values=np.nan) for one in parts]
    )
