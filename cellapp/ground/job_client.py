"""Ask the job that runs in a run's folder for something, from another process on the same computer.

A file in the folder, which only its owner may read, has the port and a random token of the job: a request never reaches
a later job, and nobody else can send one. The job locks the file while it runs: only a missing or unlocked one is no
job. A stop must not wait for packages that it does not need: this module imports little, and nothing that it imports
does otherwise.
"""

from __future__ import annotations

import json
import os
import socket
import sys
from pathlib import Path
from typing import IO, Literal, NamedTuple, get_args

from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.shell import filled, shell_word

if sys.platform != "win32":
    import fcntl

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

_HELD = "a job that runs holds it"
_PRESS = "if an arm moves, press its emergency stop"
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


class UnreadableJob(InputError):
    """The folder's job cannot be asked: ``owner`` is the account that alone may read its file."""

    def __init__(self, path: Path, error: OSError) -> None:
        self.owner = "unknown"
        for place in (path.parent, path):
            try:
                self.owner = place.owner()
            except (OSError, KeyError, NotImplementedError):  # hidden by its folder; not a known account; Windows
                break
        super().__init__(
            f"{path}: belongs to account '{self.owner}' and cannot be read ({error.strerror}), so a job may run and"
            f" move arms: give the command as that account or as root; {_PRESS}"
        )


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
    address = address_of_job(folder)
    if address is None and not (folder / _RUN_FILE).is_file():
        raise InputError(f"{folder}: no run is here; name the folder of a run")
    if address is None:
        raise NoJob(f"no job runs in {folder}")
    if not address.is_here:
        raise InputError(f"the job in {folder} runs on computer '{address.computer}'; give the command there")
    answer = exchange(folder, address, verb, PATIENCE_S)
    if answer is None:
        raise NoJob(f"no job runs in {folder}; the last one has ended")
    word, _, text = filled(answer, {"DIR": folder}).partition(" ")
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
            f"the job in {folder} is of another version of cellapp; look at it with that one. 'cellapp stop"
            f" {shell_word(folder)}'"
            " stops it all the same"
        ) from None


def who_uses(folder: Path) -> str:
    """Which job uses a run's folder, as a phrase; empty if none does. The job itself is not asked for anything."""
    try:
        address = address_of_job(folder)
        if address is None:
            return ""
        if not address.is_here:
            return f"a job on computer '{address.computer}', if it still runs"
        return "" if exchange(folder, address, LOOK, _GLANCE_S) is None else RUNS_NOW
    except UnreadableJob as error:
        return f"a job of account '{error.owner}', if it still runs"
    except HardwareError:
        return "a job that does not answer"


def address_of_job(folder: Path) -> JobAddress | None:
    """Read where the job of a folder listens; None if there is no file, or a damaged one that no job holds.

    The job may have ended since.

    Raises
    ------
    UnreadableJob
        If there is a file that this account may not read.
    HardwareError
        If a job holds a file that does not state where it listens.
    """
    path = folder / JOB_FILE
    try:
        with path.open("rb") as file:
            text, held = file.read(LONGEST_LINE), not taken(file)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise UnreadableJob(path, error) from None
    try:
        found = json.loads(text)
        process = int(found.get("process", 0))  # files of earlier versions do not state it
        return JobAddress(str(found["computer"]), process, int(found["port"]), str(found["token"]))
    except (ValueError, KeyError, TypeError, AttributeError):
        if held:
            raise HardwareError(f"{path}: {_HELD}, but the file does not say where it listens; {_PRESS}") from None
        return None


def taken(file: IO[bytes], *, alone: bool = False) -> bool:
    """Take the lock of an open job file until it is closed, ``alone`` as a job does; return False if it is held.

    A system without such locks, like some network folders, knows no holder.
    """
    if sys.platform != "win32":
        try:
            fcntl.flock(file, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            pass
    return True


def exchange(folder: Path, address: JobAddress, request: str, patience_s: float) -> str | None:
    """Send one request and return the answer; None if nobody listens or it is not that job.

    Raises ``HardwareError`` if somebody listens and is silent, or a job holds the file and nobody listens.
    """
    try:
        with socket.create_connection(("127.0.0.1", address.port), patience_s) as connection:
            connection.sendall(f"{address.token} {request}\n".encode())
            with connection.makefile("rb") as reader:
                answer = reader.readline(LONGEST_LINE)
    except TimeoutError:
        raise HardwareError(
            f"the job in {folder} did not answer within {patience_s:g} s; {_PRESS}. If no job runs there, delete"
            f" {folder / JOB_FILE}"
        ) from None
    except (OSError, OverflowError):
        answer = b""
    text = answer.decode("utf-8", "replace").strip()
    if not text and _is_held(folder / JOB_FILE):
        raise HardwareError(f"{folder / JOB_FILE}: {_HELD} and does not answer; {_PRESS}")
    return text or None


def _is_held(path: Path) -> bool:
    """Return whether a job that runs holds the lock of a job file."""
    try:
        with path.open("rb") as file:
            return not taken(file)
    except OSError:  # it has ended meanwhile
        return False
