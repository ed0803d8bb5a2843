"""Points of a moving SMR in the bridge's protocol, and the buffer of a track at the tracker's end.

A packet is a list of points, ``stamp,x,y,z,sigma;...``: the tracker's own timestamp [s], coordinates and their standard
uncertainty [m] (empty if not known).
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge_wire import BadField, Fields
from drivers.trackers.protocol import Packet, StreamLimits, Track, Tracker, TrackerError, stream_limits_of, stream_of

MOST_WAITING = 200_000
"""Largest number of points buffered for a client; a slower client loses points."""
_LONGEST_POINTS = 1500
"""Longest text of the points in one line, whose length is limited [characters]."""
_STAMP = re.compile(r"-?[0-9]{1,12}(?:\.[0-9]{1,12})?")
_POINT = re.compile(r"(-?[0-9.]+),(-?[0-9.]+),(-?[0-9.]+),(-?[0-9.]+),([0-9.e-]*)")


def limits_fields(limits: StreamLimits | None) -> dict[str, str]:
    """Return the answer to ``stream-limits``."""
    shortest, longest = (0.0, 0.0) if limits is None else (limits.shortest_s, limits.longest_s)
    return {"shortest": wire.number(shortest), "longest": wire.number(longest)}


def read_limits(fields: Fields) -> StreamLimits | None:
    """Read the answer to ``stream-limits``. Raises ``BadField``."""
    longest_s = wire.read_number(fields, "longest", 0.0, 3600.0)
    shortest_s = wire.read_number(fields, "shortest", 0.0, 3600.0)
    return None if longest_s == 0.0 else StreamLimits(shortest_s, longest_s)


def _point(stamp_s: float, p_M: NDArray[np.float64], sigma_m: float) -> str:
    sigma = f"{sigma_m:.2e}" if math.isfinite(sigma_m) else ""
    return f"{stamp_s:.7f},{p_M[0]:.8f},{p_M[1]:.8f},{p_M[2]:.8f},{sigma}"


def read_packet(fields: Fields, now_s: float) -> tuple[Packet, int]:
    """Read an answer to ``points`` that came at ``now_s``: a packet, and how many points wait. Raises ``BadField``."""
    text = fields.get("points", "")
    found = [_POINT.fullmatch(part) for part in text.split(";")] if text else []
    if any(match is None for match in found):
        raise BadField(f"points: '{wire.text(text, 40)}' is not a list of 'stamp,x,y,z,sigma'")
    try:
        rows = np.array([[float(value or "nan") for value in match.groups()] for match in found if match is not None])
    except ValueError as error:
        raise BadField(f"points: {error}") from error
    rows = rows.reshape(-1, 5)
    pulses = [part for part in fields.get("pulses", "").split(";") if part]
    if not all(_STAMP.fullmatch(part) for part in pulses):
        raise BadField("pulses are stamps, separated by ';'")
    age_s = wire.read_number(fields, "age", 0.0, 1e6) if len(rows) else 0.0
    waiting = int(wire.read_number(fields, "waiting", 0, 10 * MOST_WAITING))
    triggers = np.array([float(part) for part in pulses])
    return Packet(rows[:, 0], rows[:, 1:4], rows[:, 4], now_s - age_s, triggers), waiting


@dataclass(frozen=True)
class _Waiting:
    """Points of one line, their arrival time at the bridge, and the trigger pulses since the previous line."""

    points: tuple[str, ...]
    arrived_s: float
    pulses: tuple[str, ...]


class TrackBuffer:
    """Buffer of the points of a track that the client has not confirmed yet. From any thread.

    Lines are numbered; a request for line k confirms all lines before it.
    """

    def __init__(self, id_: str, clock: Callable[[], float] = time.monotonic) -> None:
        self.id = id_
        self._clock = clock
        self._lock = threading.Lock()
        self._lines: deque[_Waiting] = deque()
        self._first = 0
        self._waiting = 0
        self._last_stamp_s = -math.inf
        self._pulses: list[str] = []
        self._heard_pulses = 0
        self._lost: TrackerError | None = None

    def received(self, packet: Packet) -> None:
        """Buffer a packet of the tracker."""
        if len(packet.device_time_s) and packet.device_time_s[0] <= self._last_stamp_s:
            return  # it was on its way when the track was ended
        points = [
            _point(stamp, p, sigma)
            for stamp, p, sigma in zip(packet.device_time_s, packet.p_M, packet.sigma_m, strict=True)
        ]
        with self._lock:
            self._heard_pulses += len(packet.triggers_s)
            self._pulses += [f"{stamp:.7f}" for stamp in packet.triggers_s]
            if self._waiting + len(points) > MOST_WAITING or not (points or self._pulses):
                return
            if points:
                self._last_stamp_s = float(packet.device_time_s[-1])
            self._waiting += len(points)
            for some in _lines(points) or [()]:
                self._lines.append(_Waiting(some, self._clock(), tuple(self._pulses)))
                self._pulses = []

    def lost(self, error: TrackerError) -> None:
        """Note that the track was lost: it has ended by itself."""
        with self._lock:
            self._lost = self._lost or error

    def ended(self, track: Track) -> None:
        """Buffer the points of a finished track that did not arrive as packets."""
        rest = track.within(track.device_time_s > self._last_stamp_s)
        pulses = track.triggers_s[self._heard_pulses :]
        self.received(Packet(rest.device_time_s, rest.p_M, rest.sigma_m, 0.0, pulses))

    def fields(self, number: int) -> dict[str, str]:
        """Return the answer to ``points from=number``. Raises ``BadField`` for a line that is no longer buffered."""
        with self._lock:
            while self._first < number and self._lines:
                self._waiting -= len(self._lines.popleft().points)
                self._first += 1
            if number != self._first:
                raise BadField(f"from is {number}; the next line is {self._first}")
            if not self._lines:
                ended = {} if self._lost is None else _lost(self._lost)
                return {"points": "", "waiting": "0", "next": str(number), **ended}
            line = self._lines[0]
            return {
                "points": ";".join(line.points),
                "age": f"{max(self._clock() - line.arrived_s, 0.0):.6f}",
                "waiting": str(self._waiting - len(line.points)),
                "next": str(number + 1),
                "pulses": ";".join(line.pulses),
            }


class ServedTracks:
    """The track of a bridge's tracker. The bridge's thread answers ``points``; the tracker's thread calls the rest."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._track: TrackBuffer | None = None

    def of(self, fields: Fields) -> TrackBuffer:
        """Return the track named by a line. Raises ``BadField`` unless it is the newest one."""
        track, id_ = self._track, wire.read_id(fields, "track")
        if track is None or track.id != id_:
            raise BadField("no such track: the bridge has restarted, or another one was begun")
        return track

    def points(self, fields: Fields) -> dict[str, str]:
        """Return the answer to ``points`` from the buffer."""
        return self.of(fields).fields(int(wire.read_number(fields, "from", 0, 1e9)))

    def limits(self) -> dict[str, str]:
        """Return the answer to ``stream-limits``."""
        return limits_fields(stream_limits_of(self._tracker))

    def start(self, id_: str, expected_M: NDArray[np.float64], interval_s: float) -> dict[str, str]:
        """Start a track of an SMR. Raises as ``start_track``."""
        if (streaming := stream_of(self._tracker)) is None:
            raise ValueError("this tracker does not measure an SMR while it moves")
        track = TrackBuffer(id_)
        streaming.start_track(expected_M, interval_s, track.lost, track.received)
        self._track = track
        return {}

    def end(self, track: TrackBuffer) -> dict[str, str]:
        """End a track; its points stay buffered."""
        if (streaming := stream_of(self._tracker)) is not None:
            track.ended(streaming.end_track())
        return {}

    def forget(self) -> None:
        """Forget the track, as a restart would."""
        self._track = None


def _lost(error: TrackerError) -> dict[str, str]:
    """Return the fields that say why a track has ended by itself."""
    return {f"lost.{key}": text for key, text in wire.error_fields(error).items()}


def _lines(points: list[str]) -> list[tuple[str, ...]]:
    """Split the points into groups that fit into one line each."""
    lines: list[tuple[str, ...]] = []
    some: list[str] = []
    length = 0
    for point in points:
        if some and length + len(point) > _LONGEST_POINTS:
            lines.append(tuple(some))
            some, length = [], 0
        some.append(point)
        length += len(point) + 1
    return [*lines, tuple(some)] if some else lines
