"""Processes of this computer: the same results, killed workers, killed clients, Ctrl-C."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from cellapp.ground.progress import Cancelled, CancelToken
from cellapp.ground.scale.executor import MOST_ATTEMPTS, Resources
from cellapp.ground.scale.gather import gather
from tests.ground.scale.client import client_here, has_kept, last_words, started_client
from tests.ground.scale.kinds import LONGEST_S, Number, Shared, Switchboard, begun, squares

FEW = [Number(value=value) for value in range(4)]


def test_a_killed_worker_is_replaced_and_a_task_that_kills_every_worker_is_named(tmp_path: Path) -> None:
    numbers = [*FEW, Number(value=10, deed="die once"), Number(value=11, deed="die"), Number(value=12, deed="fail")]
    found = gather(squares(Shared(folder=str(tmp_path)), *numbers), "squares", Resources(jobs=2))
    assert [one.square for one in found.found] == [0.0, 1.0, 4.0, 9.0, 100.0], "as in one process"
    assert list(found.failures) == ["number 11", "number 12"]
    assert "its process was ended 3 times" in found.failures["number 11"]
    assert begun(tmp_path) == {0: 1, 1: 1, 2: 1, 3: 1, 10: 2, 11: MOST_ATTEMPTS, 12: 1}
    assert found.workers == 2


def test_a_killed_client_takes_its_workers_along_and_continues(tmp_path: Path) -> None:
    resources = Resources(jobs=2, store=tmp_path / "store.sqlite")
    with Switchboard.opened() as switchboard:
        shared = Shared(folder=str(tmp_path), port=switchboard.port)
        numbers = [*FEW[:2], *(Number(value=value, deed="call") for value in (8, 9))]
        client = started_client(resources, shared, *numbers)
        calls = [switchboard.next_call() for _ in range(2)]
        has_kept(client, 2)
        client.kill()
        assert last_words(client)[0] == -signal.SIGKILL
        for call in calls:
            assert call.ended(), "its process ended with the client"
        with client_here(Resources(jobs=1, store=resources.store), shared, *numbers) as again:
            for _ in range(2):
                switchboard.next_call().answer()
            assert [one.square for one in again.result(LONGEST_S).found] == [0.0, 1.0, 64.0, 81.0]
    assert begun(tmp_path) == {0: 1, 1: 1, 8: 2, 9: 2}


def test_ctrl_c_ends_with_the_tasks_under_way(tmp_path: Path) -> None:
    resources = Resources(jobs=2, store=tmp_path / "store.sqlite")
    with Switchboard.opened() as switchboard:
        numbers = [*(Number(value=value, deed="call") for value in (8, 9)), *FEW]
        client = started_client(resources, Shared(folder=str(tmp_path), port=switchboard.port), *numbers)
        calls = [switchboard.next_call() for _ in range(2)]
        os.killpg(client.pid, signal.SIGINT)
        assert client.stderr is not None
        assert "the job ends at its next step" in client.stderr.readline()
        for call in calls:
            call.answer()
        code, _, err = last_words(client)
    assert code == 4
    assert "the same command with --store" in err
    assert "Traceback" not in err
    assert begun(tmp_path) == {8: 1, 9: 1}


@pytest.mark.fast
def test_a_cancelled_job_begins_no_further_task(tmp_path: Path) -> None:
    cancel = CancelToken()
    batch = squares(Shared(folder=str(tmp_path)), *FEW)
    with pytest.raises(Cancelled):
        gather(batch, "squares", Resources(jobs=1), lambda event: cancel.cancel() if event.done == 2 else None, cancel)
    assert begun(tmp_path) == {0: 1, 1: 1}
