"""What waits today: open runs, ages of calibration and check of each arm, what is due; from the list of runs alone."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from cellapp.commands.next_step import ArmState
from cellapp.commands.runs.request import RunsRequest
from cellapp.commands.runs.result import ArmFigures, RunsResult, RunSummary, StageSummary
from cellapp.commands.runs.today import today_sentences, today_tables
from cellapp.commands.runs.view import view
from cellapp.commands.view.table import Table
from cellapp.estimation.discovery.records import BeforeAfter

NOW = datetime(2026, 3, 31, 12, tzinfo=UTC)
ARMS = {"left": ArmState(type="UR10", planned=40, measured=40, splits={})}


def run(name: str, error: float, checked: str = "", **more: object) -> RunSummary:
    stages = [StageSummary(name="calibrate", written="2026-03-01T12:00:00+00:00")]
    stages += [StageSummary(name="check", written=checked)] if checked else []
    figures = {"left": ArmFigures(heldout_mm=BeforeAfter(before=1.0, after=error))}
    known = {"run": f"logs/{name}", "profile": "cell", "arms": ARMS, "figures": figures, "stages": tuple(stages)}
    return RunSummary.model_validate({**known, "stops_planned": 40, "stops_measured": 40, **more})


NEW = run("new", 0.06, next_verb="discover", tracker_due="2026-03-30")
OLD = run("old", 0.05, checked="2026-03-21T12:00:00+00:00")
PART = run("part", 0.05, stages=(), figures={}, interrupted=True, stops_measured=10, next_verb="collect")
RUNS = RunsResult(folder="logs", runs=(NEW, PART, OLD))


def test_open_runs_say_what_they_wait_for_and_done_ones_are_left_out() -> None:
    opened, _ = today_tables(RUNS, NOW)
    assert [(row[0], row[4]) for row in opened.rows] == [("new", "discover"), ("part", "the rest of its stops")]


def test_each_arm_has_its_ages_its_error_and_how_that_changed() -> None:
    _, arms = today_tables(RUNS, NOW)
    (row,) = arms.rows
    assert row[:4] == ("cell", "left", 30, 10)
    assert row[4] == pytest.approx(0.06)
    assert row[5] == pytest.approx(0.01)
    assert row[6] == "2026-03-30"


def test_what_is_overdue_or_cannot_be_read_is_a_sentence() -> None:
    broken = RunSummary(run="logs/bad", problem="logs/bad/run.sqlite is no run")
    found = today_sentences(RunsResult(folder="logs", runs=(NEW, broken)), NOW)
    assert found == [
        "the tracker of cell was due for calibration on 2026-03-30",
        "logs/bad/run.sqlite is no run",
    ]
    assert today_sentences(RunsResult(folder="logs", runs=(OLD,)), NOW) == []
    assert "No run" in today_sentences(RunsResult(folder="logs", runs=()), NOW)[0]


def test_an_outdated_calibration_has_no_age_and_no_stage_is_no_age() -> None:
    stages = (StageSummary(name="calibrate", written="2026-03-01T12:00:00+00:00", out_of_date="readings were added"),)
    _, arms = today_tables(RunsResult(folder="logs", runs=(run("a", 0.1, stages=stages, next_verb="calibrate"),)), NOW)
    assert arms.rows[0][2:4] == (None, None)


def test_the_command_has_it_by_an_option() -> None:
    shown = view(RUNS, RunsRequest(today=True))
    assert [part.title for part in shown.parts if isinstance(part, Table)][:1] == ["Open runs, newest first"]
