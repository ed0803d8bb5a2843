"""Receiver of LMF's continuous time measurement, with which a Leica tracker follows a moving SMR.

LMF delivers packets, at most 50 a second, on a thread of its own and waits until the handler has returned. The handler
only stores the packet and the time; another thread of the driver reads the points from it. Timestamps are those of the
tracker's controller. A broken beam shows in ``Targets.Selected``, as LMF publishes no error number for it.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Any

from drivers.trackers.lmf_objects import Handlers, describe, unwrap
from drivers.trackers.protocol import StreamLimits, TargetLost, Track, TrackerError

LIMITS = StreamLimits(1e-3, 1.0)
"""Intervals between two points: an AT960 measures at most 1000 points a second."""
CONTINUOUS_PROFILE = "ContinuousTimeProfile"
_ENDS_WITHIN_S = 5.0
_LOST = "beam"


class Following:
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


def continuous_profile(tracker: Any) -> Any:
    """Return LMF's profile of a continuous measurement; None if this tracker has none."""
    return next((one for one in unwrap(tracker.Measurement.Profiles) if type(one).__name__ == CONTINUOUS_PROFILE), None)
