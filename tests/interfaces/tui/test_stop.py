"""The keys that pause, resume, stop and abort a job: at once, over every dialog, with the screen busy."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from textual.events import MouseDown
from textual.pilot import Pilot
from textual.widgets import Input, Static

from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.program import MotionQuestion, Palette
from cellapp.interfaces.tui.dialogs.question import Choice
from cellapp.interfaces.tui.widgets.controls import StopButton
from tests.interfaces.tui.pilot import WAIT_S, MovingJob, ended, log_text, running, until
from tests.latency import attempts
from tests.sure import sure

BAR_S = 0.1
"""From the press to the brakes."""


async def started(pilot: Pilot[None], app: CellApp, moving: MovingJob) -> None:
    moving.clock = time.monotonic
    app.start_job(moving.job(Path("here")))
    await until(pilot, moving.began.is_set, "the job")


@asynccontextmanager
async def held_by(moving: MovingJob) -> AsyncIterator[tuple[Pilot[None], CellApp]]:
    """The application while a job of moving arms runs."""
    async with running() as (pilot, app):
        await started(pilot, app, moving)
        yield pilot, app


async def aborted(pilot: Pilot[None], app: CellApp) -> None:
    await pilot.press("ctrl+x")
    await ended(pilot, app)


@pytest.mark.usefixtures("painted")
@pytest.mark.parametrize(("way", "verb"), [("escape", "stop"), ("click", "stop"), ("ctrl+x", "abort")])
async def test_one_key_and_one_click_brake_within_the_bar_over_every_dialog(way: str, verb: str) -> None:
    async with running() as (pilot, app):
        for dialog in ("none", "motion") if verb == "abort" else ("none", "leave", "motion", "palette"):
            for took in attempts(braked=BAR_S):
                took["braked"] = await braked_over(pilot, app, dialog, way, verb)


async def braked_over(pilot: Pilot[None], app: CellApp, dialog: str, way: str, verb: str) -> float:
    """Stop over a dialog while the screen is busy; return how long it took until the arms braked [s]."""
    moving = MovingJob(flood=True, asks=dialog == "motion")
    await started(pilot, app, moving)
    await opened_dialog(pilot, app, dialog)
    pressing: list[asyncio.Task[None]] = []
    pressed_s = time.monotonic()
    if way == "click":
        press_stop(app)
    else:
        pressing.append(asyncio.ensure_future(pilot.press(way)))
    assert await asyncio.to_thread(moving.braked.wait, WAIT_S)
    await asyncio.gather(*pressing)
    first_verb, braked_s = moving.brakes[0]
    assert first_verb == verb
    if dialog == "motion":
        await ended(pilot, app)
        assert moving.allowed is False
        assert "not confirmed" in app.message
    elif verb == "stop":
        assert app.jobs.running, "a stopped job holds"
        await until(pilot, lambda: app.record.state == "stopped", "the state")
        await aborted(pilot, app)
    await ended(pilot, app)
    assert "keys 3, b go on" in app.message or dialog == "motion"
    if app.screen is not app.day_screen:
        await pilot.press("escape")
        await until(pilot, lambda: app.screen is app.day_screen, "the end of the dialog")
    return braked_s - pressed_s


def press_stop(app: CellApp) -> None:
    """Press STOP as a terminal does. A pilot would first wait until the screen is idle, which is no latency of STOP."""
    x, y = app.screen.query_one(StopButton).region.offset
    sure(app._driver).process_message(MouseDown(None, x, y, 0, 0, 1, False, False, False))


async def opened_dialog(pilot: Pilot[None], app: CellApp, dialog: str) -> None:
    """Open a dialog over a busy screen."""
    if dialog == "motion":
        await until(pilot, lambda: isinstance(app.screen, MotionQuestion), "the question")
        return
    seen = app.record.changes
    await until(pilot, lambda: app.record.changes > seen, "a busy screen")
    assert app.record.latest is not None
    assert app.record.latest.job == "collect"
    if dialog == "leave":
        await pilot.press("q")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question")
    elif dialog == "palette":
        await pilot.press("ctrl+p")
        await until(pilot, lambda: isinstance(app.screen, Palette), "the palette")
    await until(pilot, lambda: app.screen.query_one(StopButton).region.width > 0, "STOP")


async def test_pause_resume_stop_and_abort_are_different_things() -> None:
    moving = MovingJob()
    async with held_by(moving) as (pilot, app):
        assert app.record.state == "running"
        for key, request, shown in (
            ("p", "pause", "paused"),
            ("p", "none", "running"),
            ("p", "pause", "paused"),
            ("c", "none", "running"),
            ("escape", "stop", "stopped"),
            ("c", "none", "running"),
            ("escape", "stop", "stopped"),
            ("p", "stop", "stopped"),
            ("c", "none", "running"),
        ):
            await pilot.press(key)
            assert moving.control.request == request
            await until(pilot, lambda: app.record.state == shown, f"{shown} after {key}")  # noqa: B023
            if (key, shown) == ("p", "stopped"):
                assert "Stopped, not paused" in app.message
        assert [verb for verb, _ in moving.brakes] == ["stop", "stop"]
        await pilot.press("x")
        assert [verb for verb, _ in moving.brakes] == ["stop", "stop", "abort"]
        await ended(pilot, app)
        assert app.record.state is None
        assert app.message.startswith("Aborted; ")
        await pilot.press("q")
    assert app.return_code == 4


async def test_real_arms_move_when_the_profiles_name_is_typed() -> None:
    moving = MovingJob(asks=True)
    async with held_by(moving) as (pilot, app):
        await until(pilot, lambda: isinstance(app.screen, MotionQuestion), "the question")
        words = [str(text.render()) for text in app.screen.query(Static)]
        assert any("arm left turns joint 1" in text for text in words)
        await pilot.press(*"sxpc", "enter")
        await until(pilot, lambda: isinstance(app.screen, MotionQuestion), "the question")
        assert moving.control.request == "none", "letters in the field are text"
        app.screen.query_one("#name", Input).value = sure(app.workspace.profile).name
        await pilot.press("enter")
        await until(pilot, lambda: moving.allowed is True, "the permission")
        assert not isinstance(app.screen, MotionQuestion)
        await aborted(pilot, app)


async def test_a_button_refuses_the_motion() -> None:
    moving = MovingJob(asks=True)
    async with held_by(moving) as (pilot, app):
        await until(pilot, lambda: isinstance(app.screen, MotionQuestion), "the question")
        await pilot.pause()
        await pilot.click("#refuse")
        await ended(pilot, app)
        assert moving.allowed is False


async def test_a_resume_that_is_handled_after_a_later_stop_does_not_undo_it() -> None:
    moving = MovingJob()
    async with held_by(moving) as (pilot, app):
        given = sure(app.presses.give())  # as the thread does that reads the terminal
        requests: list[str] = []
        app.action_resume()
        requests.append(moving.control.request)  # it may have been pressed before
        app.post_message(given)
        await until(pilot, lambda: "STOP: all arms brake" in log_text(app), "the words")
        await until(pilot, lambda: not app.presses.just_given, "a moment later")
        app.action_resume()
        requests.append(moving.control.request)
        assert requests == ["stop", "none"]
        assert [verb for verb, _ in moving.brakes] == ["stop"]
        await aborted(pilot, app)


async def test_leaving_brakes_and_ends_a_job_that_holds() -> None:
    moving = MovingJob()
    async with held_by(moving) as (pilot, app):
        await pilot.press("escape")
        await until(pilot, lambda: app.record.state == "stopped", "the held job")
        await pilot.press("q", "y")
        await until(pilot, lambda: app.return_code is not None, "the end of the application")
    assert app.return_code == 4
    assert moving.brakes[-1][0] == "stop"


async def test_an_application_that_goes_away_brakes_the_arms() -> None:
    moving = MovingJob()
    async with held_by(moving) as (_, app):
        pass  # it is left at once
    assert moving.brakes[-1][0] == "stop"
    await asyncio.to_thread(app.leaving.wait_for_job)
    assert not [thread for thread in threading.enumerate() if thread.name == "collect"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM] if sys.platform != "win32" else [])
async def test_a_closed_terminal_brakes_the_arms_and_ends_the_program(number: int) -> None:
    for took in attempts(braked=BAR_S):
        took["braked"] = await braked_by_signal(number)


async def braked_by_signal(number: int) -> float:
    """Send this process a signal during a job; return how long it took until the arms braked [s]."""
    moving, before = MovingJob(), signal.getsignal(number)
    async with held_by(moving) as (pilot, app):
        sent_s = time.monotonic()
        os.kill(os.getpid(), number)
        assert await asyncio.to_thread(moving.braked.wait, WAIT_S)
        await until(pilot, lambda: app.return_code is not None, "the end of the application")
    assert app.return_code == 4
    assert signal.getsignal(number) is before
    return moving.brakes[0][1] - sent_s


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
async def test_ctrl_z_of_another_terminal_pauses_instead_of_freezing_the_program() -> None:
    moving = MovingJob()
    async with held_by(moving) as (pilot, app):
        os.kill(os.getpid(), signal.SIGTSTP)
        await until(pilot, lambda: app.record.state == "paused", "the pause")
        os.kill(os.getpid(), signal.SIGTSTP)
        await until(pilot, lambda: app.record.state == "running", "the continuation")
        await aborted(pilot, app)
