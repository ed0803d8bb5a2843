"""The screen, driven by keys: with a run that the test controls, and once with the real one."""

from __future__ import annotations

import asyncio
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Button, DataTable, Input, Label, OptionList, ProgressBar, RichLog, Static, TabbedContent

from cellapp.commissioning.confirm import Ask
from cellapp.control import JobControl
from cellapp.errors import HardwareError, InputError
from cellapp.progress import Listener, Progress
from cellapp.reporting.discovery_tables import discovery_tables
from cellapp.results import DiscoverResult, WholeRunResult
from cellapp.tui.app import CellApp
from cellapp.tui.dialogs import LeaveScreen
from cellapp.tui.endings import ERROR_LOG
from tests.reporting.cases import calibration, unknown_effect

PROFILES = Path(__file__).resolve().parents[2] / "profiles"
WAIT_S = 30.0
WHOLE_RUN_S = 150.0
SMALL = (80, 24)
CONTROLS = "#profiles, #profile, #folder, #run, #stop, #pause, #resume, #abort"

SENTENCE = "arm left: backlash [joint 2] explains it"
RESULTS = WholeRunResult(
    run="",
    calibrate=calibration("left"),
    discover=DiscoverResult(arms={"left": unknown_effect("left").model_copy(update={"sentence": SENTENCE})}),
    notes=("target left-17: not [reached]",),
)


@dataclass
class HeldRun:
    """Stands in for ``run_whole``: emits events, waits for the test, then returns ``results`` or raises ``error``."""

    events: tuple[Progress, ...] = (Progress("plan", 30, 30, "done"), Progress("collect", 7, 30, "stop 8"))
    error: BaseException | None = None
    results: WholeRunResult = RESULTS
    reached: threading.Event = field(default_factory=threading.Event)
    go_on: threading.Event = field(default_factory=threading.Event)
    calls: list[tuple[Path, Path | None]] = field(default_factory=list)
    thread: threading.Thread | None = None

    def hold_again(self) -> None:
        self.reached.clear()
        self.go_on.clear()

    def __call__(
        self, profile: Path, folder: Path | None, listener: Listener, control: JobControl, *, ask: Ask
    ) -> WholeRunResult:
        assert folder is not None
        self.calls.append((profile, folder))
        self.thread = threading.current_thread()
        for event in self.events:
            listener(event)
        self.reached.set()
        assert self.go_on.wait(WAIT_S)
        control.check()
        if self.error is not None:
            raise self.error
        return self.results.model_copy(update={"run": str(folder)})


@pytest.fixture(autouse=True)
def _surroundings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("textual.constants.TEXTUAL_ANIMATIONS", "none")  # nothing to wait for
    monkeypatch.chdir(tmp_path)  # runs without a name go to logs in the working directory


async def until(pilot: Pilot[None], holds: Callable[[], bool], what: str, wait_s: float = WAIT_S) -> None:
    try:
        async with asyncio.timeout(wait_s):
            while not holds():
                await pilot.pause()
    except TimeoutError:
        pytest.fail(f"never came: {what}; the status is: {status(pilot)}")


async def started(pilot: Pilot[None], run: HeldRun, key: str = "f5") -> None:
    await pilot.pause()
    await pilot.press(key)
    assert await asyncio.to_thread(run.reached.wait, WAIT_S)
    await pilot.pause()


async def ended(pilot: Pilot[None], app: CellApp, wait_s: float = WAIT_S) -> None:
    await until(pilot, lambda: not app.running, "the end of the run", wait_s)
    await pilot.pause()


def status(pilot: Pilot[None]) -> str:
    return str(pilot.app.query_one("#status", Static).render())


def log(app: CellApp) -> str:
    return "\n".join(line.text for line in app.query_one("#log", RichLog).lines)


def texts(app: CellApp) -> list[str]:
    return [str(static.render()) for static in app.query_one("#tables").query(Static)]


@pytest.mark.fast
async def test_events_move_the_bar_of_their_job() -> None:
    run = HeldRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SMALL) as pilot:
        await started(pilot, run)
        await until(pilot, lambda: "collect 7/30 stop 8" in log(app), "the last event in the log")
        assert app.query_one("#plan-bar", ProgressBar).percentage == 1.0
        assert app.query_one("#collect-bar", ProgressBar).percentage == pytest.approx(7 / 30)
        assert app.query_one("#discover-bar", ProgressBar).percentage == 0.0
        assert str(app.query_one("#collect-count", Label).render()) == "7/30"
        assert str(app.query_one("#collect-note", Label).render()) == "stop 8"
        assert str(app.query_one("#discover-count", Label).render()) == ""
        run.go_on.set()
        await ended(pilot, app)


async def test_tables_verdict_and_notes_appear_when_the_run_is_done() -> None:
    run = HeldRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SMALL) as pilot:
        await started(pilot, run)
        assert not app.query(DataTable)
        run.go_on.set()
        await ended(pilot, app)
        assert app.query_one("#results", TabbedContent).active == "tables-pane"
        first = app.query(DataTable).first()
        assert [str(cell) for cell in first.get_row_at(0)] == [
            "nominal, position", "0.1234", "0.2000", "0.0500", "0.4000", "17",
        ]  # fmt: skip
        shown = texts(app)
        assert SENTENCE in shown
        assert "Arm left: held-out errors [mm] (27 parameters, 4 iterations)" in shown
        assert "Note: target left-17: not [reached]" in shown
        assert "target left-17" in log(app)
        (meaning,) = [text for text in shown if "settle   - Repeat 20 stops with a second payload." in text]
        assert meaning.startswith("Arm left: Something behaves like backlash, but of the opposite sign")
        assert "Arm left: What is left still depends on time (p below 0.001)." in meaning
        steps, accepted = list(app.query(DataTable))[2:]
        assert RESULTS.discover is not None
        expected = discovery_tables(RESULTS.discover)
        assert [table.title for table in expected] == [
            text for text in shown if text.startswith("Arm left: ") and "\n" not in text
        ][-2:]
        for drawn, table in zip((steps, accepted), expected, strict=True):
            assert tuple(str(column.label) for column in drawn.columns.values()) == table.headings
            rows = [tuple(str(cell) for cell in drawn.get_row_at(place)) for place in range(drawn.row_count)]
            assert tuple(rows) == table.text_rows()
        assert status(pilot).startswith("Done")

        run.hold_again()
        run.events = (Progress("plan", 1, 30),)
        await started(pilot, run)
        await until(pilot, lambda: "plan 1/30" in log(app), "the event of a second run")
        assert not app.query(DataTable)
        assert app.query_one("#collect-bar", ProgressBar).percentage == 0.0
        run.go_on.set()
        await until(pilot, lambda: len(app.query(DataTable)) == 4, "the new tables")
        assert await exit_code(pilot, app) == 0


@pytest.mark.fast
async def test_results_that_do_not_hold_are_marked_and_not_shown() -> None:
    out_of_date = {"discover": "20 readings were added since"}
    run = HeldRun(results=RESULTS.model_copy(update={"out_of_date": out_of_date}))
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SMALL) as pilot:
        run.go_on.set()
        await started(pilot, run)
        await ended(pilot, app)
        assert len(app.query(DataTable)) == 2
        assert SENTENCE not in texts(app)
        (mark,) = app.query(".outdated").results(Static)
        assert "discover" in str(mark.render())
        assert "20 readings were added since" in log(app)


async def test_stop_ends_the_run_at_its_next_step_and_says_how_to_go_on() -> None:
    run = HeldRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SMALL) as pilot:
        app.query_one("#folder", Input).value = "my run"
        for key in ("escape", "s"):
            await started(pilot, run)
            assert app.query_one("#run", Button).disabled
            await pilot.press(key)
            assert status(pilot) == "Stopping at the next step."
            assert app.running
            run.go_on.set()
            await ended(pilot, app)
            assert status(pilot) == "Stopped; continue with: cellapp collect 'my run' --resume."
            assert app.query_one("#stop", Button).disabled
            assert not app.query_one("#run", Button).disabled
            run.hold_again()
        assert await exit_code(pilot, app) == 4


async def test_a_stopped_run_goes_on_from_the_step_it_was_in() -> None:
    run = HeldRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SMALL) as pilot:
        app.query_one("#folder", Input).value = "here"
        for last, way in (
            (Progress("plan", 3, 30), "start again"),
            (Progress("plan", 30, 30), "cellapp collect here --resume"),
            (Progress("calibrate", 1, 3), "cellapp calibrate here"),
            (Progress("discover", 0, 2), "cellapp discover here"),
            (Progress("push", 0, 2), "cellapp push here TARGETS --verify"),
        ):
            run.events = (last,)
            await started(pilot, run)
            app.action_stop()
            run.go_on.set()
            await ended(pilot, app)
            assert status(pilot).startswith("Stopped")
            assert way in status(pilot)
            run.hold_again()


@pytest.mark.fast
async def test_errors_are_shown_in_words() -> None:
    run = HeldRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SMALL) as pilot:
        app.query_one("#folder", Input).value = "here"
        for error, text in (
            (InputError("a.yaml: seed: expected [int]"), "a.yaml: seed: expected [int]"),
            (HardwareError("left: no answer"), "left: no answer; then continue with: cellapp collect here --resume."),
        ):
            run.error = error
            run.go_on.set()
            await started(pilot, run)
            await ended(pilot, app)
            assert status(pilot) == text
            run.hold_again()
        assert "Traceback" not in log(app)
        assert not Path("here").exists()
        assert await exit_code(pilot, app) == HardwareError.exit_code


async def test_an_unforeseen_error_is_one_sentence_and_its_text_is_kept() -> None:
    run = HeldRun(error=ZeroDivisionError("by the test"))
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SMALL) as pilot:
        app.query_one("#folder", Input).value = "here"
        await started(pilot, run)
        run.go_on.set()
        await ended(pilot, app)
        kept = Path("here") / ERROR_LOG
        assert str(kept) in status(pilot)
        assert "Traceback" not in log(app)
        assert "ZeroDivisionError: by the test" in kept.read_text(encoding="utf-8")

        Path("file").write_text("not a folder")
        app.query_one("#folder", Input).value = "file"
        await started(pilot, run)
        await ended(pilot, app)
        assert "by the test" in status(pilot)
        assert "could not be written" in status(pilot)
        assert await exit_code(pilot, app) == 3


@pytest.mark.fast
async def test_a_bad_profile_gives_a_message(tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("schema: cellapp-profile\nversion: 1\nname: bad\nsede: 1\n")
    app = CellApp(tmp_path)
    async with app.run_test(size=SMALL) as pilot:
        await pilot.pause()
        await pilot.press("r")
        await ended(pilot, app)
        assert "bad.yaml" in status(pilot)
        assert "sede" in status(pilot)
        assert not Path("logs").exists()
        assert await exit_code(pilot, app) == 2


async def test_a_profile_that_is_not_there_and_none_at_all(tmp_path: Path) -> None:
    app = CellApp(tmp_path / "nowhere")
    async with app.run_test(size=SMALL) as pilot:
        await pilot.pause()
        assert "No *.yaml found" in status(pilot)
        await pilot.press("f5")
        assert status(pilot).startswith("No profile selected")
        assert not app.running
        await pilot.press(*"gone", "f5")
        await ended(pilot, app)
        assert "gone" in status(pilot)


@pytest.mark.fast
@pytest.mark.parametrize("size", [SMALL, (140, 45)])
async def test_everything_is_on_the_screen_and_has_a_help_text(size: tuple[int, int]) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=size) as pilot:
        await pilot.pause()
        for widget in app.query(f"{CONTROLS}, .job, #status, #log, #hint, Footer"):
            assert widget.region.height > 0
            assert app.screen.region.contains_region(widget.region), widget
        for widget in app.query(f"{CONTROLS}, #progress, #status, #log, #tables"):
            assert isinstance(widget.tooltip, str)
            assert 0 < len(widget.tooltip) <= 78


async def test_everything_is_reached_by_keyboard_and_explained() -> None:
    run = HeldRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SMALL) as pilot:
        await pilot.pause()
        hint = app.query_one("#hint", Static)
        hints: dict[str, str] = {}
        for _ in range(7):
            assert app.focused is not None
            hints.setdefault(app.focused.id or type(app.focused).__name__, str(hint.render()))
            await pilot.press("tab")
        assert {"profiles", "profile", "folder", "run", "log"} <= set(hints)
        assert not {name: text for name, text in hints.items() if not 0 < len(text) <= 78}

        app.query_one("#profiles").focus()
        await pilot.press("home", "down")
        names = sorted(path.stem for path in PROFILES.glob("*.yaml"))
        assert app.query_one("#profiles", OptionList).option_count == len(names)
        assert app.query_one("#profile", Input).value == str(PROFILES / f"{names[1]}.yaml")
        await pilot.press("enter")
        assert app.focused is app.query_one("#run")
        assert not app.running
        await started(pilot, run, key="enter")
        assert run.calls[0][0] == PROFILES / f"{names[1]}.yaml"
        folder = run.calls[0][1]
        assert folder is not None
        assert re.fullmatch(rf"logs/{names[1]}-\d{{8}}-\d{{6}}", folder.as_posix())
        run.go_on.set()
        await ended(pilot, app)
        assert app.focused is app.query_one("#tables")
        await pilot.press("f")
        assert app.query_one("#results").region.height > SMALL[1] - 5
        await pilot.press("l")
        assert app.focused is app.query_one("#log")
        await pilot.press("f", "t")
        assert app.focused is app.query_one("#tables")
        assert app.query_one("#profiles").region.height > 0


@pytest.mark.fast
async def test_letters_typed_into_a_field_are_text() -> None:
    run = HeldRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SMALL) as pilot:
        await pilot.press("tab", "tab", *"rsqlt")
        assert app.query_one("#folder", Input).value == "rsqlt"
        assert not run.calls
        assert app.is_running


async def test_quitting_while_running_asks_stops_and_waits_for_the_end() -> None:
    run = HeldRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SMALL) as pilot:
        await started(pilot, run)
        await pilot.press("q")
        assert isinstance(app.screen, LeaveScreen)
        await pilot.press("n")
        assert not isinstance(app.screen, LeaveScreen)
        await pilot.press("ctrl+q")
        assert isinstance(app.screen, LeaveScreen)
        assert app.focused is app.screen.query_one("#stay")
        await pilot.press("y")
        assert app.running
        assert app.is_running
        assert "then quitting" in status(pilot)
        run.go_on.set()
        await until(pilot, lambda: app.return_code is not None, "the end of the screen")
    assert app.return_code == 4
    assert run.thread is not None
    run.thread.join(WAIT_S)
    assert not run.thread.is_alive()


async def test_a_run_that_ends_while_the_question_is_open() -> None:
    run = HeldRun()
    app = CellApp(PROFILES, run)
    async with app.run_test(size=SMALL) as pilot:
        await started(pilot, run)
        await pilot.press("q")
        run.go_on.set()
        await ended(pilot, app)
        assert status(pilot).startswith("Done")
        await pilot.press("tab", "enter")
        await until(pilot, lambda: app.return_code is not None, "the end of the screen")
    assert app.return_code == 0


async def test_a_run_that_does_not_stop_cannot_hold_the_program() -> None:
    run = HeldRun()
    app = CellApp(PROFILES, run, patience_s=0.05)
    async with app.run_test(size=SMALL) as pilot:
        await started(pilot, run)
        await pilot.press("q", "y")
        await until(pilot, lambda: app.return_code is not None, "the end of the screen")
    assert app.return_code == 3
    assert run.thread is not None
    assert run.thread.daemon
    run.go_on.set()
    run.thread.join(WAIT_S)
    assert not run.thread.is_alive()


async def test_a_screen_that_goes_away_stops_the_run() -> None:
    run = HeldRun()
    tokens: list[JobControl] = []

    def watched(
        profile: Path, folder: Path | None, listener: Listener, control: JobControl, *, ask: Ask
    ) -> WholeRunResult:
        tokens.append(control)
        return run(profile, folder, listener, control, ask=ask)

    app = CellApp(PROFILES, watched)
    async with app.run_test(size=SMALL) as pilot:
        await started(pilot, run)
        assert not tokens[0].cancelled
    assert tokens[0].cancelled
    run.go_on.set()
    assert run.thread is not None
    run.thread.join(WAIT_S)
    assert not run.thread.is_alive()


def small_profiles(folder: Path) -> Path:
    """The shipped twin with 30 stops and one target an arm."""
    shutil.copytree(PROFILES, folder / "profiles")
    for path in (folder / "profiles").glob("ur10*.yaml"):
        path.unlink()
    twin = folder / "profiles" / "twin.yaml"
    text = twin.read_text(encoding="utf-8")
    wanted: dict[str, object] = {
        "stops": 30, "identify": 15, "train": 5, "validate": 10, "pair_identify": 10, "pair_validate": 10,
        "kind": "none", "null_simulations": 20,
    }  # fmt: skip
    for key, value in wanted.items():
        # of the network's `kind`; those of the drivers stand further in
        text, count = re.subn(rf"^(  {key}:) .*$", rf"\1 {value}", text, flags=re.MULTILINE)
        assert count == 1, key
    twin.write_text(text, encoding="utf-8")
    targets = folder / "profiles" / "targets" / "twin.yaml"
    lines = targets.read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if "{name:" not in line or "-01," in line]
    assert len([line for line in kept if "{name:" in line]) == 2
    targets.write_text("\n".join(kept) + "\n", encoding="utf-8")
    return folder / "profiles"


async def test_the_real_run_of_a_small_twin(tmp_path: Path) -> None:
    app = CellApp(small_profiles(tmp_path))
    async with app.run_test(size=(140, 45)) as pilot:
        await pilot.pause()
        await pilot.press("r")
        await ended(pilot, app, WHOLE_RUN_S)
        assert status(pilot).startswith("Done"), status(pilot)
        # of either arm and the pair, steps of either arm and what was accepted, targets
        await until(pilot, lambda: len(app.query(DataTable)) in (6, 7, 8), "tables of all steps")
        titles = [text for text in texts(app) if text.startswith(("Arm left: ", "Arm right: "))]
        verdicts = ("explained", "nothing missing", "unknown effect", "ambiguous")
        assert sum(title.endswith(verdicts) for title in titles) == 2
        assert sum(text.startswith("arm ") for text in texts(app)) == 2
        for job, count in (("plan", "30/30"), ("collect", "30/30"), ("push", "2/2")):
            assert str(app.query_one(f"#{job}-count", Label).render()) == count
        runs = list(Path("logs").iterdir())
        assert len(runs) == 1
        assert (runs[0] / "run.sqlite").exists()
        assert str(runs[0] / "report.html") in status(pilot)


def test_importing_is_cheap_and_opening_loads_no_torch() -> None:
    script = (
        "import sys, cellapp.tui\n"
        "assert not {'textual', 'torch', 'scipy'} & set(sys.modules)\n"
        "import cellapp.tui.app\n"
        "assert 'torch' not in sys.modules\n"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=PROFILES.parent, timeout=WAIT_S).returncode == 0


async def exit_code(pilot: Pilot[None], app: CellApp) -> int | None:
    await pilot.press("ctrl+q")
    await until(pilot, lambda: app.return_code is not None, "the end of the screen")
    return app.return_code
