"""The terminal application on emulated controllers, as an operator tries it: the stop key, resume, pause, abort."""

from __future__ import annotations

import asyncio
import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Input, Static

from cellapp.run import RunFile
from cellapp.tui.app import CellApp
from drivers.emulators.ur_controller import Control
from tests.twin import PROFILES

WAIT_S = 60.0
BAR_S = 0.1
"""From the key to the stop command at every controller."""
SLACK_S = 0.2
"""From there to rest, more than the arm's own braking time."""
HOSTS = {"127.0.0.2": "127.0.82.2", "127.0.0.3": "127.0.82.3"}  # the ports are fixed, so nobody else's addresses


def free_port() -> int:
    """A port of this computer that nobody listens on."""
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        return int(server.getsockname()[1])


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    shutil.copytree(PROFILES, tmp_path / "profiles")
    path = tmp_path / "profiles" / "twin-rtde.yaml"
    text = path.read_text("utf-8").replace("127.0.0.1:50960", f"127.0.0.1:{free_port()}")
    for before, now in HOSTS.items():
        text = text.replace(before, now)
    path.write_text(text.replace("stops: 80", "stops: 6"), "utf-8")
    return path


def object_on(process: subprocess.Popen[str]) -> str:
    """The JSON object that a process prints and ends with a line of its own."""
    assert process.stdout is not None
    lines = [""]
    while lines[-1] != "}\n":
        lines.append(process.stdout.readline())
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


async def stopped_by(pilot: Pilot[None], control: Control, key: str) -> None:
    """Press a key while both arms move: both controllers must get the stop, and the arms rest, in time."""
    await until(lambda: all(moving(control)), "both arms move")
    pressed_s = time.monotonic()
    await pilot.press(key)
    await until(lambda: not any(moving(control)), f"the arms rest after {key}")
    for name in ("left", "right"):
        stop = control(name, "status")["stop"]
        assert 0.0 < stop["received_s"] - pressed_s < BAR_S
        assert stop["rest_s"] - stop["received_s"] < stop["ideal_s"] + SLACK_S


async def test_the_arms_stop_under_ones_finger(profile: Path, tmp_path: Path) -> None:
    app = CellApp(profile.parent)
    with emulated(profile) as control:
        async with app.run_test(size=(140, 45)) as pilot:

            def says(words: str) -> Callable[[], bool]:
                return lambda: words in str(app.query_one("#status", Static).content)

            app.query_one("#profile", Input).value = str(profile)
            app.query_one("#folder", Input).value = str(tmp_path / "run")
            app.query_one("#run").focus()
            await pilot.press("f5")
            await stopped_by(pilot, control, "escape")
            await until(says("STOPPED"), "the stop is shown")
            moves = [control(name, "status")["moves"] for name in ("left", "right")]
            await asyncio.sleep(0.5)
            assert [control(name, "status")["moves"] for name in ("left", "right")] == moves, "nothing moves by itself"
            await pilot.press("c")
            await until(lambda: all(moving(control)), "the job goes on")
            await pilot.press("p")
            await until(says("PAUSED"), "it rests after the stop")
            assert moving(control) == [False, False]
            await pilot.press("p")
            await stopped_by(pilot, control, "x")
            await until(lambda: not app.running, "the end of the run")
    with RunFile.open(tmp_path / "run") as run:
        (session,) = run.sessions()
        assert [kind for _, kind, _ in session.requests] == ["stop", "resume", "pause", "resume", "abort"]
        assert session.outcome == "aborted"
        assert len(run.stops_done()) == 1
