"""Motions of a UR arm as its RTDE client shows them: state samples, rest criterion, rates of the leading joint.

Loads no numpy: the worker process starts faster without it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from drivers.arms.ur_rtde_reader import PROGRAM_STATES, ROBOT_MODES, SAFETY_MODES, mode_name

MAX_SPEED = 3.14
"""Of a joint [rad/s]; the RTDE client accepts no more."""
MAX_ACCELERATION = 40.0
"""Of a joint [rad/s^2]; the RTDE client accepts no more."""


@dataclass(frozen=True)
class WorkerSample:
    """One state of the arm; the fields are named as in the worker's answers."""

    time_s: float
    q: tuple[float, ...]
    qd: tuple[float, ...]
    temperatures: tuple[float, ...]
    robot_mode: str
    safety_mode: str
    program: str
    payload_kg: float | None

    @property
    def valid(self) -> bool:
        """Whether it has six joints with finite numbers."""
        return len(self.q) == 6 and len(self.qd) == 6 and all(map(math.isfinite, (*self.q, *self.qd)))

    @property
    def speed(self) -> float:
        """Speed of the fastest joint [rad/s]."""
        return max(map(abs, self.qd))

    def distance(self, q: Sequence[float]) -> float:
        """Return the largest difference of a joint from ``q`` [rad]."""
        return max(abs(a - b) for a, b in zip(self.q, q))

    def as_dict(self) -> dict[str, Any]:
        """Return the fields of an answer."""
        return asdict(self)


def read_worker_sample(receive: Any, *, payload: bool) -> WorkerSample:
    """Read the newest state from an ``RTDEReceiveInterface``, all values from one packet."""
    while True:
        stamp = receive.getTimestamp()
        payload_kg = receive.getPayload() if payload else None
        q, qd, temperatures = receive.getActualQ(), receive.getActualQd(), receive.getJointTemperatures()
        modes = receive.getRobotMode(), receive.getSafetyMode(), receive.getRuntimeState()
        if receive.getTimestamp() == stamp:
            break
    return WorkerSample(
        time_s=stamp,
        q=tuple(q),
        qd=tuple(qd),
        temperatures=tuple(temperatures),
        robot_mode=mode_name(ROBOT_MODES, modes[0]),
        safety_mode=mode_name(SAFETY_MODES, modes[1]),
        program=mode_name(PROGRAM_STATES, modes[2]),
        payload_kg=payload_kg,
    )


@dataclass
class Motion:
    """A motion: the client's operation number before it, and what has been observed since."""

    goal: Sequence[float]
    number_before: int
    began_s: float
    running: bool = True
    ended_s: float = math.inf
    standing_since_s: float | None = None


@dataclass(frozen=True)
class RestCriterion:
    """The arm rests if for ``dwell_s`` no joint exceeds ``speed`` [rad/s] or leaves a window ``position`` [rad]."""

    dwell_s: float
    speed: float
    position: float


def leading_rates(
    start: Sequence[float], goal: Sequence[float], speed: Sequence[float], acceleration: Sequence[float]
) -> tuple[float, float]:
    """Return speed and acceleration of the joint with the longest travel, such that no joint exceeds its own limits.

    A UR controller moves all joints in the same time; the others are slower in proportion to their travel.
    """
    travel = [abs(b - a) for a, b in zip(start, goal, strict=True)]
    longest = max(travel)
    if longest == 0.0:
        return min(*speed, MAX_SPEED), min(*acceleration, MAX_ACCELERATION)
    lead_speed = min(limit * longest / way for limit, way in zip(speed, travel, strict=True) if way > 0.0)
    lead_acceleration = min(limit * longest / way for limit, way in zip(acceleration, travel, strict=True) if way > 0.0)
    return min(lead_speed, MAX_SPEED), min(lead_acceleration, MAX_ACCELERATION)
