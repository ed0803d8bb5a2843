"""How joints answer to the whole course of a motion: time constants and vibration, by filters along the path.

    time constant   x' = (q - x) / T;                             the joint is at x(T), not at q
    vibration       y'' + 2 d w y' + w^2 y = -w^2 q'',  w = 2 pi f   a joint on a damped spring, driven by q''

``y`` is the answer of a spring of unit gain: for slow motions it is ``-q''``, which is the deflection under the joint's
own acceleration (``inertia``). Vibration is what comes beside that after changes of acceleration: ``y + q''``. Filters
are solved on an even grid of times between gaps, by the bilinear transform; each begins as if the motion before had the
first speed and acceleration for ever.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import Array

_STEP_S = 2e-3
"""Step of the grid: a hundredth of the period of 5 Hz, 12 steps of 40 Hz."""
_SHARE = 0.02
"""Relative step of frequency and damping for derivatives."""


@dataclass(frozen=True, eq=False)
class EvenPath:
    """Joint positions and accelerations on even grids, each run after the other: times (G,) [s], (G, N) [rad],
    (G, N) [rad/s^2]; ``runs`` are the first row of each, and G."""

    time_s: Array
    q: Array
    qdd: Array
    runs: NDArray[np.intp]
    _known: dict[tuple[object, ...], Array] = field(default_factory=dict, repr=False)

    def lagging(self, joint: int, T: float) -> tuple[Array, Array]:
        """``x(T) - q`` (G,) [rad] of a joint, and its derivative by T."""
        return (
            self._filtered("lag", joint, (-T, 0.0), (T, 1.0), ramp=-T),
            self._filtered("by T", joint, (0.0, -1.0, 0.0), (T * T, 2.0 * T, 1.0), ramp=-1.0),
        )

    def vibrating(self, joint: int, frequency: float, damping: float) -> Array:
        """``y + q''`` (G,) [rad/s^2] of a joint for unit gain."""
        w = 2.0 * math.pi * frequency
        # -w^2 s^2 / (s^2 + 2 d w s + w^2) + s^2 = s^2 (s^2 + 2 d w s) / (...): nothing for slow motions
        answer = self._filtered("y", joint, (-w * w, 0.0, 0.0), (1.0, 2.0 * damping * w, w * w), ramp=0.0, warped=w)
        return np.asarray(answer + self.qdd[:, joint])

    def by_shape(self, joint: int, frequency: float, damping: float, part: int) -> Array:
        """Derivative of ``vibrating`` by frequency (``part`` 1) or damping (2)."""
        step = _SHARE * (frequency if part == 1 else damping)
        more, less = (
            self.vibrating(joint, frequency + (sign * step if part == 1 else 0.0), damping + (part == 2) * sign * step)
            for sign in (1.0, -1.0)
        )
        return np.asarray((more - less) / (2.0 * step))

    def at(self, values: Array, time_s: Array) -> Array:
        """Values (G,) at times (n,) [s]."""
        return np.asarray(np.interp(time_s, self.time_s, values))

    def _filtered(
        self,
        name: str,
        joint: int,
        above: tuple[float, ...],
        below: tuple[float, ...],
        *,
        ramp: float,
        warped: float = 0.0,
    ) -> Array:
        """A transfer function on a joint's position; ``ramp`` is its answer to unit speed, beside which the first
        acceleration of a run counts as lasting for functions whose numerator is quadratic."""
        key = (name, joint, above, below)
        if key not in self._known:
            from scipy.signal import bilinear, lfilter  # it loads scipy.stats: not for commands without recordings

            rate = 1.0 / _STEP_S if not warped else 0.5 * warped / math.tan(0.5 * warped * _STEP_S)
            b, a = bilinear(above, below, rate)
            if warped:  # right at the natural frequency; slow accelerations as they are
                b = b / (rate * _STEP_S) ** 2
            found = np.empty(len(self.time_s))
            for first, last in pairwise(self.runs.tolist()):
                t, q = self.time_s[first:last] - self.time_s[first], self.q[first:last, joint]
                speed = (q[1] - q[0]) / _STEP_S if last - first > 1 else 0.0
                bend = self.qdd[first, joint] if warped else 0.0
                speed -= 0.5 * bend * _STEP_S
                rest = q - q[0] - t * (speed + 0.5 * bend * t)
                found[first:last] = lfilter(b, a, rest) + ramp * speed - bend
            if len(self._known) > _MOST_KEPT:
                self._known.clear()
            self._known[key] = found
        return self._known[key]


_MOST_KEPT = 200
"""Answers that are kept of one path."""


def even_grid(runs: list[tuple[float, float]]) -> tuple[Array, NDArray[np.intp]]:
    """Times (G,) of even grids between the first and the last time [s] of each run, and where the runs begin."""
    parts = [np.arange(first, last, _STEP_S) for first, last in runs if last > first]
    return np.concatenate(parts), np.cumsum([0, *map(len, parts)]).astype(np.intp)
