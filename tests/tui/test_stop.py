"""The keys that pause, resume, stop and abort a run: at once, over every dialog, with the screen busy."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Button, Input, Label, RichLog, Static

from cellapp.commissioning.confirm import Ask
from cellapp.control import JobControl
from cellapp.errors import InputError
from cellapp.progress import Listener, Progress, ReferenceReport, StateChange, StopReport, Suspicion
from cellapp.results import WholeRunResult
from cellapp.tui.app import CellApp
from cellapp.tui.dialogs import ConfirmScreen, LeaveScreen
from cellapp.tui.progress_panel import ProgressPanel
from tests.latency import attempts

PROFILES = Path(__file__).resolve().parents[2] / "profiles"
WAIT_S = 30.0
BAR_S = 0.1
SIZE = (80, 24)
DETAILS = (
    StopReport(4, "left", 0.0512, 0.0123, {}),
    Suspicion("loose SMR", "the SMR of the left arm wobbles", "left"),
    ReferenceReport({"arm left": 0.034}, 0.1),
)


@dataclass
class MovingRun:
    """Stands in for ``run_whole``: arms that note when they brake, and events as fast as they can be emitted."""

    flood: bool = False
    asks: bool = False
    began: threading.Event = field(default_factory=threading.Event)
    braked: threading.Event = field(default_factory=threading.Event)
    brakes: list[tuple[str, float]] = field(default_factory=list)
    control: JobControl = field(default_factory=JobControl)
    allowed: bool | None = None

    def __call__(
        self, profile: Path, folder: Path | None, listener: Listener, control: JobControl, *, ask: Ask
    ) -> WholeRunResult:
        self.control = control
        with control.brakes(self._brake):
            self.began.set()
            if self.asks:
                self.allowed = ask("First motion: arm left turns joint 1 by 90 deg.")
                if not self.allowed:
                    raise InputError("the first motion was not confirmed; nothing was moved")
            for detail in DETAILS:
                listener(Progress("collect", 5, 30, eta_s=240.0, detail=detail))
            while True:
                self._hold(listener)
                for number in range(50 if self.flood else 1):
                    listener(Progress("collect", 5, 30, f"event {number}", eta_s=240.0))
                control.wait_while("none", timeout_s=0.005 if self.flood else 0.1)

    def _hold(self, listener: Listener) -> None:
        self.control.check()
        request = self.control.request
        if request in ("pause", "stop"):
            state = StateChange("paused" if request == "pause" else "stopped", "asked by a person")
            listener(Progress("collect", 5, 30, detail=state))
            while self.control.request == request:
                self.control.check()
                self.control.wait_while(request, timeout_s=0.1)
            self.control.check()
            listener(Progress("collect", 5, 30, detail=StateChange("running", "resumed by a person")))

    def _brake(self, verb: str) -> None:
        self.brakes.append((verb, time.monotonic()))
        self.braked.set()


@pytest.fixture(autouse=True)
def _surroundings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("textual.constants.TEXTUAL_ANIMATIONS", "none")
    monkeypatch.chdir(tmp_path)


async def until(pilot: Pilot[None], holds: Callable[[], bool], what: str) -> None:
    try:
        async with asyncio.timeout(WAIT_S):
            while not holds():
                await pilot.pause()
    except TimeoutError:
        pytest.fail(f"never came: {what}; the status is: {status(pilot)}")


async def started(pilot: Pilot[None], app: CellApp, run: MovingRun) -> None:
    await pilot.pause()
    app.query_one("#folder", Input).value = "here"
    await pilot.press("f5")
    assert await asyncio.to_thread(run.began.wait, WAIT_S)


def status(pilot: Pilot[None]) -> str:
    return str(pilot.app.query_one("#status", Static).render())


def state(app: CellApp) -> str:
    return str(app.query_one(ProgressPanel).border_title)


def log(app: CellApp) -> str:
    return "\n".join(line.text for line in app.query_one("#log", RichLog).lines)


async def aborted(pilot: Pilot[None], app: CellApp) -> None:
    await pilot.press("ctrl+x")
    await until(pilot, lambda: not app.running, "the end of the run")


@pytest.mark.parametrize("dialog", ["none", "leave", "confirm"])
@pytest.mark.parametrize(("key", "verb"), [("escape", "stop"), ("s", "stop"), ("ctrl+x", "abort")])
async def test_the_key_brakes_within_the_bar_over_every_dialog_with_the_screen_busy(
    key: str, verb: str, dialog: str
) -> None:
    if (key, dialog) == ("s", "confirm"):
        pytest.skip("there, s is a letter of the profile's name")
    for took in attempts(braked=BAR_S):
        took["braked"] = await braked_over(dialog, key, verb)


async def braked_over(dialog: str, key: str, verb: str) -> float:
    """Press the key over a dialog while the screen is busy; return how long it took until the arms braked [s]."""
    run = MovingRun(flood=True, asks=dialog == "confirm")
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SIZE) as pilot:
        await started(pilot, app, run)
        if dialog == "confirm":
            await until(pilot, lambda: isinstance(app.screen, ConfirmScreen), "the question")
        else:
            await until(pilot, lambda: "event" in log(app), "a busy screen")
        if dialog == "leave":
            await pilot.press("q")
            assert isinstance(app.screen, LeaveScreen)
        pressed_s = time.monotonic()
        pressing = asyncio.create_task(pilot.press(key))
        assert await asyncio.to_thread(run.braked.wait, WAIT_S)
        await pressing
        first_verb, braked_s = run.brakes[0]
        assert first_verb == verb
        said = status(pilot)
        assert "brake" in said or "STOPPED" in said or not app.running  # the run may have answered already
        if dialog == "confirm":
            await until(pilot, lambda: not app.running, "the end of the run")
            assert run.allowed is False
            assert "not confirmed" in status(pilot)
        elif verb == "stop":
            assert app.running, "a stopped run holds"
            if dialog == "leave":
                await pilot.press("n")
            await aborted(pilot, app)
            assert "Aborted; continue with: cellapp collect here --resume" in status(pilot)
    return braked_s - pressed_s


async def test_pause_resume_stop_and_abort_are_different_things() -> None:
    run = MovingRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SIZE) as pilot:
        await started(pilot, app, run)
        assert state(app) == "progress: running"
        for key, request, shown in (
            ("p", "pause", "paused"),
            ("p", "none", "running"),
            ("p", "pause", "paused"),
            ("c", "none", "running"),
            ("escape", "stop", "stopped"),
            ("c", "none", "running"),
            ("s", "stop", "stopped"),
            ("p", "stop", "stopped"),
            ("c", "none", "running"),
        ):
            await pilot.press(key)
            assert run.control.request == request
            said = "Stopped, not paused" if (key, shown) == ("p", "stopped") else f"{shown.upper()}: "
            await until(pilot, lambda: said in status(pilot), f"{shown} after {key}")  # noqa: B023
            assert state(app) == f"progress: {shown}"
        assert [verb for verb, _ in run.brakes] == ["stop", "stop"]
        await pilot.press("x")
        assert [verb for verb, _ in run.brakes] == ["stop", "stop", "abort"]
        await until(pilot, lambda: not app.running, "the end of the run")
        assert state(app) == "progress"
        assert status(pilot).startswith("Aborted; continue with")
        await pilot.press("q")
    assert app.return_code == 4


async def test_every_request_has_a_button_that_is_there_when_it_is_possible() -> None:
    run = MovingRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=(140, 45)) as pilot:
        names = ("stop", "pause", "resume", "abort")

        def possible() -> set[str]:
            return {name for name in names if not app.query_one(f"#{name}", Button).disabled}

        await pilot.pause()
        assert possible() == set()
        await started(pilot, app, run)
        assert possible() == {"stop", "pause", "abort"}
        await pilot.click("#pause")
        await until(pilot, lambda: "PAUSED" in status(pilot), "the pause")
        assert possible() == set(names)
        await pilot.click("#resume")
        assert run.control.request == "none"
        await pilot.click("#stop")
        assert run.brakes[-1][0] == "stop"
        await pilot.click("#abort")
        assert run.brakes[-1][0] == "abort"
        await until(pilot, lambda: not app.running, "the end of the run")
        assert possible() == set()


@pytest.mark.fast
async def test_reports_of_the_run_are_shown() -> None:
    run = MovingRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SIZE) as pilot:
        await started(pilot, app, run)
        await until(pilot, lambda: "event 0" in log(app), "the events")
        assert str(app.query_one("#eta", Label).render()) == "collect: 4 min left"
        assert str(app.query_one("#fit", Label).render()) == "left: residual 0.051 mm, standard error 0.0123 mm"
        shown = " ".join(log(app).split())
        assert "SUSPICION: loose SMR: the SMR of the left arm wobbles" in shown
        assert "reference: arm left 0.034 mm from the first measurement, limit 0.100 mm" in shown
        await aborted(pilot, app)


@pytest.mark.fast
async def test_real_arms_move_when_the_profiles_name_is_typed() -> None:
    run = MovingRun(asks=True)
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SIZE) as pilot:
        await started(pilot, app, run)
        await until(pilot, lambda: isinstance(app.screen, ConfirmScreen), "the question")
        name = Path(app.query_one("#profile", Input).value).stem
        words = [str(text.render()) for text in app.screen.query(Static)]
        assert any("arm left turns joint 1" in text for text in words)
        await pilot.press(*"sxpc", "enter")
        assert isinstance(app.screen, ConfirmScreen)
        assert run.control.request == "none", "letters in the field are text"
        app.screen.query_one("#name", Input).value = name
        await pilot.press("enter")
        await until(pilot, lambda: run.allowed is True, "the permission")
        assert not isinstance(app.screen, ConfirmScreen)
        await aborted(pilot, app)


async def test_a_button_refuses_the_motion() -> None:
    run = MovingRun(asks=True)
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SIZE) as pilot:
        await started(pilot, app, run)
        await until(pilot, lambda: isinstance(app.screen, ConfirmScreen), "the question")
        await pilot.click("#refuse")
        await until(pilot, lambda: not app.running, "the end of the run")
        assert run.allowed is False


async def test_leaving_brakes_and_ends_a_run_that_holds() -> None:
    run = MovingRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SIZE) as pilot:
        await started(pilot, app, run)
        await pilot.press("escape")
        await until(pilot, lambda: "STOPPED" in status(pilot), "the held run")
        await pilot.press("q", "y")
        await until(pilot, lambda: app.return_code is not None, "the end of the screen")
    assert app.return_code == 4
    assert run.brakes[-1][0] == "stop"


@pytest.mark.fast
async def test_a_screen_that_goes_away_brakes_the_arms() -> None:
    run = MovingRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SIZE) as pilot:
        await started(pilot, app, run)
    assert run.brakes[-1][0] == "stop"
    await asyncio.to_thread(app.wait_for_run)
    assert not [thread for thread in threading.enumerate() if thread.name == "run"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM] if sys.platform != "win32" else [])
async def test_a_closed_terminal_brakes_the_arms_and_ends_the_program(number: int) -> None:
    for took in attempts(braked=BAR_S):
        took["braked"] = await braked_by_signal(number)


async def braked_by_signal(number: int) -> float:
    """Send this process a signal during a run; return how long it took until the arms braked [s]."""
    run = MovingRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SIZE) as pilot:
        await started(pilot, app, run)
        sent_s = time.monotonic()
        os.kill(os.getpid(), number)
        assert await asyncio.to_thread(run.braked.wait, WAIT_S)
        await until(pilot, lambda: app.return_code is not None, "the end of the screen")
    assert app.return_code == 4
    assert signal.getsignal(number) is signal.SIG_DFL
    return run.brakes[0][1] - sent_s


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
async def test_ctrl_z_of_another_terminal_pauses_instead_of_freezing_the_program() -> None:
    run = MovingRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SIZE) as pilot:
        await started(pilot, app, run)
        os.kill(os.getpid(), signal.SIGTSTP)
        await until(pilot, lambda: "PAUSED" in status(pilot), "the pause")
        os.kill(os.getpid(), signal.SIGTSTP)
        await until(pilot, lambda: "RUNNING" in status(pilot), "the continuation")
        await aborted(pilot, app)
