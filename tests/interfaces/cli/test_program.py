"""The program around its commands: version, help, errors as JSON, the demonstration."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import jsonschema
import pytest

import cellapp
from cellapp.commands.doctor.result import DoctorResult, Finding
from cellapp.commands.run.run import WholeRunResult
from cellapp.commands.schema import json_schema
from cellapp.ground.results import ErrorResult
from cellapp.interfaces.cli.program import wants_json
from tests.interfaces.cli.test_cli import call, exit_code  # noqa: F401 - a fixture
from tests.twin import write_profile


def test_version(call: Any) -> None:  # noqa: F811
    ended = call("--version")
    assert (ended.code, ended.out, ended.err) == (0, f"cellapp {cellapp.__version__}\n", "")


@pytest.mark.parametrize("verb", [(), ("plan",), ("trials", "seal")])
def test_short_and_long_help_are_the_same(call: Any, verb: tuple[str, ...]) -> None:  # noqa: F811
    short, long = call(*verb, "-h"), call(*verb, "--help")
    assert short.code == long.code == 0
    assert "Usage" in short.out
    assert short.out == long.out


def test_the_list_of_commands_is_that_of_the_whole_program_and_loads_none_of_them() -> None:
    asked = "import sys; sys.argv = ['cellapp', '--help']; from cellapp.interfaces.cli{} import main; main()"
    loaded = "import atexit, sys; atexit.register(lambda: print({*sys.modules} & {'pydantic', 'numpy'} or 'light')); "
    short, whole = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True).stdout
        for code in (loaded + asked.format(""), asked.format(".app"))
    )
    assert "calibrate" in whole
    assert short == f"{whole}light\n"


@pytest.mark.parametrize(("words", "expected"), [("cellapp calib", "calibrate"), ("cellapp plan --che", "--check")])
def test_the_shell_completes(call: Any, monkeypatch: pytest.MonkeyPatch, words: str, expected: str) -> None:  # noqa: F811
    monkeypatch.setenv("_CELLAPP_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
    assert call().out.split() == [expected]


FAILING = {
    "no such verb": (("nonsense",), 2, "No such command 'nonsense'"),
    "no such option": (("collect", "--unknown", "run"), 2, "No such option"),
    "missing argument": (("calibrate",), 2, "Missing argument 'DIR'"),
    "no such run": (("calibrate", "nowhere"), 2, "nowhere: run folder not found"),
    "before the job": (("docs", "effects", "--out", "x"), 2, "--out belongs to"),
    "a removed command": (("check-certificate", "none.json"), 2, "was removed in"),
}


@pytest.mark.parametrize("case", FAILING)
@pytest.mark.parametrize("form", [("--json", "-"), ("--json=-",)])
def test_a_failure_is_one_object_on_standard_output(call: Any, case: str, form: tuple[str, ...]) -> None:  # noqa: F811
    arguments, code, text = FAILING[case]
    ended = call(*arguments, *form)
    assert ended.code == code
    assert ended.json["exit_code"] == code
    assert text in ended.json["message"]
    assert ended.err  # a person still gets the sentence
    jsonschema.validate(ended.json, json_schema(ErrorResult))


def test_every_verb_answers_bad_usage_with_an_object(call: Any) -> None:  # noqa: F811
    from typer.main import get_command

    from tests.program import app

    verbs = get_command(app).commands  # type: ignore[attr-defined]
    assert {"run", "demo", "calibrate", "trials"} < set(verbs)
    for verb in verbs:
        ended = call(verb, "--no-such-option", "--json", "-")
        assert (verb, ended.code, ended.json["schema"]) == (verb, 2, "cellapp-error")


def test_a_result_that_was_written_stays_the_only_object(call: Any, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    failed = DoctorResult(findings=(Finding(subject="arm", status="failed", text="not reached"),))
    monkeypatch.setattr("cellapp.commands.doctor.run.examine_run", lambda profile, nests: failed)
    ended = call("doctor", write_profile(Path("profiles")), "--json", "-")
    assert (ended.code, ended.json["schema"]) == (1, "cellapp-doctor")


def test_an_unexpected_error_is_an_object(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def broken(folder: Path | None) -> None:
        raise RuntimeError("out of order")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cellapp.commands.runs.history.list_runs", broken)
    assert exit_code(monkeypatch, "runs", "--json", "-") == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["exit_code"] == 1
    assert answer["message"].startswith("unexpected RuntimeError: out of order")
    assert "out of order" in Path("cellapp-error.log").read_text("utf-8")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [("plan --json -", True), ("plan --json=-", True), ("plan --json file -", False), ("plan - --json", False)],
)
def test_when_json_is_wanted(arguments: str, expected: bool) -> None:
    assert wants_json(arguments.split()) is expected


def test_the_demonstration(call: Any, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    """Profile and run go below the folder; a profile that is there is used as it is. The run itself is tested apart."""
    started: list[tuple[Path, Path]] = []
    swept: list[int | None] = []

    def run_whole(
        profile: Path, folder: Path, *more: object, ask: object, sweeps: int | None, hung: object
    ) -> WholeRunResult:
        assert ask is None
        started.append((profile, folder))
        swept.append(sweeps)
        return WholeRunResult(run=str(folder))

    monkeypatch.setattr("cellapp.commands.run.run.run_whole", run_whole)
    assert "written: " in call("demo", "here").out
    assert "is used as it is" in call("demo", "here").out
    call("demo", "--full")
    call("demo", "here", "--sweeps")
    assert swept == [None, None, None, 20]
    assert [profile for profile, _ in started] == [
        Path("here/profiles/twin-small.yaml"),
        Path("here/profiles/twin-small.yaml"),
        Path("profiles/twin.yaml"),
        Path("here/profiles/twin-small.yaml"),
    ]
    assert started[0][1].parent == Path("here/logs")
    assert all(profile.is_file() for profile, _ in started)
