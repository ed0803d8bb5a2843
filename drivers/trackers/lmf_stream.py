"""A Leica tracker through LMF that follows a moving SMR with LMF's continuous time measurement.

LMF delivers packets, at most 50 a second, on a thread of its own and waits until the handler has returned. The handler
only stores the packet and the time; another thread of the driver reads the points from it. Timestamps are those of the
tracker's controller. A broken beam shows in ``Targets.Selected``, as LMF publishes no error number for it.
"""

from __future__ import annotations

import contextlib
import math
import queue
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from drivers.trackers.lmf import LmfTracker, Vector
from drivers.trackers.lmf_objects import Handlers, describe, set_quantity, set_value, to_si, tracker_time_s, unwrap
from drivers.trackers.protocol import (
    PACKETS_HZ,
    Point,
    Preparation,
    StreamLimits,
    TargetLost,
    Track,
    TrackerError,
    checked_point,
    no_packet,
)

LIMITS = StreamLimits(1e-3, 1.0)
"""Intervals between two points: an AT960 measures at most 1000 points a second."""
_PROFILE = "ContinuousTimeProfile"
_ENDS_WITHIN_S = 5.0
_LOST = "beam"


class LmfStreamTracker(LmfTracker):
    """One Leica tracker through LMF, see ``LmfTracker``; it streams if LMF has continuous measurements."""

    _follows: _Following | None = None

    def stream_limits(self) -> StreamLimits | None:
        """Return the limits of an AT960; None if this tracker has no continuous measurement."""
        profile = self._call("reading the profiles", lambda its: _continuous(its) is not None)
        return LIMITS if profile else None

    def start_track(
        self,
        expected_M: Vector,
        interval_s: float,
        lost: Callable[[TrackerError], None],
        received: Callable[[Track], None] = no_packet,
    ) -> None:
        """Lock the SMR, select the continuous measurement and start it."""
        LIMITS.check(interval_s)
        expected = checked_point(expected_M, interval_s)
        self._leave()
        self._clear_halt()
        lock = partial(self._lock, expected=expected, averaging_s=interval_s)
        self._call("pointing and searching", lock, haltable=True)
        self._follows = following = _Following(self._packet, lost, received)
        try:
            self._call("starting to follow", partial(self._begin, following=following, interval_s=interval_s))
        except BaseException:
            with contextlib.suppress(TrackerError):  # report why it did not begin, not why it did not end
                self.end_track()
            raise

    def end_track(self) -> Track:
        """Stop measuring, return to stationary measurements and return all points."""
        following, self._follows = self._follows, None
        if following is None:
            return Track.of([])
        try:
            self._call("ending the measurement", partial(self._stop, following=following))
        finally:
            packets = following.end()
        return Track.of(packets)

    def measure(self, expected_M: Vector, averaging_s: float) -> Point:
        """Measure at rest; end a track."""
        self._leave()
        return super().measure(expected_M, averaging_s)

    def prepare(self, settings: Preparation) -> None:
        """Prepare the tracker; end a track."""
        self._leave()
        super().prepare(settings)

    def disconnect(self) -> None:
        """Release the tracker; end a track."""
        with contextlib.suppress(TrackerError):
            self._leave()
        super().disconnect()

    # -- on the thread that calls LMF ----------------------------------------------------------------------------------

    def _begin(self, tracker: Any, following: _Following, interval_s: float) -> None:
        profile = _continuous(tracker)
        if profile is None:
            raise TrackerError(f"tracker: this tracker has no {_PROFILE}")
        with self._no_handlers(tracker):
            profile.Select()
            self._averaging_set_s = None
            set_quantity(profile.TimeSeparation, "time", interval_s)
            set_value(profile, "PacketRate", max(1, min(int(PACKETS_HZ), round(1.0 / interval_s))))
        following.handlers.set(tracker, wanted=True)
        tracker.Measurement.StartMeasurement()
        if tracker.Targets.Selected is None:
            raise TargetLost("tracker: the beam to the SMR broke before it was followed")

    def _stop(self, tracker: Any, following: _Following) -> None:
        following.handlers.set(tracker, wanted=False)
        self._apply(tracker, self._preparation)  # stops the measurement and selects the stationary one

    def _leave(self) -> None:
        """End a track that is still running."""
        if self._follows is not None:
            self.end_track()

    # -- on the thread that reads packets ------------------------------------------------------------------------------

    def _packet(self, points: Any, arrived_s: float) -> Track:
        """Convert a packet of LMF. Raises ``TrackerError``."""
        stamps, places = [], []
        with self._translating_errors("reading points"):
            for one in points:
                position = one.Position
                places.append([to_si(getattr(position, f"Coordinate{axis}"), "length") for axis in (1, 2, 3)])
                stamps.append(tracker_time_s(one) or math.nan)
        p_M = np.array(places, dtype=np.float64).reshape(-1, 3)
        time_s = np.array(stamps, dtype=np.float64)
        known = np.isfinite(time_s) & np.isfinite(p_M).all(axis=1)
        p_M, time_s = p_M[known], time_s[known]
        sigma_m = np.array([math.sqrt(np.trace(self._law.covariance(p)) / 3.0) for p in p_M], dtype=np.float64)
        return Track(time_s, p_M, sigma_m, np.full(len(p_M), arrived_s))


class _Following:
    """Receiver of LMF's events during a track: handlers that only store them, and a thread that reads them."""

    def __init__(
        self,
        read: Callable[[Any, float], Track],
        lost: Callable[[TrackerError], None],
        received: Callable[[Track], None],
    ) -> None:
        self._read, self._lost, self._received = read, lost, received
        self._queue: queue.SimpleQueue[tuple[Any, float] | None] = queue.SimpleQueue()
        self._packets: list[Track] = []
        self._over = False
        self.handlers = Handlers(
            ("Measurement", "MeasurementArrived", self._arrived), ("Targets", "SelectedChanged", self._selected)
        )
        self._thread = threading.Thread(target=self._work, name="LMF points", daemon=True)
        self._thread.start()

    def end(self) -> list[Track]:
        """Read all stored events and return all packets."""
        self._queue.put(None)
        self._thread.join(_ENDS_WITHIN_S)
        return self._packets

    def _arrived(self, *arguments: Any) -> None:
        """Store an event of LMF: sender, points, error."""
        self._queue.put((arguments[1:], time.monotonic()))

    def _selected(self, *arguments: Any) -> None:
        """Store that the beam broke: the target is null then."""
        if arguments and arguments[-1] is None:
            self._queue.put((_LOST, time.monotonic()))

    def _work(self) -> None:
        while (item := self._queue.get()) is not None:
            if not self._over:
                self._take(*item)

    def _take(self, what: Any, arrived_s: float) -> None:
        """Read a packet, or report that the track has ended."""
        try:
            if what == _LOST:
                raise TargetLost("tracker: the beam to the SMR broke while it was followed")
            points, error = what[0], what[1] if len(what) > 1 else None
            if error is not None:
                raise TrackerError(f"tracker: following the SMR failed: {describe(error)}")
            packet = self._read(points, arrived_s)
        except TrackerError as ended:
            self._over = True
            self._lost(ended)
            return
        if len(packet.device_time_s):
            self._packets.append(packet)
            self._received(packet)


def _continuous(tracker: Any) -> Any:
    """Return LMF's profile of a continuous measurement; None if this tracker has none."""
    return next((one for one in unwrap(tracker.Measurement.Profiles) if type(one).__name__ == _PROFILE), None)
