"""Run the user's command (mail, chat, a lamp) when a job stops, waits for somebody, or ends.

The command runs without a shell, in a worker thread: no job waits for it. It is killed after its time limit, and
few run at once. If it fails, the job gets a notice and goes on.
"""

from __future__ import annotations

import os
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.ground.errors import CellappError
from cellapp.ground.profile.notify import Notify, NotifyEvent
from cellapp.ground.progress import Cancelled, JobState, Listener, Notice, Progress, StateChange
from cellapp.ground.results import Result

_EVENT_OF: Mapping[JobState, NotifyEvent] = {
    "stopped": "stopped",
    "aborted": "stopped",
    "paused": "waiting",
    "suspended": "waiting",
}
_MOST = 4
"""Most commands that run at once, so that a job that stops and resumes again and again starts no more."""
_STARTS_S = 2.0
"""How long the end of a job waits for the last command to start; the command then goes on by itself."""


def run_notified(
    name: str,
    profile: object,
    folder: object,
    listener: Listener,
    do: Callable[[Listener], Result],
    failed: Callable[[Result], Sequence[str]],
) -> Result:
    """Do the work of a verb, and run the command of the profile's section ``notify``, if there is one, on its events.

    ``profile`` and ``folder`` come from the request; there is no section if they are no paths or cannot be read.
    """
    settings = _settings(profile, folder)
    if settings is None:
        return do(listener)
    runner = Commands(settings, name, str(folder) if isinstance(folder, Path) else "", listener)
    try:
        result = do(runner.listen)
        runner.tell("done", f"{name}: {'; '.join(failed(result)) or 'done'}")
        return result
    except (Cancelled, CellappError, OSError) as error:
        runner.tell("stopped", f"{name}: {error}")
        raise
    finally:
        runner.close()


def _settings(profile: object, folder: object) -> Notify | None:
    """Return the section of a profile, or of the profile of a run; None if there is none or it cannot be read."""
    try:
        if isinstance(profile, Path):
            return load_profile(profile).notify
        if isinstance(folder, Path):
            with RunFile.peek(folder) as run:
                return run.profile.notify
    except (CellappError, OSError, ValueError):  # the verb itself reports the error
        return None
    return None


class Commands:
    """Runner of the command of a section ``notify``.

    Parameters
    ----------
    settings : Notify
    name, run : str
        The job, and the folder of its run; empty if it has none.
    listener : callable
        Receives all events, and notices if the command fails.
    """

    def __init__(self, settings: Notify, name: str, run: str, listener: Listener) -> None:
        self._settings, self._name, self._run, self._listener = settings, name, run, listener
        self._free = threading.BoundedSemaphore(_MOST)
        self._last: Progress = Progress(name, 0, 1)
        self._told: NotifyEvent | None = None
        self._begun: threading.Event | None = None
        self._open = True

    def listen(self, event: Progress) -> None:
        """Pass an event on; run the command if the job's new state needs somebody."""
        self._last = event
        self._listener(event)
        if isinstance(event.detail, StateChange):
            state, reason = event.detail.state, event.detail.reason
            kind = _EVENT_OF.get(state)
            if kind is not None and kind != self._told:
                self.tell(kind, f"{self._name} {state}: {reason}, {event.done} of {event.total}")
            self._told = kind

    def tell(self, event: NotifyEvent, text: str) -> None:
        """Run the command for an event, if the section names this event."""
        if event not in self._settings.events or not self._free.acquire(blocking=False):
            return
        self._begun = threading.Event()
        # no daemon thread: the program waits for it at exit, at most for its time limit
        threading.Thread(target=self._execute, args=(event, text, self._begun), name="notify").start()

    def close(self) -> None:
        """Wait at most ``_STARTS_S`` until the last command has started."""
        if self._begun is not None:
            self._begun.wait(_STARTS_S)
        self._open = False

    def _execute(self, event: NotifyEvent, text: str, begun: threading.Event) -> None:
        words = {"event": event, "text": text, "run": self._run}
        command = [_filled(argument, words) for argument in self._settings.command]
        added = {f"CELLAPP_{name.upper()}": value for name, value in words.items()}
        nowhere = subprocess.DEVNULL
        try:
            process = subprocess.Popen(
                command, stdin=nowhere, stdout=nowhere, stderr=nowhere, env={**os.environ, **added}
            )
            begun.set()
            if (code := process.wait(self._settings.timeout)) != 0:
                self._complain(f"ended with exit code {code}")
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            self._complain(f"took longer than {self._settings.timeout:g} s and was ended")
        except (OSError, ValueError) as error:  # no such program, or an invalid argument
            self._complain(f"cannot be run ({error})")
        finally:
            begun.set()
            self._free.release()

    def _complain(self, what: str) -> None:
        if self._open:
            text = f"the command of the profile's section 'notify' {what}: {self._settings.command[0]}"
            self._listener(replace(self._last, detail=Notice(text), note=""))


def _filled(argument: str, words: Mapping[str, str]) -> str:
    for name, value in words.items():
        argument = argument.replace(f"{{{name}}}", value)
    return argument.replace("\0", " ")
