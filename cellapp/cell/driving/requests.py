"""Requests to a running job from other processes.

Receive a person's requests to the job in a run's folder from other processes of this computer: the job's side.

The job listens on a loopback port, which ``ground.job_client`` publishes.

Run a job in a run's folder: other processes can reach it, and the run records how each arm's halt ended.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import os
import secrets
import socketserver
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import IO, NamedTuple

from cellapp.cell.run import RunFile
from cellapp.cell.run.run_arms import note_halt
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.job_client import (
    DONE,
    JOB_FILE,
    LONGEST_LINE,
    LOOK,
    PATIENCE_S,
    VERBS,
    JobAddress,
    JobSeen,
    Verb,
    address_of_job,
    exchange,
    taken,
    this_computer,
)
from cellapp.ground.progress import Listener, Progress, StateChange
from cellapp.ground.shell import shell_word

_LOCK_AGAIN_S, _LOCK_TRIES = 0.001, 50
_POLL_S = 0.05
"""Period [s] in which the server checks whether the job has ended."""
_MOST_WORDS = 300
"""Characters of a reason or a note that are told; both fit a line."""


class Answer(NamedTuple):
    """Answer to a request: whether it was carried out, and a sentence."""

    carried_out: bool
    text: str


@contextlib.contextmanager
def taking_requests(folder: Path, control: JobControl, name: str = "job") -> Iterator[None]:
    """Let other processes send requests to this job, which runs in ``folder``, while the context is open.

    ``name`` is what the job does, as one word. What other processes may ask for is kept of its events.

    Raises
    ------
    InputError
        If another job runs there or may run there, or the folder cannot be written.
    HardwareError
        If another job runs there and does not answer.
    """
    _refuse_second(folder)
    token = secrets.token_urlsafe(32)
    with _Server(control, token, name) as server, contextlib.ExitStack() as stack:

        def hear(event: Progress, listener: Listener) -> None:
            listener(event)
            server.note(event)

        thread = threading.Thread(target=server.serve_forever, args=(_POLL_S,), name="requests", daemon=True)
        thread.start()
        stack.callback(thread.join)
        stack.callback(server.shutdown)
        stack.enter_context(
            _published(folder / JOB_FILE, JobAddress(this_computer(), os.getpid(), server.server_address[1], token))
        )
        stack.enter_context(control.heard_by(hear))
        yield


def _refuse_second(folder: Path) -> None:
    """Raise if another job runs in a folder, or may run there; remove the file that a killed job left."""
    path, address = folder / JOB_FILE, address_of_job(folder)
    if address is not None and not address.is_here:
        raise InputError(
            f"{folder}: a job on computer '{address.computer}' uses this run; wait for its end. If it has ended, delete"
            f" {path}"
        )
    if address is not None and exchange(folder, address, LOOK, PATIENCE_S) is not None:
        raise _another(folder)
    with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
        if not _locked(file):
            raise _another(folder)
        _remove(path, file)


def _another(folder: Path) -> InputError:
    return InputError(f"{folder}: another job runs here; 'cellapp stop {shell_word(folder)}' stops it")


class _Server(socketserver.ThreadingTCPServer):
    """Server with one thread per request, so that a slow one does not delay a stop."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 32

    def __init__(self, control: JobControl, token: str, name: str) -> None:
        super().__init__(("127.0.0.1", 0), _Request)
        self.control, self.token, self._name = control, token, name
        self._newest = Progress(name, 0, 0)
        self._state = StateChange("running", "")

    def note(self, event: Progress) -> None:
        """Keep an event for those who ask how far the job is."""
        if isinstance(event.detail, StateChange):
            self._state = event.detail
        else:
            self._newest = event

    def seen(self) -> JobSeen:
        """Return the state of the job."""
        control, newest, state = self.control, self._newest, self._state
        return JobSeen(
            self._name, control.request, control.holds, control.has_brakes, state.state, state.reason[:_MOST_WORDS],
            newest.job, newest.done, newest.total, newest.note[:_MOST_WORDS],
        )  # fmt: skip


class _Request(socketserver.StreamRequestHandler):
    """One line with token and verb, answered by one line."""

    timeout = PATIENCE_S
    server: _Server

    def handle(self) -> None:
        with contextlib.suppress(OSError):  # the client has gone, or it is silent
            given, _, asked = self.rfile.readline(LONGEST_LINE).strip().partition(b" ")
            if not hmac.compare_digest(given, self.server.token.encode()):
                return
            verb = asked.decode("utf-8", "replace")
            if verb == LOOK:
                answer = Answer(True, json.dumps(self.server.seen()._asdict(), default=int))  # numpy's integers, too
            else:
                answer = answer_to(self.server.control, verb)
            self.wfile.write(f"{DONE if answer.carried_out else 'refused'} {answer.text}\n".encode())


def answer_to(control: JobControl, verb: str) -> Answer:
    """Carry out a request and return the answer, or refuse it with a reason."""
    if verb not in VERBS:
        return Answer(False, f"'{verb}' is no request; requests are {', '.join(VERBS)}")
    if refusal := _refusal(control, verb):
        return Answer(False, refusal)
    brake = "all arms brake" if control.has_brakes else "no arm is open"
    control.ask(verb)
    match verb:
        case "pause":
            text = "pause: the arms rest after the present stop; 'cellapp job resume DIR' continues"
        case "resume":
            text = "resume: the job continues"
        case "stop":
            then = "the job waits for 'resume' or 'abort'" if control.holds else "the job ends and can be resumed later"
            text = f"stopped: {brake}; {then}"
        case "abort":
            text = f"aborted: {brake}; the job ends"
    return Answer(True, text)


def _refusal(control: JobControl, verb: Verb) -> str:
    """Return why a request does not fit the state of the job; empty if it does."""
    before = control.request
    if verb in ("pause", "resume") and before == "abort":
        return "the job was aborted and ends"
    if verb in ("pause", "resume") and before == "stop" and not control.holds:
        return "the job was stopped and ends; 'cellapp collect DIR --resume' continues later"
    if verb == "pause" and before != "none":
        return "the job is paused already" if before == "pause" else "the job is stopped already"
    return "the job is neither paused nor stopped" if verb == "resume" and before == "none" else ""


@contextlib.contextmanager
def _published(path: Path, address: JobAddress) -> Iterator[None]:
    """Tell in a new file, which is locked as long as this context is open, where the job listens."""
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600)
    except FileExistsError:  # a job that began meanwhile
        raise _another(path.parent) from None
    except OSError as error:
        raise _unwritable(path, error) from error
    with os.fdopen(handle, "w+b", buffering=0) as file:
        try:
            if not (_locked(file) and _is_at(path, file)):  # a job that begins now may take it for a killed one's
                raise _another(path.parent)
            try:
                file.write(json.dumps(address._asdict()).encode())
            except OSError as error:
                raise _unwritable(path, error) from error
            yield
        finally:
            _remove(path, file)


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot be written ({error.strerror}); check the folder's rights and the disk's space")


def _locked(file: IO[bytes]) -> bool:
    """Lock a job file for the job; return False if another one holds it. Who only looks holds it for an instant."""
    for _ in range(_LOCK_TRIES):
        if taken(file, alone=True):
            return True
        time.sleep(_LOCK_AGAIN_S)
    return False


def _is_at(path: Path, file: IO[bytes]) -> bool:
    with contextlib.suppress(OSError):
        return os.path.samestat(os.fstat(file.fileno()), os.stat(path))
    return False


def _remove(path: Path, file: IO[bytes]) -> None:
    """Remove a job file whose lock is held, unless another one has its name: that is not ours."""
    if _is_at(path, file):
        with contextlib.suppress(OSError):  # one left behind is harmless: nobody holds it
            path.unlink()


@contextlib.contextmanager
def running_job(run: RunFile, control: JobControl, name: str) -> Iterator[None]:
    """While the context is open, take requests of other processes and record arms that were not seen at rest.

    Raise as ``taking_requests``.
    """
    control.run = run.folder.resolve().name
    with control.recording(partial(note_halt, run)), taking_requests(run.folder, control, name):
        yield
