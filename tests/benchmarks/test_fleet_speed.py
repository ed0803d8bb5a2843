"""Speed of ``fleet`` over 200 runs: with an index only changed runs are read.

    pytest tests/benchmarks/test_fleet_speed.py -s

Nothing absolute is asserted; the test prints the times. ``make_fleet`` copies one run and shifts its times.
"""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import time
from datetime import datetime, timedelta
from pathlib import Path

from cellapp.commands.fleet.run import fleet
from cellapp.interfaces.page.fleet_page import write_fleet_page
from tests.estimation.monitoring.fleet.runs import Truth, measured_run

RUNS = 200
BETWEEN = timedelta(days=7)


def make_fleet(source: Path, folder: Path, runs: int = RUNS) -> Path:
    """Copies of a run, a week after each other."""
    for number in range(runs):
        copy = folder / f"run-{number:03}"
        copy.mkdir(parents=True)
        shutil.copyfile(source / "run.sqlite", copy / "run.sqlite")
        with contextlib.closing(sqlite3.connect(copy / "run.sqlite")) as connection:
            later = number * BETWEEN
            for table, column, where in (
                ("meta", "value", "key = 'created'"),
                ("session", "began", "1"),
                ("stage", "written", "1"),
            ):
                rows = connection.execute(f"SELECT rowid, {column} FROM {table} WHERE {where}").fetchall()
                for row, text in rows:
                    shifted = (datetime.fromisoformat(text) + later).isoformat(timespec="milliseconds")
                    connection.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (shifted, row))
            connection.commit()
    return folder


def test_a_fleet_of_200_runs(tmp_path: Path) -> None:
    source = measured_run(tmp_path / "source", 1, Truth(half_play=1e-4), search=True)
    folder = make_fleet(source, tmp_path / "fleet")
    seconds = {}
    for state in ("cold", "warm"):
        began = time.perf_counter()
        result = fleet([folder])
        seconds[state] = time.perf_counter() - began
        assert len(result.runs) == RUNS
        assert all(arm.condition == "unchanged" for arm in result.arms.values())
    began = time.perf_counter()
    write_fleet_page(result, tmp_path / "fleet.html")
    seconds["page"] = time.perf_counter() - began
    print(f"\nfleet of {RUNS} runs [s]: {seconds}")  # noqa: T201
    assert seconds["warm"] < seconds["cold"]
