"""Walks through the application by keys, approved as transcripts: ``walks/NAME.txt`` has the steps and the screens.

A step is a line ``$ WHAT ...``: see ``Walk.step``. To make a new walk, write its steps, then let ``tests/approved.py``
add what they show.
"""

from __future__ import annotations

import re
import shutil
from contextlib import AsyncExitStack
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from textual.pilot import Pilot
from textual.widgets import Input

from cellapp.cell.run import RunFile
from cellapp.commands.plan.run import new_planned_run
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.job_record import LEVELS, LogRow
from cellapp.interfaces.tui.widgets.log_pane import LogPane
from cellapp.robot.kinematics.chain import nominal_geometry, smr_positions
from tests.approved import assert_approved, commands_of
from tests.arms import UR5
from tests.cell.run.small_runs import collected_run, set_began
from tests.interfaces.tui.pilot import SIZES, ended, opened, shows, until
from tests.interfaces.tui.test_snapshots import final_text, words_of
from tests.twin import small_twin, write_few_targets, write_profile

WALKS = sorted((Path(__file__).parent / "walks").glob("*.txt"))
DAY = Path("logs") / "day"
NOON = datetime(2026, 3, 1, 12, 0, 0)
DOWN = np.array([[0.0, 0.6, 0.0, -1.5, 0.0, 0.0]])
"""Bent down into the floor."""


def make_run(kind: str, count: str, finished: Path) -> None:
    """A run of a kind in ``logs/day``."""
    match kind:
        case "finished":
            shutil.copytree(finished, DAY)
        case "outdated":
            shutil.copytree(finished, DAY)
            with RunFile.open(DAY, write=True) as run:
                words = list(run.readings("left").split or ())
                run.assign_splits("left", [*words[1:], words[0]])
            (DAY / "report.html").write_text("<html>")
        case "collected":
            collected_run(DAY, "complete" if count == "4" else "stopped", int(count))
        case "planned":
            new_planned_run(small_twin(int(count), plan={"method": "random"}), DAY).close()
        case "imported":
            RunFile.create(DAY, small_twin()).close()
        case "bent":
            plan = {"left": DOWN, "right": DOWN}
            RunFile.create(DAY, small_twin(1), lambda run: run.write_plan(plan)).close()
        case "several":
            for minute, (name, measured) in enumerate((("first", 4), ("second", 2), ("third", 3))):
                collected_run(Path("logs") / name, "stopped" if measured == 2 else "complete", measured)
                set_began(Path("logs") / name, minute)
            (Path("logs") / "broken").mkdir()
            (Path("logs") / "broken" / "run.sqlite").write_text("no run")


def make_profiles() -> None:
    """Small profiles, and a list of three targets."""
    write_profile(Path("profiles"))
    write_few_targets(Path("few.yaml"))


class Walk:
    """A person at the application, in the folder of a test."""

    def __init__(self, finished: Path, stack: AsyncExitStack) -> None:
        self.finished, self.stack = finished, stack
        self.pilot: Pilot[None]
        self.app: CellApp

    def _fields(self, name: str) -> list[Input]:
        """The fields of the screen that are called so."""
        return list(self.app.screen.query(f"Input#{name}, #{name} Input").results(Input))

    async def step(self, what: str, rest: str) -> str:
        """Do a step; what it shows."""
        name, _, text = rest.partition(" ")
        match what:
            case "run":  # KIND [COUNT]: profiles and a run
                make_profiles()
                make_run(name, text, self.finished)
            case "start":  # [SIZE]: the application; without profiles it offers to begin
                self.app = CellApp(Path("profiles"))
                size = next(one for one in SIZES if f"{one[0]}x{one[1]}" == (rest or "80x24"))
                self.pilot = await self.stack.enter_async_context(self.app.run_test(size=size))
                if (Path("profiles") / "twin.yaml").exists():
                    await opened(self.pilot, self.app)
            case "open":  # the run
                self.app.open_run(DAY, Path("profiles") / "twin.yaml")
                await until(self.pilot, lambda: self.app.workspace.folder == DAY and self.app.workspace.results, "it")
            case "press":  # KEY ...
                await self.pilot.press(*rest.split())
            case "type":  # TEXT
                await self.pilot.press(*("space" if letter == " " else letter for letter in rest))
            case "set":  # FIELD TEXT
                await until(self.pilot, lambda: self._fields(name), f"the field '{name}'")
                self._fields(name)[0].value = text
                await self.pilot.pause()
            case "until":  # WORDS on the screen
                await shows(self.pilot, rest)
            case "ended":  # no job runs any more
                await ended(self.pilot, self.app)
            case "quits":
                await until(self.pilot, lambda: self.app.return_code is not None, "the end of the application")
                return f"exit code {self.app.return_code}"
            case "look":
                return await final_text(self.pilot, self.app)
            case "write":  # FILE TEXT
                Path(name).parent.mkdir(exist_ok=True)
                Path(name).write_text(text.replace("\\n", "\n"), encoding="utf-8")
            case "own":  # FILE: stops of a UR5 in somebody's own form
                q = np.random.default_rng(2).uniform(-2.5, 2.5, (40, 6))
                p_M = smr_positions(nominal_geometry(UR5, np.array([0.0, 0.02, 0.08])), q)
                table = np.column_stack([np.degrees(q), p_M])
                np.savetxt(rest, table, "%.6f", header="j1 j2 j3 j4 j5 j6 x y z", comments="")
            case "copy":  # FILE NEW
                Path(text).parent.mkdir(exist_ok=True)
                shutil.copy(name, text)
            case "log":  # COUNT lines of all levels, on the screen Collect
                pane = self.app.screen.query_one(LogPane)
                await until(self.pilot, lambda: pane.view.size.width > 0, "the log on the screen")
                texts = (f"event {number} of arm {'left' if number % 3 else 'right'}" for number in range(int(rest)))
                pane.show("A log", [LogRow(NOON, LEVELS[n % 3], text) for n, text in enumerate(texts)])
            case "edit":  # FILE OLD NEW: another text in a file
                old, _, new = text.partition(" ")
                Path(name).write_text(Path(name).read_text("utf-8").replace(old, new), "utf-8")
            case "bend":  # FILE NEW: a plan whose third row is bent down into the floor
                cells = [line.split(",") for line in Path(name).read_text("utf-8").splitlines()]
                cells[3][cells[0].index("q2")] = "0.6"
                Path(text).write_text("\n".join([*map(",".join, cells), ""]), encoding="utf-8")
            case "read":  # FILE
                return Path(rest).read_text("utf-8")
            case other:
                raise ValueError(f"no step is called {other!r}")
        return ""


@pytest.mark.parametrize("path", WALKS, ids=lambda path: path.stem)
async def test_a_walk_shows_what_was_approved(
    path: Path, finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shown = []
    async with AsyncExitStack() as stack:
        walk = Walk(finished_run, stack)
        for command in commands_of(path):
            what, _, rest = command.partition(" ")
            shown.append(f"$ {command}\n{await walk.step(what, rest)}".rstrip("\n"))
    assert_approved(path, "\n".join(shown), without_folders)


def without_folders(text: str) -> str:
    """A text as screens are compared, without lines that show the folder of the test."""
    return re.sub(r"│[^│\n]*test_a_walk_shows[^│\n]*│", "│ FOLDER │", words_of(text))
