"""Laws of recordings with non-linear parameters: time constants and vibration of joints.

Their terms are linearised at a shape (``terms``); a fit gives new values, which define the next shape. A vibration is
searched in the residuals: how much they contain of the response of a spring of each frequency, on each joint. Columns
and residuals pass the filter that whitens the residuals; a spring of one frequency passes it as a tone of that
frequency.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.motion.fit import Problem, Solution
from cellapp.estimation.motion.observe import residuals
from cellapp.estimation.motion.terms import JointTerm, Law
from cellapp.robot.effects import MotionLaw
from cellapp.robot.kinematics.chain import Geometry, JointAngles, joint_jacobian
from cellapp.robot.kinematics.transforms import Array

FREQUENCIES = np.geomspace(3.0, 40.0, 47)
"""Natural frequencies to try [Hz]: some 6 % apart, the width of a resonance at usual damping."""
_DAMPING = 0.06
"""Start value of the damping: arms swing on for some cycles."""
_CHUNK = 4096
_SAME = 1e-3
"""Relative change of a shape below which it has settled."""
_REACH: Mapping[Law | MotionLaw, tuple[tuple[float, float], ...]] = {
    Law.TIME_CONSTANT: ((1e-3, 0.3),),
    Law.VIBRATION: ((1e-7, 1.0), (1.0, 60.0), (3e-3, 0.7)),
}
"""Bounds of the shapes: time constant [s]; gain [s^2], frequency [Hz], damping."""


def vibration(joint: int, shape: tuple[float, ...]) -> tuple[JointTerm, ...]:
    """Return the terms of a vibration of a joint (from 0): gain [s^2], frequency [Hz], damping ratio."""
    return tuple(JointTerm(Law.VIBRATION, joint, shape=shape, part=part) for part in range(3))


def reshaped(terms: Sequence[JointTerm], values: Sequence[float]) -> tuple[JointTerm, ...]:
    """Return the terms linearised at their ``values``; those without a shape unchanged."""
    found, rest = list(terms), dict(zip(terms, values, strict=True))
    for place, term in enumerate(terms):
        if not term.shape:
            continue
        near = [rest[replace(term, part=part)] for part in range(len(term.shape))]
        shape = tuple(float(np.clip(v, *reach)) for v, reach in zip(near, _REACH[term.law], strict=True))
        # at most a factor of two at once: far from its shape the linearisation fails
        shape = tuple(float(np.clip(new, 0.5 * old, 2.0 * old)) for new, old in zip(shape, term.shape))
        found[place] = replace(term, shape=shape)
    return tuple(found)


def settled(terms: Sequence[JointTerm], before: Sequence[JointTerm]) -> bool:
    """Return whether all shapes have settled."""
    pairs = [(new, old) for a, b in zip(terms, before, strict=True) for new, old in zip(a.shape, b.shape)]
    return all(abs(new - old) <= _SAME * abs(old) for new, old in pairs)


def strongest_vibration(
    problem: Problem, solution: Solution, taken: Sequence[int]
) -> tuple[float, tuple[JointTerm, ...]]:
    """Find the vibration that is least likely to be chance, of a joint that is not ``taken``; return half of its
    chi-square, and its terms."""
    free = sorted(set(range(problem.layout.parameters.joints)) - set(taken))
    product, square = _matched(problem, solution, free)
    product, square = np.maximum(product, 0.0), np.maximum(square, 1e-300)  # springs yield to a load, never against it
    power = 0.5 * product**2 / square
    joint, place = np.unravel_index(int(np.argmax(power)), power.shape)
    gain = float(product[joint, place] / square[joint, place])
    return float(power[joint, place]), vibration(int(joint), (gain, float(FREQUENCIES[place]), _DAMPING))


def _matched(problem: Problem, solution: Solution, free: Sequence[int]) -> tuple[Array, Array]:
    """Return the products of residuals and unit responses by joint and frequency (N, F), and of the responses with
    themselves, in units of the noise; zero for joints that are not ``free``."""
    from scipy.signal import freqz, lfilter  # it loads scipy.stats: not for commands without recordings

    joints, model = problem.layout.parameters.joints, problem.model(solution.values)
    product, square = np.zeros((2, joints, len(FREQUENCIES)))
    for number, (track, source) in enumerate(zip(problem.tracks, solution.sources)):
        filtered = np.ones(1) if problem.whitening is None else problem.whitening[number]
        left = lfilter(filtered, [1.0], residuals(model, track, number, source.rows), axis=0)
        scale = 1.0 / max(float(np.mean(left**2)), 1e-300)
        left = lfilter(filtered, [1.0], left[::-1], axis=0)[::-1]  # backwards: as if columns passed it
        _, gain = freqz(filtered, 1.0, 2.0 * math.pi * FREQUENCIES * track.stamps.period_s)
        u = track.controller_times(source.rows, *model.clock(number))
        turned, weight = _turned(model.geometry, track.path.at(u)[0], left)
        even = track.path.even
        for joint in free:
            for place, frequency in enumerate(FREQUENCIES.tolist()):
                answer = even.at(even.vibrating(joint, frequency, _DAMPING), u)
                product[joint, place] += scale * float(turned[:, joint] @ answer)
                square[joint, place] += scale * abs(gain[place]) ** 2 * float(weight[:, joint] @ answer**2)
    return product, square


def _turned(geometry: Geometry, q: Array, left: Array) -> tuple[Array, Array]:
    """Return the residuals (n, 3) projected on the motion by each joint, and the square of that motion, (n, N) each."""
    parts: list[tuple[Array, Array]] = []
    for first in range(0, len(q), _CHUNK):
        _, J = joint_jacobian(geometry, JointAngles.of(q[first : first + _CHUNK]))
        own = left[first : first + _CHUNK]
        parts.append((np.einsum("ajn,na->nj", J, own), np.einsum("ajn,ajn->nj", J, J)))
    turned, weight = (np.concatenate(each) for each in zip(*parts, strict=True))
    return turned, weight


def lagging_joints(terms: Sequence[JointTerm], values: Array, errors: Array, shown: float) -> tuple[JointTerm, ...]:
    """Return time constants of the joints that accelerations turn against the sense of a spring.

    A lag of time constant T adds ``T^2 qdd / 2`` to a delay.

    ``terms`` are the terms of ``Law.INERTIA`` with their values [s^2] and standard errors (N,).
    """
    which: NDArray[np.intp] = np.flatnonzero(values < -shown * errors)
    return tuple(
        JointTerm(Law.TIME_CONSTANT, terms[place].joint, shape=(math.sqrt(-2.0 * float(values[place])),))
        for place in which
    )
