"""The index of a folder of runs: it saves reading, and is never the truth."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import random
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from cellapp.cell.run import RunFile
from cellapp.commands.fleet.index import INDEX_FILE, indexed_records, stamp_of
from cellapp.estimation.monitoring.fleet.record import RunRecord
from tests.cell.run.small_runs import planned_run
from tests.cell.run.spoiled import spoil_cut, spoil_middle, spoil_text
from tests.estimation.monitoring.fleet.runs import measured_run, set_month

RUNS = 3


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One calibrated run. No test may write to it."""
    return measured_run(tmp_path_factory.mktemp("indexed") / "run", 1)


@pytest.fixture
def folder(calibrated: Path, tmp_path: Path) -> Path:
    """A folder with some runs, each of a month of its own."""
    for number in range(RUNS):
        shutil.copytree(calibrated, tmp_path / "logs" / f"run-{number}")
        set_month(tmp_path / "logs" / f"run-{number}", number)
    return tmp_path / "logs"


def read(folder: Path) -> tuple[list[RunRecord], int]:
    """Records by run, and how many of them were read from the runs."""
    found = indexed_records(folder)
    return sorted(found.records, key=lambda record: record.run), found.read


@pytest.mark.fast
def test_only_changed_runs_are_read_again(folder: Path) -> None:
    first, count = read(folder)
    assert (len(first), count) == (RUNS, RUNS)
    assert read(folder) == (first, 0)
    with RunFile.open(folder / "run-2", write=True) as run:
        run.append_stage("verify", None, "{}", None)
    second, count = read(folder)
    assert count == 1
    assert [a == b for a, b in zip(first, second)] == [True, True, False]
    assert read(folder) == (second, 0)


@pytest.mark.fast
def test_a_change_within_the_same_size_and_time_is_seen_by_its_stage(folder: Path) -> None:
    path = folder / "run-1" / "run.sqlite"
    before, times = stamp_of(folder / "run-1"), path.stat()
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("UPDATE stage SET number = 9 WHERE number = 1")
        connection.commit()
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    after = stamp_of(folder / "run-1")
    assert before is not None
    assert after is not None
    assert (after.size, after.mtime_ns) == (before.size, before.mtime_ns)
    assert after != before


@pytest.mark.fast
def test_a_removed_run_leaves_the_index_and_a_moved_folder_keeps_it(folder: Path) -> None:
    read(folder)
    shutil.rmtree(folder / "run-0")
    assert len(read(folder)[0]) == RUNS - 1
    moved = folder.rename(folder.parent / "elsewhere")
    records, count = read(moved)
    assert count == 0
    assert {Path(record.run).parent for record in records} == {moved}


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:3000])


def noise(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[4096:20000] = random.Random(2).randbytes(20000 - 4096)
    path.write_bytes(bytes(content))


def no_database(path: Path) -> None:
    path.write_text("not a database" * 500)


def other_table(path: Path) -> None:
    path.unlink()
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE run (a)")
        connection.commit()


def forged(path: Path) -> None:
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("UPDATE run SET text = replace(text, 'cell', 'sell')")
        connection.commit()


def other_version(path: Path) -> None:
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("UPDATE run SET version = '0'")
        connection.commit()


@pytest.mark.fast
@pytest.mark.parametrize("spoil", [cut, noise, no_database, other_table, forged, other_version])
def test_a_damaged_index_changes_no_record(folder: Path, spoil: Callable[[Path], None]) -> None:
    sound, _ = read(folder)
    spoil(folder / INDEX_FILE)
    assert read(folder)[0] == sound
    assert read(folder)[0] == sound


@pytest.mark.fast
@pytest.mark.parametrize("spoil", [cut, no_database, forged, other_version])
def test_a_damaged_index_is_made_again(folder: Path, spoil: Callable[[Path], None]) -> None:
    sound, _ = read(folder)
    spoil(folder / INDEX_FILE)
    read(folder)
    assert read(folder) == (sound, 0)


@pytest.mark.fast
def test_without_an_index_where_none_can_be_written(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root may write anywhere
    records, count = read(folder)
    assert (len(records), count) == (RUNS, RUNS)
    assert not (folder / INDEX_FILE).exists()


def test_an_index_in_use_is_not_waited_for_long(folder: Path) -> None:
    read(folder)
    with contextlib.closing(sqlite3.connect(folder / INDEX_FILE, isolation_level=None)) as other:
        other.execute("PRAGMA locking_mode=EXCLUSIVE")
        other.execute("BEGIN EXCLUSIVE")
        records, count = read(folder)
    assert (len(records), count) == (RUNS, RUNS)


def _read_often(folder: Path, begun: multiprocessing.synchronize.Event, counts: multiprocessing.Queue) -> None:
    begun.set()
    for number in range(6):
        if number % 2:
            (folder / INDEX_FILE).unlink(missing_ok=True)
        counts.put(len(indexed_records(folder).records))


def test_two_processes_at_once(folder: Path) -> None:
    context = multiprocessing.get_context("spawn")
    begun, counts = context.Event(), context.Queue()
    other = context.Process(target=_read_often, args=(folder, begun, counts))
    other.start()
    assert begun.wait(60)
    found: list[int] = []
    while len(found) < 6 or other.is_alive():
        found.append(len(indexed_records(folder).records))
        other.join(0.001)
    assert other.exitcode == 0
    assert [counts.get(timeout=10) for _ in range(6)] == [RUNS] * 6
    assert set(found) == {RUNS}
    sound, _ = read(folder)
    assert read(folder) == (sound, 0)


@pytest.mark.fast
@pytest.mark.parametrize("spoil", [spoil_text, spoil_cut, spoil_middle])
def test_a_run_that_cannot_be_read_is_tried_again_each_time(folder: Path, spoil: Callable[[Path], None]) -> None:
    with planned_run(folder / "broken", 200) as run:
        for _ in range(200):
            run.log("info", "x" * 200)
    spoil(folder / "broken" / "run.sqlite")
    for _ in range(2):
        records, _ = read(folder)
        (broken,) = [record for record in records if record.problem]
        assert str(folder / "broken") in broken.problem
        assert len(records) == RUNS + 1


@pytest.mark.fast
def test_a_single_run_has_no_index(folder: Path) -> None:
    assert read(folder / "run-0")[1] == 1
    assert not (folder / "run-0" / INDEX_FILE).exists()
