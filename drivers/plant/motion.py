"""Joint motions over time: all joints start and end together, straight in joint space, trapezoidal speed profile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from drivers.plant.config import Array

_ZERO_RAD = 1e-12
"""Travel [rad] and speeds [rad/s] below this count as zero."""


class AnyMotion(Protocol):
    """A motion in progress; times are those of the cell's clock [s]."""

    @property
    def start_s(self) -> float:
        """Start of the motion."""

    @property
    def end_s(self) -> float:
        """Time at which the arm comes to rest."""

    @property
    def q_to(self) -> Array:
        """Joint angles (N,) at the end of the motion [rad]."""

    @property
    def mean_speed(self) -> Array:
        """Mean absolute speed of each joint (N,) [rad/s]."""

    def scaled(self, time_s: float, scale: float) -> AnyMotion:
        """Return the same motion at ``scale`` times its full speed from ``time_s`` on."""

    def position(self, time_s: Array) -> Array:
        """Return the joint angles (n, N) at times (n,)."""

    def velocity(self, time_s: Array) -> Array:
        """Return the joint speeds (n, N) at times (n,)."""


@dataclass(frozen=True, eq=False)
class PlantMotion:
    """Motion from ``q_from`` (N,) at ``start_s`` to ``q_to`` (N,) at ``end_s``.

    The share of the travel is a parabola in each phase. Phase k begins at ``times[k]`` after the start with the share
    ``share[k]``, the rate ``rate[k]`` and the constant acceleration ``pull[k]``. A speed slider scales the motion's own
    time: from ``scaled_s`` after the start on, when its own time was ``own_s``, it passes ``scale`` times as fast as
    the clock.
    """

    start_s: float
    duration_s: float
    q_from: Array
    q_to: Array
    times: Array
    share: Array
    rate: Array
    pull: Array
    scale: float = 1.0
    scaled_s: float = 0.0
    own_s: float = 0.0

    @property
    def end_s(self) -> float:
        """End of the motion [s]; infinite while it is scaled to a standstill."""
        if self.scale == 0.0:
            return np.inf
        return self.start_s + self.scaled_s + (self.duration_s - self.own_s) / self.scale

    @property
    def mean_speed(self) -> Array:
        """Mean absolute speed of each joint (N,) at the current scale."""
        return np.abs(self.q_to - self.q_from) / self.duration_s * self.scale

    def scaled(self, time_s: float, scale: float) -> Self:
        """Return the same motion along the same path, ``scale`` times as fast as at full speed from ``time_s`` on."""
        own_s = float(np.clip(self._own(np.array([time_s]))[0], 0.0, self.duration_s))
        return replace(self, scale=scale, scaled_s=time_s - self.start_s, own_s=own_s)

    def _own(self, time_s: Array) -> Array:
        return self.own_s + (time_s - self.start_s - self.scaled_s) * self.scale

    def _phase(self, time_s: Array) -> tuple[Array, np.ndarray]:
        t = np.clip(self._own(time_s), 0.0, self.duration_s)
        phase = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 1)
        return t - self.times[phase], phase

    def position(self, time_s: Array) -> Array:
        """Return the joint angles (n, N) at times (n,); exactly the end points before the start and after the end."""
        t, phase = self._phase(time_s)
        share = self.share[phase] + t * (self.rate[phase] + 0.5 * t * self.pull[phase])
        q = self.q_from + share[:, None] * (self.q_to - self.q_from)
        return np.where((time_s >= self.end_s)[:, None], self.q_to, q)

    def velocity(self, time_s: Array) -> Array:
        """Return the joint speeds (n, N) at times (n,); zero before the start and from the end on."""
        t, phase = self._phase(time_s)
        rate = self.rate[phase] + t * self.pull[phase]
        inside = (time_s >= self.start_s) & (time_s < self.end_s)  # at its start a braking motion has its full speed
        return np.where(inside, rate * self.scale, 0.0)[:, None] * (self.q_to - self.q_from)


def _largest_rate(travel: Array, limit: Array) -> float:
    """Return the largest rate of the share of ``travel`` (N,) at which no joint exceeds its ``limit`` (N,)."""
    return 1.0 / float((np.abs(travel) / limit).max())


def travel(start_s: float, q_from: Array, q_to: Array, speed: Array, acceleration: Array) -> PlantMotion | None:
    """Return the fastest motion from rest to rest within ``speed`` and ``acceleration`` (N,); None if nothing moves."""
    way = q_to - q_from
    if np.abs(way).max() < _ZERO_RAD:
        return None
    rate, pull = _largest_rate(way, speed), _largest_rate(way, acceleration)
    rate = min(rate, np.sqrt(pull))  # triangular profile if the travel is too short for full speed
    ramp = rate / pull
    cruise = max(1.0 / rate - ramp, 0.0)
    ramp_share = 0.5 * rate * ramp
    return PlantMotion(
        start_s=start_s,
        duration_s=2.0 * ramp + cruise,
        q_from=q_from,
        q_to=q_to,
        times=np.array([0.0, ramp, ramp + cruise]),
        share=np.array([0.0, ramp_share, 1.0 - ramp_share]),
        rate=np.array([0.0, rate, rate]),
        pull=np.array([pull, 0.0, -pull]),
    )


def braked(motion: AnyMotion, time_s: float, acceleration: Array) -> PlantMotion | None:
    """Return the braking motion of ``motion`` from ``time_s`` on, within ``acceleration`` (N,); None if it rests."""
    now = np.array([time_s])
    q, velocity = motion.position(now)[0], motion.velocity(now)[0]
    if np.abs(velocity).max() < _ZERO_RAD:
        return None
    duration = 1.0 / _largest_rate(velocity, acceleration)
    return PlantMotion(
        start_s=time_s,
        duration_s=duration,
        q_from=q,
        q_to=q + 0.5 * duration * velocity,
        times=np.zeros(1),
        share=np.zeros(1),
        rate=np.array([2.0 / duration]),
        pull=np.array([-2.0 / duration**2]),
    )


# -- Recent history of an arm, as a tracker that sends packets measures points of the recent past ---------------------
#
# A phase is a time in which neither the motion nor the memories of the arm change. In a stream of positions it lasts
# one control cycle; the memories change when a joint reverses.


LONGEST = 512
"""Number of phases that are stored: a second of a stream of 500 Hz."""


@dataclass(frozen=True, eq=False)
class Phase:
    """Time until ``until_s`` [s] in which an arm made ``motion`` or rested (None); other fields as in ``TrueArm``."""

    until_s: float
    motion: AnyMotion | None
    q: Array
    memories: Sequence[Array | None]
    approach: Array
    last_step: Array
    rest_since_s: float

    def positions(self, time_s: Array) -> Array:
        """Return joint positions (n, N) at times (n,) [rad]."""
        return np.repeat(self.q[None], len(time_s), axis=0) if self.motion is None else self.motion.position(time_s)
