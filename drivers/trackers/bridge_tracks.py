"""Client of a bridge whose tracker measures an SMR while it moves: it fetches the points buffered at the bridge.

The bridge buffers points until the client confirms them, so a link that breaks for a moment loses none.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge import BridgeTracker, UnknownCommand
from drivers.trackers.bridge_points import read_limits, read_packet
from drivers.trackers.bridge_wire import Fields
from drivers.trackers.protocol import (
    Packet,
    StreamLimits,
    Track,
    TrackerError,
    TrackerLinkLost,
    checked_point,
    no_packet,
)

_SILENT_S = 1.0
"""A track is dead if no point arrives for this long and for ten point intervals."""
_AT_ONCE_S = 0.15
"""Longest time of fetching points in one go, as other commands may be waiting."""
_REST_WITHIN_S = 60.0
"""Time limit for fetching the remaining points of a finished track, over a slow line."""


@dataclass
class _Running:
    """The client's state of a track."""

    id: str
    interval_s: float
    lost: Callable[[TrackerError], None]
    received: Callable[[Packet], None]
    next: int = 0
    on: bool = True
    heard_s: float = field(default_factory=time.monotonic)
    packets: list[Packet] = field(default_factory=list)

    @property
    def wanted(self) -> dict[str, str]:
        """Fields of the request for the next points."""
        return {"track": self.id, "from": str(self.next)}


class StreamingBridgeTracker(BridgeTracker):
    """A tracker behind a bridge, see ``BridgeTracker``; the bridge reports whether it can stream."""

    _limits: StreamLimits | None = None
    _asked = False
    _track: _Running | None = None

    def connect(self) -> None:
        """Open the link and a session; the stream limits are asked again when they are needed."""
        self._asked, self._track = False, None
        super().connect()

    def stream_limits(self) -> StreamLimits | None:
        """Return what the tracker behind the bridge can stream; None also if the bridge does not know streams."""
        if not self._asked:
            self._limits = None
            with contextlib.suppress(UnknownCommand):
                self._limits = self._read(read_limits, self._command("stream-limits"))
            self._asked = True
        return self._limits

    def start_track(
        self,
        expected_M: NDArray[np.float64],
        interval_s: float,
        lost: Callable[[TrackerError], None],
        received: Callable[[Packet], None] = no_packet,
    ) -> None:
        """Make the tracker lock and follow the SMR; ``confirm`` fetches its points."""
        limits = self.stream_limits()
        if limits is None:
            raise TrackerError(f"tracker bridge {self._url}: its tracker does not measure an SMR while it moves")
        limits.check(interval_s)
        x, y, z = (wire.number(value) for value in checked_point(expected_M, interval_s))
        self._halting.clear()
        id_ = wire.new_id()
        self._command("track", {"id": id_, "x": x, "y": y, "z": z, "interval": wire.number(interval_s)})
        self._track = _Running(id_, interval_s, lost, received)

    def _ask(self, within_s: float, until_s: float) -> None:
        """During a track fetch its points: they are the tracker's sign of life."""
        track = self._track
        if track is None or not track.on:
            super()._ask(within_s, until_s)
            return
        with _known(track):
            self._fetch(track, until_s, min(until_s, time.monotonic() + _AT_ONCE_S))
        silent_s = time.monotonic() - track.heard_s
        if track.on and silent_s > max(_SILENT_S, 10.0 * track.interval_s):
            raise TrackerLinkLost(f"tracker bridge {self._url}: no point of the moving SMR came for {silent_s:.1f} s")

    def end_track(self) -> Track:
        """End the track, fetch the buffered points and return all points."""
        track, self._track = self._track, None
        if track is None:
            return Track.of([])
        with _known(track):
            self._command("end-track", {"track": track.id})
            track.lost = _nobody
            until_s = time.monotonic() + _REST_WITHIN_S
            while self._take(track, self._command("points", track.wanted)):
                if time.monotonic() > until_s:
                    raise TrackerLinkLost(
                        f"tracker bridge {self._url}: its points did not come within {_REST_WITHIN_S:g} s"
                    )
        return Track.of(track.packets)

    def _fetch(self, track: _Running, until_s: float, enough_s: float) -> None:
        """Fetch buffered points, at least one answer, until ``enough_s``."""
        while True:
            if not self._take(track, self._exchange("points", track.wanted, until_s)) or time.monotonic() > enough_s:
                return

    def _take(self, track: _Running, answer: Fields) -> bool:
        """Store the points of an answer and call the listeners; return whether there may be more."""
        now_s = time.monotonic()
        packet, waiting = self._read(lambda fields: read_packet(fields, now_s), answer)
        track.next = int(
            self._read(lambda fields: wire.read_number(fields, "next", track.next, track.next + 1), answer)
        )
        if len(packet.device_time_s) or len(packet.triggers_s):
            track.heard_s = now_s
            self._sign_of_life({})
            track.packets.append(packet)
            track.received(packet)
        if kind := answer.get("lost.kind", ""):
            track.on = False
            track.lost(wire.ERRORS.get(kind, TrackerError)(answer.get("lost.text", "the track has ended")))
        return waiting > 0


@contextlib.contextmanager
def _known(track: _Running) -> Iterator[None]:
    """Raise ``TrackerLinkLost`` if the bridge does not know the track: it has restarted."""
    try:
        yield
    except ValueError as error:
        track.on = False
        raise TrackerLinkLost(str(error)) from error


def _nobody(error: TrackerError) -> None:
    """Ignore the error of a track that is over."""
