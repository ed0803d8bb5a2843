"""A job that another program watches and commands: events arrive, requests act at once, nobody delays the job."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from cellapp.cell.driving.requests.attaching import Detached, RemoteControl, attach
from cellapp.cell.driving.requests.job_requests import taking_requests
from cellapp.cell.driving.requests.watching import MOST_WATCHERS
from cellapp.ground.asking import JOB_FILE, WATCH, ask_running_job
from cellapp.ground.control import Aborted, JobControl, Stopped
from cellapp.ground.errors import CheckFailed, HardwareError, InputError
from cellapp.ground.progress import (
    ArmLive,
    CellLive,
    Halt,
    Listener,
    LogReport,
    MeasurementBegun,
    Progress,
    StateChange,
)
from tests.latency import attempts
from tests.waiting import WAIT_S, within

BAR_S = 0.05
"""From the request to the brakes of the job, more than its own stop takes."""


class Job:
    """A job in a folder, as if another process ran it."""

    def __init__(self, folder: Path, *, holds: bool = True) -> None:
        self.folder = folder
        self.control = JobControl(holds=holds)
        self.braked: list[tuple[str, float]] = []
        self.has_braked = threading.Event()

    def brake(self, verb: str) -> None:
        self.braked.append((verb, time.monotonic()))
        self.has_braked.set()

    @contextlib.contextmanager
    def running(self) -> Iterator[Listener]:
        with taking_requests(self.folder, self.control, "collect") as listener, self.control.brakes(self.brake):
            disguise(self.folder)
            yield listener


def disguise(folder: Path, **changed: object) -> None:
    """Let the job be one of another process: one attaches to no job of one's own."""
    address = json.loads((folder / JOB_FILE).read_text())
    (folder / JOB_FILE).write_text(json.dumps({**address, "process": os.getppid(), **changed}))


class Watched:
    """Follows a job in a thread, and keeps what it hears."""

    def __init__(self, folder: Path) -> None:
        self.remote = attach(folder)
        self.events: list[Progress] = []
        self.said: list[str] = []
        self.ended: BaseException | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._follow)
        self._thread.start()

    def _follow(self) -> None:
        try:
            self.remote.follow(self._hear, self._note)
        except (Exception, Detached) as error:  # noqa: BLE001 - the test judges it
            self.ended = error

    def _hear(self, event: Progress) -> None:
        with self._changed:
            self.events.append(event)
            self._changed.notify_all()

    def _note(self, text: str) -> None:
        with self._changed:
            self.said.append(text)
            self._changed.notify_all()

    def until(self, count: int) -> list[Progress]:
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.events) >= count, WAIT_S)
        return self.events

    def until_said(self, words: str) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: any(words in text for text in self.said), WAIT_S), self.said

    def end(self) -> BaseException | None:
        self._thread.join(WAIT_S)
        assert not self._thread.is_alive()
        return self.ended


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "run.sqlite").write_bytes(b"")
    return tmp_path


def until(remote: RemoteControl, request: str) -> None:
    """Wait until the job says that a request stands."""
    others = [one for one in ("none", "pause", "stop", "abort") if one != request]
    assert remote.wait_while(*others, timeout_s=WAIT_S) == request  # type: ignore[arg-type]


EVENTS = (
    Progress("collect", 3, 30, detail=StateChange("running", "measuring")),
    Progress("collect", 3, 30, detail=MeasurementBegun(3, "left")),
    Progress("collect", 4, 30, "stop 5", eta_s=12.0),
)


@pytest.mark.fast
def test_who_attaches_hears_the_newest_of_each_kind_and_then_all(folder: Path) -> None:
    job = Job(folder)
    with job.running() as listener:
        listener(Progress("collect", 2, 30, detail=MeasurementBegun(2, "left")))
        for event in EVENTS:
            listener(event)
        watched = Watched(folder)
        assert watched.until(3) == list(EVENTS)
        assert (watched.remote.name, watched.remote.process) == ("collect", os.getppid())
        assert watched.remote.holds
        assert watched.remote.has_brakes
        listener(EVENTS[1])
        assert watched.until(4)[3:] == [EVENTS[1]]
    assert watched.end() is None


@pytest.mark.fast
def test_requests_act_on_the_job_and_its_state_comes_back(folder: Path) -> None:
    job = Job(folder)
    with job.running():
        watched = Watched(folder)
        remote = watched.remote
        for ask, request in ((remote.pause, "pause"), (remote.resume, "none"), (remote.stop, "stop")):
            ask()
            assert remote.request == request, "expected before it is answered"
            job.control.wait_while(*{"none", "pause", "stop"} - {request}, timeout_s=WAIT_S)  # type: ignore[arg-type]
            assert job.control.request == request
        assert not remote.cancelled
        ask_running_job(folder, "resume")  # somebody else
        until(remote, "none")
        remote.resume()
        watched.until_said("resume: refused: the job is neither paused nor stopped")
        job.has_braked.clear()
        remote.abort()
        assert job.has_braked.wait(WAIT_S)
        assert remote.cancelled
        with pytest.raises(Aborted):
            job.control.check()
    assert [verb for verb, _ in job.braked] == ["stop", "abort"]


@pytest.mark.fast
def test_a_stop_of_a_job_that_nobody_attends_ends_it(folder: Path) -> None:
    job = Job(folder, holds=False)
    with job.running():
        watched = Watched(folder)
        watched.remote.stop()
        assert watched.remote.cancelled
        assert job.has_braked.wait(WAIT_S)
        assert job.control.cancelled


def test_a_stop_takes_one_line(folder: Path) -> None:
    for took in attempts(braked=BAR_S):
        job = Job(folder)
        with job.running():
            watched = Watched(folder)
            asked_s = time.monotonic()
            watched.remote.stop()
            assert job.has_braked.wait(WAIT_S)
            took["braked"] = job.braked[0][1] - asked_s


@pytest.mark.fast
@pytest.mark.parametrize("error", [Stopped("on request"), Aborted("now"), CheckFailed("too far")])
def test_the_end_is_told_as_it_was(folder: Path, error: Exception) -> None:
    watching: list[Watched] = []

    def fail() -> None:
        with Job(folder).running():
            watching.append(Watched(folder))
            raise error

    with pytest.raises(type(error)):
        fail()
    ended = watching[0].end()
    assert type(ended) is type(error)
    assert str(ended) == str(error)


@pytest.mark.fast
def test_leaving_lets_the_job_go_on(folder: Path) -> None:
    job = Job(folder)
    with job.running():
        watched = Watched(folder)
        watched.remote.leave()
        assert isinstance(watched.end(), Detached)
        assert (job.control.request, job.braked) == ("none", [])
        watched.remote.stop()  # does no harm
        assert job.braked == []


@pytest.mark.fast
def test_what_is_live_comes_with_the_heartbeat(folder: Path) -> None:
    job = Job(folder)
    left = ArmLive(0.012, True, Halt("braking", "its stop was commanded"))
    known = CellLive({"left": left, "right": ArmLive(None, False)}, 0.1, 0.2, ("a person stopped the arms",))
    with job.running(), job.control.watching(lambda: known):
        watched = Watched(folder)
        live = watched.remote.live()
        assert live is not None
        assert live.arms["right"].age_s is None, "what is not known does not get an age on the way"
        assert live.arms["left"].halt == left.halt
        assert live.causes == known.causes
        for there_s, here_s in ((0.012, live.arms["left"].age_s), (0.1, live.tracker_age_s), (0.2, live.job_age_s)):
            assert here_s is not None
            assert there_s <= here_s <= there_s + watched.remote.age_s, "as old as there, and the way"
        assert watched.remote.age_s < WAIT_S


@pytest.mark.fast
def test_a_watcher_that_reads_nothing_does_not_delay_the_job(folder: Path) -> None:
    text = LogReport("info", "x" * 2000)
    for took in attempts(events=2.0, end=1.0):
        with Job(folder).running() as listener:
            address = json.loads((folder / JOB_FILE).read_text())
            with socket.create_connection(("127.0.0.1", address["port"])) as mute:
                mute.sendall(f"{address['token']} {WATCH}\n".encode())
                mute.settimeout(WAIT_S)
                assert mute.recv(1)
                began_s = time.monotonic()
                for number in range(20_000):  # 40 MB: far more than any buffer of the system takes
                    listener(Progress("collect", number, 30_000, detail=text))
                took["events"] = time.monotonic() - began_s
                assert "stopped" in ask_running_job(folder, "stop")
                began_s = time.monotonic()
        took["end"] = time.monotonic() - began_s


@pytest.mark.fast
def test_at_most_some_programs_watch(folder: Path) -> None:
    job = Job(folder)
    with job.running(), contextlib.ExitStack() as stack:
        for _ in range(MOST_WATCHERS):
            stack.callback(attach(folder).close)
        with pytest.raises(InputError, match="watch this job already"):
            attach(folder)
        assert "stopped" in ask_running_job(folder, "stop"), "requests do not count"


@pytest.mark.fast
def test_there_may_be_nothing_to_attach_to(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="no job runs in"):
        attach(folder)
    job = Job(folder)
    with job.running():
        for changed, says in (
            ({"process": os.getpid()}, "one of this program"),
            ({"computer": "cell-pc"}, "runs on computer 'cell-pc'; watch it there"),
            ({"token": "of an earlier job"}, "the last one has ended"),
        ):
            disguise(folder)
            kept = (folder / JOB_FILE).read_text()
            disguise(folder, **changed)
            with pytest.raises(InputError, match=says):
                attach(folder)
            (folder / JOB_FILE).write_text(kept)
        with socket.create_server(("127.0.0.1", 0)) as mute:
            disguise(folder, port=mute.getsockname()[1])
            monkeypatch.setattr("cellapp.cell.driving.requests.attaching.PATIENCE_S", 0.05)
            with pytest.raises(HardwareError, match="press its emergency stop"):
                attach(folder)
    (folder / JOB_FILE).write_text(kept)  # as a killed job leaves it
    with pytest.raises(InputError, match="the last one has ended"):
        attach(folder)


@pytest.mark.fast
def test_a_silent_process_and_one_that_is_gone_are_said(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.cell.driving.requests.attaching._SILENT_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as server, Job(folder).running():
        disguise(folder, port=server.getsockname()[1])
        accepted: list[socket.socket] = []

        def accept() -> None:
            connection, _ = server.accept()
            connection.sendall(
                b'{"type": "Heartbeat", "name": "collect", "request": "none", "holds": true, "has_brakes": true,'
                b' "ends": false}\n'
            )
            accepted.append(connection)

        thread = threading.Thread(target=accept)
        thread.start()
        watched = Watched(folder)
        within(thread.join, "the link")
        watched.until_said("has been silent for 0.05 s")
        watched.remote.stop()
        assert watched.remote.request == "stop"
        accepted[0].close()
    ended = watched.end()
    assert isinstance(ended, HardwareError)
    assert f"process {os.getppid()}, which ran 'collect' in {folder}, is gone without a word" in str(ended)
