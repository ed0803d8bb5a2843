"""One thread that makes calls which may hang, and waits for them that always end."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Generic, TypeVar, cast

from drivers.trackers.protocol import Halted, TrackerLinkLost, TrackerTimeout

_T = TypeVar("_T")


@dataclass(eq=False)
class _Job(Generic[_T]):
    """One call and, once it is done, what it returned or raised."""

    what: str
    function: Callable[[], _T]
    limit_s: float
    taken: bool = False
    done: bool = False
    result: _T | None = None
    error: BaseException | None = None

    def run(self) -> None:
        with self:
            self.result = self.function()

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> bool:
        self.error = error
        return True  # it is raised again where the call was made


class Commands:
    """Runs calls one by one on one thread. One that does not come back in time is left alone, and blocks the next."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._job: _Job[Any] | None = None
        self._halted = False
        self._closed = False
        threading.Thread(target=self._work, name="LMF", daemon=True).start()

    def call(self, what: str, function: Callable[[], _T], limit_s: float, *, heeds_halt: bool = False) -> _T:
        """Run ``function`` and hand on what it returns or raises.

        Raises
        ------
        TrackerTimeout
            If it takes longer than ``limit_s``.
        TrackerLinkLost
            If an earlier one has still not come back.
        Halted
            If somebody halts meanwhile; what it returns then is thrown away.
        """
        job = _Job(what, function, limit_s)
        with self._changed:
            earlier = self._job
            if earlier is not None and not self._changed.wait_for(lambda: earlier.done, timeout=earlier.limit_s):
                raise TrackerLinkLost(
                    f"tracker: LMF has not come back from {earlier.what}; disconnect, see that the tracker is on, and"
                    " connect again"
                )
            self._job = job
            self._changed.notify_all()
            self._changed.wait_for(lambda: job.done or (heeds_halt and self._halted), timeout=limit_s)
            if heeds_halt and self._halted:
                raise Halted("tracker: it was told to halt; there is no measurement")
            if not job.done:
                raise TrackerTimeout(f"tracker: {what} took longer than {limit_s:g} s")
        if job.error is not None:
            raise job.error
        return cast(_T, job.result)

    def halt(self) -> None:
        with self._changed:
            self._halted = True
            self._changed.notify_all()

    def begin(self) -> None:
        """Forget an earlier halt."""
        with self._changed:
            self._halted = False

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or (self._job is not None and not self._job.taken))
                job = self._job
                if job is None or job.taken:
                    return
                job.taken = True
            job.run()
            with self._changed:
                job.done = True
                self._changed.notify_all()
