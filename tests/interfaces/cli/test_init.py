"""``cellapp init``: a profile in an empty folder; a second time, an unknown name or two sources get a sentence."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from cellapp.cell.driving.requests import taking_requests
from cellapp.cell.profile import load_profile
from cellapp.cell.run.run_arms import note_halt
from cellapp.commands.job import RequestResult
from cellapp.ground import progress
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.job_client import VERBS, Verb
from cellapp.ground.progress import Halt, Progress
from cellapp.interfaces.cli.job import CommandJob
from cellapp.interfaces.cli.requests import JobRequest, plain_request
from tests.cell.run.small_runs import planned_run
from tests.interfaces.cli.conftest import one_sentence
from tests.latency import attempts
from tests.program import app
from tests.waiting import WAIT_S


def test_the_twin_in_an_empty_folder(call: Any) -> None:
    ended = call("init", "--twin", "--json", "-")
    assert ended.code == 0
    assert ended.json["profile"] == str(Path("profiles") / "twin.yaml")
    assert "next: cellapp doctor" in ended.err
    assert load_profile(Path("profiles/twin.yaml")).name == "twin"
    one_sentence(call("init", "--twin"), "twin.yaml exists already; nothing was written")


@pytest.mark.parametrize(
    ("line", "other", "words"),
    [
        ("  stops: 80", "  stops: 1", "at least 4 and 1 are needed"),
        ("plan:", "targets: none.yaml\nplan:", "none.yaml: file not found"),
        ("plan:", "arms: {left: {driver: {kind: none}}}\nplan:", "arms.left.driver: 'none' has no device"),
        ("plan:", "tracker: {driver: {kind: none}}\nplan:", "tracker.driver: 'none' has no"),
        ("  stops: 80", "  stops: 80\n  effects: [bogus]", "plan.effects: 'bogus' is no effect"),
        ("plan:", f"arms: {{left: {{payloads: [{'{mass: 0.3}, ' * 90}]}}}}\nplan:", "few for 91 loads"),
        ("  identify: 40", "  identify: 900", ""),
    ],
)
def test_what_run_would_refuse_the_doctor_refuses(call: Any, line: str, other: str, words: str) -> None:
    call("init", "--from", "twin-small")
    profile = Path("profiles/twin-small.yaml")
    profile.write_text(profile.read_text("utf-8").replace(line, other, 1), "utf-8")
    found = call("doctor", profile, "--json", "-")
    wrong = [one for one in found.json["findings"] if one["status"] != "ok"]
    assert found.code == bool(words)
    if words:
        one_sentence(call("run", profile, "--run", "run"), words)
        assert any(words in one["text"] for one in wrong)
    else:
        assert any("80 stops are too few" in one["text"] for one in wrong)


def test_answers_into_another_folder(call: Any) -> None:
    call("init", "--from", "ur5-real")
    Path("a.yaml").write_text(
        "name: one\narms: {left: {type: ur5, driver: {kind: none}, smr: {offset: unknown}}}\n"
        "tracker: {driver: {kind: none}}\n",
        "utf-8",
    )
    ended = call("init", "elsewhere", "--answers", "a.yaml", "--json", "init.json")
    assert (ended.code, json.loads(Path("init.json").read_text("utf-8"))["schema"]) == (0, "cellapp-init")
    assert [*load_profile(Path("elsewhere/profiles/one.yaml")).arms] == ["left"]
    one_sentence(call("init", "elsewhere", "--answers", "b.yaml"), "b.yaml: file not found")


@pytest.mark.parametrize("arguments", [(), ("--twin", "--from", "twin")])
def test_one_source_is_needed(call: Any, arguments: tuple[str, ...]) -> None:
    ended = call("init", *arguments)
    assert ended.code == 2
    assert "give one of --demo, --twin, --from NAME, --answers FILE and --readings FILE" in ended.err
    assert "ur10-ur5       The real cell" in ended.err
    one_sentence(call("init", "--from", "tvin"), "'tvin' is no profile that comes with cellapp; there are twin,")


# -- ``job confirm-rest``: a person settles that an arm counts as moving; ``show`` says it first -----------------------


def test_a_person_says_that_an_arm_rests(tmp_path: Path) -> None:
    folder, invoke = tmp_path / "run", CliRunner().invoke
    with planned_run(folder) as run:
        note_halt(run, "left", Halt("not seen at rest", "arm left: link lost"))
    shown = " ".join(invoke(app, ["show", str(folder)]).output.split())
    assert "arm left: NOT SEEN AT REST since" in shown
    state = json.loads(invoke(app, ["show", str(folder), "--json", "-"]).stdout)
    assert state["not_seen_at_rest"]["left"]["reason"] == "arm left: link lost"

    told = json.loads(invoke(app, ["job", "confirm-rest", str(folder), "left", "--json", "-"]).stdout)
    assert (told["schema"], told["counted_as_moving"]) == ("cellapp-at-rest", True)
    assert "it did not count as moving" in invoke(app, ["job", "confirm-rest", str(folder), "left"]).stdout
    assert "NOT SEEN" not in invoke(app, ["show", str(folder)]).output
    refused = invoke(app, ["job", "confirm-rest", str(folder), "middle"])
    assert isinstance(refused.exception, InputError)
    assert "arm 'middle' not found" in str(refused.exception)


# -- A long job whose output goes to a file is not silent --------------------------------------------------------------


def test_lines_on_standard_error_where_that_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with CommandJob(None) as job:
        job.listen(Progress("iso9283", 3, 10, "pose of left"))
    assert capfd.readouterr() == ("", ""), "a short job says nothing"
    monkeypatch.setattr(progress, "_SILENCE_S", 0.0)
    with CommandJob(None) as job:
        job.listen(Progress("iso9283", 3, 10, "pose of left"))
    assert capfd.readouterr() == ("", "cellapp: iso9283: 3 of 10, pose of left\n")


# -- A request from a shell is sent before the program is loaded, and says what the whole command line would say -------

ROOT = Path(__file__).parents[3]
LIMIT_CPU_S = 0.1

HEAVY = {
    "typer",
    "rich",
    "click",
    "pydantic",
    "dataclasses",
    "numpy",
    "cellapp.ground.control",
    "cellapp.interfaces.cli.app",
}
"""Some of what a stop must not wait for."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "läuft"
    folder.mkdir()
    (folder / "run.sqlite").write_bytes(b"")
    return folder


@pytest.fixture
def job(folder: Path) -> Iterator[JobControl]:
    control = JobControl(holds=True)
    with taking_requests(folder, control), control.brakes(lambda verb: None):
        yield control


def asked(*arguments: object, program: tuple[str, ...] = ("-m", "cellapp")) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *program, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"},
        cwd=ROOT,
        capture_output=True,
        encoding="utf-8",
        timeout=WAIT_S,
        check=False,
    )


@pytest.fixture
def whole(call: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The same through the whole command line, in this process."""
    monkeypatch.setattr("cellapp.interfaces.cli.plain_request", lambda words: None)
    return call


def words_of(verb: Verb) -> tuple[str, ...]:
    return (verb,) if verb == "stop" else ("job", verb)


def test_only_plain_arguments_are_sent_at_once() -> None:
    for verb in VERBS:
        words = words_of(verb)
        assert plain_request([*words, "logs/a"]) == JobRequest(verb, Path("logs/a"))
        assert plain_request([*words, "logs/a", "--json", "-"]) == JobRequest(verb, Path("logs/a"), "-")
        assert plain_request([*words, "--json", "x.json", "logs/a"]) == JobRequest(verb, Path("logs/a"), "x.json")
        for unusual in ([], ["--help"], ["a", "b"], ["a", "--json"], ["--json", "a"], ["a", "--json=b"], ["-a"],
                        ["a", "--json", "--x"], ["a", "--json", "b", "--json", "c"], ["lo*"], ["--", "a"]):  # fmt: skip
            assert plain_request([*words, *unusual]) is None, unusual
    for other in (
        ["collect", "logs/a"],
        ["job", "stop", "logs/a"],
        ["pause", "logs/a"],
        ["job", "confirm-rest", "a"],
        ["job"],
        [],
    ):
        assert plain_request(other) is None, other


@pytest.mark.parametrize("words", ["stop --help", "job pause a b", "stop a --json nowhere/b"])
def test_errors_and_help_are_those_of_the_whole_command_line(whole: Any, words: str) -> None:
    one, other = asked(*words.split()), whole(*words.split())
    assert (one.returncode, one.stdout, one.stderr) == (other.code, other.out, other.err)


@pytest.mark.parametrize(
    ("before", "verb"), [(None, "pause"), ("pause", "resume"), (None, "stop"), (None, "resume"), ("abort", "abort")]
)
def test_answers_are_those_of_the_whole_command_line(whole: Any, folder: Path, before: Verb | None, verb: Verb) -> None:
    ended: list[Any] = []
    for ask in (asked, whole):
        control = JobControl(holds=True)
        if before is not None:
            control.ask(before)
        with taking_requests(folder, control):
            ended.append(ask(*words_of(verb), folder, "--json", "-"))
    one, other = ended
    assert (one.returncode, one.stdout, one.stderr) == (other.code, other.out, other.err)
    if one.returncode == 0:
        assert RequestResult.from_json(one.stdout, "it").to_json(indent=1) + "\n" == one.stdout
        assert json.loads(one.stdout)["run"] == str(folder)


def test_the_answer_is_printed_and_written(folder: Path, job: JobControl, tmp_path: Path) -> None:
    path = tmp_path / "answer.json"
    said = asked("stop", folder, "--json", path)
    assert said.stdout == "stopped: all arms brake; the job waits for 'resume' or 'abort'\n"
    assert RequestResult.from_json(path.read_text("utf-8"), "it").answer + "\n" == said.stdout


def test_a_stop_is_carried_out_even_where_its_json_cannot_be_written(folder: Path, job: JobControl) -> None:
    ended = asked("stop", folder, "--json", folder / "nowhere" / "x.json")
    assert ended.returncode == 2
    assert "cannot be written (No such file or directory)" in ended.stderr
    assert ended.stdout.startswith("stopped: all arms brake")
    assert job.request == "stop"


def test_a_request_loads_nothing_that_it_does_not_need(folder: Path, job: JobControl) -> None:
    loaded = f"sys.exit(', '.join({HEAVY!r} & sys.modules.keys()) or None)"
    code = f"import sys; from cellapp.interfaces.cli import main; main(); {loaded}"
    ended = asked("stop", folder, program=("-c", code))
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.skipif(sys.platform == "win32", reason="no times of children")
def test_a_request_needs_little_processor_time(folder: Path, job: JobControl) -> None:
    for took in attempts(cpu=LIMIT_CPU_S):
        before = os.times()
        assert asked("stop", folder).returncode == 0
        after = os.times()
        took["cpu"] = after.children_user + after.children_system - before.children_user - before.children_system
