"""A verb is one file and one word: a toy appears on the command line, in schemas, handbook and palette."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from textual.widgets import Input
from typer.testing import CliRunner

from cellapp.cell.run import RunFile
from cellapp.commands.registry import records
from cellapp.commands.schema import results_by_name, written_results
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.derived import add_verbs
from cellapp.interfaces.page.drawn import drawn_parts
from cellapp.interfaces.tui import offers
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.program import possible_commands
from cellapp.interfaces.tui.dialogs.question import Reading
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from tests.commands.toys.greet import VERB as GREET
from tests.commands.toys.greet import GreetResult
from tests.handbook import declarations
from tests.interfaces.tui.pilot import PROFILES, SMALL, opened, shown_text, until
from tests.twin import finished_twin

pytestmark = pytest.mark.fast
WITH_TOY = (*records(), GREET)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Folder of a run without a plan."""
    with RunFile.create(tmp_path / "run", finished_twin()):
        return tmp_path / "run"


def test_a_command_with_its_options_its_output_and_its_json(run: Path) -> None:
    app = Commands()
    app.callback()(lambda: None)
    add_verbs(app, WITH_TOY)
    printed = CliRunner().invoke(app, ["greet", str(run), "--times", "2"])
    assert printed.exit_code == 0
    assert "Greeted" in printed.stdout
    assert "hello to all of them" in printed.stdout
    written = json.loads(CliRunner().invoke(app, ["greet", str(run), "--json", "-"]).stdout)
    assert written == {"schema": "toy-greet", "version": 1, "arms": ["left", "right"], "times": 1}
    assert CliRunner().invoke(app, ["greet", str(run), "--times", "4"]).exit_code == 2


def test_a_chart_on_the_page() -> None:
    result = GreetResult(arms=("left", "right"), times=2)
    (figure,) = drawn_parts(GREET.view(result).parts, "greet").figures
    assert figure.caption == "Greetings"
    assert figure.note == "Everybody is greeted as often."


def test_a_schema() -> None:
    assert GreetResult in written_results(WITH_TOY)
    assert "toy-greet" in results_by_name(written_results(WITH_TOY))


def test_a_line_in_the_list_of_the_handbook(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(declarations, "records", lambda: WITH_TOY)
    assert "| `cellapp greet` | Say hello to the arms of a run. | no | [commands](commands.md) |" in (
        declarations.verbs_part()
    )


@pytest.mark.slow
async def test_a_dialog_a_job_and_a_text_in_the_terminal_application(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(offers, "records", lambda: WITH_TOY)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(run)
        await until(pilot, lambda: app.workspace.folder == run, "the run")
        offered = {one.title: one for one in possible_commands(app, app.day_screen)}
        assert offered["cellapp greet"].help == "Say hello to the arms of a run."
        offered["cellapp greet"].callback()
        await until(pilot, lambda: isinstance(app.screen, VerbQuestion) and "times" in shown_text(app), "the dialog")
        app.screen.query_one("#times", Input).value = "3"
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(app.screen, Reading), "the result")
        assert "hello to all of them" in shown_text(app)
