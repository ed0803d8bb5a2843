"""Loops of lost motion: the offset of a joint from its motor over its position, by the direction of its last motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cellapp.estimation.motion.fit import Problem, Solution
from cellapp.estimation.motion.observe import residuals
from cellapp.estimation.motion.terms import Law, state_in_motion
from cellapp.robot.kinematics.chain import JointAngles, joint_jacobian
from cellapp.robot.kinematics.transforms import Array

_BINS = 24
_CHUNK = 4096
_CROSSED = 0.9
"""Share of the gap that a joint must have crossed to count for a direction."""
_FEWEST = 20
"""Least points of a bin; bins with fewer are left out."""


@dataclass(frozen=True, eq=False)
class Loop:
    """Loop of one joint (from 1) over its position (n,) [rad], by direction (n,), 1 or -1. ``measured`` and
    ``computed`` (n,) [rad] are its offset from the motor without the model's other effects, and by its hysteresis."""

    joint: int
    position: Array = field(repr=False)
    direction: Array = field(repr=False)
    measured: Array = field(repr=False)
    computed: Array = field(repr=False)


def loops(problem: Problem, solution: Solution, joints: Sequence[int]) -> tuple[Loop, ...]:
    """Return the loops of some joints (from 1) from all points of the recordings.

    A residual r turns joint j by ``J_j . r / |J_j|^2``; a bin has the mean over its points, weighted by ``|J_j|^2``.
    """
    places = [joint - 1 for joint in joints]
    positions = np.concatenate([track.path.at(track.path.stamps.time_s)[0] for track in problem.tracks])
    low, high = positions.min(axis=0), np.maximum(positions.max(axis=0), positions.min(axis=0) + 1e-9)
    sums = np.zeros((len(places), 4, 2, _BINS))  # joint; weight, measured, computed, count; falling, rising
    model = problem.model(solution.values)
    hysteresis = [
        (number, term) for number, term in enumerate(problem.layout.terms) if term.law in (Law.PLAY, Law.WINDUP)
    ]
    for number, (track, source) in enumerate(zip(problem.tracks, solution.sources)):
        for first in range(0, len(source.rows), _CHUNK):
            rows = source.rows[first : first + _CHUNK]
            left = residuals(model, track, number, rows)
            u = track.controller_times(rows, *model.clock(number))
            state = state_in_motion(track.path, u, model.masses, torques=model.needs_torques)
            _, J = joint_jacobian(model.geometry, JointAngles.of(state.q))
            for place, joint in enumerate(places):
                own = np.zeros(len(rows))
                for value, term in ((model.of_terms[n], term) for n, term in hysteresis if term.joint == joint):
                    own += value * term.offset(state)
                weight = np.einsum("an,an->n", J[:, joint], J[:, joint])
                measured = np.einsum("an,na->n", J[:, joint], left) + weight * own
                share = (state.q[:, joint] - low[joint]) / (high[joint] - low[joint])
                bins = np.clip((share * _BINS).astype(np.intp), 0, _BINS - 1)
                bins += np.where(state.direction[:, joint] > 0.0, _BINS, 0)
                crossed = np.abs(state.direction[:, joint]) > _CROSSED
                for what, values in enumerate((weight, measured, weight * own, np.ones(len(rows)))):
                    found = np.bincount(bins[crossed], values[crossed], 2 * _BINS)
                    sums[place, what] += found.reshape(2, _BINS)
    middles = (np.arange(_BINS) + 0.5) / _BINS
    return tuple(
        _loop(joint, low[joint - 1] + middles * (high - low)[joint - 1], its) for joint, its in zip(joints, sums)
    )


def _loop(joint: int, middles: Array, sums: Array) -> Loop:
    sides, bins = np.nonzero(sums[3] >= _FEWEST)
    order = np.lexsort((sides, bins))
    sides, bins = sides[order], bins[order]
    weight, measured, computed, _ = sums[:, sides, bins]
    return Loop(joint, middles[bins], np.where(sides == 1, 1.0, -1.0), measured / weight, computed / weight)
