"""Watch the tracker of an open cell: if it dies while the arms move, the cell stops at once."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import NoReturn, ParamSpec, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.trackers.protocol import (
    NotReady,
    Point,
    Preparation,
    StreamingTracker,
    StreamLimits,
    Track,
    Tracker,
    TrackerError,
    TrackerIdentity,
    TrackerLinkLost,
    no_packet,
    stream_limits_of,
)

Died = Callable[[str], None]
"""Callback with the reason, as a sentence, from any thread."""
Watch = Callable[[Died], AbstractContextManager[None]]
"""Context that watches the tracker while it is open. A tracker that is dead already is reported before it opens."""

CONFIRM_WITHIN_S = 0.3
"""Timeout [s] after which a tracker counts as dead while the arms move; over a network it answers in milliseconds."""
_EVERY_S = 0.04
"""Period of the queries [s]: with the answers they take an eighth of a serial line of 115200 baud."""
_DEAD_EVERY_S = 0.5
"""Period of the queries of a dead tracker while the arms rest [s]."""
_LOOK_S = 0.05
_SILENT_S = 0.4
"""Longest time without an answer [s], in case a driver does not keep to ``CONFIRM_WITHIN_S``. It is counted in periods
of ``_LOOK_S`` that really ran: while this process is not scheduled, it neither counts nor sends queries."""
_ONE_ANSWER_S = 5.0
"""Longest wait [s] for a pending answer when a job calls the tracker, and at the end."""

_P = ParamSpec("_P")
_T = TypeVar("_T")


class TrackerMonitor:
    """Wrapper of a tracker that forwards calls and, between them, queries repeatedly whether the tracker answers.

    Queries never overlap with the job's calls: a call waits for at most one answer, and there are no queries during a
    call. Outside ``watching`` a silent tracker is not reported, but ``data_age_s`` grows.
    Queries are sent while the context is open.
    """

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._in_use = threading.Lock()
        self._over = threading.Event()
        self._asking = threading.Thread(target=self._ask, name="tracker watch", daemon=True)
        self._reporting = threading.Lock()
        self._died: Died | None = None
        self._heard = 0
        """Number of answers so far, to queries and calls."""
        self._calls = 0
        """Number of the job's calls in progress."""

    def __enter__(self) -> Self:
        self._asking.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._asking.join(_ONE_ANSWER_S)

    # -- the job's calls -----------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Call the tracker's ``connect``."""
        self._alone(self._tracker.connect)

    def identify(self) -> TrackerIdentity:
        """Call the tracker's ``identify``."""
        return self._alone(self._tracker.identify)

    def prepare(self, settings: Preparation) -> None:
        """Call the tracker's ``prepare``."""
        self._alone(self._tracker.prepare, settings)

    def unmet(self) -> list[str]:
        """Call the tracker's ``unmet``."""
        return self._alone(self._tracker.unmet)

    def confirm(self, within_s: float = CONFIRM_WITHIN_S) -> None:
        """Check that the tracker answers now, as ``Tracker.confirm``."""
        self._alone(self._tracker.confirm, within_s)

    def data_age_s(self) -> float:
        """Return the age of the newest sign of life [s], as ``Tracker.data_age_s``."""
        return self._tracker.data_age_s()

    def measure(self, expected_M: NDArray[np.float64], averaging_s: float) -> Point:
        """Call the tracker's ``measure``."""
        return self._alone(self._tracker.measure, expected_M, averaging_s)

    def stream_limits(self) -> StreamLimits | None:
        """Return the limits of the tracker's stream; None if it cannot measure a moving SMR."""
        return self._alone(stream_limits_of, self._tracker)

    def start_track(
        self,
        expected_M: NDArray[np.float64],
        interval_s: float,
        lost: Callable[[TrackerError], None],
        received: Callable[[Track], None] = no_packet,
    ) -> None:
        """Call the tracker's ``start_track``, if it has ``stream_limits``."""
        assert isinstance(self._tracker, StreamingTracker)
        self._alone(self._tracker.start_track, expected_M, interval_s, lost, received)

    def end_track(self) -> Track:
        """Call the tracker's ``end_track``, if it has ``stream_limits``."""
        assert isinstance(self._tracker, StreamingTracker)
        return self._alone(self._tracker.end_track)

    def halt(self) -> None:
        """End the running measurement at once; may be called from any thread."""
        self._tracker.halt()

    def disconnect(self) -> None:
        """Call the tracker's ``disconnect``."""
        self._alone(self._tracker.disconnect)

    def _alone(self, call: Callable[_P, _T], *args: _P.args, **kwargs: _P.kwargs) -> _T:
        """Call the tracker when no query is pending. Raise ``TrackerLinkLost`` if a query does not end."""
        self._calls += 1  # calls come one at a time
        try:
            if not self._in_use.acquire(timeout=_ONE_ANSWER_S):
                raise TrackerLinkLost(f"tracker: its driver has not answered a question for {_ONE_ANSWER_S:g} s")
            try:
                return call(*args, **kwargs)
            finally:
                self._in_use.release()
        finally:
            self._calls -= 1

    # -- watching ------------------------------------------------------------------------------------------------------

    @contextmanager
    def watching(self, died: Died) -> Iterator[None]:
        """Call ``died`` once if the tracker does not answer now, or dies or falls silent before the context ends."""
        over = threading.Event()
        listening = threading.Thread(target=self._listen, args=(over,), name="tracker watch limit", daemon=True)
        self._died = died
        try:
            self.confirm()
        except TrackerError as error:
            self._report(str(error))
        listening.start()
        try:
            yield
        finally:
            with self._reporting:
                self._died = None
            over.set()
            listening.join()

    def _report(self, reason: str) -> None:
        with self._reporting:
            died, self._died = self._died, None
        if died is not None:
            died(reason)

    def _ask(self) -> None:
        """Query the tracker repeatedly while the job makes no call."""
        again_s = 0.0
        while not self._over.wait(_EVERY_S):
            at_rest = self._died is None
            if (at_rest and time.monotonic() < again_s) or not self._in_use.acquire(blocking=False):
                continue
            problem = ""
            try:
                self._tracker.confirm(CONFIRM_WITHIN_S)
                self._heard += 1
            except TrackerError as error:
                problem = str(error)
            finally:
                self._in_use.release()
            if problem:
                self._report(problem)
                again_s = time.monotonic() + _DEAD_EVERY_S

    def _listen(self, over: threading.Event) -> None:
        """Report silence, even while a query hangs."""
        heard, looks = self._heard, 0
        while not over.wait(_LOOK_S):
            looks += 1
            if self._heard != heard or self._calls:
                heard, looks = self._heard, 0
            elif looks * _LOOK_S >= _SILENT_S:
                self._report(f"tracker: no answer for {_SILENT_S:g} s while the arms moved")
                return


@contextmanager
def unwatched(tracker: Tracker, died: Died) -> Iterator[None]:
    """Query the tracker once, before the arms move: in a simulated cell all calls come from one thread."""
    try:
        tracker.confirm(CONFIRM_WITHIN_S)
    except TrackerError as error:
        died(str(error))
    yield


# -- Tracker for cells whose arms are driven without one --------------------------------------------------------------


class UnaskedTracker:
    """Placeholder in a cell whose tracker is not connected: it measures nothing and stops nothing."""

    def connect(self) -> None:
        """Do nothing."""

    def identify(self) -> NoReturn:
        """Raise ``NotReady``."""
        self._refuse()

    def prepare(self, settings: Preparation) -> None:
        """Do nothing."""

    def unmet(self) -> list[str]:
        """Return that the tracker is not used."""
        return ["the tracker is not asked"]

    def confirm(self, within_s: float) -> None:
        """Do nothing: no job depends on this tracker."""

    def data_age_s(self) -> float:
        """Return infinity: there are no data."""
        return math.inf

    def measure(self, expected_M: NDArray[np.float64], averaging_s: float) -> NoReturn:
        """Raise ``NotReady``."""
        self._refuse()

    def halt(self) -> None:
        """Do nothing."""

    def disconnect(self) -> None:
        """Do nothing."""

    def _refuse(self) -> NoReturn:
        raise NotReady("the tracker is not asked in a rehearsal")
