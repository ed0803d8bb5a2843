"""Latency and deceleration of a controller's stops; records of when each stop was received, took effect and ended.

Published times of real controllers: the UR10/CB3 user manual (section on the monitoring of safety inputs) states that a
stop of category 1 or 2 begins to brake within 24 ms and is never slower than a ramp from the joint's speed limit to 0
in 500 ms. The UR5/CB3 user manual (appendix A) measures 244, 530 and 164 ms for base, shoulder and elbow from 183 deg/s
in a stop of category 0, fully extended with the largest payload. The emulator brakes at the slowest permitted ramp. The
latency of a stop over the network is an assumption: a few control cycles of the slower series.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from drivers.emulators.ur_controller.motion import Array, Motions

StopKind = Literal["program", "stopj", "protective", "emergency"]
"""Kinds of stop: end or pause of a program, deceleration requested by a program, safety stops of category 2 and 1."""
_SAFETY_STOPS = ("protective", "emergency")
_MOST_RECORDS = 2000


@dataclass(frozen=True)
class Braking:
    """Reaction of a controller to stops, in cell time.

    Attributes
    ----------
    latency_s, safety_latency_s : float
        From a stop over the network, and from a stop of the safety system, to the start of braking [s].
    full_speed_s : float
        Time to brake a joint from its speed limit [s].
    """

    latency_s: float = 0.020
    safety_latency_s: float = 0.024
    full_speed_s: float = 0.5


@dataclass
class StopRecord:
    """One stop of an arm, moving or at rest; times are ``time.monotonic`` [s].

    Attributes
    ----------
    ideal_s : float
        Braking time from the speed at ``received_s``, in cell time [s].
    began_s, rest_s : float or None
        When braking began and when the arm rested; None until then. ``began_s`` is also None for an arm at rest.
    """

    kind: StopKind
    received_s: float
    ideal_s: float
    began_s: float | None = None
    rest_s: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the fields, for the control channel."""
        return asdict(self)


@dataclass
class StopTrigger:
    """Condition of a protective stop: the arm reaches ``speed`` [rad/s] or has moved by ``travel`` [rad]."""

    speed: float = math.inf
    travel: float = math.inf


class Brakes:
    """The stops of one arm.

    Attributes
    ----------
    records : deque of StopRecord
        Newest last. A stop that arrives while the arm is already braking has no record of its own.
    """

    def __init__(
        self,
        name: str,
        motions: Motions,
        braking: Braking,
        speed: Sequence[float],
        acceleration: Sequence[float],
        clock: Callable[[], float],
    ) -> None:
        """``speed`` and ``acceleration`` (6,) are the limits of the joints; ``clock`` is ``time.monotonic``."""
        self._name, self._motions, self._braking, self._clock = name, motions, braking, clock
        self._ramp = np.array(speed) / braking.full_speed_s
        self._greatest = np.maximum(self._ramp, acceleration)
        self._deceleration: Array | None = None  # of the stop in progress
        self._record: StopRecord | None = None
        self._due_s = math.inf
        self.records: deque[StopRecord] = deque(maxlen=_MOST_RECORDS)

    @property
    def braking(self) -> bool:
        """Whether the arm brakes now; False during the latency before."""
        return self._record is not None and self._record.began_s is not None

    def request(self, kind: StopKind, deceleration: float | None = None) -> None:
        """Brake after the latency of this kind, with the leading joint at ``deceleration`` [rad/s^2] if given."""
        limit = self._ramp if deceleration is None else np.minimum(deceleration, self._greatest)
        speeds = np.abs(self._motions.speeds(self._name))
        now_s = self._clock()
        if not self._motions.moving(self._name):
            self.records.append(StopRecord(kind, now_s, 0.0, rest_s=now_s))
            return
        if self._deceleration is None:
            self._record = StopRecord(kind, now_s, float((speeds / limit).max()))
            self.records.append(self._record)
            self._deceleration = limit
        else:  # a gentler stop does not weaken the one in progress
            self._deceleration = np.maximum(limit, self._deceleration)
        latency_s = self._braking.safety_latency_s if kind in _SAFETY_STOPS else self._braking.latency_s
        self._due_s = min(self._due_s, self._motions.clock_s + latency_s)

    def cycle(self, now_s: float) -> None:
        """Start braking when it is due, and detect rest; call it once per control period at ``now_s``."""
        if self._deceleration is None or self._record is None:
            return
        if self._motions.moving(self._name) and self._motions.clock_s >= self._due_s:
            self._due_s = math.inf
            self._motions.stop(self._name, self._deceleration)
            if self._record.began_s is None:
                self._record.began_s = now_s
        if not self._motions.moving(self._name):
            self._record.rest_s = now_s
            self._record, self._deceleration, self._due_s = None, None, math.inf
