"""Run a command of the user's when a job stops, waits for somebody, or ends: mail, chat, a lamp.

No shell reads the command, and no job waits for it: it runs in a thread of its own, is killed after its time, and at
most a few run at once. What goes wrong with it is a notice of the job, never its end.
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
"""Commands that run at once; a job that stops and resumes again and again starts no more."""
_STARTS_S = 2.0
"""For how long the end of a job waits until the command has begun: it goes on by itself."""


def run_notified(
    name: str,
    profile: object,
    folder: object,
    listener: Listener,
    do: Callable[[Listener], Result],
    failed: Callable[[Result], Sequence[str]],
) -> Result:
    """Do the work of a verb, and run the command of its profile's section on its events, where there is one.

    ``profile`` and ``folder`` are what the request says of them; what is no path, or cannot be read, has no section.
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
    """Return the section of a profile, or of the profile of a run; None where there is none to be read."""
    try:
        if isinstance(profile, Path):
            return load_profile(profile).notify
        if isinstance(folder, Path):
            with RunFile.peek(folder) as run:
                return run.profile.notify
    except (CellappError, OSError, ValueError):  # the verb says what is wrong with it
        return None
    return None


class Commands:
    """Runs the command of a section.

    Parameters
    ----------
    settings : Notify
    name, run : str
        The job, and the folder of its run; empty where it has none.
    listener : callable
        Hears all events, and what goes wrong with the command.
    """

    def __init__(self, settings: Notify, name: str, run: str, listener: Listener) -> None:
        self._settings, self._name, self._run, self._listener = settings, name, run, listener
        self._free = threading.BoundedSemaphore(_MOST)
        self._last: Progress = Progress(name, 0, 1)
        self._told: NotifyEvent | None = None
        self._begun: threading.Event | None = None
        self._open = True

    def listen(self, event: Progress) -> None:
        """Pass an event on; tell of a state in which somebody is needed."""
        self._last = event
        self._listener(event)
        if isinstance(event.detail, StateChange):
            state, reason = event.detail.state, event.detail.reason
            kind = _EVENT_OF.get(state)
            if kind is not None and kind != self._told:
                self.tell(kind, f"{self._name} {state}: {reason}, {event.done} of {event.total}")
            self._told = kind

    def tell(self, event: NotifyEvent, text: str) -> None:
        """Run the command for an event, if it is one of those that the section names."""
        if event not in self._settings.events or not self._free.acquire(blocking=False):
            return
        self._begun = threading.Event()
        # no daemon: a program that ends waits for it, at most for its time
        threading.Thread(target=self._execute, args=(event, text, self._begun), name="notify").start()

    def close(self) -> None:
        """Wait, for a bounded time, until the last command has begun."""
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
        except (OSError, ValueError) as error:  # no such program, or an argument that no program can get
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
