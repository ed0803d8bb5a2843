"""Requests of a person: pause, resume, stop, abort, and the way to the brakes."""

from __future__ import annotations

import ast
import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest

import cellapp
from cellapp.ground.control import Aborted, JobControl, Stopped
from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.executors import ComputingLost, PoolWork, gather
from cellapp.ground.progress import UNATTENDED, Cancelled, JobToken, Progress, eta_words, in_lines
from cellapp.ground.results import Record


def test_stop_calls_the_brakes_in_the_callers_thread_when_the_request_stands() -> None:
    control, braked = JobControl(), list[tuple[str, str, int]]()
    with control.brakes(lambda verb: braked.append((verb, control.request, threading.get_ident()))):
        control.stop()
    assert braked == [("stop", "stop", threading.get_ident())]
    assert control.request == "stop"


def test_a_job_that_nobody_attends_ends_with_stop() -> None:
    control = JobControl()
    with control.brakes(lambda verb: None):
        control.stop()
        with pytest.raises(Stopped):
            control.check()
    assert control.cancelled


def test_nobody_can_cancel_what_all_calls_without_a_job_share() -> None:
    with pytest.raises(RuntimeError, match="JobToken of its own"):
        UNATTENDED.cancel()
    assert not UNATTENDED.cancelled


def test_an_attended_job_holds_and_resumes() -> None:
    control = JobControl(holds=True)
    with control.brakes(lambda verb: None):
        control.stop()
        control.check()
        requests = [control.request]
        control.resume()
        assert [*requests, control.request] == ["stop", "none"]


def test_abort_ends_every_job_and_cannot_be_taken_back() -> None:
    control = JobControl(holds=True)
    with control.brakes(lambda verb: None):
        control.stop()
        control.abort()
        control.resume()
        control.stop()
        control.pause()
        with pytest.raises(Aborted):
            control.check()
    assert issubclass(Aborted, Cancelled)


def test_pause_does_not_brake_and_stop_goes_before_pause() -> None:
    control, braked = JobControl(), list[str]()
    with control.brakes(braked.append):
        control.pause()
        control.check()
        assert (control.request, braked) == ("pause", [])
        control.stop()
        control.pause()
        assert (control.request, braked) == ("stop", ["stop"])


def test_a_request_that_stands_brakes_a_cell_that_opens_later() -> None:
    control, braked = JobControl(), list[str]()
    control.stop()
    with control.brakes(braked.append):
        assert braked == ["stop"]


def test_waiting_ends_with_the_request() -> None:
    control = JobControl()
    control.pause()
    threading.Timer(0.01, control.resume).start()
    assert control.wait_while("pause", timeout_s=30.0) == "none"
    threading.Timer(0.01, control.stop).start()
    assert control.wait(30.0)


def test_who_leaves_is_named_once_and_nothing_resumes() -> None:
    control, braked = JobControl(holds=True), list[tuple[str, str]]()
    with control.brakes(lambda verb: braked.append((verb, control.departure))):
        control.leave("the terminal was closed")
        control.leave("the application ended")
        control.resume()
        with pytest.raises(Stopped, match="the terminal was closed"):
            control.check()
    assert braked == [("stop", "the terminal was closed")]
    assert (control.request, control.departure) == ("stop", "the terminal was closed")


# -- Numbers with the noun that they count, one function for all sentences ---------------------------------------------

_NOUNS = ("targets", "stops", "readings", "cycles", "checks", "positions")
_NUMBER = re.compile(
    r"len\(.*\)|count|remaining|todo|rows|wanted|total|done|asked|n|.*\.(n|stops|cycles|readings|stops_left|targets)"
)
_AT_LEAST_TWO = {"one.targets"}
"""Of sentences that are said of two or more only."""


def _bare(path: Path) -> Iterator[str]:
    """Numbers that stand before a plural without being counted."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if not isinstance(node, ast.JoinedStr):
            continue
        for value, after in pairwise(node.values):
            if isinstance(value, ast.FormattedValue) and value.format_spec is None and isinstance(after, ast.Constant):
                source, word = ast.unparse(value.value), str(after.value).removeprefix(" ").partition(" ")[0]
                if word.strip(".,;:)") in _NOUNS and _NUMBER.fullmatch(source) and source not in _AT_LEAST_TWO:
                    yield f"{path.name}:{node.lineno}: {{{source}}} {word}"


def test_what_a_person_reads_counts_with_one_function() -> None:
    root = Path(cellapp.__file__).parent
    found = [
        one
        for part in ("interfaces", "commands", "cell")
        for path in (root / part).rglob("*.py")
        for one in _bare(path)
    ]
    assert not found, "\n".join(found)


# -- Many tasks: in this process, in processes, on a Dask cluster; what is kept, what is killed and goes on ------------

FOUR = {f"square of {number}": number for number in range(1, 5)}
WAIT_S = 20.0


class Square(Record):
    """A result, with the process that computed it."""

    value: float
    process: int


def offset(value: float, folder: Path | None = None) -> tuple[float, Path | None]:
    """What all tasks share, which a process prepares once."""
    if folder is not None:
        (folder / f"prepared-{os.getpid()}").touch(exist_ok=False)
    return value, folder


def square(prepared: tuple[float, Path | None], number: int) -> Square:
    """A task: it says that it began, fails for a negative number, and ends its process where a file says so."""
    value, folder = prepared
    if folder is not None:
        with (folder / f"begun-{number}").open("a") as file:
            file.write(".")
        with contextlib.suppress(FileNotFoundError):
            (folder / f"kill-{number}").unlink()
            os.kill(os.getpid(), signal.SIGKILL)
    if number < 0:
        raise ValueError("negative")
    if number == 13:
        os.kill(os.getpid(), signal.SIGKILL)
    if number > 100:
        threading.Event().wait(number / 1000.0)
    return Square(value=number**2 + value, process=os.getpid())


def values(given: dict[str, int], work: PoolWork, folder: Path | None = None) -> list[float | None]:
    """Values of all tasks; None of those that failed."""
    found = gather(square, partial(offset, 0.5, folder), given, Square, "squares", work)
    return [None if one is None else one.value for one in found.results]


def test_a_task_that_fails_is_named_and_does_not_stop_the_others() -> None:
    found = gather(square, partial(offset, 0.0), {"a": -1, "b": 2}, Square, "squares", PoolWork())
    assert found.results[0] is None
    assert [one.value for one in found.found] == [4.0]
    assert found.failed[0].startswith("a: ValueError: negative (test_control.py:")
    with pytest.raises(CheckFailed, match=r"negative .*all 2 failed"):
        gather(square, partial(offset, 0.0), {"a": -1, "b": -2}, Square, "squares", PoolWork())
    assert not gather(square, partial(offset, 0.0), {"a": -1}, Square, "x", PoolWork(), all_may_fail=True).found


def test_what_a_results_file_holds_is_not_computed_again(tmp_path: Path) -> None:
    kept = tmp_path / "kept.jsonl"
    work = PoolWork(results=kept)
    assert values(FOUR | {"fails": -1}, work, tmp_path) == [1.5, 4.5, 9.5, 16.5, None]
    (tmp_path / f"prepared-{os.getpid()}").unlink()
    with kept.open("a") as file:  # killed while it wrote
        file.write('{"key": "ab')
    assert values(FOUR | {"five": 5}, work, tmp_path) == [1.5, 4.5, 9.5, 16.5, 25.5]
    assert {path.name: len(path.read_text()) for path in tmp_path.glob("begun-*")} == {
        **{f"begun-{number}": 1 for number in (1, 2, 3, 4, 5)},
        "begun--1": 1,
    }
    assert len(kept.read_text().splitlines()) == 5
    other = gather(square, partial(offset, 2.0), FOUR, Square, "squares", work)
    assert [one.value for one in other.found] == [3.0, 6.0, 11.0, 18.0], "what all tasks share is another"


@pytest.mark.parametrize("text", ["cells\n", '{"no": 1}\n'])
def test_another_file_is_no_results_file_and_stays(tmp_path: Path, text: str) -> None:
    kept = tmp_path / "notes.txt"
    kept.write_text(text)
    with pytest.raises(InputError, match=r"notes.txt is no results file"):
        values(FOUR, PoolWork(results=kept))
    assert kept.read_text() == text
    with pytest.raises(InputError, match="choose a file that can be written"):
        values(FOUR, PoolWork(results=tmp_path / "missing" / "kept.jsonl"))


def test_a_cancelled_job_begins_nothing_and_keeps_what_ended(tmp_path: Path) -> None:
    kept = tmp_path / "kept.jsonl"

    def after_two(event: Progress) -> None:
        if event.done == 2:
            job.cancel()

    job = JobToken(after_two)
    with pytest.raises(Cancelled):
        values(FOUR, PoolWork(results=kept, job=job))
    assert len(kept.read_text().splitlines()) == 2


def test_processes_prepare_once_give_the_same_and_outlive_one_that_is_killed(tmp_path: Path) -> None:
    (tmp_path / "kill-2").touch()
    found = gather(square, partial(offset, 0.5, tmp_path), FOUR, Square, "squares", PoolWork(jobs=2))
    assert [one.value for one in found.found] == [1.5, 4.5, 9.5, 16.5]
    assert os.getpid() not in {one.process for one in found.found}
    assert len([*tmp_path.glob("prepared-*")]) <= 4, "two processes, and two after one was killed"


def test_a_task_that_always_ends_its_process_is_named(tmp_path: Path) -> None:
    kept = tmp_path / "kept.jsonl"
    with pytest.raises(ComputingLost, match=r"processes were ended 3 times.*at thirteen(, one)?; repeat") as raised:
        values({"thirteen": 13, "one": 1}, PoolWork(jobs=2, results=kept))
    assert raised.value.exit_code == 4


def test_processes_end_with_their_client_even_if_it_is_killed(tmp_path: Path) -> None:
    source = (
        "from functools import partial; from pathlib import Path;"
        "from cellapp.ground.executors import PoolWork, gather;"
        "from tests.ground.test_control import Square, offset, square;"
        f"gather(square, partial(offset, 0.0, Path({str(tmp_path)!r})), {{'a': 60_000, 'b': 60_001}}, Square, 'x',"
        " PoolWork(jobs=2))"
    )
    client = subprocess.Popen([sys.executable, "-c", source])
    try:
        until(lambda: len([*tmp_path.glob("begun-6*")]) == 2, "two tasks begin")
    finally:
        client.kill()
        client.wait(WAIT_S)
    workers = [int(path.name.removeprefix("prepared-")) for path in tmp_path.glob("prepared-*")]
    until(lambda: not any(map(runs, workers)), "the processes end")


# -- a cluster --------------------------------------------------------------------------------------------------------


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Address and process of a scheduler with a worker in a process of its own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    dask = [sys.executable, "-W", "ignore", "-m", "distributed.cli"]
    log = (tmp_path / "dask.log").open("wb")
    port = ["--port", address.rpartition(":")[2]]
    scheduler = subprocess.Popen(
        [*dask[:-1], "distributed.cli.dask_scheduler", "--host", "127.0.0.1", *port, "--no-dashboard"], stderr=log
    )
    worker = subprocess.Popen(
        [*dask[:-1], "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"],
        stderr=log,
    )
    yield address, scheduler
    for process in (worker, scheduler):
        process.kill()
        process.wait(WAIT_S)
    log.close()


def test_workers_of_a_cluster_give_the_same(cluster: tuple[str, subprocess.Popen[bytes]], tmp_path: Path) -> None:
    address, scheduler = cluster
    work = PoolWork(jobs=None, scheduler=address, results=tmp_path / "kept.jsonl")
    assert values(FOUR | {"fails": -1}, work) == [1.5, 4.5, 9.5, 16.5, None]
    with pytest.raises(InputError, match="--jobs: the scheduler has workers of its own"):
        values(FOUR, PoolWork(jobs=2, scheduler=address))

    def end_it(event: Progress) -> None:
        if event.done == 5:
            scheduler.kill()

    more = FOUR | {f"slow {number}": 1000 + number for number in range(3)}
    with pytest.raises(ComputingLost, match="the scheduler is gone"):
        values(more, PoolWork(jobs=None, scheduler=address, results=work.results, job=JobToken(end_it)))


def test_no_scheduler_is_said_with_what_to_do() -> None:
    with pytest.raises(InputError, match=r"no Dask scheduler answers .*'dask scheduler'"):
        values(FOUR, PoolWork(jobs=None, scheduler="nonsense://x"))


def until(holds, what: str) -> None:
    """Wait until something holds."""
    end = time.monotonic() + WAIT_S
    while not holds():
        assert time.monotonic() < end, f"waited {WAIT_S:.0f} s until {what}"
        threading.Event().wait(0.02)


def runs(process: int) -> bool:
    """Whether a process is there and no zombie."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


# -- Estimated times, parts of a job that run at the same time ---------------------------------------------------------


class Clocked:
    """Events with the estimates that a listener got, at times that the test sets."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.events: list[Progress] = []
        self._job = JobToken(self.events.append, lambda: self.now_s)

    def emit(self, now_s: float, event: Progress) -> float | None:
        self.now_s = now_s
        self._job.tell(event.job, event.done, event.total, event.note)
        return self.events[-1].eta_s


def test_the_rate_is_that_of_steps_under_our_eyes() -> None:
    job = Clocked()
    assert job.emit(0.0, Progress("collect", 200, 400)) is None, "a resumed job: the stored steps took no time"
    assert job.emit(10.0, Progress("collect", 201, 400)) == pytest.approx(1990.0)
    assert job.emit(14.0, Progress("collect", 201, 400, "measuring")) == pytest.approx(1986.0)
    assert job.emit(20.0, Progress("collect", 202, 400)) == pytest.approx(1980.0)
    assert job.emit(50.0, Progress("collect", 202, 400)) == pytest.approx(198 * 50.0 / 3 - 30.0), "a long step counts"
    assert job.emit(2001.0, Progress("collect", 400, 400)) == 0.0


def test_times_in_words() -> None:
    assert [eta_words(eta_s) for eta_s in (None, 0.0, 59.0, 90.0, 3700.0)] == [
        "", "0 s left", "59 s left", "2 min left", "1 h 02 min left",
    ]  # fmt: skip


def test_a_long_job_without_a_terminal_says_each_minute_how_far_it_is() -> None:
    now_s, said = [0.0], list[str]()
    listen = in_lines(said.append, lambda: now_s[0])
    for step in range(1000):  # 250 s
        now_s[0] = 0.25 * step
        listen(Progress("iso9283", step, 1000, f"pose {step}", eta_s=249.75 - now_s[0]))
    assert said == [f"iso9283: {k} of 1000, pose {k}, {eta_words(249.75 - k / 4)}" for k in (240, 480, 720, 960)]
    listen(Progress("iso9283", 1000, 1000, "done"))
    assert len(said) == 4


# -- Linear algebra keeps to one thread, whichever library does it and whenever it is loaded ---------------------------

PROGRAM = """
import json, sys
import numpy as np, scipy, threadpoolctl
from cellapp.ground.threads import one_blas_thread
with one_blas_thread():
    scipy.linalg.lapack.dpotrf(np.eye(3))
    print(json.dumps([one["num_threads"] for one in threadpoolctl.threadpool_info() if one["user_api"] == "blas"]))
"""


def test_a_library_that_is_loaded_later_has_one_thread_too() -> None:
    """numpy and scipy bring a BLAS each, and scipy loads its own at the first use."""
    said = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=60)
    assert set(json.loads(said.stdout)) == {1}
