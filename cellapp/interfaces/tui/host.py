"""Interface of the application for screens, dialogs and widgets; they know nothing else of it.

Presses of STOP that brake before the event loop gets them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from textual.app import App, ScreenStackError
from textual.geometry import Region
from textual.message import Message
from textual.screen import ModalScreen

from cellapp.commands.docs.keys import Step
from cellapp.interfaces.tui.day_state import DayState, day_state
from cellapp.interfaces.tui.job_record import JobRecord
from cellapp.interfaces.tui.jobs import Job, JobRunner
from cellapp.interfaces.tui.leaving import Leaving
from cellapp.interfaces.tui.workspace import Workspace

if TYPE_CHECKING:
    from cellapp.commands.record import View
    from cellapp.ground.results import Result


Severity = Literal["information", "warning", "error"]
"""Severity of a sentence, with Textual's words."""


class StopGiven(Message):
    """A person pressed STOP and the brakes were called; the screens must only say so. ``arms``: whether arms brake."""

    def __init__(self, arms: bool) -> None:
        super().__init__()
        self.arms = arms


ShowsResult = Callable[["Result", "View"], None]
"""Draws the result of a job, which is also given as a view."""


class Host(App[None]):
    """An application with an open profile or run, and one job at a time.

    Attributes
    ----------
    profiles, logs : Path
        Folder whose ``*.yaml`` are offered; folder of the runs.
    shows_result : callable or None
        Draws the result of the current job, as the screen that started it, whichever screen is shown then.
    jobs : JobRunner
    leaving : Leaving
    last_run : Path or None
        The run that was changed last when the application began.
    waits : str
        That run in words; empty if there is none.
    reading : str
        Sentence that the first profile, or the result of the last job, is being read; empty when it is read.
    """

    def __init__(self, profiles: Path, logs: Path, jobs: JobRunner, leaving: Leaving) -> None:
        super().__init__()
        self.profiles, self.logs = profiles, logs
        self.workspace = Workspace()
        self.record = JobRecord()
        self.jobs, self.leaving = jobs, leaving
        self.presses = StopPresses(jobs)
        self.shows_result: ShowsResult | None = None
        self.last_run: Path | None = None
        self.waits = self.reading = ""
        self._state: tuple[tuple[object, ...], DayState] | None = None

    @property
    def state(self) -> DayState:
        """The only state of the open run and the job; derived once for each change of its inputs."""
        known = (self.workspace, self.record.changes, self.jobs.job, self.waits, self.reading)
        if self._state is None or any(one is not other for one, other in zip(known, self._state[0], strict=True)):
            self._state = known, day_state(self.workspace, self.record, self.jobs.job, self.waits, self.reading)
        return self._state[1]

    def start_job(self, job: Job, cell: Workspace | None = None, shows_result: ShowsResult | None = None) -> bool:
        """Start a job; ``cell`` is its workspace if not the open one. Return whether it was started."""
        if self.jobs.running:
            self.say(f"'{self.record.name}' is still running; stop it or wait for its end.", "warning")
            return False
        self.shows_result = shows_result
        self.workspace = cell or self.workspace
        self.record.begin(job.name, "" if job.verb is None else job.verb.name)
        self.say(f"{job.name}: started" + ("" if job.folder is None else f" in {job.folder}"))
        self.jobs.start(job)
        self.draw_all()
        return True

    @property
    def escape_closes(self) -> bool:
        """Whether Escape closes a dialog: there is one, and nothing can move."""
        if self.jobs.moves or not self.jobs.running:
            return False  # stop first, or nothing to stop: Escape closes by itself
        with suppress(ScreenStackError):  # called by the thread that reads keys, also while screens are removed
            return isinstance(self.screen, ModalScreen)
        return False

    @contextmanager
    def lend_terminal(self) -> Iterator[None]:
        """Let another program have the terminal; ``SuspendNotSupported`` where that cannot be."""
        with self.suspend(), self.leaving.lent():
            yield

    def open_profile(self, path: Path) -> None:
        """Open a profile without a run."""
        self.open_run(None, path)

    def open_run(self, folder: Path | None, profile_path: Path | None = None) -> None:
        """Open a run; its own profile is used. Without one open a profile."""
        raise NotImplementedError

    def action_show(self, step: Step) -> None:
        """Show the screen of a step."""
        raise NotImplementedError

    def action_resume(self) -> None:
        """Let a paused or stopped job continue."""
        raise NotImplementedError

    def say(self, text: str, severity: Severity = "information") -> None:
        """Show a sentence in the message line of every screen and keep it in the log."""
        raise NotImplementedError

    def draw_all(self) -> None:
        """Redraw the whole screen."""
        raise NotImplementedError


# -- Presses of STOP that brake before the event loop gets them, and protection against misordered resume keys --------


_RESUME_AFTER_S = 0.3
"""A resume key that is handled sooner than this after a STOP may have been pressed before it."""


class StopPresses:
    """Presses of STOP, handled in the thread that reads the terminal.

    Attributes
    ----------
    region : Region
        Position of STOP, on every screen and every dialog [cells].
    """

    def __init__(self, jobs: JobRunner) -> None:
        self._jobs = jobs
        self.region = Region()
        self._given = self._said = 0
        self._said_s = -_RESUME_AFTER_S

    def give(self) -> StopGiven | None:
        """Brake all arms now; return None and do nothing if no job runs. In the thread that read the press."""
        if not self._jobs.possible("stop"):
            return None
        control = self._jobs.control
        arms = control.has_brakes
        self._given += 1  # first: from now on an earlier key does not resume
        control.stop()
        return StopGiven(arms)

    def said(self) -> None:
        """Note that the screens have handled the oldest press."""
        self._said += 1
        self._said_s = time.monotonic()

    @property
    def just_given(self) -> bool:
        """Whether the key that is handled now may have been pressed before the last STOP."""
        return self._given != self._said or time.monotonic() < self._said_s + _RESUME_AFTER_S
