"""The store of results: what is kept, what is refused, what of it is used."""

from __future__ import annotations

import math
import os
import sqlite3
import sys
from pathlib import Path

import pytest

from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.progress import Progress
from cellapp.ground.scale import gather as gathering
from cellapp.ground.scale.executor import Resources, _quota, local_cores
from cellapp.ground.scale.gather import Gathered, gather
from cellapp.ground.scale.program import program_text, this_program
from cellapp.ground.scale.store import ResultStore
from cellapp.ground.scale.task import as_json, load_kind
from cellapp.ground.scale.worker import Answer, perform
from tests.ground.scale.kinds import SQUARES, Number, Shared, Square, begun, squares

pytestmark = pytest.mark.fast

FOUR = [Number(value=value) for value in range(4)]


def gathered_into(
    store: Path, folder: Path, *numbers: Number, offset: float = 0.0, said: list[Progress] | None = None
) -> Gathered[Square]:
    batch = squares(Shared(folder=str(folder), offset=offset), *numbers)
    return gather(batch, "squares", Resources(1, store=store), (said if said is not None else []).append)


def test_only_what_is_missing_is_computed(tmp_path: Path) -> None:
    store, said = tmp_path / "store.sqlite", list[Progress]()
    first = gathered_into(store, tmp_path, *FOUR[:2])
    assert [one.square for one in first.found] == [0.0, 1.0]
    again = gathered_into(store, tmp_path, *reversed(FOUR), said=said)
    assert [one.square for one in again.found] == [9.0, 4.0, 1.0, 0.0], "in the order of the tasks"
    assert begun(tmp_path) == dict.fromkeys(range(4), 1)
    assert (said[0].done, said[0].total, said[0].note) == (2, 4, "2 in the store")
    assert said[-1].done == 4


def test_other_data_and_other_programs_have_results_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, said = tmp_path / "store.sqlite", list[Progress]()
    gathered_into(store, tmp_path, *FOUR)
    other = gathered_into(store, tmp_path, *FOUR, offset=0.5, said=said)
    assert [one.square for one in other.found] == [0.5, 1.5, 4.5, 9.5]
    assert said[0].note == "4 there of another program or other data are not used"
    newer = this_program().model_copy(update={"source": "another"})
    monkeypatch.setattr(gathering, "program_text", newer.model_dump_json)
    with pytest.raises(InputError, match=r"\(source another\).*install the same on both"):
        gathered_into(store, tmp_path, *FOUR)
    assert begun(tmp_path) == dict.fromkeys(range(4), 2)


def test_tasks_that_fail_are_named_kept_and_tried_again(tmp_path: Path) -> None:
    store = tmp_path / "store.sqlite"
    numbers = [FOUR[0], Number(value=7, deed="fail"), FOUR[1]]
    for attempt in (1, 2):
        found = gathered_into(store, tmp_path, *numbers)
        assert found.failed == ("number 7: 7 has no square",)
        assert [one and one.square for one in found.results] == [0.0, None, 1.0]
        assert begun(tmp_path) == {0: 1, 7: attempt, 1: 1}
    with pytest.raises(InputError, match=r"^7 has no square$"):
        gathered_into(store, tmp_path, numbers[1])


def test_an_error_that_nobody_foresaw_names_its_place(tmp_path: Path) -> None:
    with pytest.raises(CheckFailed, match=r"FileNotFoundError: .*nowhere.* \(pathlib.py:\d+\)"):
        gathered_into(tmp_path / "store.sqlite", tmp_path / "nowhere", FOUR[0])


@pytest.mark.slow
def test_damaged_and_foreign_files_are_named(tmp_path: Path) -> None:
    text, other, damaged = (tmp_path / name for name in ("text", "other", "damaged"))
    text.write_text("no database, but long enough for a header " * 9, encoding="ascii")
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE t (x)")
    connection.close()
    gathered_into(damaged, tmp_path, *[Number(value=value) for value in range(300)])
    content = bytearray(damaged.read_bytes())
    content[4096:] = os.urandom(len(content) - 4096)
    damaged.write_bytes(content)
    for path, sentence in (
        (text, "is no store of results"),
        (other, "is an SQLite file, but no store of results"),
        (damaged, "is damaged"),
        (tmp_path, "expected a file"),
        (tmp_path / "no" / "store", "expected a file in a folder that exists"),
    ):
        with pytest.raises(InputError, match=f"{path.name}.*{sentence}"):
            gathered_into(path, tmp_path, *FOUR)
    with pytest.raises(InputError, match="file not found"):
        ResultStore.open(tmp_path / "none", new=False)


def test_a_result_that_was_changed_is_not_used(tmp_path: Path) -> None:
    store = tmp_path / "store.sqlite"
    gathered_into(store, tmp_path, *FOUR)
    with sqlite3.connect(store) as connection:
        connection.execute("""UPDATE result SET found = '{"square":5.0}' WHERE found = '{"square":4.0}'""")
    connection.close()
    with pytest.raises(InputError, match="damaged: a result is not what was written"):
        gathered_into(store, tmp_path, *FOUR)


def test_a_newer_store_is_refused(tmp_path: Path) -> None:
    store = tmp_path / "store.sqlite"
    gathered_into(store, tmp_path, *FOUR)
    with sqlite3.connect(store) as connection:
        connection.execute("PRAGMA user_version = 99")
    connection.close()
    with pytest.raises(InputError, match="newer cellapp"):
        gathered_into(store, tmp_path, *FOUR)


def test_a_worker_answers_in_text(tmp_path: Path) -> None:
    shared = as_json(Shared(folder=str(tmp_path)))
    text = perform("tests.ground.scale.kinds:SQUARES", shared, as_json(FOUR[3]), program_text())
    answer = Answer.model_validate_json(text)
    assert Square.model_validate_json(answer.found or "").square == 9.0
    assert answer.wall_s >= answer.cpu_s > 0.0


def test_infinite_results_are_kept(tmp_path: Path) -> None:
    for _ in range(2):
        (found,) = gathered_into(tmp_path / "store.sqlite", tmp_path, Number(value=3, deed="overflow")).found
        assert found.square == math.inf
    assert begun(tmp_path) == {3: 1}


def test_kinds_are_found_where_they_stand() -> None:
    assert load_kind("tests.ground.scale.kinds:SQUARES") is SQUARES
    for reference in ("tests.ground.scale.kinds:CIRCLES", "tests.ground.scale.nothing:SQUARES", "nothing"):
        with pytest.raises(InputError, match="not known here"):
            load_kind(reference)
    with pytest.raises(InputError, match="no kind of task"):
        load_kind("os:sep")


def test_cores_are_those_that_this_process_may_use(tmp_path: Path) -> None:
    assert 1 <= local_cores() <= len(os.sched_getaffinity(0))
    limits = {"150000 100000": 2, "max 100000": 2**31, "": 2**31}
    for number, (text, cores) in enumerate(limits.items()):
        path = tmp_path / str(number)
        path.write_text(text, encoding="ascii")
        assert _quota(path) == cores
    assert _quota(tmp_path / "missing") == 2**31


def test_jobs_and_scheduler_exclude_each_other(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="leave out --jobs or --scheduler"):
        gather(squares(Shared(folder=str(tmp_path)), *FOUR), "squares", Resources(2, "tcp://127.0.0.1:1"))


def test_without_dask_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "cellapp.ground.scale.dask_cluster", raising=False)
    with pytest.raises(InputError, match=r"--scheduler needs Dask .*pip install 'cellapp\[cluster\]'"):
        gather(squares(Shared(folder=str(tmp_path)), *FOUR), "squares", Resources(scheduler="tcp://127.0.0.1:1"))
