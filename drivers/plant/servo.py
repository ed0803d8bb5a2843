"""An arm that follows a stream of joint positions (``servoj``): each joint lags behind like a damped spring.

Manufacturers do not publish the filter behind ``servoj``. The assumption here: every joint follows the latest position
as a critically damped second-order system, ``q'' = w^2 (goal - q) - 2 w q'``. Its delay at constant speed, ``2 / w``,
is the look-ahead time at gain 300 and falls with the root of the gain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from drivers.plant.config import Array
from drivers.plant.true_arm import TrueArm

LOOKAHEAD_S = 0.03
GAIN = 300.0
"""Defaults of a stream: the shortest look-ahead time that UR controllers accept, and their usual gain."""
_AT_GOAL_RAD = 1e-7
_LONGEST_S = 1e3
"""Longest motion, in time constants: after this a joint rests wherever it began."""


def servo_rate(lookahead_s: float, gain: float) -> float:
    """Return the rate ``w`` [1/s] of the lag. Raises ``ValueError`` for values that no UR controller accepts."""
    if not (0.03 <= lookahead_s <= 0.2 and 100.0 <= gain <= 2000.0):
        raise ValueError(f"servoj: look-ahead {lookahead_s!r} s (0.03 to 0.2) or gain {gain!r} (100 to 2000)")
    return float(2.0 / (lookahead_s * np.sqrt(300.0 / gain)))


@dataclass(frozen=True, eq=False)
class ServoMotion:
    """Motion of an arm to a goal that was set at ``start_s`` [s], when its joints may have been moving.

    Attributes
    ----------
    q_from, speed_from : arrays, shape (N,)
        Joint positions [rad] and speeds [rad/s] at ``start_s``.
    q_to : array, shape (N,)
        The goal [rad].
    rate : float
        ``w`` of the lag [1/s].
    end_s : float
        When the arm has come to rest at its goal [s].
    """

    start_s: float
    q_from: Array
    speed_from: Array
    q_to: Array
    rate: float
    end_s: float

    @classmethod
    def towards(cls, goal: Array, start_s: float, q: Array, speed: Array, rate: float) -> Self:
        """Create the motion to ``goal`` (N,) [rad] from joints at ``q`` (N,) with ``speed`` (N,)."""
        size = float(np.max(np.abs(q - goal) + np.abs(speed) / rate, initial=_AT_GOAL_RAD))
        # (1 + x) exp(-x) bounds the remaining travel after x time constants
        x = np.log(size / _AT_GOAL_RAD) + 1.0
        x += np.log1p(x)
        return cls(start_s, q, speed, goal, rate, start_s + float(min(x, _LONGEST_S)) / rate)

    @property
    def mean_speed(self) -> Array:
        """Mean absolute speed of each joint (N,) during the motion [rad/s]."""
        return np.asarray(np.abs(self.q_to - self.q_from) / max(self.end_s - self.start_s, 1e-9))

    def scaled(self, time_s: float, scale: float) -> Self:
        """Return the same motion: the speed slider does not act on a stream of positions."""
        return self

    def position(self, time_s: Array) -> Array:
        """Return the joint angles (n, N) at times (n,)."""
        t = np.maximum(time_s - self.start_s, 0.0)[:, None]
        away, pull = self._state()
        q = self.q_to + (away + pull * t) * np.exp(-self.rate * t)
        return np.where((time_s >= self.end_s)[:, None], self.q_to, q)

    def velocity(self, time_s: Array) -> Array:
        """Return the joint speeds (n, N) at times (n,); zero from the end on."""
        t = np.maximum(time_s - self.start_s, 0.0)[:, None]
        away, pull = self._state()
        speed = (pull - self.rate * (away + pull * t)) * np.exp(-self.rate * t)
        return np.where((time_s >= self.end_s)[:, None], 0.0, speed)

    def _state(self) -> tuple[Array, Array]:
        away = self.q_from - self.q_to
        return away, self.speed_from + self.rate * away


def follow(arm: TrueArm, goal: Array, time_s: float, rate: float, repeatability: float) -> None:
    """Make an arm that is at rest, or already in a stream, follow ``goal`` (N,) [rad] from ``time_s`` [s] on.

    ``repeatability`` [rad] is the standard deviation of the position error sampled for a
    new stream. Raises ``ValueError`` during a motion of another kind.
    """
    if arm.motion is not None and arm.streamed is None:
        raise ValueError(f"arm {arm.config.name} is still moving")
    ended, q, speed = arm.motion, arm.q, np.zeros(arm.config.joints)
    arm.note_phase(time_s)
    if ended is None:
        arm.resting = None
        arm.stop_error = repeatability * arm.repeatability.standard_normal(arm.config.joints)
    else:
        now = np.array([time_s])
        q, speed = ended.position(now)[0], ended.velocity(now)[0]
        assert arm.streamed is not None
        arm.note_reversal(arm.streamed, q)
    arm.streamed = q
    arm.motion = ServoMotion.towards(np.array(goal, dtype=np.float64), time_s, q, speed, rate)
