"""Parts of ``show`` come from the verbs that store them, and each part is shown by the view of its verb."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import BeforeValidator
from textual.widgets import Input
from typer.testing import CliRunner

from cellapp.cell.run import RunFile
from cellapp.cell.targets.records import ArmVerification, MeasuredTarget, VerifyResult
from cellapp.commands.check.request import VERB as CHECK
from cellapp.commands.discover.request import VERB as DISCOVER
from cellapp.commands.push.request import VERB as PUSH
from cellapp.commands.record import Asked, Request, Stored, Variant, Verb, View, Work
from cellapp.commands.registry import records
from cellapp.commands.run.request import VERB as RUN
from cellapp.commands.run_results import WholeRunResult
from cellapp.commands.show.request import show_verb
from cellapp.commands.show.result import Shown
from cellapp.commands.show.view import view
from cellapp.commands.view.charts import Axis, Chart
from cellapp.commands.view.parts import Facts, Parts, Section, printed
from cellapp.commands.view.table import Column, Table
from cellapp.ground.errors import InputError
from cellapp.ground.results import ErrorSummary
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.verb_commands import add_verb
from cellapp.interfaces.page.page import template
from cellapp.interfaces.python.printed import html_view
from cellapp.interfaces.render.terminal import plain_text
from cellapp.interfaces.tui import confirmations
from cellapp.interfaces.tui.dialogs.program import possible_commands
from cellapp.interfaces.tui.dialogs.question import Reading
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.verb_jobs import job_of
from tests.commands.toys.greet import VERB as GREET
from tests.interfaces.tui.pilot import running, shown_text, until
from tests.twin import finished_twin

SMALL_MM, LARGE_MM = (ErrorSummary(mean=mm, rms=mm, std=0.0, max=mm, n=3) for mm in (0.1, 2.0))
TARGETS = (MeasuredTarget(name="t1", arm="left", nominal_mm=None, compensated_mm=None, note=""),)
WORSE = VerifyResult(arms={"left": ArmVerification(nominal_mm=SMALL_MM, compensated_mm=LARGE_MM)}, targets=TARGETS)


def test_what_a_verb_stores_is_a_part_of_show() -> None:
    toy = Verb("toy", Request, "commands", stored=(Stored("toys", "no toy is", ("check",)),))
    show = show_verb((toy,))
    assert show.asked({"folder": "here", "part": "toys"}).model_dump()["part"] == "toys"
    with pytest.raises(InputError, match="show: "):
        show.asked({"folder": "here", "part": "calibration"})


def test_a_part_says_that_it_is_out_of_date_and_its_json_is_its_own() -> None:
    stored = Shown(part="verification", result=WORSE, out_of_date="new readings", made_by="'cellapp push --verify'")
    assert view(stored).parts[-1] == "out of date: new readings; repeat it with 'cellapp push --verify'"
    assert not view(stored).failed
    assert stored.to_json(indent=1) == WORSE.to_json(indent=1)
    assert view(stored.model_copy(update={"complaints": ("old",)})).failed == ("old",)


def test_a_view_says_which_step_failed() -> None:
    shown = RUN.view(WholeRunResult(run="here", verify=WORSE))
    assert (shown.checks, len(shown.failed)) == ("verification", 1)


def test_only_a_push_that_measures_can_fail() -> None:
    for verify in (True, False):
        request = PUSH.asked({"folder": "here", "targets": (), "verify": verify})
        assert bool(PUSH.view(WORSE, request).failed) is verify


def test_a_job_is_called_as_its_request_says() -> None:
    names = [job_of(PUSH, folder="here", targets=(), verify=verify).name for verify in (True, False)]
    assert names == ["verify", "push"]
    assert job_of(DISCOVER, folder="here", propose=3).name == "propose"
    assert job_of(CHECK, folder="here", tracker_moved=True).name == "locate"


# -- What a view is made of: plain text says all of it but the charts, and a section has a message ---------------------

TABLE = Table("a table", (Column("name"),), (("<b>",),))
CHART = Chart("a chart", Axis("x"), Axis("y"), (), "nothing")
INSIDE = Section(["'cellapp docs x' says more"], folded=True, title="details")
SHOWN = Section(
    [CHART, "word " * 30, Section([CHART], title="empty")], message="In a sentence.", about="how to read", title="shown"
)
PARTS: Parts = ["first", Facts((("title", "text"), ("", "more"))), CHART, TABLE, INSIDE, SHOWN, "last"]


def test_plain_text_says_everything_but_charts_and_details_in_its_order() -> None:
    told = list(printed(PARTS))
    wrapped = ["  " + " ".join(["word"] * 15), "    " + " ".join(["word"] * 15)]
    section = ["shown", "  In a sentence.", *wrapped, ""]
    assert told == ["first", "title: text", "  more", TABLE, *section, "last"]
    for text in (plain_text(PARTS), html_view(PARTS)):
        assert all(words in text for words in ("first", "title: text", "a table", "shown", "last"))
        assert not any(words in text for words in ("a chart", "details", "empty", "how to read"))


def test_the_page_draws_parts_by_their_kind_and_leaves_empty_charts_out() -> None:
    html = str(template("sections/layout.html").module.draw_parts(PARTS, "key"))  # type: ignore[attr-defined]
    assert html.index("<p>first</p>") < html.index("<p>last</p>") < html.index("<caption>a table</caption>")
    assert "<dt>title</dt>" in html
    assert "<figure" not in html
    assert "&lt;b&gt;" in html
    assert "<code>cellapp docs x</code> says more" in html
    assert '<details class="more">' in html


# -- What the most used verbs load when they start: no part of scipy before it is used, no search for a mere look ------

LOADED = """
import sys
import cellapp.interfaces.cli.app, cellapp.commands.doctor.run
searches = [name for name in sys.modules if name.startswith("cellapp.estimation.discovery.search")]
assert not searches, f"doctor: {searches}"
from importlib import import_module
for verb in ("plan", "calibrate", "report", "show", "check"):
    import_module(f"cellapp.commands.{verb}.run")
    parts = [name for name in sys.modules if name.startswith("scipy.") and not name.startswith("scipy._")]
    assert set(parts) <= {"scipy.__config__", "scipy.version"}, f"{verb}: {parts}"
"""


def test_verbs_start_without_scipy_and_doctor_without_the_search() -> None:
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr


# -- What a record declares beyond plain fields reaches the command line: words, types ---------------------------------


class ToyRequest(Request):
    """Do a toy's work."""

    cell: Annotated[Path, Asked("The cell.", "CELL", argument=True)]
    sides: Annotated[
        tuple[str, ...],
        BeforeValidator(lambda given: ("left", "right") if given == "both" else given),
        Asked("Sides.", typed=Literal["both"] | None),
    ] = ()
    parts: Annotated[tuple[str, ...], Asked("Parts.")] = ()
    count: Annotated[int, Asked("How many.", label="how many")] = 3
    word: Annotated[str, Asked("A word.", label="word")] = ""


VERB = Verb(
    "toy",
    ToyRequest,
    chapter="toy",
    question="Toy?",
    variants={"all": Variant("All.", {"parts": ("a", "b")}), "one": Variant("One.", {"parts": ("a",)})},
)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[ToyRequest]:
    """The requests that the verb was run with."""
    requests: list[Any] = []

    def run(verb: Verb, request: Request, work: Work) -> Any:
        requests.append(request)

    monkeypatch.setattr(Verb, "run", run)
    monkeypatch.setattr(Verb, "view", lambda verb, result, request: View())
    monkeypatch.setattr("cellapp.interfaces.cli.job.CommandJob.result", lambda job, result: None)
    return requests


def test_words_after_a_verb_fix_fields_and_the_first_may_be_left_out(asked: list[ToyRequest]) -> None:
    app = Commands()
    app.callback()(lambda: None)
    add_verb(app, VERB, VERB.name)
    for words in (["all", "c.yaml"], ["c.yaml", "--sides", "both"], ["one", "c.yaml", "--count", "1"]):
        assert CliRunner().invoke(app, ["toy", *words]).exit_code == 0
    assert asked == [
        ToyRequest(cell=Path("c.yaml"), parts=("a", "b")),
        ToyRequest(cell=Path("c.yaml"), parts=("a", "b"), sides=("left", "right")),
        ToyRequest(cell=Path("c.yaml"), parts=("a",), count=1),
    ]
    assert CliRunner().invoke(app, ["toy", "all"]).exit_code == 2, "the command line needs the cell"


# -- A verb is one folder and one word: a toy appears on the command line, in schemas and palette ----------------------

WITH_TOY = (*records(), GREET)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Folder of a run without a plan."""
    with RunFile.create(tmp_path / "run", finished_twin()):
        return tmp_path / "run"


def test_a_command_with_its_options_its_output_and_its_json(run: Path) -> None:
    app = Commands()
    app.callback()(lambda: None)
    add_verb(app, GREET, GREET.name)
    printed = CliRunner().invoke(app, ["greet", str(run), "--times", "2"])
    assert printed.exit_code == 0
    assert "Greeted" in printed.stdout
    assert "hello to all of them" in printed.stdout
    written = json.loads(CliRunner().invoke(app, ["greet", str(run), "--json", "-"]).stdout)
    assert written == {"schema": "toy-greet", "version": 1, "arms": ["left", "right"], "times": 1}
    refused = CliRunner().invoke(app, ["greet", str(run), "--times", "4"])
    assert str(refused.exception) == "greet: --times: expected at most 3, got 4"


async def test_a_dialog_a_job_and_a_text_in_the_terminal_application(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(confirmations, "records", lambda: WITH_TOY)
    async with running() as (pilot, app):
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
