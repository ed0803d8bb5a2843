"""Periodic motions of the joints: few harmonics of a base frequency, from rest to rest (Swevers et al., 1997).

    q(t) = c + sum_k a_k (sin(k w t) / k - sin((k + 1) w t) / (k + 1)) + b_k (1 - cos(k w t)),  k = 1 .. K

Every term and its first derivative vanish at t = 0 and after each period: the arm begins and ends at rest at ``c``, and
speed, acceleration and jerk follow in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, eq=False)
class Sweep:
    """A periodic motion of N joints.

    Attributes
    ----------
    center : array, shape (N,)
        Positions at its start and end [rad].
    sine, cosine : array, shape (K, N)
        Coefficients a and b [rad].
    period_s : float
    """

    center: Array
    sine: Array
    cosine: Array
    period_s: float

    def at(self, time_s: Array, derivative: int = 0) -> Array:
        """Positions (n, N) at times (n,) [s], or their 1st, 2nd or 3rd derivative."""
        w = 2.0 * np.pi / self.period_s * np.arange(1, len(self.sine) + 2)
        # the n-th derivative of a sine is w^n times a sine whose phase is n quarter turns further
        phase = np.outer(time_s, w) + 0.5 * np.pi * derivative
        sines, cosines = np.sin(phase) * w**derivative, np.cos(phase) * w**derivative
        sines = sines / np.arange(1, len(w) + 1)
        moved = (sines[:, :-1] - sines[:, 1:]) @ self.sine - cosines[:, :-1] @ self.cosine
        return np.asarray(moved if derivative else self.center + self.cosine.sum(axis=0) + moved)

    def times(self, step_s: float) -> Array:
        """Times of one period at most ``step_s`` apart, both ends included [s]."""
        return np.linspace(0.0, self.period_s, int(np.ceil(self.period_s / step_s)) + 1)

    def scaled(self, factor: float) -> Sweep:
        """Return the motion with its amplitude scaled by ``factor``."""
        return replace(self, sine=self.sine * factor, cosine=self.cosine * factor)

    def slowed(self, speed: Array, acceleration: Array, jerk: Array) -> Sweep:
        """Return the motion slowed so that no joint exceeds these limits (N,) [rad/s, rad/s^2, rad/s^3]."""
        time_s, slower = self.times(self.period_s / 400.0), 1.0
        for order, limit in enumerate((speed, acceleration, jerk), start=1):
            excess = float((np.abs(self.at(time_s, order)).max(axis=0) / limit).max())
            slower = max(slower, excess ** (1.0 / order))
        return replace(self, period_s=self.period_s * slower)
