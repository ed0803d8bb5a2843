"""What tests of the terminal application share: bounded waits, the text of a screen, jobs that the test controls."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from textual.app import App
from textual.css.query import NoMatches
from textual.pilot import Pilot

from cellapp.commands.record import Ask
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.progress import Progress, ReferenceReport, StateChange, StopReport, Suspicion
from cellapp.ground.results import Result
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.jobs import Job
from tests.interfaces.tui.idle import wait_for_idle
from tests.waiting import WAIT_S

PROFILES = Path(__file__).resolve().parents[3] / "profiles"
_LOOK_S = 0.5
"""A condition is looked at again at least so often, while threads compute."""
_DRAWN_S = 0.2
"""What follows from a condition is drawn within this time, or while nothing else is done."""
_MOST_VIEWS = 10
"""More than any screen has."""
SMALL = (80, 24)
SIZES = (SMALL, (120, 40), (200, 60))
"""Terminals: the smallest that is supported, a usual one, a large one."""


async def until(pilot: Pilot[None], holds: Callable[[], Any], what: str, wait_s: float = WAIT_S) -> None:
    """Wait for a condition, then for what follows from it on the screen; fail with what the screen says if it never
    holds.

    A condition holds before the screen is drawn that goes with it: a busy computer shows the test a blank or half made
    one. What the test asserts next of the screen, it rather waits for, too (``shows``, ``tells``).
    """
    app = pilot.app

    def is_so() -> bool:
        with suppress(NoMatches):  # a part of the screen that is not made yet
            return bool(holds())
        return False

    try:
        async with asyncio.timeout(wait_s):
            while not is_so():
                await _rest(pilot, _LOOK_S)
            while app.return_code is None:
                await _rest(pilot, _DRAWN_S)
                if not app.is_running or app.screen._compositor.visible_widgets:
                    break
    except TimeoutError:
        assert isinstance(app, CellApp)
        pytest.fail(f"not within {wait_s:g} s: {what}; the message is: {app.message}; the screen:\n{shown_text(app)}")


async def _rest(pilot: Pilot[None], at_most_s: float) -> None:
    """Let the application draw what it knows by now; no longer than that where its threads compute all the time."""
    await asyncio.sleep(0.005)  # the job's thread needs the processor, too
    await pilot._wait_for_screen()
    await wait_for_idle(max_sleep=at_most_s)
    if pilot.app.is_running and pilot.app.return_code is None:
        pilot.app.screen._on_timer_update()


async def shows(pilot: Pilot[None], *words: str, wait_s: float = WAIT_S) -> None:
    """Wait until the screen says all ``words``, as they stand or wherever its lines break."""

    def said() -> bool:
        shown = shown_text(pilot.app)
        flat = " ".join(shown.split())
        return all(text in shown or text in flat for text in words)

    await until(pilot, said, f"the words {words}", wait_s)


async def tells(pilot: Pilot[None], words: str) -> None:
    """Wait until the message of the application has the words in it."""
    app = pilot.app
    assert isinstance(app, CellApp)
    await until(pilot, lambda: words in app.message, f"the message {words!r}")


async def turned_to(pilot: Pilot[None], view: str) -> None:
    """Press ``t`` until the screen shows a view of it, by its class."""
    for _ in range(_MOST_VIEWS):
        if pilot.app.screen.has_class(view):
            return
        await pilot.press("t")
    assert pilot.app.screen.has_class(view), f"t never came to the view {view}"


async def opened(pilot: Pilot[None], app: CellApp) -> None:
    """Wait until the first profile is open."""
    await until(pilot, lambda: app.workspace.profile is not None, "a profile")


@asynccontextmanager
async def running(folder: Path = PROFILES, size: tuple[int, int] = SMALL) -> AsyncIterator[tuple[Pilot[None], CellApp]]:
    """The application with the first profile of a folder open."""
    app = CellApp(folder)
    async with app.run_test(size=size) as pilot:
        await opened(pilot, app)
        yield pilot, app


async def ended(pilot: Pilot[None], app: CellApp, wait_s: float = WAIT_S) -> None:
    """Wait until no job runs."""
    await until(pilot, lambda: not app.jobs.running, "the end of the job", wait_s)
    await pilot.pause()


async def exit_code(pilot: Pilot[None], app: CellApp) -> int | None:
    """Quit an application without a job."""
    await pilot.press("ctrl+q")
    await until(pilot, lambda: app.return_code is not None, "the end of the application")
    return app.return_code


def shown_text(app: App[Any]) -> str:
    """The text of the whole screen, a line for each of its lines."""
    rows = app.screen._compositor.render_strips()
    return "\n".join("".join(segment.text for segment in row).rstrip() for row in rows)


def log_text(app: CellApp) -> str:
    """The lines of the log."""
    return "\n".join(entry.text for entry in app.record.log)


@dataclass
class HeldJob:
    """A job that emits events, waits for the test, then returns ``result`` or raises ``error``."""

    events: tuple[Progress, ...] = (Progress("plan", 30, 30, "done"), Progress("collect", 7, 30, "stop 8"))
    error: BaseException | None = None
    result: Result | None = None
    patience_s: float = WAIT_S
    reached: threading.Event = field(default_factory=threading.Event)
    go_on: threading.Event = field(default_factory=threading.Event)
    thread: threading.Thread | None = None
    control: JobControl = field(default_factory=JobControl)

    def job(self, name: str = "collect", folder: Path | None = None) -> Job:
        """As a job of the application."""
        self.reached.clear()
        self.go_on.clear()
        return Job(name, self._work, folder, moves=True)

    def _work(self, control: JobControl, ask: Ask) -> Result | None:
        self.thread, self.control = threading.current_thread(), control
        for event in self.events:
            control.tell(event.job, event.done, event.total, event.note, event.detail)
        self.reached.set()
        assert self.go_on.wait(self.patience_s)
        control.check()
        if self.error is not None:
            raise self.error
        return self.result


DETAILS = (
    StopReport(4, "left", 0.0512, 0.0123),
    Suspicion("loose SMR", "the SMR of the left arm wobbles", "left"),
    ReferenceReport({"arm left": 0.034}, 0.1),
)


@dataclass
class MovingJob:
    """A job with arms that note when they brake; it can be paused and emits events as fast as is asked."""

    flood: bool = False
    asks: bool = False
    began: threading.Event = field(default_factory=threading.Event)
    braked: threading.Event = field(default_factory=threading.Event)
    brakes: list[tuple[str, float]] = field(default_factory=list)
    control: JobControl = field(default_factory=JobControl)
    allowed: bool | None = None
    clock: Callable[[], float] = field(default=lambda: 0.0)

    def job(self, folder: Path | None = None) -> Job:
        """As a job of the application."""
        return Job("collect", self._work, folder, moves=True)

    def _work(self, control: JobControl, ask: Ask) -> Result | None:
        self.control = control
        with control.brakes(self._brake):
            self.began.set()
            if self.asks:
                self.allowed = ask("First motion: arm left turns joint 1 by 90 deg.")
                if not self.allowed:
                    raise InputError("the first motion was not confirmed; nothing was moved")
            for detail in DETAILS:
                control.tell("collect", 5, 30, detail=detail)
            while True:
                self._hold()
                for number in range(50 if self.flood else 1):
                    control.tell("collect", 5, 30, f"event {number}")
                control.wait_while("none", timeout_s=0.005 if self.flood else 0.1)

    def _hold(self) -> None:
        self.control.check()
        request = self.control.request
        if request in ("pause", "stop"):
            state = StateChange("paused" if request == "pause" else "stopped", "asked by a person")
            self.control.tell("collect", 5, 30, detail=state)
            while self.control.request == request:
                self.control.check()
                self.control.wait_while(request, timeout_s=0.1)
            self.control.check()
            self.control.tell("collect", 5, 30, detail=StateChange("running", "resumed by a person"))

    def _brake(self, verb: str) -> None:
        self.brakes.append((verb, self.clock()))
        self.braked.set()
