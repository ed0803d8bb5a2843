"""Requests of a person to the job that runs in a run's folder, from another process on the same computer.

The job listens on a loopback port. A file in the folder, which only its owner may read, has the port and a random token
of this job: a request never reaches a later job, and nobody else can send one.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import os
import platform
import secrets
import socket
import socketserver
import threading
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from cellapp.control import VERBS, JobControl, Verb
from cellapp.errors import HardwareError, InputError

JOB_FILE = "running-job.json"
_RUN_FILE = "run.sqlite"
"""As ``cellapp.run`` names it; importing that would make a stop wait for packages that it does not need."""
_PATIENCE_S = 2.0
"""A job answers in milliseconds: its brakes are commanded without waiting for rest."""
_GLANCE_S = 0.2
"""Patience of a list of runs, which only shows whether a job is there."""
_LONGEST_LINE = 500
"""Bytes; far more than a token and a verb have."""
_POLL_S = 0.05
"""How often the server looks whether the job has ended."""
_LOOK = "look"
"""Asks nothing of the job, but whether it is there."""


@dataclass(frozen=True)
class _JobAddress:
    """Where a job listens; ``computer`` is the one on which it runs."""

    computer: str
    port: int
    token: str


@contextlib.contextmanager
def taking_requests(folder: Path, control: JobControl) -> Iterator[None]:
    """Let other processes send requests to this job, which runs in ``folder``, while the context is open.

    Raises
    ------
    InputError
        If another job runs there, or the folder cannot be written.
    """
    if _is_running(folder):
        raise InputError(f"{folder}: another job runs here; 'cellapp stop {folder}' stops it")
    token = secrets.token_urlsafe(32)
    with _Server(control, token) as server:
        thread = threading.Thread(target=server.serve_forever, args=(_POLL_S,), name="requests", daemon=True)
        thread.start()
        try:
            _publish(folder, _JobAddress(platform.node(), server.server_address[1], token))
            yield
        finally:
            _withdraw(folder, token)
            server.shutdown()
            thread.join()


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
    address = _published(folder)
    if address is None:
        raise InputError(f"no job runs in {folder}")
    if address.computer != platform.node():
        raise InputError(f"the job in {folder} runs on computer '{address.computer}'; give the command there")
    answer = _exchange(folder, address, verb)
    if answer is None:
        raise InputError(f"no job runs in {folder}; the last one has ended")
    word, _, text = answer.partition(" ")
    if word != "done":
        raise InputError(f"{folder}: {text or 'the request was refused'}")
    return text


def who_uses(folder: Path) -> str:
    """Which job uses a run's folder, as a phrase; empty if none does. The job itself is not asked for anything."""
    address = _published(folder)
    if address is None:
        return ""
    if address.computer != platform.node():
        return f"a job on computer '{address.computer}', if it still runs"
    try:
        return "" if _exchange(folder, address, _LOOK, _GLANCE_S) is None else "a job that runs now"
    except HardwareError:
        return "a job that does not answer"


# -- the job's side ---------------------------------------------------------------------------------------------------


class _Server(socketserver.ThreadingTCPServer):
    """One thread for each request: one that is slow does not delay a stop."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 32

    def __init__(self, control: JobControl, token: str) -> None:
        super().__init__(("127.0.0.1", 0), _Request)
        self.control, self.token = control, token


class _Request(socketserver.StreamRequestHandler):
    """One line, the token and a verb, and one line in answer."""

    timeout = _PATIENCE_S
    server: _Server

    def handle(self) -> None:
        with contextlib.suppress(OSError):  # the asking process went away, or it is silent
            given, _, verb = self.rfile.readline(_LONGEST_LINE).strip().partition(b" ")
            if not hmac.compare_digest(given, self.server.token.encode()):
                return
            self.wfile.write(_answer(self.server.control, verb.decode("utf-8", "replace")).encode() + b"\n")


def _answer(control: JobControl, verb: str) -> str:
    """Do what is asked; return "done" or "refused" and a sentence."""
    before, arms = control.request, control.has_brakes
    brake = "all arms brake" if arms else "no arm is open"
    refusal = ""
    if verb in ("pause", "resume") and before == "abort":
        refusal = "the job was aborted and ends"
    elif verb in ("pause", "resume") and before == "stop" and not control.holds:
        refusal = "the job was stopped and ends; 'cellapp collect DIR --resume' continues later"
    elif verb == "pause" and before != "none":
        refusal = "the job is paused already" if before == "pause" else "the job is stopped already"
    elif verb == "resume" and before == "none":
        refusal = "the job is neither paused nor stopped"
    if refusal:
        return f"refused {refusal}"
    match verb:
        case "pause":
            control.pause()
            return "done pause: the arms rest after the present stop; 'cellapp resume DIR' continues"
        case "resume":
            control.resume()
            return "done resume: the job continues"
        case "stop":
            control.stop()
            then = "the job waits for 'resume' or 'abort'" if control.holds else "the job ends and can be resumed later"
            return f"done stopped: {brake}; {then}"
        case "abort":
            control.abort()
            return f"done aborted: {brake}; the job ends"
        case "look":
            return "done a job runs here"
    return f"refused '{verb}' is no request; requests are {', '.join(VERBS)}"


def _publish(folder: Path, address: _JobAddress) -> None:
    path = folder / JOB_FILE
    partial = path.with_name(f"{JOB_FILE}.part")
    try:
        partial.unlink(missing_ok=True)
        handle = os.open(partial, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            json.dump(asdict(address), file)
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); check the folder's rights") from error


def _withdraw(folder: Path, token: str) -> None:
    address = _published(folder)
    if address is not None and address.token == token:
        with contextlib.suppress(OSError):  # a file that stays behind names a port where nobody answers
            (folder / JOB_FILE).unlink()


# -- the side that asks -----------------------------------------------------------------------------------------------


def _published(folder: Path) -> _JobAddress | None:
    """Read where the job of a folder listens; None without a readable file."""
    try:
        found = json.loads((folder / JOB_FILE).read_text(encoding="utf-8"))
        return _JobAddress(str(found["computer"]), int(found["port"]), str(found["token"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _is_running(folder: Path) -> bool:
    address = _published(folder)
    if address is None or address.computer != platform.node():
        return False
    return _exchange(folder, address, _LOOK) is not None


def _exchange(folder: Path, address: _JobAddress, request: str, patience_s: float = _PATIENCE_S) -> str | None:
    """Send one request and return the answer; None if nobody listens or it is not that job.

    Raises ``HardwareError`` if somebody listens and is silent.
    """
    try:
        with socket.create_connection(("127.0.0.1", address.port), patience_s) as connection:
            connection.sendall(f"{address.token} {request}\n".encode())
            with connection.makefile("rb") as reader:
                answer = reader.readline(_LONGEST_LINE)
    except TimeoutError:
        raise HardwareError(
            f"the job in {folder} did not answer within {patience_s:g} s; if an arm moves, press its emergency"
            f" stop. If no job runs there, delete {folder / JOB_FILE}"
        ) from None
    except (OSError, OverflowError):
        return None
    return answer.decode("utf-8", "replace").strip() or None
