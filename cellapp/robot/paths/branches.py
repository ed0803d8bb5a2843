"""Follow the branches of the inverse kinematics along a path, from each solution at its start, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.robot.kinematics.branches import all_branches, turned_into
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.inverse import solve_pose
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.paths.cartesian import CartesianPath

_COARSE_M = 0.01
_COARSE_TURN_RAD = 0.05
"""Spacing of the samples along which a branch is followed: close enough that Newton stays on it."""
_LARGEST_STEP_RAD = 0.35
"""Largest step of a joint between samples: a larger one means another branch or a singularity."""


@dataclass(frozen=True, eq=False)
class Branch:
    """One solution followed along the path.

    Attributes
    ----------
    s : array, shape (m,)
        Arc lengths [m].
    q : array, shape (m, N)
        Joint positions [rad] of the chain; invalid beyond ``failed_m``.
    failure : str
        Why it cannot be followed to the end; empty if it can.
    failed_m : float
        Arc length at which it fails [m]; infinite if it does not.
    """

    s: Array
    q: Array
    failure: str = ""
    failed_m: float = np.inf


def follow_branches(geometry: Geometry, path: CartesianPath, limits: Array, near: Array, seed: int) -> list[Branch]:
    """Follow all branches of ``geometry`` along a path; those that reach its end come first, nearest to ``near`` (N,).

    Then come those that fail, the latest failure first. ``limits`` (N, 2) [rad] hold on the whole path; ``seed`` is
    that of ``all_branches``. The list is empty if the start is out of reach.
    """
    s = _samples(path)
    positions, rotations = path.poses(s)
    start = _solutions(geometry, positions[0], rotations[0], limits, near, seed)
    q = np.empty((len(s), *start.shape))
    failed = np.full(len(start), len(s))
    reasons = [""] * len(start)
    if len(start):
        q[0] = start
    for k in range(1, len(s) if len(start) else 0):
        guess = q[k - 1] if k < 2 else 2.0 * q[k - 1] - q[k - 2]
        target = np.broadcast_to(positions[k], (len(start), 3)), np.broadcast_to(rotations[k], (len(start), 3, 3))
        found = solve_pose(geometry, *target, guess, max_iterations=12)
        q[k] = np.where(found.reached[:, None], found.q, q[k - 1])
        for b in np.flatnonzero(failed == len(s)):
            reasons[b] = _why_not(q[k - 1, b], q[k, b], bool(found.reached[b]), limits)
            failed[b] = k if reasons[b] else len(s)
        if (failed < len(s)).all():
            break
    branches = [
        Branch(s, q[:, b], reasons[b], float(s[failed[b]]) if reasons[b] else np.inf) for b in range(len(start))
    ]
    return sorted(branches, key=lambda branch: (-branch.failed_m, round(float(np.abs(branch.q[0] - near).max()), 6)))


def _samples(path: CartesianPath) -> Array:
    """Choose arc lengths (m,) [m] of samples from start to end, with every stop, and dense enough in between."""
    found = [np.zeros(1)]
    for begin, end in zip(path.stops, path.stops[1:], strict=False):
        trial = np.linspace(begin, end, max(9, int(np.ceil((end - begin) / _COARSE_M)) + 1))
        turns = path.poses(np.minimum(trial, np.nextafter(end, begin)))[1]
        angle = np.arccos(np.clip(0.5 * (np.einsum("nij,nij->n", turns[1:], turns[:-1]) - 1.0), -1.0, 1.0))
        finer = max(1, int(np.ceil(angle.max() / _COARSE_TURN_RAD)))
        found.append(np.linspace(begin, end, (len(trial) - 1) * finer + 1)[1:])
    return np.concatenate(found)


def _solutions(geometry: Geometry, position: Array, rotation: Array, limits: Array, near: Array, seed: int) -> Array:
    """Find distinct solutions (b, N) [rad] within the limits at one pose."""
    (found,) = all_branches(geometry, position[None], rotation[None], limits, near, seed)
    q, _ = turned_into(found[np.isfinite(found[:, 0])], limits, np.zeros(len(limits)))
    return np.asarray(q[np.all((q >= limits[:, 0]) & (q <= limits[:, 1]), axis=1)])


def _why_not(before: Array, here: Array, reached: bool, limits: Array) -> str:
    """Say why a branch cannot be followed from one sample to the next; empty if it can."""
    if not reached:
        return "out of reach"
    step = np.abs(here - before)
    if step.max() > _LARGEST_STEP_RAD:
        return f"a singularity: joint {int(np.argmax(step)) + 1} would have to turn by {np.degrees(step.max()):.0f} deg"
    outside = (here < limits[:, 0]) | (here > limits[:, 1])
    if outside.any():
        j = int(np.argmax(outside))
        low, high = np.degrees(limits[j])
        return f"joint {j + 1} at {np.degrees(here[j]):.1f} deg is outside its limits {low:.1f} to {high:.1f} deg"
    return ""
