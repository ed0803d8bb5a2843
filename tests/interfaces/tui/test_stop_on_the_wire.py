"""The terminal application on emulated controllers, as an operator tries it: the stop key, resume, pause, abort."""

from __future__ import annotations

import asyncio
import json
import math
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from textual.pilot import Pilot

from cellapp.cell.run import RunFile
from cellapp.commands.run.request import VERB as RUN
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.work import job_of
from drivers.emulators.ur_controller import Control
from tests.commands.emulated_cell import stalled
from tests.latency import attempts
from tests.loopback import free_port, own_address
from tests.twin import PROFILES
from tests.waiting import WAIT_S, within

pytestmark = pytest.mark.waits

BAR_S = 0.1
"""From the key to the stop command at every controller."""
UNDISTURBED_PACE = 10.0
"""Seconds of the cell for each real one while a stop is measured and nothing is timed."""
SLACK_S = 0.2
"""From there to rest, more than the arm's own braking time."""
HOSTS = {"127.0.0.2": own_address(57), "127.0.0.3": own_address(58)}
TRACKER_HOST = own_address(57)


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    shutil.copytree(PROFILES, tmp_path / "profiles")
    path = tmp_path / "profiles" / "twin-rtde.yaml"
    text = path.read_text("utf-8").replace("127.0.0.1:50960", f"{TRACKER_HOST}:{free_port(TRACKER_HOST)}")
    for before, now in HOSTS.items():
        text = text.replace(before, now)
    path.write_text(text.replace("stops: 80", "stops: 6"), "utf-8")
    return path


def object_on(process: subprocess.Popen[str]) -> str:
    """The JSON object that a process prints and ends with a line of its own."""
    assert process.stdout is not None
    lines = [""]
    while lines[-1] != "}\n":
        lines.append(within(process.stdout.readline, "the addresses of the emulators"))
        assert lines[-1], "the emulators did not come up"
    return "".join(lines)


@contextmanager
def emulated(profile: Path) -> Iterator[Control]:
    """The emulated cell of a profile in real time; gives its control channel."""
    process = subprocess.Popen(
        [sys.executable, "-m", "cellapp", "emulate", str(profile), "--json", "-"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        port = json.loads(object_on(process))["arms"][0]["control_port"]
        with closing(Control(("127.0.0.1", port))) as control:
            yield control
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=WAIT_S)


async def until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end_s, what
        await asyncio.sleep(0.005)


def moving(control: Control) -> list[bool]:
    return [control(name, "status")["moving"] for name in ("left", "right")]


async def stopped_by(pilot: Pilot[None], control: Control, key: str) -> dict[str, float]:
    """Press a key while both arms move: both controllers get the stop, and the arms rest.

    Returns the later controller's times [s]: ``stop``, from the key to the stop command, and ``rest``, from there to
    rest, without the arm's own braking time.
    """
    await until(lambda: all(moving(control)), "both arms move")
    pressed_s = time.monotonic()
    await pilot.press(key)
    await until(lambda: not any(moving(control)), f"the arms rest after {key}")
    stops = [control(name, "status")["stop"] for name in ("left", "right")]
    assert all(stop["received_s"] > pressed_s for stop in stops)
    return {
        "stop": max(stop["received_s"] - pressed_s for stop in stops),
        "rest": max(stop["rest_s"] - stop["received_s"] - stop["ideal_s"] for stop in stops),
    }


async def test_the_arms_stop_under_ones_finger(profile: Path, tmp_path: Path) -> None:
    with emulated(profile) as control:
        for took in attempts(stop=BAR_S, rest=SLACK_S, abort=BAR_S, rest_after_abort=SLACK_S):
            folder = tmp_path / f"run {time.monotonic()}"
            control("*", "pace", 1.0)
            try:
                took.update(await one_session(profile, folder, control))
                with RunFile.open(folder) as run:
                    (session,) = run.sessions()
                    assert [kind for _, kind, _ in session.requests] == ["stop", "resume", "pause", "resume", "abort"]
                    assert session.outcome == "aborted"
                    assert len(run.stops_done()) == 1
            except AssertionError:
                if not this_computer_stalled(folder):
                    raise
                took.update(dict.fromkeys(("stop", "rest", "abort", "rest_after_abort"), math.inf))


def this_computer_stalled(folder: Path) -> bool:
    """Whether a run was stopped because this computer was busy elsewhere, or a key came so late that a stop more was
    measured: nothing is shown by it then."""
    with RunFile.open(folder) as run:
        reasons = [reason for session in run.sessions() for _, _, reason in session.requests]
        return len(run.stops_done()) > 1 or any(map(stalled, reasons))


async def one_session(profile: Path, folder: Path, control: Control) -> dict[str, float]:
    """Run, stop, resume, pause, resume and abort; return the times of ``stopped_by`` for the stop and the abort [s]."""
    app = CellApp(profile.parent)
    async with app.run_test(size=(140, 45)) as pilot:
        await until(lambda: app.workspace.profile is not None, "a profile")
        assert app.start_job(job_of(RUN, profile=profile, folder=folder))
        stopped = await stopped_by(pilot, control, "escape")
        await until(lambda: app.record.state == "stopped", "the stop is shown")
        moves = [control(name, "status")["moves"] for name in ("left", "right")]
        await asyncio.sleep(0.5)
        assert [control(name, "status")["moves"] for name in ("left", "right")] == moves, "nothing moves by itself"
        await pilot.press("c")
        await until(lambda: all(moving(control)), "the job goes on")
        await pilot.press("p")
        control("*", "pace", UNDISTURBED_PACE)
        await until(lambda: app.record.state == "paused", "it rests after the stop")
        control("*", "pace", 1.0)
        assert moving(control) == [False, False]
        await pilot.press("p")
        aborted = await stopped_by(pilot, control, "x")
        await until(lambda: not app.jobs.running, "the end of the run")
    return {**stopped, "abort": aborted["stop"], "rest_after_abort": aborted["rest"]}
