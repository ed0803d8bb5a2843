"""Responses of joints to the whole course of a motion: time constants and vibration, by filters along the path.

    time constant   x' = (q - x) / T;                             the joint is at x(T), not at q
    vibration       y'' + 2 d w y' + w^2 y = -w^2 q'',  w = 2 pi f   a joint on a damped spring, driven by q''

``y`` is the answer of a spring of unit gain: for slow motions it is ``-q''``, which is the deflection under the joint's
own acceleration (``inertia``). Vibration is what comes beside that after changes of acceleration: ``y + q''``, with
accelerations from the same differences as those of ``inertia`` and of torques. Where
masses are known, accelerations of other joints count by their inertia about the joint, and a spring is the slower the
more inertia the arm has in the posture in which a run begins. Filters are solved on an even grid of times between gaps,
by the bilinear transform; each begins as if the motion before had the first speed and acceleration for ever.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import Array

_STEP_S = 2e-3
"""Step of the grid: a hundredth of the period of 5 Hz, 12 steps of 40 Hz."""
_SHARE = 0.05
"""Relative steps for derivatives: frequency relative to the width of the resonance, damping to itself."""
_BILINEAR = {
    1: np.array([[1.0, -1.0], [1.0, 1.0]]),
    2: np.array([[1.0, -2.0, 1.0], [1.0, 0.0, -1.0], [1.0, 2.0, 1.0]]),
}
"""By degree n: (z - 1)^(n - i) (z + 1)^i of each term of a polynomial of s = 2 rate (z - 1) / (z + 1)."""
_MOST_KEPT = 60
"""Largest number of cached responses of one path."""


@dataclass(frozen=True, eq=False)
class EvenPath:
    """Joint positions and accelerations on even grids, one run after the other: times (G,) [s], (G, N) [rad], (G, N)
    [rad/s^2]. ``runs`` are the first rows of the runs, and G. ``inside_s`` (G,) [s] are the nearest times with known
    second differences. ``inertia`` (R, N, N) [kg m^2] are the mass matrices of the runs, None if masses are unknown."""

    time_s: Array
    inside_s: Array
    q: Array
    qdd: Array
    runs: NDArray[np.intp]
    inertia: Array | None = None
    _known: dict[tuple[object, ...], Array] = field(default_factory=dict, repr=False)

    def lagging(self, joint: int, T: float) -> tuple[Array, Array]:
        """Return ``x(T) - q`` (G,) [rad] of a joint, and its derivative with respect to T."""
        answers = (((-T, 0.0), (T, 1.0), -T), ((0.0, -1.0, 0.0), (T * T, 2.0 * T, 1.0), -1.0))

        def answer(above: tuple[float, ...], below: tuple[float, ...], ramp: float) -> Array:
            parts = pairwise(self.runs.tolist())
            return np.concatenate([_filtered(self.q[a:b, joint], above, below, ramp=ramp) for a, b in parts])

        late, by_T = (self.kept((n, joint, T), partial(answer, *one)) for n, one in enumerate(answers))
        return late, by_T

    def vibrating(self, joint: int, frequency: float, damping: float) -> Array:
        """Return ``y + q''`` (G,) [rad/s^2] of a joint for unit gain; ``frequency`` [Hz], gain at median inertia."""
        found = np.empty(len(self.time_s))
        for run, (first, last) in enumerate(pairwise(self.runs.tolist())):
            shares, more = self._driven(run, joint)
            w = 2.0 * math.pi * frequency / math.sqrt(more)
            # filter y alone, so that slow motions leave nothing beside q''
            answer = _filtered(
                self.q[first:last] @ shares,
                (-w * w, 0.0, 0.0),
                (1.0, 2.0 * damping * w, w * w),
                bend=float(self.qdd[first] @ shares) if last > first else 0.0,
                warped=w,
            )
            found[first:last] = more * (answer + self.qdd[first:last] @ shares)
        return found

    def _driven(self, run: int, joint: int) -> tuple[Array, float]:
        """Return the factors (N,) of all joints' accelerations on one spring, and its inertia over the median."""
        if self.inertia is None:
            return np.eye(self.q.shape[1])[joint], 1.0
        own = self.inertia[:, joint, joint]
        return self.inertia[run, joint] / own[run], float(own[run] / np.median(own))

    def of_shape(self, joint: int, frequency: float, damping: float, part: int) -> Array:
        """Return ``vibrating`` (``part`` 0), or its derivative with respect to frequency (1) or damping (2)."""

        def answer() -> Array:
            if not part:
                return self.vibrating(joint, frequency, damping)
            step = _SHARE * damping * (frequency if part == 1 else 1.0)
            more, less = (
                self.vibrating(joint, frequency + (part == 1) * sign * step, damping + (part == 2) * sign * step)
                for sign in (1.0, -1.0)
            )
            return np.asarray((more - less) / (2.0 * step))

        return self.kept(("vibration", joint, frequency, damping, part), answer)

    def at(self, values: Array, time_s: Array) -> Array:
        """Interpolate values (G,) at times (n,) [s]."""
        return np.asarray(np.interp(time_s, self.time_s, values))

    def kept(self, key: tuple[object, ...], answer: Callable[[], Array]) -> Array:
        """Return the response for a key, computed once and cached: fits request the same again and again."""
        found = self._known.pop(key, None)
        if found is None:
            found = answer()
        if len(self._known) >= _MOST_KEPT:
            del self._known[next(iter(self._known))]  # least recently used
        self._known[key] = found
        return found


def _filtered(
    q: Array,
    above: tuple[float, ...],
    below: tuple[float, ...],
    *,
    ramp: float = 0.0,
    bend: float = 0.0,
    warped: float = 0.0,
) -> Array:
    """Apply a transfer function to even positions ``q`` (G,) that had the first speed and the acceleration ``bend`` for
    ever. ``ramp`` is its response to unit speed. ``warped`` is the frequency [rad/s] at which a quadratic one is exact;
    its response to acceleration is -1."""
    from scipy.signal import lfilter  # it loads scipy.stats: not for commands without recordings

    rate = 0.5 * warped / math.tan(0.5 * warped * _STEP_S) if warped else 1.0 / _STEP_S
    by_z = _BILINEAR[len(below) - 1] * (2.0 * rate) ** np.arange(len(below) - 1.0, -1.0, -1.0)[:, None]
    b, a = np.array(above) @ by_z, np.array(below) @ by_z
    if warped:  # unit response to slow accelerations
        b = b / (rate * _STEP_S) ** 2
    t = _STEP_S * np.arange(len(q))
    speed = (q[1] - q[0]) / _STEP_S - 0.5 * bend * _STEP_S if len(q) > 1 else 0.0
    return np.asarray(lfilter(b, a, q - q[0] - t * (speed + 0.5 * bend * t)) + ramp * speed - bend)


def even_grid(runs: list[tuple[float, float]], margin_s: float) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return times (G,) of even grids between the first and the last time [s] of each run; the nearest times at least
    the margin inside; and the first rows of the runs."""
    runs = [(first, last) for first, last in runs if last - first > 2.0 * margin_s]
    parts = [np.arange(first, last, _STEP_S) for first, last in runs]
    inside = [np.clip(part, first + margin_s, last - margin_s) for part, (first, last) in zip(parts, runs, strict=True)]
    return np.concatenate(parts), np.concatenate(inside), np.cumsum([0, *map(len, parts)]).astype(np.intp)
