"""Motions of a UR arm as its RTDE client shows them: state samples, rest criterion, speed of the leading joint.

Loads no numpy: the worker process starts faster without it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.arms.ur_rtde_reader import ProgramState, RobotMode, SafetyMode, UrSample, mode_name

MAX_SPEED = 3.14
"""Largest joint speed that the RTDE client accepts [rad/s]."""
MAX_ACCELERATION = 40.0
"""Largest joint acceleration that the RTDE client accepts [rad/s^2]."""
DECELERATES_WITHIN_S = 0.02
"""Time in a stop for the control program to decelerate the motion, before the program is ended. On emulated controllers
the command reaches the program after 1 to 11 ms. Ending the program takes 0.4 ms but brakes less hard."""
STILL_MOVING = "it is still moving; wait until it rests, or stop it"
VARIABLES = (
    *("timestamp", "actual_q", "actual_qd", "joint_temperatures"),
    *("robot_mode", "safety_mode", "runtime_state"),
)
OPTIONAL_VARIABLES = ("target_speed_fraction", "payload", "payload_cog")
"""Older software versions lack some of these."""


def read_worker_sample(receive: Any, optional: Collection[str]) -> UrSample:
    """Read the newest state from an ``RTDEReceiveInterface``, all values from one packet.

    ``optional`` are those of ``OPTIONAL_VARIABLES`` that the controller sends.
    """
    while True:
        stamp = receive.getTimestamp()
        payload_kg = receive.getPayload() if "payload" in optional else None
        center = tuple(receive.getPayloadCog()) if "payload_cog" in optional else None
        fraction = receive.getTargetSpeedFraction() if "target_speed_fraction" in optional else None
        q, qd, temperatures = receive.getActualQ(), receive.getActualQd(), receive.getJointTemperatures()
        modes = receive.getRobotMode(), receive.getSafetyMode(), receive.getRuntimeState()
        if receive.getTimestamp() == stamp:
            break
    return UrSample(
        time_s=stamp,
        q=tuple(q),
        qd=tuple(qd),
        joints_c=tuple(temperatures),
        robot_mode=mode_name(RobotMode, modes[0]),
        safety_mode=mode_name(SafetyMode, modes[1]),
        program=mode_name(ProgramState, modes[2]),
        payload_kg=payload_kg,
        payload_center_m=center,
        speed_fraction=fraction,
    )


STREAMS_APART_S = 0.05
"""Largest age difference of the two streams: the end of a motion comes over another connection than the positions."""
REST_DWELL_S = 0.05


class Unrest:
    """Whether the arm may move: from the request of a motion until states after its end have shown rest for a while."""

    def __init__(self) -> None:
        self._moved = False
        self._from_s = 0.0
        self._still_since_s: float | None = None

    @property
    def may_move(self) -> bool:
        """Whether the arm has not been seen at rest since the last motion."""
        return self._moved

    def begin(self) -> None:
        """Note that a motion is about to be requested."""
        self._moved, self._still_since_s = True, None

    def end(self, now: float) -> None:
        """Note that the motion has ended, was stopped or failed; the arm may still be braking."""
        self._from_s, self._still_since_s = now + STREAMS_APART_S, None

    def look(self, sample: UrSample, now: float, rest_speed: float, *, running: bool) -> None:
        """Evaluate a new state; ``running``: a motion is in progress."""
        if running or now < self._from_s or sample.speed > rest_speed:
            self._still_since_s = None
        elif self._still_since_s is None:
            self._still_since_s = sample.time_s
        elif sample.time_s - self._still_since_s >= REST_DWELL_S:
            self._moved = False

    def settled(self) -> None:
        """Note that the arm was seen at rest at its goal."""
        self._moved = False


@dataclass
class Motion:
    """A motion: the client's operation number before it, and the observations since."""

    goal: Sequence[float]
    number_before: int
    began_s: float
    running: bool = True
    ended_s: float = math.inf
    standing_since_s: float | None = None


_STREAM_PERIODS_S = 0.016
"""Two state periods of a CB3 controller: it may see a silence that is longer than measured here by this much."""
_EXPIRED_WITHIN_S = 0.2
"""Largest time between a silence and a stopped program for which the watchdog is blamed."""
KICKED_AFTER = 0.2
"""Part of the watchdog's period after which it is kicked again."""


@dataclass
class Kicks:
    """Times at which the controller's watchdog was kicked, and the silences of this computer between them.

    Attributes
    ----------
    longest_s : float
        Longest silence [s].
    late : int
        Number of silences longer than half the watchdog's period.
    """

    longest_s: float = 0.0
    late: int = 0
    _period_s: float = math.inf
    _last_s: float | None = None
    _expired: tuple[float, float] | None = None

    def start(self, now: float, period_s: float) -> None:
        """Note that the watchdog was started with a period [s]."""
        self._last_s, self._period_s, self._expired = now, period_s, None

    def end(self) -> None:
        """Note that the program was stopped on purpose: silences no longer count."""
        self._last_s = None

    def due(self, now: float) -> bool:
        """Return whether the next kick is due."""
        return self._last_s is None or now - self._last_s >= KICKED_AFTER * self._period_s

    def kicked(self, now: float) -> None:
        """Note a kick, or a command that has the same effect."""
        if self._last_s is not None:
            self._note(now, now - self._last_s)
        self._last_s = now

    def _note(self, now: float, gap_s: float) -> None:
        self.longest_s = max(self.longest_s, gap_s)
        self.late += gap_s > 0.5 * self._period_s
        if gap_s > self._period_s - _STREAM_PERIODS_S:
            self._expired = (now, gap_s)

    def expired_before(self, stopped_s: float | None) -> float | None:
        """Return the silence that let the watchdog expire just before the program was seen stopped; None if none."""
        if stopped_s is None:
            return None
        if self._last_s is not None and stopped_s - self._last_s > self._period_s - _STREAM_PERIODS_S:
            self._note(stopped_s, stopped_s - self._last_s)
        if self._expired is None or not -_EXPIRED_WITHIN_S <= self._expired[0] - stopped_s <= _EXPIRED_WITHIN_S:
            return None
        return self._expired[1]


@dataclass(frozen=True)
class RestCriterion:
    """Rest criterion: for ``dwell_s`` no joint exceeds ``speed`` [rad/s] or leaves a window ``position`` [rad]."""

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
    lead_speed = min(limit * (longest / way) for limit, way in zip(speed, travel, strict=True) if way > 0.0)
    lead_acceleration = min(
        limit * (longest / way) for limit, way in zip(acceleration, travel, strict=True) if way > 0.0
    )
    return min(lead_speed, MAX_SPEED), min(lead_acceleration, MAX_ACCELERATION)
