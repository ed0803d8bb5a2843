"""A request from a shell is sent before the program is loaded, and says what the whole command line would say."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from cellapp.cell.driving.records import RequestResult
from cellapp.cell.driving.requests import taking_requests
from cellapp.ground.asking import VERBS, Verb
from cellapp.ground.control import JobControl
from cellapp.interfaces.cli.requests import JobRequest, plain_request
from tests.latency import attempts
from tests.waiting import WAIT_S

ROOT = Path(__file__).parents[3]
BAR_CPU_S = 0.1
BAR_IDLE_S = 0.3
BAR_BUSY_S = 1.0

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


def whole(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The same through the whole command line."""
    return asked(*arguments, program=("-c", "from cellapp.interfaces.cli.app import main; main()"))


@pytest.mark.fast
def test_only_plain_arguments_are_sent_at_once() -> None:
    for verb in VERBS:
        assert plain_request([verb, "logs/a"]) == JobRequest(verb, Path("logs/a"))
        assert plain_request([verb, "logs/a", "--json", "-"]) == JobRequest(verb, Path("logs/a"), "-")
        assert plain_request([verb, "--json", "x.json", "logs/a"]) == JobRequest(verb, Path("logs/a"), "x.json")
        for unusual in ([], ["--help"], ["a", "b"], ["a", "--json"], ["--json", "a"], ["a", "--json=b"], ["-a"],
                        ["a", "--json", "--x"], ["a", "--json", "b", "--json", "c"], ["lo*"], ["--", "a"]):  # fmt: skip
            assert plain_request([verb, *unusual]) is None, unusual
    assert plain_request(["collect", "logs/a"]) is None
    assert plain_request([]) is None


@pytest.mark.parametrize(
    "words", ["stop", "stop --help", "stop -x", "pause a b", "resume a", "abort a --json -", "stop a --json nowhere/b"]
)
def test_errors_and_help_are_those_of_the_whole_command_line(words: str) -> None:
    one, other = asked(*words.split()), whole(*words.split())
    assert (one.returncode, one.stdout, one.stderr) == (other.returncode, other.stdout, other.stderr)


@pytest.mark.parametrize(
    ("before", "verb"), [(None, "pause"), ("pause", "resume"), (None, "stop"), (None, "resume"), ("abort", "abort")]
)
def test_answers_are_those_of_the_whole_command_line(folder: Path, before: Verb | None, verb: Verb) -> None:
    ended = []
    for ask in (asked, whole):
        control = JobControl(holds=True)
        if before is not None:
            control.ask(before)
        with taking_requests(folder, control):
            ended.append(ask(verb, folder, "--json", "-"))
    one, other = ended
    assert (one.returncode, one.stdout, one.stderr) == (other.returncode, other.stdout, other.stderr)
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


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """That many processes that do nothing but compute."""
    spinning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait(WAIT_S)


@pytest.mark.skipif(sys.platform == "win32", reason="no times of children")
@pytest.mark.parametrize(("others", "bar_s"), [(0, BAR_IDLE_S), (2, BAR_BUSY_S)])
def test_a_request_needs_little_time(folder: Path, job: JobControl, others: int, bar_s: float) -> None:
    with busy(others):
        for took in attempts(cpu=BAR_CPU_S, wall=bar_s):
            before, began_s = os.times(), time.monotonic()
            assert asked("stop", folder).returncode == 0
            after, took["wall"] = os.times(), time.monotonic() - began_s
            took["cpu"] = after.children_user + after.children_system - before.children_user - before.children_system
