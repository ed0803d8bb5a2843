"""A run in which another process works: its state is shown, requests reach its job, and leaving it stops nothing."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Static

from cellapp.ground.job_client import JOB_FILE, ask_running_job
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.question import Choice
from cellapp.interfaces.tui.widgets.header import DayHeader
from tests.cell.run.small_runs import collected_run
from tests.interfaces.tui.pilot import ended, log_text, opened, running, shown_text, until
from tests.sure import sure
from tests.waiting import WAIT_S, next_line, process_of

pytestmark = pytest.mark.waits

LOGS = Path("logs")
RUN = LOGS / "day"
OTHER = LOGS / "other"


@pytest.fixture(autouse=True)
def _runs(tmp_path: Path) -> None:
    for folder in (RUN, OTHER):
        collected_run(tmp_path / folder, None)


@contextlib.contextmanager
def other_job(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """A job in a process of its own; it has begun to move."""
    asked = "tests.interfaces.tui.other_job", str(folder.absolute()), *words
    with process_of(*asked, stdin=subprocess.PIPE, stderr=None) as process:
        assert next_line(process) == "ready"
        yield process


async def watched(pilot: Pilot[None], app: CellApp, starts: bool = True) -> None:
    """Wait until the application shows the job; ``starts``: after its run was opened."""
    await opened(pilot, app)
    if starts:
        app.open_run(RUN)
        await pilot.press("3")
    await until(pilot, lambda: app.jobs.watched, "the job of another process")


def badge(app: CellApp) -> str:
    return str(app.day_screen.query_one(DayHeader).query_one(".badge").render())


async def test_a_run_in_which_another_process_works_is_watched_and_commanded() -> None:
    with other_job(RUN) as job:
        async with running(size=(120, 40)) as (pilot, app):
            await watched(pilot, app)
            await until(pilot, lambda: badge(app) == " WATCHED · NO ARMS ", "the badge")
            assert f"Process {job.pid} runs 'collect' in logs/day: its state is shown" in log_text(app)
            await until(pilot, lambda: "RUNNING" in shown_text(app), "the state")
            await until(pilot, lambda: "2/30" in shown_text(app), "how far it is")
            for key, state in (("p", "paused"), ("c", "running"), ("escape", "stopped"), ("c", "running")):
                await pilot.press(key)
                await until(pilot, lambda: app.record.state == state, f"{state} after {key}")  # noqa: B023
            assert next_line(job).startswith("brake stop")
            ask_running_job(RUN, "pause")  # somebody else
            await until(pilot, lambda: app.record.state == "paused", "what others ask")
            await pilot.press("x")
            assert next_line(job).startswith("brake abort")
            await ended(pilot, app)
            assert job.wait(WAIT_S) == 4
            assert app.message.startswith("Aborted; ")
            await until(pilot, lambda: "INTERRUPTED, 2 of 4 stops" in shown_text(app), "the run as it is now")
            assert "WATCHED" not in badge(app)


async def test_a_job_that_begins_or_ends_meanwhile_is_noticed() -> None:
    async with running(size=(120, 40)) as (pilot, app):
        app.open_run(RUN)
        await pilot.press("3")
        await until(pilot, lambda: app.workspace.folder is not None, "the run")
        folder = sure(app.workspace.folder)
        with other_job(folder, "batch") as job:
            await watched(pilot, app, starts=False)
            assert job.stdin is not None
            job.stdin.close()
            job.stdin = None
            await ended(pilot, app)
            assert app.message.startswith(f"collect: process {job.pid} has ended it; the run is in {folder}")
        with other_job(folder, "batch") as job:
            await watched(pilot, app, starts=False)
            job.kill()
            await ended(pilot, app)
            assert f"process {job.pid}, which ran 'collect' in {folder}, is gone without a word" in app.message


async def test_what_is_not_watched_any_more_goes_on() -> None:
    with other_job(RUN) as job:
        async with running(size=(120, 40)) as (pilot, app):
            await watched(pilot, app)
            app.open_run(OTHER)
            await until(pilot, lambda: app.workspace.folder == OTHER and not app.jobs.running, "the other run")
            assert f"'collect' goes on in process {job.pid}" in log_text(app)
            app.open_run(RUN)
            await watched(pilot, app, starts=False)
            await pilot.press("q")
            await until(pilot, lambda: isinstance(app.screen, Choice), "the question")
            says = "'collect' runs in another process and goes on; its arms are not stopped."
            assert says in " ".join(str(line.render()) for line in app.screen.query(Static))
            await pilot.press("y")
            await until(pilot, lambda: app.return_code is not None, "the end of the application")
        assert app.return_code == 0
        assert job.poll() is None
        assert "all arms brake" in ask_running_job(RUN, "stop"), "it goes on, and was not stopped before"
        assert next_line(job).startswith("brake stop")


async def test_a_job_that_hangs_is_next_line() -> None:
    with other_job(RUN) as job:
        async with running(size=(120, 40)) as (pilot, app):
            await watched(pilot, app)
            job.send_signal(signal.SIGSTOP)
            await until(pilot, lambda: "did not answer within 2 s" in app.message, "the silence")
            await pilot.press("escape")
            await asyncio.sleep(0.1)
            job.send_signal(signal.SIGCONT)
            assert next_line(job).startswith("brake stop"), "it waited on the way"


async def test_a_job_on_another_computer_is_named_and_nothing_is_begun(tmp_path: Path) -> None:
    with other_job(RUN):
        address = json.loads((RUN / JOB_FILE).read_text())
    (RUN / JOB_FILE).write_text(json.dumps({**address, "computer": "cell-pc"}))
    shutil.rmtree(OTHER)
    async with running(size=(120, 40)) as (pilot, app):
        app.open_run(RUN)
        await until(pilot, lambda: "in use by a job on computer 'cell-pc'" in app.message, "where it runs")
        await pilot.press("3")
        await until(pilot, lambda: "IN USE by a job on computer" in " ".join(shown_text(app).split()), "the headline")
        await pilot.press("b")
        assert not isinstance(app.screen, Choice)
        assert not app.jobs.running
        (RUN / JOB_FILE).unlink()
        await until(pilot, lambda: "INTERRUPTED, 2 of 4 stops" in shown_text(app), "the end of it")
