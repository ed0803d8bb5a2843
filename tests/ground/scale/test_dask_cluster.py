"""A Dask cluster in processes of its own: the same results; killed workers, clients and schedulers."""

from __future__ import annotations

import dataclasses
import os
import queue
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import Future

from cellapp.cell.profile import load_profile
from cellapp.commands.trials.coverage import coverage_trials
from cellapp.commands.trials.skeleton import Work
from cellapp.ground.errors import InputError
from cellapp.ground.progress import CancelToken
from cellapp.ground.scale import dask_cluster
from cellapp.ground.scale.executor import Resources
from cellapp.ground.scale.gather import gather
from cellapp.ground.scale.program import program_text, this_program
from tests.ground.scale.client import client_here, has_kept, last_words, started_client
from tests.ground.scale.dask_processes import scheduler, workers
from tests.ground.scale.kinds import LONGEST_S, Number, Shared, Switchboard, begun, squares
from tests.twin import PROFILES

FEW = [Number(value=value) for value in range(4)]


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Of a scheduler with two workers."""
    folder = tmp_path_factory.mktemp("dask")
    with scheduler(folder) as (_, found), workers(found, folder, 2):
        yield found


def test_results_are_those_of_this_computer_and_tasks_that_end_workers_are_named(address: str, tmp_path: Path) -> None:
    numbers = [*FEW, Number(value=11, deed="die"), Number(value=12, deed="fail")]
    found = gather(squares(Shared(folder=str(tmp_path)), *numbers), "squares", Resources(scheduler=address))
    here = gather(squares(Shared(folder=str(tmp_path)), *FEW), "squares", Resources(jobs=1))
    assert found.workers == 2
    assert found.failures == {
        "number 11": "every worker that began it ended, perhaps for memory",
        "number 12": "12 has no square",
    }
    assert found.found == here.found
    assert begun(tmp_path)[11] == 2, "among others, then alone"


def test_the_task_of_a_killed_worker_is_repeated(address: str, tmp_path: Path) -> None:
    resources = Resources(scheduler=address, store=tmp_path / "store.sqlite")
    with Switchboard.opened() as switchboard:
        shared = Shared(folder=str(tmp_path), port=switchboard.port)
        with client_here(resources, shared, *FEW, Number(value=8, deed="call")) as client:
            first = switchboard.next_call()
            os.kill(first.pid, signal.SIGKILL)
            assert first.ended()
            again = switchboard.next_call()
            assert (again.value, again.pid != first.pid) == (8, True)
            again.answer()
            gathered = client.result(LONGEST_S)
            assert not gathered.failures
            assert [one.square for one in gathered.found] == [0.0, 1.0, 4.0, 9.0, 64.0]


def test_a_result_whose_worker_is_killed_before_it_is_fetched_is_computed_again(address: str, tmp_path: Path) -> None:
    class KillsFirst(queue.SimpleQueue[Future]):
        """The first task that ends loses its worker before anybody looks at it."""

        killed = False

        def get(self, block: bool = True, timeout: float | None = None) -> Future:
            ended = super().get(block, timeout)
            if not self.killed:
                self.killed = True
                os.kill(int((tmp_path / "begun-1").read_text(encoding="ascii")), signal.SIGKILL)
                deadline, never = time.monotonic() + LONGEST_S, threading.Event()
                while ended.status == "finished" and time.monotonic() < deadline:
                    never.wait(0.01)  # Dask calls nobody when it notices
                assert ended.status == "lost"
            return ended

    program, batch = program_text(), squares(Shared(folder=str(tmp_path)), Number(value=1))
    with dask_cluster.dask_cluster(address) as cluster:
        cluster = dataclasses.replace(cluster, _ended=KillsFirst())
        ((_, answer),) = cluster.answers(batch.shared, program, batch.tasks(program), CancelToken())
    assert answer.failure == ""
    assert begun(tmp_path) == {1: 2}


def test_a_killed_client_continues(address: str, tmp_path: Path) -> None:
    resources = Resources(scheduler=address, store=tmp_path / "store.sqlite")
    with Switchboard.opened() as switchboard:
        shared = Shared(folder=str(tmp_path), port=switchboard.port)
        numbers = [*FEW, *(Number(value=value, deed="call") for value in (8, 9))]
        client = started_client(resources, shared, *numbers)
        calls = [switchboard.next_call() for _ in range(2)]
        has_kept(client, 4)
        client.kill()
        assert last_words(client)[0] == -signal.SIGKILL
        with client_here(resources, shared, *numbers) as again:
            for call in calls:
                call.answer()
            for _ in range(2):
                switchboard.next_call().answer()
            found = again.result(LONGEST_S).found
    assert [one.square for one in found] == [0.0, 1.0, 4.0, 9.0, 64.0, 81.0]
    assert begun(tmp_path) == {**dict.fromkeys(range(4), 1), 8: 2, 9: 2}


def test_ctrl_c_gives_the_tasks_under_way_up(address: str, tmp_path: Path) -> None:
    resources = Resources(scheduler=address, store=tmp_path / "store.sqlite")
    with Switchboard.opened() as switchboard:
        shared = Shared(folder=str(tmp_path), port=switchboard.port)
        client = started_client(resources, shared, FEW[3], Number(value=8, deed="call"))
        call = switchboard.next_call()
        has_kept(client, 1)
        os.killpg(client.pid, signal.SIGINT)
        code, _, err = last_words(client)
        call.answer()
    assert code == 4
    assert "the same command with --store" in err
    assert "Traceback" not in err
    (stored,) = gather(squares(shared, FEW[3]), "squares", Resources(jobs=1, store=resources.store)).found
    assert (stored.square, begun(tmp_path)[3]) == (9.0, 1)


def test_a_killed_scheduler_ends_the_job_which_continues_on_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = tmp_path / "store.sqlite"
    with Switchboard.opened() as switchboard:
        shared = Shared(folder=str(tmp_path), port=switchboard.port)
        numbers = [*FEW, Number(value=8, deed="call")]
        with scheduler(tmp_path) as (process, address), workers(address, tmp_path, 1, nanny=False):
            client = started_client(Resources(scheduler=address, store=store), shared, *numbers)
            call = switchboard.next_call()
            has_kept(client, 4)
            process.kill()
            code, _, err = last_words(client)
            assert code == 4
            call.answer()
            assert f"cellapp: --scheduler {address}: the scheduler ended" in err
            assert "with --store it continues where it was" in err
            assert len(err.splitlines()) == 1, err
        with scheduler(tmp_path) as (_, address):
            with monkeypatch.context() as patch:
                patch.setattr(dask_cluster, "_CONNECT_S", 0.3)
                with pytest.raises(InputError, match="no worker; start some, as 'dask worker"):
                    gather(squares(shared, *numbers), "squares", Resources(scheduler=address))
            resources = Resources(scheduler=address, store=store)
            with workers(address, tmp_path, 1, nanny=False), client_here(resources, shared, *numbers) as again:
                switchboard.next_call().answer()
                assert [one.square for one in again.result(LONGEST_S).found] == [0.0, 1.0, 4.0, 9.0, 64.0]
    assert begun(tmp_path) == {**dict.fromkeys(range(4), 1), 8: 2}


def test_workers_of_another_program_are_refused(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = this_program().model_copy(update={"version": "9.9"})
    monkeypatch.setattr(dask_cluster, "this_program", lambda: mine)
    with pytest.raises(InputError, match=r"the worker tcp://.* runs cellapp .*; this program is cellapp 9\.9"):
        gather(squares(Shared(folder=str(tmp_path)), *FEW), "squares", Resources(scheduler=address))


def test_a_scheduler_that_is_not_there_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_cluster, "_CONNECT_S", 0.3)
    for wrong in ("tcp://127.0.0.1:1", "nothing://here", ""):
        with pytest.raises(InputError, match="no Dask scheduler answers"):
            gather(squares(Shared(folder=str(tmp_path)), *FEW), "squares", Resources(scheduler=wrong))


def test_a_trial_is_the_same_by_seed_in_this_process_and_on_a_cluster(address: str) -> None:
    profile = load_profile(PROFILES / "twin.yaml")
    here = coverage_trials(profile, 2, 25, Work(Resources(jobs=1)))
    assert coverage_trials(profile, 2, 25, Work(Resources(scheduler=address))) == here
