"""The clock of a cell whose arms' joints are those of a plant, and the stops of its controllers."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.plant import Plant

Array = NDArray[np.float64]

_STANDSTILL_S = 30.0


class PacedCell:
    """A cell whose clock runs at ``pace`` times wall time, shared by several threads.

    Only the server of the controllers advances the clock, with ``catch_up``. Hold ``lock`` to access ``motions`` and
    release it to wait: ``passed`` is a condition on the same lock, notified when the clock has advanced.
    """

    def __init__(self, motions: Plant, pace: float = 1.0) -> None:
        self.motions = motions
        self.pace = pace
        self.lock = threading.RLock()
        self.passed = threading.Condition(self.lock)
        self._last_s: float | None = None

    @property
    def pace(self) -> float:
        """Seconds of cell time per second of wall time. Setting it raises ``ValueError`` unless in (0, 1000]."""
        return self._pace

    @pace.setter
    def pace(self, pace: float) -> None:
        if not 0.0 < pace <= 1000.0:
            raise ValueError(f"pace: expected more than 0 and at most 1000 seconds of the cell a second, got {pace!r}")
        self._pace = pace

    def catch_up(self, now_s: float) -> None:
        """Advance the cell to ``now_s`` (``time.monotonic``); the first call sets the start."""
        with self.lock:
            elapsed = 0.0 if self._last_s is None else now_s - self._last_s
            if self._last_s is None or elapsed > 0.0:
                self._last_s = now_s
            if elapsed > 0.0:
                self.motions.advance(elapsed * self.pace)
                self.passed.notify_all()

    def wait(self, duration_s: float) -> None:
        """Wait until the cell's clock has advanced by ``duration_s``; from any thread except the server's.

        Raises ``TimeoutError`` if the clock does not advance, because the server does not run.
        """
        with self.passed:
            seen_s = self.motions.clock_s
            end_s = seen_s + duration_s
            while self.motions.clock_s < end_s:
                if not self.passed.wait(_STANDSTILL_S) and seen_s == self.motions.clock_s:
                    raise TimeoutError("the cell's clock does not advance: its server does not run")
                seen_s = self.motions.clock_s


# ---------------------------------------------------------------------------------------------------------------------
# Latency and deceleration of a controller's stops; records of when each stop was received, took effect and ended.
#
# Published times of real controllers: the UR10/CB3 user manual (section on the monitoring of safety inputs) states that
# a stop of category 1 or 2 begins to brake within 24 ms and is never slower than a ramp from the joint's speed limit to
# 0 in 500 ms. The UR5/CB3 user manual (appendix A) measures 244, 530 and 164 ms for base, shoulder and elbow from 183
# deg/s in a stop of category 0, fully extended with the largest payload. The emulator brakes at the slowest permitted
# ramp. The latency of a stop over the network is an assumption: a few control cycles of the slower series.


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
        motions: Plant,
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
