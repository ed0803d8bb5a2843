"""What a person asks of a running job that moves arms: pause, resume, stop, abort.

``pause``
    Finish the present stop, then wait with the arms at rest. ``resume`` continues.
``stop``
    Brake all arms now. A job that holds then waits for ``resume`` or ``abort``; another ends and can be resumed later.
``abort``
    Brake all arms now and end the job.
"""

from __future__ import annotations

import json
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, NamedTuple, get_args

from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.progress import Cancelled, CancelToken, CellLive, Halt

# -- Ask the job that runs in a run's folder for something, from another process on the same computer -----------------
#
# A file in the folder, which only its owner may read, has the port and a random token of the job: a request never
# reaches a later job, and nobody else can send one. A stop must not wait for packages that it does not need: this
# module imports little, and nothing that it imports does otherwise.

Verb = Literal["pause", "resume", "stop", "abort"]
VERBS: tuple[Verb, ...] = get_args(Verb)
LOOK: Literal["look"] = "look"
"""Asks nothing of the job, but its state: a ``JobSeen`` as JSON."""
DONE = "done"
"""First word of the answer to a request that was carried out; a sentence follows."""
RUNS_NOW = "a job that runs now"
"""How a job of this computer is called in lists."""
JOB_FILE = "running-job.json"
LONGEST_LINE = 2000
"""Bytes of a request or its answer; far more than a token and a verb, or a state, have."""
PATIENCE_S = 2.0
"""A job answers in milliseconds: its brakes are commanded without waiting for rest."""

_RUN_FILE = "run.sqlite"
"""As ``cellapp.cell.run`` names it, which imports much."""
_GLANCE_S = 1.0
"""Patience of a list of runs, which only shows whether a job is there. A job that computes on a busy computer was taken
for one that does not answer after 0.2 s."""


class JobAddress(NamedTuple):
    """Where a job listens: the computer on which it runs, its process there (0: not stated), port and token."""

    computer: str
    process: int
    port: int
    token: str

    @property
    def is_here(self) -> bool:
        """Whether the job runs on this computer."""
        return self.computer == this_computer()

    @property
    def is_own(self) -> bool:
        """Whether the job runs in this very process."""
        return self.is_here and self.process == os.getpid()


class JobSeen(NamedTuple):
    """State of a job, as it tells other processes.

    ``name`` is what it does, as one word; ``request`` the request of a person that stands; ``holds`` whether it waits
    after a halt; ``has_brakes`` whether arms are open; ``state`` and ``reason`` are of its last ``StateChange``;
    ``part``, ``done``, ``total`` and ``note`` of its last event.
    """

    name: str
    request: Literal["none", "pause", "stop", "abort"]
    holds: bool
    has_brakes: bool
    state: Literal["running", "pausing", "paused", "suspended", "stopped", "aborted"] = "running"
    reason: str = ""
    part: str = ""
    done: int = 0
    total: int = 0
    note: str = ""


class NoJob(InputError):
    """No job runs in the folder."""


def this_computer() -> str:
    """The name of this computer."""
    return socket.gethostname()


def ask_running_job(folder: Path, verb: Verb) -> str:
    """Send a request to the job that runs in ``folder``; return its answer, a sentence.

    Raises
    ------
    InputError
        If no job runs there, or the request does not fit its state.
    HardwareError
        If a job listens but does not answer: its arms may move.
    """
    if not (folder / _RUN_FILE).is_file():
        raise InputError(f"{folder}: no run is here; name the folder of a run")
    address = address_of_job(folder)
    if address is None:
        raise NoJob(f"no job runs in {folder}")
    if not address.is_here:
        raise InputError(f"the job in {folder} runs on computer '{address.computer}'; give the command there")
    answer = exchange(folder, address, verb, PATIENCE_S)
    if answer is None:
        raise NoJob(f"no job runs in {folder}; the last one has ended")
    word, _, text = answer.partition(" ")
    if word != DONE:
        raise InputError(f"{folder}: {text or 'the request was refused'}")
    return text


def look_at_job(folder: Path) -> JobSeen | None:
    """Return the state of the job that runs in ``folder`` on this computer; None if none does.

    Raises
    ------
    HardwareError
        If a job listens but does not answer.
    InputError
        If it is of a version that tells its state otherwise.
    """
    address = address_of_job(folder)
    answer = None if address is None or not address.is_here else exchange(folder, address, LOOK, PATIENCE_S)
    if answer is None:
        return None
    try:
        return JobSeen(**json.loads(answer.partition(" ")[2]))
    except (ValueError, TypeError):
        raise InputError(
            f"the job in {folder} is of another version of cellapp; look at it with that one. 'cellapp stop {folder}'"
            " stops it all the same"
        ) from None


def who_uses(folder: Path) -> str:
    """Which job uses a run's folder, as a phrase; empty if none does. The job itself is not asked for anything."""
    address = address_of_job(folder)
    if address is None:
        return ""
    if not address.is_here:
        return f"a job on computer '{address.computer}', if it still runs"
    try:
        return "" if exchange(folder, address, LOOK, _GLANCE_S) is None else RUNS_NOW
    except HardwareError:
        return "a job that does not answer"


def address_of_job(folder: Path) -> JobAddress | None:
    """Read where the job of a folder listens; None without a readable file. The job may have ended since."""
    try:
        found = json.loads((folder / JOB_FILE).read_text(encoding="utf-8"))
        process = int(found.get("process", 0))  # files of earlier versions do not state it
        return JobAddress(str(found["computer"]), process, int(found["port"]), str(found["token"]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def exchange(folder: Path, address: JobAddress, request: str, patience_s: float) -> str | None:
    """Send one request and return the answer; None if nobody listens or it is not that job.

    Raises ``HardwareError`` if somebody listens and is silent.
    """
    try:
        with socket.create_connection(("127.0.0.1", address.port), patience_s) as connection:
            connection.sendall(f"{address.token} {request}\n".encode())
            with connection.makefile("rb") as reader:
                answer = reader.readline(LONGEST_LINE)
    except TimeoutError:
        raise HardwareError(
            f"the job in {folder} did not answer within {patience_s:g} s; if an arm moves, press its emergency"
            f" stop. If no job runs there, delete {folder / JOB_FILE}"
        ) from None
    except (OSError, OverflowError):
        return None
    return answer.decode("utf-8", "replace").strip() or None


Request = Literal["none", "pause", "stop", "abort"]


class Stopped(Cancelled):
    """A person stopped the arms; the run can be resumed."""


class Aborted(Cancelled):
    """A person ended the job; the arms were braked, and the run can be resumed later."""


class JobControl(CancelToken):
    """The request that stands, and the way to the brakes. All methods may be called from any thread.

    A signal handler must call ``stop`` in a thread of its own: a lock of this object may be held by the code it
    interrupts.

    Parameters
    ----------
    holds : bool
        Whether a person attends the job and may resume it after ``stop``. Otherwise ``stop`` ends the job.
    """

    def __init__(self, *, holds: bool = False) -> None:
        super().__init__()
        self.holds = holds
        self._request: Request = "none"
        self._changed = threading.Condition()
        self._brakes: list[Callable[[str], None]] = []
        self._holding = 0  # brakes after which the job can hold
        self._looks: list[Callable[[], CellLive]] = []
        self._record: Callable[[str, Halt], None] = lambda arm, halt: None
        self._left = ""

    @property
    def request(self) -> Request:
        """The request that stands."""
        return self._request

    @property
    def left(self) -> str:
        """How the person who attended the job went away, in words; empty while nobody did."""
        return self._left

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
        if self._left:
            return
        self._left = how  # before the brakes, which ask for it
        self.holds = False
        self.stop()

    def hold(self) -> None:
        """Ask for a person's ``resume`` after the cell stopped by itself; the arms brake already."""
        self._set("stop", replaces=("none", "pause", "stop"))

    def abort(self) -> None:
        """Brake all arms now and end the job."""
        self._set_and_brake("abort", replaces=("none", "pause", "stop", "abort"), ends=True)

    def cancel(self) -> None:
        """End the job: ``abort``, for callers that know only a cancel token."""
        self.abort()

    def check(self) -> None:
        """Raise ``Stopped`` or ``Aborted`` if the job has to end."""
        if self._request == "abort":
            raise Aborted("aborted on request")
        if self._request == "stop" and self.cancelled:
            raise Stopped(self._left or "stopped on request")

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
