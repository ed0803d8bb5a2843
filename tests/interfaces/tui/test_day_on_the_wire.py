"""Faults of an emulated cell while the terminal application collects: shown in words, recovered by keys, nothing lost.

Emulated controllers and the tracker bridge stand behind the same drivers as real ones. What a person does at the
machine, such as releasing a protective stop at the pendant, the test does at the emulator; the program never does it.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from textual.pilot import Pilot

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.plan.run import new_planned_run
from cellapp.interfaces.tui.app import CellApp
from tests.evidence.wire.storm_cell import StormCell, emulated_cell
from tests.interfaces.tui.patient_program import be_patient
from tests.interfaces.tui.pilot import shown_text, until
from tests.interfaces.tui.terminal import PATIENT, Terminal, cellapp
from tests.loopback import free_port, own_address
from tests.twin import PROFILES
from tests.waiting import WAIT_S

_SETTLE_S = 0.05
"""Wall time, of which the emulated arms need less."""
_WAITS = "collection:\n  suspend: {target: {retry: 0.5}}\n"
"""The program looks for the target again after this, instead of 2 s."""
_SPLITS = {"identify": 1, "train": 0, "validate": 1, "pair_identify": 1, "pair_validate": 1}


def planned_day(folder: Path, stops: int, address: int) -> Path:
    """Write the profile and the run ``logs/day`` into a folder; the arms have own addresses from ``address`` on."""
    for name in ("arms", "targets"):
        shutil.copytree(PROFILES / name, folder / "profiles" / name)
    host = own_address(address)
    text = (PROFILES / "twin-rtde.yaml").read_text("utf-8").replace("127.0.0.1:50960", f"{host}:{free_port(host)}")
    for number, before in enumerate(("127.0.0.2", "127.0.0.3")):
        text = text.replace(f"host: {before}", f"host: {own_address(address + number)}, settle_time: {_SETTLE_S}")
    for key, size in {"stops": stops, **_SPLITS}.items():
        text, found = re.subn(rf"^  {key}: .*$", f"  {key}: {size}", text, flags=re.MULTILINE)
        assert found == 1, key
    profile = folder / "profiles" / "twin-rtde.yaml"
    profile.write_text(text + _WAITS, "utf-8")
    new_planned_run(load_profile(profile), folder / "logs" / "day").close()
    return folder


pytestmark = pytest.mark.waits

STOPS = 8
PACE = 2.0
"""Seconds of the cell for each real one: enough of a motion is left to strike, on a busy computer, too."""
UNDISTURBED_PACE = 200.0
"""Where nothing is struck any more."""


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the profile of the wire and a planned run of it, ``logs/day``."""
    return planned_day(tmp_path_factory.mktemp("wire"), STOPS, 59)


@pytest.fixture(scope="module")
def cell(planned: Path) -> Iterator[StormCell]:
    with emulated_cell(load_profile(planned / "profiles" / "twin-rtde.yaml"), PACE) as emulated:
        yield emulated


@pytest.fixture
def day(planned: Path, cell: StormCell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of profile and run, with the emulated cell in order; its folder."""
    be_patient(monkeypatch.setattr)
    cell.control("*", "pace", PACE)
    cell.repair()
    shutil.copytree(planned, tmp_path, dirs_exist_ok=True)
    return tmp_path


def words(app: CellApp) -> str:
    return " ".join(shown_text(app).split()).lower()


async def says(pilot: Pilot[None], app: CellApp, *texts: str) -> None:
    """Wait until the screen says all of this, wherever its lines break."""
    await until(pilot, lambda: all(text.lower() in words(app) for text in texts), f"{texts}")


async def both_move(pilot: Pilot[None], cell: StormCell) -> None:
    await until(pilot, lambda: all(one["moving"] for one in cell.status().values()), "both arms move")


async def at_rest(pilot: Pilot[None], cell: StormCell) -> None:
    await until(pilot, lambda: not any(one["moving"] for one in cell.status().values()), "the arms rest")


async def resume(pilot: Pilot[None], app: CellApp, cell: StormCell) -> None:
    """Press c until the arms go on: a person presses it again where a controller was not ready yet."""

    def goes_on() -> bool:  # a short motion may be over before anybody looks
        return all(moves(cell)) or done(app) > before or not app.jobs.running

    for _ in range(10):
        before = done(app)
        await pilot.press("c")
        await until(pilot, lambda: app.record.state != "stopped" or "not moved" in app.record.reason, "an answer to c")
        await until(pilot, lambda: app.jobs.control.request == "stop" or goes_on(), "a motion or a stop")
        if goes_on():
            return
    pytest.fail(f"c does not resume: {app.message}")


def done(app: CellApp) -> int:
    """Stops that the job has done."""
    return app.record.progress["collect"].done


def moves(cell: StormCell) -> list[bool]:
    """Whether each arm moves."""
    return [one["moving"] for one in cell.status().values()]


@pytest.mark.slow
async def test_faults_while_collecting_are_shown_in_words_and_recovered_by_keys(day: Path, cell: StormCell) -> None:
    app = CellApp(Path("profiles"))
    async with app.run_test(size=(120, 40)) as pilot:
        await says(pilot, app, "EMULATED")
        await pilot.press("8")
        await says(pilot, app, "day", f"stops 0/{STOPS} not begun; no results")
        await pilot.press("enter")
        await says(pilot, app, "logs/day is open.")
        await pilot.press("n")
        await says(pilot, app, f"READY, {STOPS} stops", "b measures")
        await pilot.press("b")
        await says(pilot, app, "Begin to collect?", "the arms are emulated")
        await pilot.press("b")
        await both_move(pilot, cell)

        for _ in range(4):  # collecting tries each measurement twice, then waits, and tries twice again
            cell.tracker_fault("beam")
        await says(pilot, app, "SUSPENDED", "it resumes by itself")
        assert "something covers it" in words(app)
        await says(pilot, app, "RUNNING")

        cell.control("left", "protective", "travel", 0.02)
        await says(pilot, app, "STOPPED", "protective stop", "c resumes when the cell is clear")
        await at_rest(pilot, cell)
        await pilot.press("c")
        await says(pilot, app, "STOPPED", "protective stop")
        assert cell.status()["left"]["safety_mode"] == "PROTECTIVE_STOP", "only a person releases it"
        cell.control("left", "release")
        assert not any(moves(cell)), "only a person resumes"
        await resume(pilot, app, cell)

        cell.control("right", "drop", "rtde", "rst")
        await says(pilot, app, "STOPPED", "right", "c resumes when the cell is clear")
        await at_rest(pilot, cell)
        await resume(pilot, app, cell)
        cell.control("*", "pace", UNDISTURBED_PACE)
        await says(pilot, app, f"COMPLETE, {STOPS} stops")
    with RunFile.open(day / "logs" / "day") as run:
        assert len(run.stops_done()) == STOPS
        (session,) = run.sessions()
        assert session.outcome == "complete"


@pytest.mark.slow
def test_a_closed_terminal_stops_the_arms_and_the_next_start_goes_on_with_the_run(day: Path, cell: StormCell) -> None:
    with cellapp(day, PATIENT) as terminal:
        shows(terminal, "EMULATED")
        terminal.send("8")
        shows(terminal, f"stops 0/{STOPS} not begun; no results")  # the tab Today shows 0/n, too
        terminal.send("\r")
        shows(terminal, "logs/day is open.")
        terminal.send("n")
        shows(terminal, f"READY, {STOPS} stops")
        terminal.send("b")
        shows(terminal, "Begin to collect?")
        terminal.send("b")
        shows(terminal, f" 2/{STOPS} ")
        terminal.hang_up()
        assert terminal.process.wait(WAIT_S) == 4
    assert cell.wait_at_rest(0.0), "the program waits for the arms"
    with RunFile.open(day / "logs" / "day") as run:
        done = len(run.stops_done())
        assert 2 <= done < STOPS
    with cellapp(day, PATIENT) as terminal:
        shows(terminal, f"a goes on with the last run, logs/day: {STOPS - done} stops left")
        terminal.send("a")
        shows(terminal, "logs/day is open.")
        terminal.send("n")
        shows(terminal, f"INTERRUPTED, {done} of {STOPS} stops", "b measures")
        cell.control("*", "pace", UNDISTURBED_PACE)
        terminal.send("b")
        shows(terminal, "Resume?")
        terminal.send("b")
        complete(terminal)
        terminal.send("q")
        assert terminal.process.wait(WAIT_S) == 0


def complete(terminal: Terminal) -> None:
    """Wait until all stops are measured; where a stall of this computer stops the arms, a person resumes."""
    ends = f"COMPLETE, {STOPS} stops"
    for _ in range(10):
        terminal.until(lambda shown: ends in shown or "c resumes when the cell is clear" in shown, ends)
        if ends in terminal.shown():
            return
        terminal.send("c")
        terminal.until(lambda shown: "c resumes when the cell is clear" not in shown, "an answer to c")
    pytest.fail(f"this computer stalls too often:\n{terminal.shown()}")


def shows(terminal: Terminal, *texts: str) -> None:
    """Wait until the terminal shows all of this."""
    terminal.until(lambda shown: all(text in " ".join(shown.split()) for text in texts), f"{texts}")
