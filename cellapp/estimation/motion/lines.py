"""Lines of the spectrum of joints: the power of every cycle count of every joint in the residuals of recordings."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.motion.fit import Problem, Solution
from cellapp.estimation.motion.observe import residuals
from cellapp.robot.kinematics.chain import JointAngles, joint_jacobian
from cellapp.robot.kinematics.transforms import Array

_MOST_CYCLES = 210
"""Largest cycle count: twice the ratio of a 1:100 strain-wave gear, and a margin."""
_COUNTS = np.arange(_MOST_CYCLES + 1)
_RESPONSE = 1024
"""Number of frequencies at which the response of a filter is tabulated."""
_CHUNK = 4096
_NEIGHBOURS = 31
"""Number of cycle counts whose median power is the noise level."""
_LOG_2 = math.log(2.0)
"""Ratio of median to mean power of noise: powers of cosine and sine together are exponential."""


def line_powers(problem: Problem, solution: Solution, joints: Sequence[int]) -> tuple[Array, Array]:
    """Return the power (joints, counts + 1) of each cycle count of some joints in the residuals, in units of the noise
    there: by chance it exceeds ``ln(1 / p)`` with probability p. Return also the turns (joints,) in the range of each.

    A line of c cycles has the slowly varying frequency ``c qd / 2 pi``: whitening multiplies it by the filter's
    response there.
    """
    from scipy.signal import lfilter  # it loads scipy.stats: commands without recordings need not wait for that

    model, own, shape = problem.model(solution.values), list(joints), (len(joints), _MOST_CYCLES + 1)
    sums, energy = np.zeros(shape, dtype=np.complex128), np.zeros(shape)
    low, high = np.full(len(own), np.inf), np.full(len(own), -np.inf)
    for number, (track, source) in enumerate(zip(problem.tracks, solution.sources)):
        whitening = np.ones(1) if problem.whitening is None else problem.whitening[number]
        left = lfilter(whitening, [1.0], residuals(model, track, number, source.rows), axis=0)
        response = np.conj(np.fft.fft(whitening, _RESPONSE))
        scale, step = 1.0 / float(np.mean(left**2)), track.stamps.period_s * _RESPONSE / (2.0 * math.pi)
        for first in range(0, len(left), _CHUNK):
            part = slice(first, first + _CHUNK)
            u = track.controller_times(source.rows[part], *model.clock(number))
            q, qd = track.path.at(u)
            _, J = joint_jacobian(model.geometry, JointAngles.of(q))
            q, qd, J = q[:, own], qd[:, own], J[:, own]
            turned, weight = np.einsum("ajn,na->nj", J, left[part]) * scale, np.einsum("ajn,ajn->nj", J, J) * scale
            low, high = np.minimum(low, q.min(axis=0)), np.maximum(high, q.max(axis=0))
            for joint in range(len(own)):
                place = np.rint(np.outer(_COUNTS, qd[:, joint] * step)).astype(np.intp) % _RESPONSE
                gain = response[place]
                sums[joint] += np.einsum("cn,cn,n->c", np.conj(_powers(q[:, joint])), gain, turned[:, joint])
                energy[joint] += (gain.real**2 + gain.imag**2) @ weight[:, joint]
    raw = np.abs(sums) ** 2 / np.maximum(energy, 1e-300)
    floor = scipy.ndimage.median_filter(raw, (1, _NEIGHBOURS), mode="nearest") / _LOG_2
    return raw / np.maximum(floor, 1e-300), (high - low) / (2.0 * math.pi)


def _powers(angle: Array) -> NDArray[np.complex128]:
    """Return ``exp(i c angle)`` for counts c from 0 to the largest, (counts + 1, n), by doubling."""
    powers = np.empty((_MOST_CYCLES + 1, len(angle)), dtype=np.complex128)
    powers[0], powers[1] = 1.0, np.cos(angle) + 1j * np.sin(angle)
    have = 1
    while have < _MOST_CYCLES:
        more = min(have, _MOST_CYCLES - have)
        np.multiply(powers[1 : more + 1], powers[have], out=powers[have + 1 : have + more + 1])
        have += more
    return powers
