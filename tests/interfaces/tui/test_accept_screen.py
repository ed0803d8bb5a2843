"""The screen Accept: verdict and marks; every job is started, stopped, refused in its dialog, and shows its result.

The verbs are stood in for where driving is not what is tested: their own tests drive.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot
from textual.widgets import Checkbox, Input, Static, TabbedContent

from cellapp.cell.run import RunFile
from cellapp.commands.check import run as check_verb
from cellapp.commands.check.request import FEWEST_STOPS, STOPS
from cellapp.commands.iso9283 import run as iso_verb
from cellapp.commands.iso9283.request import Iso9283Request
from cellapp.commands.report.result import read_results
from cellapp.commands.stages import append_stage, basis_on_model, read_stages
from cellapp.estimation.iso9283.records import Iso9283Result
from cellapp.estimation.monitoring.check.records import CheckedArm, CheckResult
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.progress import Listener, Progress, StateChange
from cellapp.ground.results import CALIBRATE, CHECK, ISO9283, Result, StageName
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.program import MotionQuestion
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from tests.interfaces.tui.pilot import (
    PROFILES,
    SMALL,
    ended,
    exit_code,
    log_text,
    opened,
    shown_text,
    shows,
    tells,
    until,
)

TWIN = PROFILES / "twin.yaml"
VALID = CheckResult(
    verdict="valid",
    planned=20,
    sure_after=9,
    p_value=0.4,
    arms={"left": CheckedArm(stops=9, expected_mm=0.03, rms_mm=0.03)},
)
MOVED = VALID.model_copy(update={"verdict": "tracker moved", "p_value": 1e-9})
TESTED = Iso9283Result(tests=("pose",), arms={}, missing=("arm left: cycle 3 of pose P2: beam broken",))


@dataclass
class Driving:
    """A stand-in of a verb that drives: it reports, can be stopped, and stores its result once it may go on."""

    stage: StageName
    result: Result
    note: str
    asks: bool = False
    asked: dict[str, Any] = field(default_factory=dict)
    began: threading.Event = field(default_factory=threading.Event)
    go_on: threading.Event = field(default_factory=threading.Event)
    brakes: list[str] = field(default_factory=list)

    def check_run(self, run: RunFile, listener: Listener, control: JobControl, **asked: Any) -> Result:
        """As ``cellapp.commands.check.run.check_run``."""
        self.asked = asked
        return self._drive(run, listener, control)

    def iso9283_run(
        self, run: RunFile, request: Iso9283Request, listener: Listener, control: JobControl, **asked: Any
    ) -> Result:
        """As ``cellapp.commands.iso9283.run.iso9283_run``."""
        self.asked = {"request": request, **asked}
        return self._drive(run, listener, control)

    def _drive(self, run: RunFile, listener: Listener, control: JobControl) -> Result:
        if self.asks and not self.asked["ask"]("First motion: arm left turns joint 1 by 9 deg."):
            raise InputError("the first motion was not confirmed; nothing was moved")
        with control.brakes(self.brakes.append):
            listener(Progress(self.stage, 3, 20, self.note))
            self.began.set()
            while not self.go_on.is_set():
                control.check()
                if control.request == "pause":
                    listener(Progress(self.stage, 3, 20, detail=StateChange("paused", "asked by a person")))
                control.wait_while(control.request, timeout_s=0.02)
        stages = read_stages(run)
        append_stage(run, self.stage, self.result, basis_on_model(run, stages.in_force))  # type: ignore[arg-type]
        return self.result


async def show_accept(pilot: Pilot[None], app: CellApp, run: Path | None) -> None:
    """Open a run, show the screen, wait for its verdict."""
    await opened(pilot, app)
    if run is not None:
        app.open_run(run, TWIN)
        await until(pilot, lambda: app.workspace.folder == run, "the run")
    await pilot.press("7")
    await until(pilot, lambda: app.day_screen.STEP == "accept", "the screen")
    await until(pilot, lambda: "reading" not in decision(app), "the verdict")


def decision(app: CellApp) -> str:
    return str(app.day_screen.query_one("#decision", Static).content)


def outdated(app: CellApp) -> str:
    return str(app.day_screen.query_one("#outdated", Static).content)


def tab(app: CellApp) -> str:
    return app.day_screen.query_one("#accept", TabbedContent).active


def fill(app: CellApp, **texts: str) -> None:
    for name, text in texts.items():
        app.screen.query_one(f"#{name}", Input).value = text


async def ask(pilot: Pilot[None], app: CellApp, key: str, dialog: type) -> None:
    """Press a key and wait for its dialog; all of it fits into the smallest terminal."""
    await pilot.press(key)
    await until(pilot, lambda: isinstance(app.screen, dialog), "the dialog")
    await until(pilot, lambda: any(word in shown_text(app) for word in ("Not now", "Close")), "its answers")


async def test_what_is_out_of_date_is_loud_on_every_tab(finished_copy: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        stored = read_stages(run).current[CALIBRATE]
        result = read_results(run).calibrate
        assert result is not None
        assert stored.basis is not None
        append_stage(run, CALIBRATE, result, stored.basis.model_copy(update={"profile": "another"}), stored.model)
    (finished_copy / "report.html").write_text("<html>")
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_accept(pilot, app, finished_copy)
        assert "OUT OF DATE: report.html" in outdated(app)
        assert "calibrate" in outdated(app)
        for _ in range(4):
            await shows(pilot, "! OUT OF DATE")
            await pilot.press("t")
        await ask(pilot, app, "m", VerbQuestion)
        await shows(pilot, "The model is not up to date")
        await shows(pilot, "Use this model all the same (u)")


async def test_a_check_is_asked_for_driven_stopped_and_judged(
    finished_copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driving = Driving(CHECK, VALID, "stop 4 of 20: still valid, p = 0.4")
    monkeypatch.setattr(check_verb, "check_run", driving.check_run)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_accept(pilot, app, finished_copy)
        await ask(pilot, app, "k", VerbQuestion)
        await shows(pilot, "the arms are simulated")
        await until(pilot, lambda: app.screen.query_one("#stops", Input).value == str(STOPS), "the text of the field")
        for wrong, says in (("", "a whole number"), ("3", f"at least {FEWEST_STOPS}, got 3"), ("many", "got 'many'")):
            fill(app, stops=wrong)
            await pilot.press("b")
            await shows(pilot, says)
        fill(app, stops="12")
        await pilot.press("b")
        await until(pilot, lambda: "still valid, p = 0.4" in shown_text(app), "the evidence so far")
        assert tab(app) == "check-pane"
        assert "3/20" in shown_text(app)
        assert driving.asked["stops"] == 12
        await pilot.press("escape")
        assert driving.brakes, "the key calls the brakes"
        await tells(pilot, "STOP")
        await pilot.press("x")
        await ended(pilot, app)
        assert app.message.startswith("Aborted")
        await until(pilot, lambda: "was not checked yet" in shown_text(app), "that nothing was stored")

        await ask(pilot, app, "k", VerbQuestion)
        await pilot.press("b")
        await until(pilot, lambda: "3/20" in shown_text(app), "the second drive")
        await pilot.press("p")
        await until(pilot, lambda: "PAUSED" in shown_text(app), "the pause")
        await pilot.press("c")
        driving.go_on.set()
        await ended(pilot, app)
        await until(pilot, lambda: "the calibration still holds" in shown_text(app), "the result")
        assert "check: done; the calibration holds" in log_text(app)

        driving.result, driving.asks = MOVED, True
        for answer, says in (("", "was not confirmed"), ("twin", "does not hold as it is: tracker moved")):
            await ask(pilot, app, "k", VerbQuestion)
            await pilot.press("b")
            await until(pilot, lambda: isinstance(app.screen, MotionQuestion), "the first motion")
            assert "joint 1 by 9 deg" in shown_text(app)
            await pilot.press(*answer, "enter" if answer else "f10")
            await ended(pilot, app)
            await until(pilot, lambda says=says: says in log_text(app), "how it ended")  # type: ignore[misc]
        assert await exit_code(pilot, app) == 1


async def test_tests_by_iso_9283_are_chosen_driven_and_shown(
    finished_copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driving = Driving(ISO9283, TESTED, "arm left, cycle 3 of 4")
    monkeypatch.setattr(iso_verb, "iso9283_run", driving.iso9283_run)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_accept(pilot, app, finished_copy)
        await ask(pilot, app, "m", VerbQuestion)
        marked = {str(box.id) for box in app.screen.query(Checkbox) if box.value}
        assert marked == {"tests-pose", "commands-nominal", "commands-calibrated"}
        await shows(pilot, "X▌ pose")
        await shows(pilot, " ▌ distance")  # an empty box differs without colours, too
        app.screen.query_one("#tests-pose", Checkbox).value = False
        await pilot.press("b")
        await shows(pilot, "tests: at least one is needed")
        app.screen.query_one("#tests-distance", Checkbox).value = True
        for kind in ("nominal", "calibrated"):
            app.screen.query_one(f"#commands-{kind}", Checkbox).value = False
        await pilot.press("b")
        await shows(pilot, "commanded by the model: at least one is needed")
        app.screen.query_one("#commands-calibrated", Checkbox).value = True
        wrong = {
            "cycles": ("a whole number", ("2.5", "nan", "")),
            "speed": ("above 0 % and up to 100 %", ("101", "0", "nan")),
            "drift-minutes": ("above 0 and up to 960, got 0", ("0",)),
            "also-speeds": ("expected shares", ("0", "50, 101")),
        }
        for name, (says, texts) in wrong.items():
            right = app.screen.query_one(f"#{name}", Input).value
            for text in texts:
                fill(app, **{name: text})
                await pilot.press("b")
                await shows(pilot, says)
            fill(app, **{name: right})
        fill(app, cycles="4", speed="50", **{"also-speeds": "50, 10"})
        app.screen.query_one("#arms-left", Checkbox).value = True
        await pilot.press("b")
        await until(pilot, lambda: "cycle 3 of 4" in shown_text(app), "the progress")
        assert tab(app) == "iso9283-pane"
        assert driving.asked["request"] == Iso9283Request(
            folder=finished_copy,
            tests=("distance",),
            cycles=4,
            speed=50.0,
            also_speeds=(50.0, 10.0),
            arms=("left",),
            commands=("calibrated",),
        )
        driving.go_on.set()
        await ended(pilot, app)
        await until(pilot, lambda: "cycle 3 of pose P2: beam broken" in shown_text(app), "what is missing")
        assert "Nothing was tested yet" not in shown_text(app)
