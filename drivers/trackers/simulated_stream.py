"""The stream of the simulated tracker: points of a moving SMR in packets, stamped by the tracker's own clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.plant import Plant
from drivers.trackers.imperfections import Imperfections
from drivers.trackers.protocol import PACKETS_HZ, Packet, StreamLimits, TargetLost, Track, TrackerError

Vector = NDArray[np.float64]

STREAM_LIMITS = StreamLimits(1e-3, 1.0)
TRIGGER_S = 5e-6
"""Largest error of the stamp of a pulse at the trigger input [s]."""


class Followed(Protocol):
    """The SMR that is followed, now."""

    @property
    def owner(self) -> str:
        """Whose it is, in words."""

    @property
    def arm(self) -> str | None:
        """The arm that carries it; None: it rests."""

    @property
    def p_M(self) -> Vector:
        """Where it is (3,) [m]."""

    @property
    def hidden(self) -> str:
        """Why it is not seen; empty if it is."""

    @property
    def moving(self) -> bool:
        """Whether it moves."""


class Measured(Protocol):
    """Measures true points (n, 3) [m]: points and standard uncertainties (n,)."""

    def __call__(self, p_M: Vector, *, moving: bool) -> tuple[Vector, Vector]:
        """Return what the tracker reads."""


class SimulatedStream:
    """Follows one SMR; the plant's schedule lets its packets go while others let time pass."""

    def __init__(
        self,
        plant: Plant,
        errors: Imperfections,
        look: Callable[[], Followed],
        measured: Measured,
        interval_s: float,
        rng: np.random.Generator,
        lost: Callable[[TrackerError], None],
        received: Callable[[Packet], None],
    ) -> None:
        """``look`` finds the SMR as it is now, ``lost`` and ``received`` are the listeners of the track."""
        self._plant, self._errors, self._look = plant, errors, look
        self._measured, self._interval_s, self._rng = measured, interval_s, rng
        self._lost, self._received = lost, received
        self._began_s = plant.clock_s
        self._packet_s = max(interval_s, 1.0 / PACKETS_HZ)
        self._taken = 0
        self._packets: list[Packet] = []
        self._triggers: list[float] = []
        self._arrived_s = -math.inf
        self._on = True

    def begin(self) -> None:
        """Take the first point, and enter the first packet into the schedule."""
        self._send(0)

    def end(self) -> Track:
        """Return all points up to now."""
        if self._on:
            self._take()
        self._on = False
        return Track.of(self._packets)

    def trigger(self) -> None:
        """Keep the stamp of a pulse."""
        error_s = self._rng.uniform(-TRIGGER_S, TRIGGER_S)
        self._triggers.append(float(self._errors.own_time_s(np.array(self._plant.clock_s + error_s))))

    def _send(self, number: int) -> None:
        """Let one packet go, and enter the next one."""
        if not self._on:
            return
        now = self._look()
        often = self._errors.lost_beams_per_min * self._packet_s / 60.0
        why = now.hidden or ("something crossed it" if number and self._rng.random() < often else "")
        if why:
            self._on = False
            self._lost(TargetLost(f"tracker: the beam to the SMR of {now.owner} broke while it was followed: {why}"))
            return
        self._take()
        self._plant.schedule.at(self._began_s + (number + 1) * self._packet_s, lambda: self._send(number + 1))

    def _take(self) -> None:
        """Measure what is due since the last packet, and send it."""
        due = math.floor((self._plant.clock_s - self._began_s) / self._interval_s + 1e-6) + 1
        time_s = self._began_s + self._interval_s * np.arange(self._taken, due, dtype=np.float64)
        self._taken = due
        triggers, self._triggers = np.array(self._triggers), []
        if self._errors.saturated and self._rng.random() < self._errors.saturated:
            time_s = time_s[:0]
        if not len(time_s) and not len(triggers):
            return
        now = self._look()
        true_M = np.repeat(now.p_M[None], len(time_s), axis=0)
        if now.arm is not None and len(time_s):
            true_M, _ = self._plant.recent_smr(now.arm, time_s)
        p_M, sigma_m = self._measured(true_M, moving=now.moving)
        late_s = self._rng.uniform(0.0, self._errors.packet_jitter_s)
        self._arrived_s = max(self._arrived_s, self._plant.clock_s + late_s)
        packet = Packet(self._errors.own_time_s(time_s), p_M, sigma_m, self._arrived_s, triggers)
        self._packets.append(packet)
        if late_s:
            self._plant.schedule.at(self._arrived_s, lambda: self._received(packet))
        else:
            self._received(packet)
