"""Requests to a running job from other processes.

Receive a person's requests to the job in a run's folder from other processes of this computer: the job's side.

The job listens on a loopback port, which ``ground.asking`` publishes.

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
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

from cellapp.cell.run import RunFile
from cellapp.cell.run.unseen_arms import note_halt
from cellapp.ground.asking import (
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
    this_computer,
)
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.progress import Listener, Progress, StateChange, ignore

_POLL_S = 0.05
"""Period [s] in which the server checks whether the job has ended."""
_MOST_WORDS = 300
"""Characters of a reason or a note that are told; both fit a line."""


class Answer(NamedTuple):
    """Answer to a request: whether it was carried out, and a sentence."""

    carried_out: bool
    text: str


@contextlib.contextmanager
def taking_requests(
    folder: Path, control: JobControl, name: str = "job", listener: Listener = ignore
) -> Iterator[Listener]:
    """Let other processes send requests to this job, which runs in ``folder``, while the context is open.

    ``name`` is what the job does, as one word. Yield the listener to report to: it passes events to ``listener``, and
    keeps of them what other processes may ask for.

    Raises
    ------
    InputError
        If another job runs there, or the folder cannot be written.
    """
    _refuse_second(folder)
    token = secrets.token_urlsafe(32)
    with _Server(control, token, name) as server, contextlib.ExitStack() as stack:

        def listen(event: Progress) -> None:
            listener(event)
            server.note(event)

        thread = threading.Thread(target=server.serve_forever, args=(_POLL_S,), name="requests", daemon=True)
        thread.start()
        stack.callback(thread.join)
        stack.callback(server.shutdown)
        stack.callback(_withdraw, folder, token)
        _publish(folder, JobAddress(this_computer(), os.getpid(), server.server_address[1], token))
        yield listen


def _refuse_second(folder: Path) -> None:
    """Raise ``InputError`` if another job runs in a folder, or may run there on another computer."""
    address = address_of_job(folder)
    if address is None:
        return
    if not address.is_here:
        raise InputError(
            f"{folder}: a job on computer '{address.computer}' uses this run; wait for its end. If it has ended, delete"
            f" {folder / JOB_FILE}"
        )
    if exchange(folder, address, LOOK, PATIENCE_S) is not None:
        raise InputError(f"{folder}: another job runs here; 'cellapp stop {folder}' stops it")


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
            text = "pause: the arms rest after the present stop; 'cellapp resume DIR' continues"
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


def _publish(folder: Path, address: JobAddress) -> None:
    path = folder / JOB_FILE
    partial = path.with_name(f"{JOB_FILE}.part")
    try:
        partial.unlink(missing_ok=True)
        handle = os.open(partial, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            json.dump(address._asdict(), file)
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); check the folder's rights") from error


def _withdraw(folder: Path, token: str) -> None:
    address = address_of_job(folder)
    if address is not None and address.token == token:
        with contextlib.suppress(OSError):  # a file left behind is harmless: nobody answers at its port
            (folder / JOB_FILE).unlink()


@contextlib.contextmanager
def running_job(run: RunFile, control: JobControl, name: str, listener: Listener = ignore) -> Iterator[Listener]:
    """While the context is open, take requests of other processes and record arms that were not seen at rest.

    Yield the listener to report to. Raise as ``taking_requests``.
    """
    recording = control.recording(partial(note_halt, run))
    with recording, taking_requests(run.folder, control, name, listener) as heard:
        yield heard
