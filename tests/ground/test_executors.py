"""Many tasks: in this process, in processes, on a Dask cluster; what is kept, what is killed and goes on."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.executors import ComputingLost, Work, gather, local_cores
from cellapp.ground.progress import Cancelled, CancelToken, Progress
from cellapp.ground.results import Record

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


def values(given: dict[str, int], work: Work, folder: Path | None = None) -> list[float | None]:
    """Values of all tasks; None of those that failed."""
    found = gather(square, partial(offset, 0.5, folder), given, Square, "squares", work)
    return [None if one is None else one.value for one in found.results]


@pytest.mark.fast
def test_one_process_is_this_one_and_listens_to_every_task() -> None:
    heard = list[Progress]()
    found = gather(square, partial(offset, 0.5), FOUR, Square, "squares", Work(listener=heard.append))
    assert [one.value for one in found.found] == [1.5, 4.5, 9.5, 16.5]
    assert {one.process for one in found.found} == {os.getpid()}
    assert [(one.done, one.total) for one in heard] == [(done, 4) for done in range(5)]
    assert heard[-1].note == "square of 4"


def square_of_squares(prepared: tuple[float, Path | None], number: int) -> Square:
    """A task that gathers tasks of its own."""
    (inner,) = gather(square, partial(offset, 0.0), {"inner": number}, Square, "inner", Work()).found
    return square(prepared, int(inner.value))


@pytest.mark.fast
def test_a_task_may_gather_tasks_of_its_own() -> None:
    found = gather(square_of_squares, partial(offset, 0.5), {"three": 3}, Square, "squares", Work())
    assert [one.value for one in found.found] == [81.5]


@pytest.mark.fast
def test_a_task_that_fails_is_named_and_does_not_stop_the_others() -> None:
    found = gather(square, partial(offset, 0.0), {"a": -1, "b": 2}, Square, "squares", Work())
    assert found.results[0] is None
    assert [one.value for one in found.found] == [4.0]
    assert found.failed[0].startswith("a: ValueError: negative (test_executors.py:")
    with pytest.raises(CheckFailed, match=r"negative .*all 2 failed"):
        gather(square, partial(offset, 0.0), {"a": -1, "b": -2}, Square, "squares", Work())
    assert not gather(square, partial(offset, 0.0), {"a": -1}, Square, "x", Work(), all_may_fail=True).found


@pytest.mark.fast
def test_what_a_results_file_holds_is_not_computed_again(tmp_path: Path) -> None:
    kept = tmp_path / "kept.jsonl"
    work = Work(results=kept)
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


@pytest.mark.fast
@pytest.mark.parametrize("text", ["cells\n", '{"no": 1}\n'])
def test_another_file_is_no_results_file_and_stays(tmp_path: Path, text: str) -> None:
    kept = tmp_path / "notes.txt"
    kept.write_text(text)
    with pytest.raises(InputError, match=r"notes.txt is no results file"):
        values(FOUR, Work(results=kept))
    assert kept.read_text() == text
    with pytest.raises(InputError, match="choose a file that can be written"):
        values(FOUR, Work(results=tmp_path / "missing" / "kept.jsonl"))


@pytest.mark.fast
def test_a_cancelled_job_begins_nothing_and_keeps_what_ended(tmp_path: Path) -> None:
    cancel, kept = CancelToken(), tmp_path / "kept.jsonl"

    def after_two(event: Progress) -> None:
        if event.done == 2:
            cancel.cancel()

    with pytest.raises(Cancelled):
        values(FOUR, Work(results=kept, listener=after_two, cancel=cancel))
    assert len(kept.read_text().splitlines()) == 2


def test_processes_prepare_once_give_the_same_and_outlive_one_that_is_killed(tmp_path: Path) -> None:
    (tmp_path / "kill-2").touch()
    found = gather(square, partial(offset, 0.5, tmp_path), FOUR, Square, "squares", Work(jobs=2))
    assert [one.value for one in found.found] == [1.5, 4.5, 9.5, 16.5]
    assert os.getpid() not in {one.process for one in found.found}
    assert len([*tmp_path.glob("prepared-*")]) <= 4, "two processes, and two after one was killed"


def test_a_task_that_always_ends_its_process_is_named(tmp_path: Path) -> None:
    kept = tmp_path / "kept.jsonl"
    with pytest.raises(ComputingLost, match=r"processes were ended 3 times.*at thirteen; repeat") as raised:
        values({"thirteen": 13, "one": 1}, Work(jobs=2, results=kept))
    assert raised.value.exit_code == 4


def test_processes_end_with_their_client_even_if_it_is_killed(tmp_path: Path) -> None:
    source = (
        "from functools import partial; from pathlib import Path; from cellapp.ground.executors import Work, gather;"
        "from tests.ground.test_executors import Square, offset, square;"
        f"gather(square, partial(offset, 0.0, Path({str(tmp_path)!r})), {{'a': 60_000, 'b': 60_001}}, Square, 'x',"
        " Work(jobs=2))"
    )
    client = subprocess.Popen([sys.executable, "-c", source])
    try:
        until(lambda: len([*tmp_path.glob("begun-6*")]) == 2, "two tasks begin")
    finally:
        client.kill()
        client.wait(WAIT_S)
    workers = [int(path.name.removeprefix("prepared-")) for path in tmp_path.glob("prepared-*")]
    until(lambda: not any(map(runs, workers)), "the processes end")


def test_cores_are_those_of_this_process() -> None:
    assert 1 <= local_cores() <= (os.cpu_count() or 1)


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
    work = Work(jobs=None, scheduler=address, results=tmp_path / "kept.jsonl")
    assert values(FOUR | {"fails": -1}, work) == [1.5, 4.5, 9.5, 16.5, None]
    with pytest.raises(InputError, match="--jobs: the scheduler has workers of its own"):
        values(FOUR, Work(jobs=2, scheduler=address))

    def end_it(event: Progress) -> None:
        if event.done == 5:
            scheduler.kill()

    more = FOUR | {f"slow {number}": 1000 + number for number in range(3)}
    with pytest.raises(ComputingLost, match="the scheduler is gone"):
        values(more, Work(jobs=None, scheduler=address, results=work.results, listener=end_it))


def test_no_scheduler_is_said_with_what_to_do() -> None:
    with pytest.raises(InputError, match=r"no Dask scheduler answers .*'dask scheduler'"):
        values(FOUR, Work(jobs=None, scheduler="nonsense://x"))


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
