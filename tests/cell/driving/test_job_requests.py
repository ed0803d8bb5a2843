"""Requests to a running job from another process: delivered and answered at once, never to a wrong job."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.driving.requests import taking_requests
from cellapp.ground.asking import JOB_FILE, JobSeen, Verb, ask_running_job, look_at_job
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.progress import Progress, StateChange


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "run.sqlite").write_bytes(b"")
    return tmp_path


@pytest.fixture
def braked() -> list[str]:
    """Verbs with which the arms were braked."""
    return []


@pytest.fixture
def job(folder: Path, braked: list[str]) -> Iterator[JobControl]:
    """A job with open arms that a person attends."""
    control = JobControl(holds=True)
    with taking_requests(folder, control), control.brakes(braked.append):
        yield control


@pytest.mark.fast
def test_every_verb_is_done_before_it_is_answered(folder: Path, job: JobControl, braked: list[str]) -> None:
    steps: tuple[tuple[Verb, str, str], ...] = (
        ("pause", "after the present stop", "pause"),
        ("resume", "continues", "none"),
        ("stop", "stopped: all arms brake; the job waits", "stop"),
        ("resume", "continues", "none"),
        ("abort", "aborted: all arms brake", "abort"),
    )
    for verb, says, request in steps:
        assert says in ask_running_job(folder, verb)
        assert job.request == request
    assert braked == ["stop", "abort"]
    assert job.cancelled


@pytest.mark.fast
def test_a_request_that_does_not_fit_the_state_is_refused_in_words(folder: Path, job: JobControl) -> None:
    cases: tuple[tuple[Verb | None, Verb, str], ...] = (
        (None, "resume", "neither paused nor stopped"),
        ("pause", "pause", "paused already"),
        ("stop", "pause", "stopped already"),
        ("abort", "resume", "was aborted"),
    )
    for first, verb, says in cases:
        if first is not None:
            job.ask(first)
        with pytest.raises(InputError, match=says) as caught:
            ask_running_job(folder, verb)
        assert caught.value.exit_code == 2


@pytest.mark.fast
def test_a_job_that_nobody_attends_ends_after_a_stop_and_cannot_be_resumed(folder: Path) -> None:
    control = JobControl()
    with taking_requests(folder, control):
        assert ask_running_job(folder, "stop") == ("stopped: no arm is open; the job ends and can be resumed later")
        refused: tuple[Verb, ...] = ("resume", "pause")
        for verb in refused:
            with pytest.raises(InputError, match="was stopped and ends"):
                ask_running_job(folder, verb)
        assert control.request == "stop"
        assert "stopped" in ask_running_job(folder, "stop"), "a second stop does no harm"


@pytest.mark.fast
def test_no_run_no_job_and_a_job_that_ended(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(InputError, match="no run is here"):
        ask_running_job(tmp_path / "nowhere", "stop")
    with pytest.raises(InputError, match="no job runs in"):
        ask_running_job(folder, "stop")
    with taking_requests(folder, JobControl()):
        stale = (folder / JOB_FILE).read_text()
    assert not (folder / JOB_FILE).exists()
    (folder / JOB_FILE).write_text(stale)  # as a killed job leaves it
    with pytest.raises(InputError, match="the last one has ended"):
        ask_running_job(folder, "stop")


@pytest.mark.fast
@pytest.mark.parametrize("text", ["", "[]", "{}", '{"computer": "a", "port": "x", "token": ""}', "\x00"])
def test_a_damaged_file_is_no_job(folder: Path, text: str) -> None:
    (folder / JOB_FILE).write_text(text)
    with pytest.raises(InputError, match="no job runs in"):
        ask_running_job(folder, "stop")
    with taking_requests(folder, JobControl()):
        assert "stopped" in ask_running_job(folder, "stop")


@pytest.mark.fast
def test_a_stale_token_never_acts_on_a_later_job(folder: Path, job: JobControl, braked: list[str]) -> None:
    address = json.loads((folder / JOB_FILE).read_text())
    (folder / JOB_FILE).write_text(json.dumps({**address, "token": "of an earlier job"}))
    with pytest.raises(InputError, match="no job runs in"):
        ask_running_job(folder, "stop")
    assert (job.request, braked) == ("none", [])


@pytest.mark.fast
def test_a_second_job_in_the_folder_is_refused(folder: Path, job: JobControl) -> None:
    with pytest.raises(InputError, match="another job runs here"), taking_requests(folder, JobControl()):
        pytest.fail("two jobs in one folder")
    ask_running_job(folder, "stop")
    assert job.request == "stop", "the first job still takes requests"


@pytest.mark.fast
def test_a_job_on_another_computer_is_named(folder: Path, job: JobControl) -> None:
    address = json.loads((folder / JOB_FILE).read_text())
    (folder / JOB_FILE).write_text(json.dumps({**address, "computer": "cell-pc"}))
    with pytest.raises(InputError, match="runs on computer 'cell-pc'"):
        ask_running_job(folder, "stop")
    assert job.request == "none"


@pytest.mark.fast
@pytest.mark.skipif(os.name != "posix", reason="Windows has other rights")
def test_only_the_owner_may_read_the_token(folder: Path, job: JobControl) -> None:
    assert stat.S_IMODE((folder / JOB_FILE).stat().st_mode) == 0o600


@pytest.mark.fast
def test_hostile_requests_change_nothing_and_delay_no_stop(folder: Path, job: JobControl) -> None:
    address = json.loads((folder / JOB_FILE).read_text())
    lines = (b"\n", b"x" * 10_000, b"wrong abort\n", f"{address['token']} explode\n".encode(), b"\xff\xfe \x00\n")
    with socket.create_connection(("127.0.0.1", address["port"])):  # silent until the end
        for line in lines:
            with (
                socket.create_connection(("127.0.0.1", address["port"])) as hostile,
                contextlib.suppress(ConnectionError),  # the job hangs up without reading the rest
            ):
                hostile.sendall(line)
                with hostile.makefile("rb") as reader:
                    assert reader.readline(1000).startswith(b"refused" if b"explode" in line else b"")
        assert job.request == "none"
        assert "stopped" in ask_running_job(folder, "stop")


def test_a_job_that_listens_and_is_silent_is_a_fault(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.ground.asking.PATIENCE_S", 0.05)
    with taking_requests(folder, JobControl()), socket.create_server(("127.0.0.1", 0)) as mute:
        address = json.loads((folder / JOB_FILE).read_text())
        (folder / JOB_FILE).write_text(json.dumps({**address, "port": mute.getsockname()[1]}))
        with pytest.raises(HardwareError, match="press its emergency stop"):
            ask_running_job(folder, "stop")


@pytest.mark.fast
def test_requests_of_many_at_once_are_all_answered(folder: Path, job: JobControl) -> None:
    answers: list[str] = []
    askers = [threading.Thread(target=lambda: answers.append(ask_running_job(folder, "stop"))) for _ in range(20)]
    for asker in askers:
        asker.start()
    for asker in askers:
        asker.join(10.0)
    assert len(answers) == 20


@pytest.mark.fast
def test_a_look_tells_the_state_and_how_far_the_job_is(folder: Path) -> None:
    control = JobControl(holds=True)
    assert look_at_job(folder) is None
    with taking_requests(folder, control, "collect") as listener:
        assert look_at_job(folder) == JobSeen("collect", "none", True, False, part="collect")
        with control.brakes(lambda verb: None):
            listener(Progress("plan", 30, 30))
            listener(Progress("collect", np.int64(7), 30, "stop 8"))  # type: ignore[arg-type]  # some loops count so
            control.pause()
            listener(Progress("collect", 7, 30, detail=StateChange("paused", "asked by a person" + "!" * 3000)))
            seen = look_at_job(folder)
    assert seen is not None
    assert seen[:5] == ("collect", "pause", True, True, "paused")
    assert seen.reason.startswith("asked by a person!")
    assert (seen.part, seen.done, seen.total, seen.note) == ("collect", 7, 30, "stop 8")
    assert look_at_job(folder) is None


def test_a_job_of_another_version_is_named(folder: Path, job: JobControl, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.ground.asking.exchange", lambda *_: "done a job runs here")
    with pytest.raises(InputError, match="of another version of cellapp"):
        look_at_job(folder)
