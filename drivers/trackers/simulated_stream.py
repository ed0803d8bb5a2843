"""The stream of the simulated tracker: points of a moving SMR in packets, timestamped by the tracker's own clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.plant import Plant
from drivers.trackers.imperfections import Imperfections
from drivers.trackers.protocol import PACKETS_HZ, Packet, StreamLimits, TargetLost, Track, TrackerError

Vector = NDArray[np.float64]

STREAM_LIMITS = StreamLimits(1e-3, 1.0)
_STILL_M = 1e-9
"""Motion between two packets below which an SMR counts as resting."""
TRIGGER_S = 5e-6
"""Largest error of the timestamp of a pulse at the trigger input [s]."""


class Measured(Protocol):
    """Function that simulates measurements of true points (n, 3) [m]: points and standard uncertainties (n,)."""

    def __call__(self, p_M: Vector, *, moving: bool) -> tuple[Vector, Vector]:
        """Return the measured points."""


class SimulatedStream:
    """Stream of one SMR; the plant's schedule sends its packets while other calls advance the time."""

    def __init__(
        self,
        plant: Plant,
        errors: Imperfections,
        owner: str,
        true_smr: Callable[[Vector], tuple[Vector, Vector]],
        hidden: Callable[[Vector, Vector], str],
        measured: Measured,
        interval_s: float,
        rng: np.random.Generator,
        lost: Callable[[TrackerError], None],
        received: Callable[[Packet], None],
    ) -> None:
        """``owner`` names the owner of the SMR. ``true_smr`` returns its positions and viewing directions (n, 3) at
        recent times (n,). ``hidden`` returns why it is not visible at one of them; empty if it is."""
        self._plant, self._errors, self._owner = plant, errors, owner
        self._true_smr, self._hidden = true_smr, hidden
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
        """Take the first point, and schedule the first packet."""
        self._send(0)

    def end(self) -> Track:
        """Return all points up to now."""
        if self._on:
            self._take(may_break=False)
        self._on = False
        return Track.of(self._packets)

    def trigger(self) -> None:
        """Store the timestamp of a pulse."""
        error_s = self._rng.uniform(-TRIGGER_S, TRIGGER_S)
        self._triggers.append(float(self._errors.own_time_s(np.array(self._plant.clock_s + error_s))))

    def _send(self, number: int) -> None:
        """Send one packet and schedule the next."""
        if self._on and self._take(may_break=number > 0):
            self._plant.schedule.at(self._began_s + (number + 1) * self._packet_s, lambda: self._send(number + 1))

    def _take(self, *, may_break: bool) -> bool:
        """Measure the points due since the last packet and send them; return False if the beam has broken."""
        due = math.floor((self._plant.clock_s - self._began_s) / self._interval_s + 1e-6) + 1
        time_s = self._began_s + self._interval_s * np.arange(self._taken, due, dtype=np.float64)
        self._taken = due
        true_M, normal_M = self._true_smr(np.append(time_s, self._plant.clock_s))
        if why := self._broken(true_M[-1], normal_M[-1], may_break=may_break):
            self._on = False
            self._lost(TargetLost(f"tracker: the beam to the SMR of {self._owner} broke while it was followed: {why}"))
            return False
        triggers, self._triggers = np.array(self._triggers), []
        if self._errors.saturated and self._rng.random() < self._errors.saturated:
            time_s = time_s[:0]
        if len(time_s) or len(triggers):
            p_M, sigma_m = self._measured(true_M[: len(time_s)], moving=float(np.ptp(true_M, axis=0).max()) > _STILL_M)
            self._go(Packet(self._errors.own_time_s(time_s), p_M, sigma_m, math.nan, triggers))
        return True

    def _broken(self, p_M: Vector, normal_M: Vector, *, may_break: bool) -> str:
        """Return why the beam is broken now; empty if it is not."""
        often = self._errors.lost_beams_per_min * self._packet_s / 60.0
        return self._hidden(p_M, normal_M) or (
            "something crossed it" if may_break and self._rng.random() < often else ""
        )

    def _go(self, packet: Packet) -> None:
        """Deliver a packet, delayed by the receiving computer's random delay."""
        late_s = self._rng.uniform(0.0, self._errors.packet_jitter_s)
        self._arrived_s = max(self._arrived_s, self._plant.clock_s + late_s)
        packet = replace(packet, arrived_s=self._arrived_s)
        self._packets.append(packet)
        if late_s:
            self._plant.schedule.at(self._arrived_s, lambda: self._received(packet))
        else:
            self._received(packet)
