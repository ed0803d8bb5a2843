"""A thread for calls that may hang; every wait for a call has a time limit."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, cast

from drivers.trackers.protocol import Halted, TrackerLinkLost, TrackerTimeout

_T = TypeVar("_T")

_LOOK_S = 0.05


@dataclass(eq=False)
class _Call(Generic[_T]):
    """One call and, when it is done, its return value or exception."""

    what: str
    function: Callable[[], _T]
    limit_s: float
    began_s: float
    started: bool = False
    done: bool = False
    result: _T | None = None
    error: BaseException | None = None

    def run(self) -> None:
        try:
            self.result = self.function()
        except BaseException as error:  # noqa: BLE001 - raised again in the thread that made the call
            self.error = error


class CallThread:
    """Runs calls one by one on one thread. A call that exceeds its time limit is abandoned; it blocks the next one."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._current: _Call[Any] | None = None
        self._halted = False
        self._closed = False
        self._returned_s = -math.inf
        threading.Thread(target=self._work, name="LMF", daemon=True).start()

    def call(self, what: str, function: Callable[[], _T], limit_s: float, *, haltable: bool = False) -> _T:
        """Run ``function``; return its value or raise its exception.

        Raises
        ------
        TrackerTimeout
            If it takes longer than ``limit_s``.
        TrackerLinkLost
            If the previous call has still not returned.
        Halted
            If ``haltable`` and ``halt`` is called meanwhile; the result of the call is then discarded.
        """
        call = _Call(what, function, limit_s, time.monotonic())
        with self._changed:
            previous = self._current
            if previous is not None and not self._wait_for(lambda: previous.done, previous.limit_s):
                raise TrackerLinkLost(
                    f"tracker: LMF has not returned from {previous.what}; disconnect, check that the tracker is on, and"
                    " connect again"
                )
            call.began_s = time.monotonic()
            self._current = call
            self._changed.notify_all()
            self._wait_for(lambda: call.done or (haltable and self._halted), limit_s)
            if haltable and self._halted:
                raise Halted("tracker: a halt was requested; no measurement was made")
            if not call.done:
                raise TrackerTimeout(f"tracker: {what} took longer than {limit_s:g} s")
        if call.error is not None:
            raise call.error
        return cast(_T, call.result)

    def _wait_for(self, done: Callable[[], bool], limit_s: float) -> bool:
        """Wait until ``done()``, holding ``_changed``; time in which this process was not scheduled does not count."""
        waited_s = 0.0
        while not done() and waited_s < limit_s:
            began_s = time.monotonic()
            self._changed.wait(min(_LOOK_S, limit_s - waited_s))
            waited_s += min(time.monotonic() - began_s, _LOOK_S)
        return done()

    def require_idle(self) -> None:
        """Raise ``TrackerTimeout`` while an abandoned call runs, ``TrackerLinkLost`` after its time limit."""
        call = self._current
        if call is None or call.done:
            return
        if time.monotonic() < call.began_s + call.limit_s:
            raise TrackerTimeout(f"tracker: LMF is still at work on {call.what}, which was given up; wait for its end")
        raise TrackerLinkLost(f"tracker: LMF has not returned from {call.what}; check that the tracker is on")

    def age_s(self) -> float:
        """Return the time since the last call returned without an error [s]; 0 while a call is within its time limit.

        Never blocks.
        """
        call, now = self._current, time.monotonic()
        if call is not None and not call.done and now < call.began_s + call.limit_s:
            return 0.0
        return now - self._returned_s

    def halt(self) -> None:
        """End the wait for a haltable call, now and until ``clear_halt``."""
        with self._changed:
            self._halted = True
            self._changed.notify_all()

    def clear_halt(self) -> None:
        """Allow haltable calls again."""
        with self._changed:
            self._halted = False

    def close(self) -> None:
        """Let the thread end after its current call."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._closed or (self._current is not None and not self._current.started)
                )
                call = self._current
                if call is None or call.started:
                    return
                call.started = True
            call.run()
            if call.error is None:
                self._returned_s = time.monotonic()
            with self._changed:
                call.done = True
                self._changed.notify_all()
