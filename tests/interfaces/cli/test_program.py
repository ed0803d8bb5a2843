"""The program around its commands: version, help, errors as JSON, what earlier versions had, the report."""

from __future__ import annotations

import html
import json
import re
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import cellapp
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.docs.schema import json_schema
from cellapp.commands.doctor.result import DoctorResult
from cellapp.commands.export.request import ExportRequest
from cellapp.commands.export.run import export
from cellapp.commands.registry import PANEL, name_of, records
from cellapp.commands.run_state import DATA_MARK, RunState
from cellapp.commands.runs.run import summarise
from cellapp.commands.show.overview import run_history, run_overview
from cellapp.commands.show.view import overview_sentences, overview_tables
from cellapp.commands.stages import append_stage, basis_of
from cellapp.estimation.readings import Readings
from cellapp.ground import removed
from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.results import ErrorResult
from cellapp.interfaces.page import page
from cellapp.interfaces.page.page import page_text
from cellapp.interfaces.tui.workspace import load_workspace
from drivers.findings import Finding
from tests.cell.run.small_runs import import_csv
from tests.interfaces.cli.conftest import exit_code
from tests.interfaces.page.cases import calibration
from tests.interfaces.page.parsed_page import NOON
from tests.program import app
from tests.twin import PROFILES, small_twin, write_profile


def test_version(call: Any) -> None:
    ended = call("--version")
    assert (ended.code, ended.out, ended.err) == (0, f"cellapp {cellapp.__version__}\n", "")


@pytest.mark.parametrize("verb", [(), ("plan",), ("trials", "seal")])
def test_short_and_long_help_are_the_same(call: Any, verb: tuple[str, ...]) -> None:
    short, long = call(*verb, "-h"), call(*verb, "--help")
    assert short.code == long.code == 0
    assert "Usage" in short.out
    assert short.out == long.out


@pytest.mark.parametrize(
    ("verb", "words"),
    [
        ("collect", "carries now [kg], as"),
        ("compensate", "frame [m, rad], if it sets none"),
        ("import", "several are given by repeating both options"),
    ],
)
def test_help_shows_units_and_breaks_lines_at_its_edge_alone(call: Any, verb: str, words: str) -> None:
    assert words in call(verb, "--help").out


def test_the_list_of_commands_is_that_of_the_whole_program_and_loads_none_of_them() -> None:
    asked = "import sys; sys.argv = ['cellapp', '--help']; from cellapp.interfaces.cli{} import main; main()"
    loaded = "import atexit, sys; atexit.register(lambda: print({*sys.modules} & {'pydantic', 'numpy'} or 'light')); "
    short, whole = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True).stdout
        for code in (loaded + asked.format(""), asked.format(".app"))
    )
    assert "calibrate" in whole
    assert short == f"{whole}light\n"


@pytest.mark.parametrize(("words", "expected"), [("cellapp calib", "calibrate"), ("cellapp plan --kee", "--keep")])
def test_the_shell_completes(call: Any, monkeypatch: pytest.MonkeyPatch, words: str, expected: str) -> None:
    monkeypatch.setenv("_CELLAPP_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
    assert call().out.split() == [expected]


FAILING = {
    "no such verb": (("nonsense",), 2, "No such command 'nonsense'"),
    "no such option": (("collect", "--unknown", "run"), 2, "No such option"),
    "missing argument": (("calibrate",), 2, "Missing argument 'DIR'"),
    "no such run": (("calibrate", "nowhere"), 2, "nowhere: run folder not found"),
    "before the job": (("show", "x", "--last", "3"), 2, "--level and --last belong to"),
    "a removed command": (("check-certificate", "none.json"), 2, "was removed in"),
}


@pytest.mark.parametrize("case", FAILING)
@pytest.mark.parametrize("form", [("--json", "-"), ("--json=-",)])
def test_a_failure_is_one_object_on_standard_output(call: Any, case: str, form: tuple[str, ...]) -> None:
    arguments, code, text = FAILING[case]
    ended = call(*arguments, *form)
    assert ended.code == code
    assert ended.json["exit_code"] == code
    assert text in ended.json["message"]
    assert ended.err  # a person still gets the sentence
    jsonschema.validate(ended.json, json_schema(ErrorResult))


def test_every_verb_answers_bad_usage_with_an_object(call: Any) -> None:
    from typer.main import get_command

    from tests.program import app

    verbs = get_command(app).commands  # type: ignore[attr-defined]
    assert {"run", "job", "calibrate", "trials"} < set(verbs)
    assert len(verbs) <= 24
    for verb in verbs:
        ended = call(verb, "--no-such-option", "--json", "-")
        assert (verb, ended.code, ended.json["schema"]) == (verb, 2, "cellapp-error")


def test_a_result_that_was_written_stays_the_only_object(call: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = DoctorResult(findings=(Finding(subject="arm", status="failed", text="not reached"),))
    monkeypatch.setattr("cellapp.commands.doctor.run.examine_run", lambda profile: failed)
    ended = call("doctor", write_profile(Path("profiles")), "--json", "-")
    assert (ended.code, ended.json["schema"]) == (1, "cellapp-doctor")


def test_an_unexpected_error_is_an_object(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def broken(folder: Path | None) -> None:
        raise RuntimeError("out of order")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cellapp.commands.runs.run.list_runs", broken)
    assert exit_code(monkeypatch, "runs", "--json", "-") == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["exit_code"] == 1
    assert answer["message"].startswith("unexpected RuntimeError: out of order")
    assert "out of order" in Path("cellapp-error.log").read_text("utf-8")


# -- What a finished run says, on the terminal and on the page: no double stop, one spelling of units, words for keys --

FAULTS = {
    "a double full stop": re.compile(r"[\w)]\.\.(?![./\w])"),
    "one of several": re.compile(
        r"(?<![\w.,-])1 (arms|checks|cycles|effects|errors|iterations|parameters|points|readings|rows|stops|targets)\b"
    ),
    "micro without its sign": re.compile(r"\d u(m|rad)\b"),
    "a key for people": re.compile(r"\bmethod_\d\b"),
    "two spaces in a sentence": re.compile(r"(?m)^(?!.*  .*  )\w[\w ,]*[a-z]  [a-z][\w ,]*\.$"),
}


def faults_of(text: str) -> Iterator[str]:
    for name, pattern in FAULTS.items():
        for found in pattern.finditer(text):
            yield f"{name}: ...{text[max(found.start() - 50, 0) : found.end() + 30]}..."


def test_a_finished_run_is_shown_without_them(finished_run: Path) -> None:
    parts = [stored.part for verb in records() for stored in verb.stored]
    assert len(parts) > 5
    shown = []
    for part in ("", *parts):
        ended = CliRunner().invoke(app, ["show", str(finished_run), *filter(None, [part])])
        assert ended.exit_code == 0 or isinstance(ended.exception, InputError), part  # this run has none
        shown.append(ended.output)
    assert sum("mm" in text for text in shown) > 4
    assert list(faults_of("\n".join(shown))) == []


def test_its_page_has_none(finished_run: Path) -> None:
    with RunFile.open(finished_run) as run:
        page = page_text(run, NOON)
    page = re.sub(r"(?s)<(script|style|svg).*?</\1>", " ", page)
    text = html.unescape(re.sub(r"<[^>]+>", " ", page))
    assert "Errors against" in text or "errors" in text
    assert list(faults_of(re.sub(r"\s+", " ", text))) == []


# -- What earlier versions had is answered by what to do instead; what they stored opens -------------------------------

KEYS = {"arms.*.teleport": "drive it", "magic": "nothing takes its place"}


@pytest.fixture
def some_removed(monkeypatch):
    monkeypatch.setattr(
        removed,
        "COMMANDS",
        {"dance": "use 'cellapp run'", "trials dance": "use 'cellapp run'", "iso9283 dance": "use 'cellapp run'"},
    )
    monkeypatch.setattr(removed, "PROFILE_KEYS", KEYS)


@pytest.mark.parametrize("command", ["dance", "trials dance", "iso9283 dance"])
def test_a_removed_command_says_what_to_do_instead(some_removed, command):
    with pytest.raises(InputError, match=rf"^'cellapp {command}' was removed in [\d.]+: use 'cellapp run'$") as error:
        app([*command.split(), "--option"], prog_name="cellapp", standalone_mode=False)
    assert error.value.exit_code == 2


def test_every_removed_command_says_something_else_that_is_there():
    for name, instead in removed.COMMANDS.items():
        assert instead.strip().rstrip(".") == instead, name
        for verb in re.findall(r"'cellapp ([a-z][\w-]*)", instead):
            assert verb in {name_of(word) for word in PANEL}, name


def test_a_removed_key_of_a_users_profile_is_refused_by_name(some_removed, tmp_path):
    content = yaml.safe_load((PROFILES / "twin.yaml").read_text("utf-8"))
    content["magic"] = 1
    for arm in content["arms"].values():
        arm["type"] = str(PROFILES / arm["type"])
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(content), "utf-8")
    with pytest.raises(InputError, match=r"cell\.yaml:\d+: magic: was removed in [\d.]+: nothing takes its place"):
        load_profile(path)


def test_a_run_of_an_earlier_version_opens_and_says_what_is_ignored(some_removed, tmp_path):
    profile = load_profile(PROFILES / "twin.yaml")
    with RunFile.create(tmp_path / "run", profile) as run:
        path = run.path
        run.append_stage("dance", basis_of(run).model_dump_json(), "{}", None)
    with closing(sqlite3.connect(path)) as connection, connection:
        ((text,),) = connection.execute("SELECT value FROM meta WHERE key = 'profile'")
        content = json.loads(text)
        content["magic"] = 1
        content["arms"]["left"]["teleport"] = {"far": True}
        connection.execute("UPDATE meta SET value = ? WHERE key = 'profile'", (json.dumps(content),))
    with RunFile.open(path.parent) as run:
        assert run.profile == profile
        state, history = run_overview(RunState(run)), run_history(RunState(run))
    assert set(state.ignored_keys) == {"magic", "arms.left.teleport"}
    assert [one.out_of_date for one in (*state.stages, *history.stages)] == [
        "an earlier version made it; this one has no such step"
    ] * 2
    assert any("arms.left.teleport" in sentence for sentence in overview_sentences(state))
    assert any("dance" in str(table) for table in overview_tables(state))


def old_rows(path, columns, rows):
    """Add rows of a kind that no version stores any more; they are of the left arm, at three stops."""
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.executemany(
            f"INSERT INTO reading (arm, configuration, q, approach, {columns}) VALUES ('left', ?, ?, ?, ?, ?)",
            [(stop, json.dumps([0.1 * stop] * 6), "[0, 0, 0, 0, 0, 0]", *row) for stop in range(3) for row in rows],
        )


@pytest.mark.parametrize(
    ("rows", "columns", "what", "last"),
    [
        ([("[null, null, null]", "cup")], "p_m, point", "a ball in sockets", ",,,,cup"),
        ([("[3.0, 0.1, 0.2]", "A"), ("[3.0, 0.2, 0.2]", "B")], "p_m, smr", "several SMRs at a stop", "3.0,0.1,0.2,A"),
    ],
)
def test_a_run_of_removed_readings_opens_for_show_and_export_and_calibrate_says_why_not(
    tmp_path, rows, columns, what, last
):
    profile = load_profile(PROFILES / "twin.yaml")
    with RunFile.create(tmp_path / "run", profile) as run:
        path = run.path
        run.add_stop(0, {"right": Readings.one(q=np.zeros(6), p_M=np.array([3.0, 0.5, 0.1]))})
    old_rows(path, columns, rows)
    with RunFile.open(path.parent, write=True) as run:
        state = run_overview(RunState(run))
        assert (state.arms["left"].measured, state.next_step) == (3, "cellapp docs planning")
        assert state.complaints[0].startswith(f"arm 'left': readings of {what} were removed in ")
        exported = export(run, ExportRequest(folder=run.folder, csv=tmp_path / "out.csv"))
        assert exported.readings == {"left": 3, "right": 1}
        assert (tmp_path / "out.csv").read_text("utf-8").splitlines()[1].endswith(last)
        with pytest.raises(InputError, match=rf"arm 'left': readings of {what}.*'cellapp show "):
            calibrate_run(run)
        append_stage(run, "calibrate", calibration("left", "right"), basis_of(run))
        (stage,) = run_overview(RunState(run)).stages
        assert stage.out_of_date == "an earlier version made it, from readings of a kind that was removed"
    opened = load_workspace(None, path.parent)
    assert (opened.problem, opened.folder, opened.conformity) == ("", path.parent, "not decided")
    assert summarise(path.parent).problem == ""


def test_an_import_of_what_was_exported_of_sockets_is_refused(tmp_path):
    (tmp_path / "out.csv").write_text("configuration,arm,q1,x_m,y_m,z_m,point\n0,left,0.1,,,,cup\n", "utf-8")
    with pytest.raises(InputError, match=r"out\.csv:1: point: readings of a ball in sockets were removed"):
        import_csv(small_twin(), tmp_path / "out.csv", tmp_path / "again")


RUNNER = CliRunner()


@pytest.fixture(autouse=True)
def blank_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """What stands on the page is tested with the page; here it is only written."""

    def write(run: RunFile) -> Path:
        page = run.folder / "report.html"
        page.write_text(f'<meta name="{DATA_MARK}" content="{RunState(run).data_mark}">', encoding="utf-8")
        return page

    monkeypatch.setattr(page, "write_page", write)


def test_strict_fails_only_where_something_is_out_of_date(finished_copy: Path) -> None:
    assert RUNNER.invoke(app, ["report", str(finished_copy), "--strict"]).exit_code == 0
    with RunFile.open(finished_copy, write=True) as run:
        name = run.arms()[0]
        readings = run.readings(name)
        again = readings.take([0])
        run.add_readings(name, type(again)(**{**vars(again), "configuration": again.configuration + 10_000}))
    assert RUNNER.invoke(app, ["report", str(finished_copy)]).exit_code == 0
    ended = RUNNER.invoke(app, ["report", str(finished_copy), "--strict", "--json", str(finished_copy / "r.json")])
    assert isinstance(ended.exception, CheckFailed)
    assert "'calibrate' is out of date (1 reading" in str(ended.exception)
    assert "'verify' is out of date" in str(ended.exception)
    assert "calibrate" in json.loads((finished_copy / "r.json").read_text("utf-8"))["out_of_date"]
    assert (finished_copy / "report.html").is_file(), "the page is written all the same"
