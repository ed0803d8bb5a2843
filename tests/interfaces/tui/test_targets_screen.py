"""The screen Targets: listed, edited with undo, saved, opened, compensated, pushed and verified; what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import DataTable, Input, Static

from cellapp.cell.run import RunFile
from cellapp.cell.targets.target_text import targets_text
from cellapp.cell.targets.targets import load_targets
from cellapp.commands.correct import correct_run
from cellapp.commands.push.request import MOST_ROUNDS, PushRequest
from cellapp.commands.record import Verb
from cellapp.commands.report.result import read_results
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker, SaveAs
from cellapp.interfaces.tui.dialogs.question import Choice, Reading
from cellapp.interfaces.tui.dialogs.target_form import FieldRow, TargetForm
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.jobs import Job
from cellapp.interfaces.tui.plots import ChartPlot
from cellapp.interfaces.tui.screens import targets
from cellapp.interfaces.tui.screens.targets import TargetEdits, TargetsScreen
from cellapp.interfaces.tui.widgets.charts_view import PartsView
from tests.cell.run.small_runs import collected_run
from tests.interfaces.tui.pilot import PROFILES, SIZES, SMALL, ended, log_text, opened, shown_text, shows, tells, until
from tests.twin import small_twin

TWIN = PROFILES / "twin.yaml"
LISTED = load_targets(PROFILES / "targets" / "twin.yaml", small_twin())


def grid(app: CellApp) -> DataTable[object]:
    return app.day_screen.query_one("#grid", DataTable)


def column(app: CellApp, number: int) -> list[str]:
    """The cells of one column of the list."""
    return [str(grid(app).get_row_at(row)[number]) for row in range(grid(app).row_count)]


def heading(app: CellApp) -> str:
    return str(app.day_screen.query_one("#about-list", Static).content)


def about(app: CellApp) -> str:
    return str(app.day_screen.query_one("#about-target", Static).content)


async def show_targets(pilot: Pilot[None], app: CellApp, run: Path | None, targets: Path | None = None) -> None:
    """Open a run, show the screen, wait for its list; then open another list if one is given."""
    await opened(pilot, app)
    if run is not None:
        app.open_run(run, TWIN)
        await until(pilot, lambda: app.workspace.folder == run, "the run")
    await pilot.press("6")
    await until(pilot, lambda: app.day_screen.STEP == "targets" and grid(app).row_count == len(LISTED), "the list")
    if targets is not None:
        await open_list(pilot, app, targets)
        await until(pilot, lambda: str(targets) in heading(app), "the other list")


async def open_list(pilot: Pilot[None], app: CellApp, path: Path) -> None:
    await pilot.press("o")
    await until(pilot, lambda: isinstance(app.screen, FilePicker), "the file picker")
    app.screen.query_one("#path", Input).value = str(path)
    await pilot.press("enter")
    await pilot.pause()


def asked(app: CellApp) -> str:
    """The text of the present question."""
    return str(app.screen.query_one(".text", Static).content)


def fill_fields(app: CellApp, **texts: str) -> None:
    for row in app.screen.query(FieldRow):
        if row.field_id in texts:
            row.input.value = texts[row.field_id]


async def fill_form(pilot: Pilot[None], app: CellApp, key: str, **texts: str) -> None:
    """Open the form with a key and fill fields."""
    await pilot.press(key)
    await until(pilot, lambda: isinstance(app.screen, TargetForm), "the form")
    fill_fields(app, **texts)
    await pilot.pause()


@pytest.fixture
def few(tmp_path: Path) -> Path:
    """Three targets, the first with a tolerance that is met, the second with one that is not."""
    path = tmp_path / "few.yaml"
    sizes = (2e-3, 1e-6, None)
    path.write_text(targets_text([t.model_copy(update={"tolerance": size}) for t, size in zip(LISTED, sizes)]))
    return path


@pytest.mark.parametrize("size", [SIZES[0], SIZES[-1]])
async def test_the_list_of_the_profile_with_what_the_run_says(finished_copy: Path, size: tuple[int, int]) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=size) as pilot:
        await show_targets(pilot, app, finished_copy)
        await until(pilot, lambda: "mm from the target" in " ".join(shown_text(app).split()), "the first target")
        text = shown_text(app)
        assert "40 targets" in text
        assert "left-01" in text
        assert column(app, 3)[:3] == ["measured", "measured", ""]
        assert len(grid(app).columns) == (7 if size == SMALL else 15)
        pose = "mm; roll 121.67, pitch 46.27, yaw 17.13 deg"
        await until(pilot, lambda: pose in shown_text(app), "the pose of the first target")
        await pilot.press("t")
        await until(pilot, lambda: "Arm left: compensated commands" in shown_text(app), "all about the first target")
        await until(pilot, lambda: "mm from the target" in shown_text(app), "what was measured there")
        await pilot.press("t")
        results = app.day_screen.query_one("#target-results", PartsView)
        await until(pilot, lambda: len(results.query(ChartPlot)) >= 2, "the errors of both arms")
        assert len(results.query(".table")) >= 2, "what was measured, and the commands"
        await pilot.press("t")
        await until(pilot, lambda: "40 targets" in shown_text(app), "the list again")


async def test_a_target_is_edited_in_a_form_that_judges_while_typing() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_targets(pilot, app, None)
        await fill_form(pilot, app, "enter", position="250, 0, 1")
        await shows(pilot, "250 m is beyond")
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(app.screen, TargetForm), "a wrong target is not taken")
        fill_fields(app, position="250 mm, 0, 1", tolerance="0.1 mm")
        await pilot.press("enter")
        await until(pilot, lambda: "NOT SAVED" in heading(app), "the edited list")
        assert column(app, 2)[0] == "0.1"
        assert "x 250.0, y 0.0, z 1000.0 mm" in about(app)
        await pilot.press("ctrl+z")
        await until(pilot, lambda: "NOT SAVED" not in heading(app), "the list as it was")
        assert "x -148.3" in about(app)
        await pilot.press("ctrl+y")
        await until(pilot, lambda: "x 250.0" in about(app), "the edit again")
        await fill_form(pilot, app, "enter")
        await pilot.press("escape")
        await until(pilot, lambda: "NOT SAVED" in heading(app), "the edited list")


async def test_targets_are_added_removed_brought_back_and_saved(few: Path) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_targets(pilot, app, None, few)
        before = load_targets(few, small_twin())
        await fill_form(pilot, app, "+", name="left-02")
        await shows(pilot, "is listed twice")
        fill_fields(app, name="mine", position="0.1, 200 mm, 0.5")
        await pilot.press("enter")
        await until(pilot, lambda: column(app, 0) == ["left-01", "left-02", "left-03", "mine"], "the new target")
        await pilot.press("ctrl+home", "-")
        await until(pilot, lambda: column(app, 0) == ["left-02", "left-03", "mine"], "a target less")
        await pilot.press("ctrl+z")
        await until(pilot, lambda: grid(app).row_count == 4, "the target again")
        new = few.with_name("new.yaml")
        await pilot.press("w")
        await until(pilot, lambda: isinstance(app.screen, SaveAs), "the question where")
        app.screen.query_one("#path", Input).value = str(new)
        await pilot.press("enter")
        await until(pilot, lambda: str(new) in heading(app), "the saved list")
        assert "NOT SAVED" not in heading(app)
        *kept, mine = load_targets(new, small_twin())
        assert tuple(kept) == before
        assert mine.position == (0.1, 0.2, 0.5)
        assert mine.rpy == before[0].rpy
        new.unlink()
        await pilot.press("-")
        await until(pilot, lambda: "the file is gone" in heading(app), "a word about the file")


async def test_edits_are_not_left_without_a_question(few: Path) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_targets(pilot, app, None, few)
        await pilot.press("-", "o")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question")
        await pilot.press("k")
        await until(pilot, lambda: app.screen is app.day_screen, "the end of the question")
        app.open_profile(TWIN)  # another profile or run does not replace them either
        await until(pilot, lambda: app.workspace.profile is not None, "the profile")
        await pilot.pause()
        assert str(few) in heading(app)
        assert column(app, 0) == ["left-02", "left-03"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("targets: [", "bad.yaml:2: not YAML"),
        ("schema: cellapp-targets\nversion: 1\ntargets: []\n", "bad.yaml:3: targets: expected at least 1 values"),
        (targets_text(LISTED[:1]).replace("left,", "middle,"), "bad.yaml:7: target 'left-01': no arm 'middle'"),
        (targets_text([LISTED[0], LISTED[0]]), "bad.yaml:8: target 'left-01' is listed twice"),
    ],
)
async def test_a_broken_list_is_refused_in_a_sentence(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_targets(pilot, app, None)
        await open_list(pilot, app, path)
        await until(pilot, lambda: says in app.message, "the refusal")
        assert app.message.endswith("o opens another list.")
        assert grid(app).row_count == len(LISTED), "the list before stays"


async def test_what_is_missing_is_said_with_a_way_on(tmp_path: Path, few: Path) -> None:
    collected_run(tmp_path / "run", "complete", 3)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_targets(pilot, app, None, few)
        for key in ("b", "P", "m"):
            app.say("")
            await pilot.press(key)
            await until(pilot, lambda: app.message.startswith("No run is open: plan one (keys 2, b)"), "the message")
        app.open_run(tmp_path / "run", TWIN)
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        await pilot.press("b")
        await until(pilot, lambda: app.message.startswith("Not calibrated yet"), "the message")
        assert not app.jobs.running


async def test_an_empty_list_and_an_arm_that_the_run_does_not_have(
    finished_copy: Path, few: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_targets(pilot, app, finished_copy, few)
        screen = app.day_screen
        assert isinstance(screen, TargetsScreen)
        strange = LISTED[0].model_copy(update={"arm": "middle"})
        monkeypatch.setattr(screen, "_edits", TargetEdits(few, (strange,), (strange,)))
        await pilot.press("b")
        await until(
            pilot,
            lambda: app.message == "Target 'left-01': no arm 'middle'; arms are left, right. Enter edits it.",
            "the message",
        )
        monkeypatch.setattr(screen, "_edits", TargetEdits(few, (), ()))
        screen._draw_list()
        for key, says in (("b", "No targets"), ("m", "No targets"), ("w", "An empty list cannot be saved")):
            await pilot.press(key)
            await tells(pilot, says)
        await pilot.press("enter", "-", "ctrl+z")
        assert app.screen is screen


async def test_the_application_asks_before_edits_are_lost(few: Path) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_targets(pilot, app, None, few)
        await pilot.press("-", "1", "q")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question")
        assert "Not saved, and lost: 2 targets with edits" in " ".join(shown_text(app).split())
        await pilot.press("enter")
        await until(pilot, lambda: app.screen is app.day_screen, "it stays")
        await pilot.press("6", "ctrl+z", "q")
        await until(pilot, lambda: app.return_code is not None, "nothing is lost: it ends at once")


async def test_an_unsaved_list_is_compensated_and_verified(finished_copy: Path, few: Path) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=(120, 40)) as pilot:
        await show_targets(pilot, app, finished_copy, few)
        await pilot.press("ctrl+end", "-", "ctrl+home", "b")
        await until(pilot, lambda: "predicted: in" in about(app), "the prediction for the first")
        await ended(pilot, app)
        assert column(app, 3)[0] == "in, measured", "what was measured is judged by the new tolerance"
        await pilot.press("m")
        await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the question")
        assert "arm left to 2 targets" in asked(app)
        assert "the arms are simulated" in asked(app)
        app.screen.query_one("#iterate", Input).value = str(MOST_ROUNDS + 1)
        await pilot.press("b")
        await until(pilot, lambda: f"expected 1 to {MOST_ROUNDS} rounds" in shown_text(app), "a word about the number")
        app.screen.query_one("#iterate", Input).value = ""
        await pilot.press("b")
        await until(pilot, lambda: column(app, 3) == ["in, measured", "cannot say, measured"], "the verdicts")
        await pilot.press("f")
        await until(pilot, lambda: column(app, 0) == ["left-02"], "what needs attention")
        await pilot.press("f")
        await until(pilot, lambda: grid(app).row_count == 2, "all targets")
        assert "1 of 2 targets with a tolerance are out of it: left-02" in log_text(app)
        assert "out of date" not in heading(app)
        await fill_form(pilot, app, "enter", tolerance="")
        await pilot.press("enter")
        await until(pilot, lambda: column(app, 3)[0] == "measured", "what was measured, without a tolerance")
        assert "compensated;" not in about(app)
        await fill_form(pilot, app, "enter", tolerance="0.000001")
        await pilot.press("enter")
        await until(pilot, lambda: column(app, 3)[0].endswith(", measured"), "judged anew by another tolerance")
        assert column(app, 3)[0] != "in, measured"
        await fill_form(pilot, app, "enter", position="0.3, 0, 0.5")
        await pilot.press("enter")
        await until(pilot, lambda: column(app, 3)[0] == "", "a target that is elsewhere now")
        assert about(app).startswith("left-01: not compensated yet as it is now.\n")
    with RunFile.open(finished_copy) as run:
        verify = read_results(run).verify
    assert verify is not None
    assert [target.verdict for target in verify.targets] == ["in", "cannot say"]


async def test_a_model_that_is_out_of_date_is_used_only_if_that_is_said(
    finished_copy: Path, few: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[PushRequest] = []

    def job(verb: Verb, request: PushRequest) -> Job:
        started.append(request)
        return Job(verb.name, lambda listener, control, ask: None)

    monkeypatch.setattr("cellapp.interfaces.tui.work.verb_job", job)
    monkeypatch.setattr(targets, "stale_model", lambda results: "'discover' is out of date (new readings)")
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_targets(pilot, app, finished_copy, few)
        for answer in ("enter", "u"):
            await pilot.press("P")
            await until(pilot, lambda: isinstance(app.screen, Choice), "the question")
            assert "'discover' is out of date (new readings)" in asked(app)
            await pilot.press(answer)
            await until(pilot, lambda: app.screen is app.day_screen, "the answer")
        await ended(pilot, app)
    (request,) = started
    assert request.targets == load_targets(few, small_twin())
    assert (request.verify, request.out_of_date) == (False, True)


# -- A program is corrected from the screen Targets, as the command does it --------------------------------------------

DAY = Path("logs") / "day"


async def ask_for_program(pilot: Pilot[None], app: CellApp) -> None:
    await opened(pilot, app)
    app.open_run(DAY)
    await until(pilot, lambda: app.workspace.results is not None, "the run")
    await pilot.press("6")
    await until(pilot, lambda: app.day_screen.STEP == "targets", "the screen")
    await pilot.press("e")
    await until(pilot, lambda: isinstance(app.screen, FilePicker), "the question for the program")
    app.screen.query_one("#path", Input).value = "old.script"
    await pilot.press("enter")
    await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the dialog")


async def test_a_program_is_corrected(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    with RunFile.open(DAY) as run:
        q = run.readings("left").q[5].tolist()
        Path("old.script").write_text(f"# day\nmovej({q})\n", encoding="utf-8")
        correct_run(run, Path("old.script"), Path("command.script"), "left")
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await ask_for_program(pilot, app)
        await shows(pilot, "Write (Ctrl+S)")  # all of the dialog fits into the smallest terminal
        await until(
            pilot, lambda: app.screen.query_one("#out", Input).value == "old-corrected.script", "the text of the field"
        )
        app.screen.query_one("#arm", Input).value = "left"
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(app.screen, Reading), "what was written")
        assert "1 target corrected" in shown_text(app)
        await pilot.press("escape")
        assert Path("old-corrected.script").read_bytes() == Path("command.script").read_bytes()
        await until(pilot, lambda: "movej" in shown_text(app), "the table")
        assert app.day_screen.query(DataTable)


async def test_what_the_verb_refuses_is_said(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    Path("old.script").write_text("movej([0,0,0,0,0,0])\n", encoding="utf-8")
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await ask_for_program(pilot, app)
        app.screen.query_one("#arm", Input).value = "third"
        await pilot.press("ctrl+s")
        await until(pilot, lambda: "no calibrated arm 'third'" in app.message, "the reason")
        await ended(pilot, app)
        assert not Path("old-corrected.script").exists()
