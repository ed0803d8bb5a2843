"""Watch a job that runs in another process of this computer, and send it requests as if it were one's own.

remote = attach(folder)
remote.follow(listener)  # in a thread of its own, until the job ends or somebody calls ``remote.leave``
remote.stop()  # from any thread
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from cellapp.cell.driving.requests.job_stream import Answer, Ending, Heartbeat, Line, decode
from cellapp.ground.asking import PATIENCE_S, WATCH, JobAddress, NoJob, Verb, address_of_job, silent_job
from cellapp.ground.control import Aborted, JobControl, Stopped
from cellapp.ground.errors import CellappError, CheckFailed, HardwareError, InputError
from cellapp.ground.progress import CancelToken, CellLive, Listener, Progress

_SILENT_S = 1.0
"""Time without data [s] after which a job counts as silent: a running job sends five times a second."""
_MOST_READ = 65536
_FAILURES = {kind.exit_code: kind for kind in (CheckFailed, InputError, HardwareError)}


class Detached(Exception):
    """This process no longer watches the job; the job goes on."""


class RemoteControl(JobControl):
    """Control of a job in another process: requests are sent over a connection that stays open.

    ``request``, ``holds``, ``has_brakes``, ``cancelled`` and ``live()`` are as last received from that process, or as a
    request that it has not answered yet will make them.

    Attributes
    ----------
    name : str
        What the job does, as one word.
    process : int
        Id of the process that runs it.
    """

    def __init__(self, folder: Path, process: int, connection: socket.socket) -> None:
        super().__init__()
        self.folder, self.process = folder, process
        self._connection, self._begun = connection, b""
        self._beat = Heartbeat("", "none", True, False, False)
        self._heard_s = time.monotonic()
        self._sending = threading.Lock()
        self._asked = self._answered = 0
        self._unheard: Verb | None = None
        self._heard = self._lines()

    @property
    def name(self) -> str:
        """What the job does, as one word."""
        return self._beat.name

    @property
    def has_brakes(self) -> bool:
        """Whether the other process has opened arms."""
        return self._beat.has_brakes

    @property
    def can_hold(self) -> bool:
        """Whether the job could wait after a halt."""
        return self.has_brakes

    @property
    def age_s(self) -> float:
        """Time since the last data from the other process [s]; more than 1 s is a doubt."""
        return time.monotonic() - self._heard_s

    # -- requests: first sent, then assumed here -----------------------------------------------------------------------

    def pause(self) -> None:
        """Ask the job to wait after the current stop."""
        self._send("pause")
        super().pause()

    def resume(self) -> None:
        """Let a paused or stopped job continue."""
        self._send("resume")
        super().resume()

    def stop(self) -> None:
        """Brake all arms of the job now. If the process is gone, ``follow`` reports that the request was lost."""
        self._send("stop")
        super().stop()

    def abort(self) -> None:
        """Brake all arms of the job now and end it."""
        self._send("abort")
        super().abort()

    def leave(self, how: str = "") -> None:
        """Stop watching. The job goes on: another person attends it."""
        self._left = how or "left"
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the connection to a job that was never followed."""
        self.leave()
        self._connection.close()

    def _send(self, verb: Verb) -> None:
        with self._sending:
            self._asked += 1  # before sending: a heartbeat in transit does not include this request yet
            try:
                self._connection.sendall(f"{verb}\n".encode())
            except OSError:
                self._unheard = verb

    def live(self) -> CellLive | None:
        """Return what the other process last sent of its cell, with ages increased by the time since then."""
        live, age_s = self._beat.live, self.age_s
        if live is None:
            return None
        arms = {name: replace(arm, age_s=_older(arm.age_s, age_s)) for name, arm in live.arms.items()}
        return replace(
            live, arms=arms, tracker_age_s=_older(live.tracker_age_s, age_s), job_age_s=live.job_age_s + age_s
        )

    # -- what the other process says -----------------------------------------------------------------------------------

    def begin(self) -> None:
        """Wait for the first line. Raise ``InputError`` if the job has ended or refuses, ``HardwareError`` if it is
        silent."""
        for line in self._heard:
            if line is None:
                raise silent_job(self.folder, PATIENCE_S)
            if isinstance(line, Answer):
                raise InputError(f"{self.folder}: {line.text}")
            self._take(line)
            return
        raise NoJob(f"no job runs in {self.folder}; the last one has ended")

    def follow(self, listener: Listener, say: Callable[[str], None]) -> None:
        """Pass the job's events to ``listener`` until it ends, and messages about the connection to ``say``.

        Raises
        ------
        Cancelled
            If the job was stopped or aborted.
        CellappError
            If the job failed; ``HardwareError`` also if its process is gone without a last message.
        Detached
            After ``leave``.
        """
        self._connection.settimeout(_SILENT_S)
        silent = False
        with self._connection:
            for line in self._heard:
                if line is None and not silent:
                    say(self._silence())
                silent = line is None
                if isinstance(line, Ending):
                    self._raise(line)
                    return
                if isinstance(line, Progress):
                    listener(line)
                elif isinstance(line, Answer) and not line.carried_out:
                    say(f"{line.verb}: refused: {line.text}.")
                if line is not None:
                    self._take(line)
        if self._left:
            raise Detached
        raise HardwareError(self._gone())

    def _take(self, line: Line) -> None:
        self._heard_s = time.monotonic()
        if isinstance(line, Answer):
            self._answered += 1
        elif isinstance(line, Heartbeat):
            self._beat, self.holds = line, line.holds
            if self._asked == self._answered:
                with self._changed:
                    self._request = line.request
                    self._changed.notify_all()
            if line.ends:
                CancelToken.cancel(self)

    def _lines(self) -> Iterator[Line | None]:
        """Yield what the other process sends until the connection ends; None after each silence."""
        while True:
            try:
                data = self._connection.recv(_MOST_READ)
            except TimeoutError:
                yield None
                continue
            except OSError:
                return
            if not data:
                return
            *lines, self._begun = (self._begun + data).split(b"\n")
            for line in lines:
                yield self._decoded(line)

    def _decoded(self, line: bytes) -> Line:
        try:
            return decode(line)
        except ValueError as error:
            raise InputError(
                f"process {self.process}, which runs '{self.name}' in {self.folder}, is another version of cellapp"
                f" ({error}); watch it with that one. 'cellapp stop {self.folder}' stops it all the same"
            ) from error

    def _raise(self, ending: Ending) -> None:
        match ending.how:
            case "stopped":
                raise Stopped(ending.text)
            case "aborted":
                raise Aborted(ending.text)
            case "failed":
                raise _FAILURES.get(ending.exit_code, CellappError)(ending.text)

    def _silence(self) -> str:
        asked = "; it has not answered a request" if self._asked > self._answered else ""
        return (
            f"Process {self.process}, which runs '{self.name}', has been silent for {_SILENT_S:g} s{asked}. It may hang"
            " or be suspended: if an arm moves, press its emergency stop."
        )

    def _gone(self) -> str:
        unheard = "" if self._unheard is None else f"; '{self._unheard}' did not reach it"
        return (
            f"process {self.process}, which ran '{self.name}' in {self.folder}, is gone without a word{unheard}. If an"
            " arm moves, press its emergency stop; the run keeps what was stored"
        )


def _older(age_s: float | None, by_s: float) -> float | None:
    return None if age_s is None else age_s + by_s


def attach(folder: Path) -> RemoteControl:
    """Connect to the job that another process runs in ``folder``.

    Raises
    ------
    InputError
        If no job runs there (``NoJob``), it runs on another computer or in this process, or too many clients watch it.
    HardwareError
        If a job listens but does not answer.
    """
    address = address_of_job(folder)
    if address is None:
        raise NoJob(f"no job runs in {folder}")
    if not address.is_here:
        raise InputError(f"the job in {folder} runs on computer '{address.computer}'; watch it there")
    if address.is_own:
        raise InputError(f"the job in {folder} is one of this program")
    return _connected(folder, address)


def _connected(folder: Path, address: JobAddress) -> RemoteControl:
    with contextlib.ExitStack() as undo:
        try:
            connection = undo.enter_context(socket.create_connection(("127.0.0.1", address.port), PATIENCE_S))
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.sendall(f"{address.token} {WATCH}\n".encode())
        except (OSError, OverflowError):
            raise NoJob(f"no job runs in {folder}; the last one has ended") from None
        remote = RemoteControl(folder, address.process, connection)
        remote.begin()
        undo.pop_all()
    return remote
