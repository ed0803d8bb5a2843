"""The clock of a recording again, free of what the geometry lacks: for samples that are searched for missing effects.

What an arm's model lacks is a function of its posture (elastic joints, gears that do not turn evenly); an error of the
clock moves the points along their velocity, forth on the way there and back on the way back. Functions of posture are
therefore taken out of the residuals and of the columns of the clock before these are compared.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.motion.records import RecordingFit
from cellapp.robot.kinematics.chain import Geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array

_POINTS = 6000
_STEP_RAD = 1e-6
_ROUNDS = 2
_GROSS = 5.0
"""Multiple of the median residual beyond which a point is not used."""


def aligned(one: RecordingFit, geometry: Geometry, half_play: Array) -> RecordingFit:
    """The recording with offsets and rate of its clock by all its points, whatever the ``geometry`` lacks.

    ``half_play`` (N,) [rad] is the lost motion that the fit found; what is left of it is estimated beside the clock.
    """
    rows = np.flatnonzero(one.track.learnt | one.track.held_out)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _POINTS)).astype(np.intp)]
    for _ in range(_ROUNDS):
        offset, rate = _correction(one, geometry, half_play, rows)
        one = replace(one, offsets_s=one.offsets_s + offset, rate=one.rate + rate)
    return one


def _correction(one: RecordingFit, geometry: Geometry, half_play: Array, rows: NDArray[np.intp]) -> tuple[float, float]:
    """By how much offset [s] and rate are too small."""
    track = one.track
    time_s = track.controller_times(rows, one.offsets_s, one.rate)
    q, qd = track.path.at(time_s)
    side = track.path.direction_at(time_s)
    at = q - half_play * side
    left = track.p_M[rows] - smr_positions(geometry, at)
    size = np.linalg.norm(left, axis=1)
    good = size < _GROSS * np.median(size)
    columns = np.empty((len(rows), 3, 2 + q.shape[1]))
    columns[:, :, 0] = -_moved(geometry, at, qd)
    columns[:, :, 1] = columns[:, :, 0] * (track.time_s[rows] - track.middle_s)[:, None]
    for joint in range(q.shape[1]):
        turned = np.zeros_like(q)
        turned[:, joint] = -side[:, joint]
        columns[:, :, 2 + joint] = _moved(geometry, at, turned)
    basis, _ = np.linalg.qr(_functions_of_posture(q[good]))
    table = np.concatenate([columns[good], left[good, :, None]], axis=2).reshape(len(basis), -1)
    table = (table - basis @ (basis.T @ table)).reshape(len(basis) * 3, -1)
    unit = np.maximum(np.linalg.norm(table[:, :-1], axis=0), 1e-300)
    found, *_ = np.linalg.lstsq(table[:, :-1] / unit, table[:, -1], rcond=1e-6)
    return float(found[0] / unit[0]), float(found[1] / unit[1])


def _moved(geometry: Geometry, q: Array, direction: Array) -> Array:
    """Derivatives (n, 3) of the points along ``direction`` (n, N) of the joints."""
    ahead, behind = (smr_positions(geometry, q + sign * _STEP_RAD * direction) for sign in (1.0, -1.0))
    return np.asarray((ahead - behind) / (2.0 * _STEP_RAD))


def _functions_of_posture(q: Array) -> Array:
    """One and two cycles of each joint, sums and differences of any two, and sums along the arm, (n, f)."""
    joints = range(q.shape[1])
    angles = [factor * q[:, joint] for joint in joints for factor in (1, 2)]
    angles += [q[:, i] + sign * q[:, k] for i, k in combinations(joints, 2) for sign in (1, -1)]
    angles += [q[:, first:last].sum(axis=1) for first in joints for last in range(first + 3, q.shape[1] + 1)]
    table = np.stack(angles, axis=1)
    return np.concatenate([np.ones((len(q), 1)), np.sin(table), np.cos(table)], axis=1)
