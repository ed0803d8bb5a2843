"""The clock of a recording again, free of what the geometry lacks: for samples that are searched for missing effects.

What an arm's model lacks is a function of its posture (elastic joints, gears that do not turn evenly); an error of the
clock moves the points along their velocity, forth on the way there and back on the way back. Functions of posture are
therefore taken out of the residuals and of the columns of the clock before these are compared.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from cellapp.estimation.motion.records import RecordingFit
from cellapp.robot.kinematics.chain import Geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array

_POINTS = 6000
_STEP_RAD = 1e-6
_INDEPENDENT = 300.0
"""Of these points about so many are independent: neighbours are alike."""
_PLAY_SD = 3e-5
"""Of what is left of lost motion [rad]."""
_MORE_THAN_STATED = 3.0
"""Standard errors of the fit hold for its own model; the clock may be off by this multiple of them."""
_GROSS = 5.0
"""Multiple of the median residual beyond which a point is not used."""


def aligned(one: RecordingFit, geometry: Geometry, half_play: Array) -> RecordingFit:
    """The recording with offsets and rate of its clock by all its points, whatever the ``geometry`` lacks.

    ``half_play`` (N,) [rad] is the lost motion that the fit found; what is left of it is estimated beside the clock.
    """
    rows = np.flatnonzero(one.track.learnt | one.track.held_out)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _POINTS)).astype(np.intp)]
    offset, rate = _correction(one, geometry, half_play, rows)
    return replace(one, offsets_s=one.offsets_s + offset, rate=one.rate + rate)


def _correction(one: RecordingFit, geometry: Geometry, half_play: Array, rows: Array) -> tuple[float, float]:
    """By how much offset [s] and rate are too small, as far as the points say more than the fit does."""
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
    clock = one.clock
    errors = clock.offset_standard_error_s, 1e-6 * clock.rate_standard_error_ppm
    spread = np.append(np.multiply(_MORE_THAN_STATED, errors), np.full(q.shape[1], _PLAY_SD))
    variance = float(np.mean(table[:, -1] ** 2)) * len(table) / _INDEPENDENT + 1e-300
    scaled = table[:, :-1] * spread
    found = np.linalg.solve(scaled.T @ scaled + variance * np.eye(len(spread)), scaled.T @ table[:, -1]) * spread
    return float(found[0]), float(found[1])


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
