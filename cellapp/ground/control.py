"""What a person asks of a running job that moves arms: pause, resume, stop, abort.

``pause``
    Finish the present stop, then wait with the arms at rest. ``resume`` continues.
``stop``
    Brake all arms now. A job that holds then waits for ``resume`` or ``abort``; another ends and can be resumed later.
``abort``
    Brake all arms now and end the job.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

from cellapp.ground.job_client import Verb
from cellapp.ground.progress import Cancelled, CellLive, Halt, JobToken, Listener, ignore

Request = Literal["none", "pause", "stop", "abort"]


class Stopped(Cancelled):
    """A person stopped the arms; the run can be resumed."""


class Aborted(Cancelled):
    """A person ended the job; the arms were braked, and the run can be resumed later."""


class JobControl(JobToken):
    """The request that stands, and the way to the brakes. All methods may be called from any thread.

    A signal handler must call ``stop`` in a thread of its own: a lock of this object may be held by the code it
    interrupts.

    Parameters
    ----------
    listener : callable
        As in ``JobToken``.
    holds : bool
        Whether a person attends the job and may resume it after ``stop``. Otherwise ``stop`` ends the job.

    Attributes
    ----------
    run : str
        The run of the job, by which controllers name its programs; empty until it is known.
    """

    def __init__(self, listener: Listener = ignore, *, holds: bool = False) -> None:
        super().__init__(listener)
        self.holds = holds
        self.run = ""
        self._request: Request = "none"
        self._changed = threading.Condition()
        self._brakes: list[Callable[[str], None]] = []
        self._holding = 0  # brakes after which the job can hold
        self._looks: list[Callable[[], CellLive]] = []
        self._record: Callable[[str, Halt], None] = lambda arm, halt: None
        self._departure = ""

    @property
    def request(self) -> Request:
        """The request that stands."""
        return self._request

    @property
    def departure(self) -> str:
        """How the person who attended the job went away, in words; empty while nobody did."""
        return self._departure

    def ask(self, verb: Verb) -> None:
        """Do what a verb says."""
        {"pause": self.pause, "resume": self.resume, "stop": self.stop, "abort": self.abort}[verb]()

    @property
    def has_brakes(self) -> bool:
        """Whether arms are open that ``stop`` and ``abort`` brake."""
        return bool(self._brakes)

    @property
    def can_hold(self) -> bool:
        """Whether the job could wait after a halt: without open arms it has nothing to hold, and ends."""
        return self._holding > 0

    def pause(self) -> None:
        """Ask the job to wait after the present stop."""
        self._set("pause", replaces=("none",))

    def resume(self) -> None:
        """Let a paused or halted job continue; one that ends because of the halt ends all the same."""
        self._set("none", replaces=("pause",) if self.cancelled else ("pause", "stop"))

    def stop(self) -> None:
        """Brake all arms now."""
        attended = self.holds and self.can_hold
        self._set_and_brake("stop", replaces=("none", "pause", "stop"), ends=not attended)

    def leave(self, how: str) -> None:
        """Brake all arms now and end the job as stopped: the person who attended it goes away.

        ``how`` is recorded as the cause, in place of a person's STOP: "the terminal was closed". The first one counts;
        nothing resumes after it.
        """
        if self._departure:
            return
        self._departure = how  # before the brakes, which ask for it
        self.holds = False
        self.stop()

    def hold(self) -> None:
        """Ask for a person's ``resume`` after the cell stopped by itself; the arms brake already."""
        self._set("stop", replaces=("none", "pause", "stop"))

    def abort(self) -> None:
        """Brake all arms now and end the job."""
        self._set_and_brake("abort", replaces=("none", "pause", "stop", "abort"), ends=True)

    def cancel(self) -> None:
        """End the job: ``abort``, for callers that know only a ``JobToken``."""
        self.abort()

    def check(self) -> None:
        """Raise ``Stopped`` or ``Aborted`` if the job has to end."""
        if self._request == "abort":
            raise Aborted("aborted on request")
        if self._request == "stop" and self.cancelled:
            raise Stopped(self._departure or "stopped on request")

    def wait_while(self, *requests: Request, timeout_s: float | None = None) -> Request:
        """Wait while one of ``requests`` stands; return the request that stands then.

        A simulated person overrides this: it is the only place where a job waits for a person in real time.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._request not in requests, timeout_s)
        return self._request

    def wait(self, timeout_s: float) -> bool:
        """Rest for at most ``timeout_s``, less if a person stops or aborts; whether somebody did."""
        with self._changed:
            return self._changed.wait_for(lambda: self._request in ("stop", "abort"), timeout_s)

    @contextmanager
    def brakes(self, brake: Callable[[str], None], *, holds: bool = True) -> Iterator[None]:
        """Call ``brake(verb)`` at once on ``stop`` and ``abort``, in the caller's thread, while this context is open.

        A request that already stands calls it at once. Without ``holds`` a halt ends the job even where a person
        attends it: the cell is not open yet.
        """
        self._brakes.append(brake)
        self._holding += holds
        try:
            if self._request in ("stop", "abort"):
                brake(self._request)
            yield
        finally:
            self._brakes.remove(brake)
            self._holding -= holds

    # -- what is known of the cell now ---------------------------------------------------------------------------------

    @contextmanager
    def watching(self, look: Callable[[], CellLive]) -> Iterator[None]:
        """Let ``live`` ask ``look`` while this context is open: a cell is open. It returns at once, in any thread."""
        self._looks.append(look)
        try:
            yield
        finally:
            self._looks.remove(look)

    def live(self) -> CellLive | None:
        """Return what is known of the open cell now; None while none is open."""
        looks = tuple(self._looks)
        return looks[-1]() if looks else None

    @contextmanager
    def recording(self, record: Callable[[str, Halt], None]) -> Iterator[None]:
        """Let ``record`` take the end of each arm's halt, while this context is open; from any thread."""
        self._record, before = record, self._record
        try:
            yield
        finally:
            self._record = before

    def note_halt(self, arm: str, halt: Halt) -> None:
        """Take the end of an arm's halt: it was seen at rest, or was not."""
        self._record(arm, halt)

    def _set_and_brake(self, verb: Literal["stop", "abort"], replaces: tuple[Request, ...], *, ends: bool) -> None:
        """Set the request, then brake: a job that sees its arms stopped must find who asked for it.

        Setting takes microseconds, and nothing that holds the lock waits. Brakes that open later see the request.
        """
        self._set(verb, replaces)
        if ends:
            super().cancel()
        for brake in tuple(self._brakes):
            brake(verb)

    def _set(self, request: Request, replaces: tuple[Request, ...]) -> None:
        """Set the request if one of ``replaces`` stands: a late ``resume`` must not undo an ``abort``."""
        with self._changed:
            if self._request in replaces:
                self._request = request
                self._changed.notify_all()
