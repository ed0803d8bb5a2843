"""Stops that are measured again: what replaces what, what is kept, and what a file of an older schema lacks."""

from __future__ import annotations

import contextlib
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.run import Outcome, RunFile
from cellapp.cell.run.measured_again import earlier_readings, replace_stop, replaced_counts
from cellapp.estimation.readings import Reading
from tests.cell.run.small_runs import add_stop, planned_run

pytestmark = pytest.mark.fast


def seen(joints: int, x_m: float) -> Reading:
    return Reading(q=np.zeros(joints), p_M=np.array([x_m, 0.0, 0.0]), time_s=9.0, split="train")


@pytest.fixture
def run(tmp_path: Path) -> RunFile:
    run = planned_run(tmp_path / "run")
    for stop in (0, 1):
        add_stop(run, stop)
    return run


def test_the_newest_reading_counts_and_those_before_are_kept_as_they_were(run: RunFile) -> None:
    before = run.readings("left")
    for x_m in (2.0, 3.0):
        replace_stop(run, 1, {"left": seen(2, x_m), "right": seen(3, x_m)})
    left, earlier = run.readings("left"), earlier_readings(run, "left")
    np.testing.assert_array_equal(left.p_M[:, 0], [1.0, 3.0])
    assert earlier.readings.configuration.tolist() == [1, 1]
    np.testing.assert_array_equal(earlier.readings.p_M[:, 0], [1.0, 2.0])
    np.testing.assert_array_equal(earlier.readings.q[0], before.q[1])
    assert list(earlier.replaced) == sorted(earlier.replaced)
    assert replaced_counts(run) == {"left": 2, "right": 2}
    assert run.stops_done() == {0, 1}


def test_a_stop_stays_in_its_split(run: RunFile) -> None:
    run.assign_splits("left", ["identify", "validate"])
    replace_stop(run, 1, {"left": seen(2, 2.0), "right": seen(3, 2.0)})
    assert run.readings("left").split == ("identify", "validate")
    assert run.readings("right").split is None, "its splits are not drawn yet"


def test_an_arm_without_a_new_reading_keeps_what_it_has_and_one_that_had_none_gets_it(run: RunFile) -> None:
    run.add_stop(2, {"left": seen(2, 1.0)}, [Outcome(2, "right", "not measured", "hidden")])
    replace_stop(run, 2, {"right": seen(3, 2.0)}, [Outcome(2, "left", "not measured", "hidden")])
    assert run.readings("left").p_M[2, 0] == 1.0
    assert run.readings("right").p_M[2, 0] == 2.0
    assert run.outcomes() == []
    assert replaced_counts(run) == {}
    replace_stop(run, 3, {}, [Outcome(3, "left", "not measured", "still hidden")])
    assert [(one.stop, one.reason) for one in run.outcomes()] == [(3, "still hidden")]


def test_what_cannot_be_stored_leaves_the_stop_as_it_was(run: RunFile) -> None:
    with pytest.raises(ValueError, match="not finite"):
        replace_stop(run, 1, {"left": replace(seen(2, 2.0), p_M=np.full(3, np.nan))})
    assert run.readings("left").p_M[1, 0] == 1.0
    assert replaced_counts(run) == {}


def test_a_file_of_the_eighth_schema_has_none_and_takes_some(run: RunFile) -> None:
    session = run.begin_session()
    run.end_session(session, "complete", "")
    run.close()
    with contextlib.closing(sqlite3.connect(run.path)) as connection:
        connection.execute("DROP TABLE earlier_reading")
        connection.execute("ALTER TABLE session DROP COLUMN again")
        connection.execute("ALTER TABLE reading DROP COLUMN turning_covariance_rad2")
        connection.execute("PRAGMA user_version=8")
        connection.commit()
    with RunFile.open(run.folder) as older:
        assert len(earlier_readings(older, "left").readings) == 0
        assert replaced_counts(older) == {}
        assert [one.again for one in older.sessions()] == [""]
    with RunFile.open(run.folder, write=True) as older:
        older.begin_session("2")
        replace_stop(older, 1, {"left": seen(2, 2.0)})
        assert replaced_counts(older) == {"left": 1}
        assert [one.again for one in older.sessions()] == ["", "2"]
