"""The record of a job: what events leave behind, without any screen."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.ground.progress import (
    AirReport,
    Detail,
    LogReport,
    MeasurementBegun,
    MotionBegun,
    MotionEnded,
    PointMeasured,
    PointMissed,
    Progress,
    ReferenceReport,
    StateChange,
    StopReport,
    Suspicion,
    SweepLive,
)
from cellapp.interfaces.tui.job_record import MOST_LINES, ArmRecord, JobRecord, level_of

pytestmark = pytest.mark.fast

Q0, Q1 = (0.0, 0.1), (1.0, 1.1)
WARM = (30.0, 31.0)


def record_of(*details: Detail | None, name: str = "collect") -> JobRecord:
    record = JobRecord()
    record.begin(name)
    for detail in details:
        record.add(Progress("collect", 3, 9, detail=detail))
    return record


def test_an_arm_is_followed_from_motion_to_its_point() -> None:
    record = record_of(MotionBegun(4, {"left": Q0}, {"left": Q1}, 2.5))
    assert record.arms == {"left": ArmRecord("moving", 4, q=Q0, expected_s=2.5)}
    record.add(Progress("collect", 3, 9, detail=MotionEnded(4, {"left": Q1}, {"left": WARM})))
    assert record.arms["left"] == ArmRecord("settling", 4, q=Q1, joint_temperature_c=WARM)
    record.add(Progress("collect", 3, 9, detail=MeasurementBegun(4, "left")))
    assert record.arms["left"].activity == "measuring"
    assert (record.tracker.arm, record.tracker.measuring) == ("left", True)
    point = PointMeasured(4, "left", Q1, (1.0, 2.0, 3.0), 0.01, 21.5)
    record.add(Progress("collect", 3, 9, detail=point))
    assert record.arms["left"] == ArmRecord("measured", 4, q=Q1, joint_temperature_c=WARM)
    assert record.tracker.point is point
    assert not record.tracker.measuring
    report = StopReport(4, "left", 0.05, 0.01)
    record.add(Progress("collect", 4, 9, detail=report))
    assert record.arms["left"].report is report
    assert record.stops == {"left": [report]}


def test_a_missed_point_keeps_its_reason_until_the_next_motion() -> None:
    record = record_of(MeasurementBegun(4, "left"), PointMissed(4, "left", "the beam was broken"))
    assert record.arms["left"] == ArmRecord("not measured", 4, "the beam was broken")
    record.add(Progress("collect", 3, 9, detail=MotionBegun(5, {"left": Q0}, {"left": Q1}, 2.5)))
    assert record.arms["left"].reason == ""


def test_a_sweep_that_was_given_up_is_followed_no_more_when_the_next_stop_is_measured() -> None:
    searched = SweepLive(3, "left", "sweep-4", 16.0, "searching", 4.0)
    record = record_of(searched)
    followed = record.tracker.sweep
    assert followed is searched
    record.add(Progress("collect", 4, 9, detail=MeasurementBegun(4, "right")))
    assert (record.tracker.sweep, record.tracker.arm) == (None, "right")
    assert record.sweep is searched


def test_the_air_is_that_of_the_weather_station_until_a_point_says_otherwise() -> None:
    air = AirReport(21.5, 1013.0, 44.0)
    record = record_of(air, PointMeasured(0, "left", Q1, (1.0, 2.0, 3.0), None, 21.5))
    assert record.tracker.air == air
    record = record_of(air, PointMeasured(0, "left", Q1, (1.0, 2.0, 3.0), None, 22.0))
    assert record.tracker.air == AirReport(22.0)
    record = record_of(air, PointMeasured(0, "left", Q1, (1.0, 2.0, 3.0)))
    assert record.tracker.air == air


@pytest.mark.parametrize(("state", "activity"), [("stopped", "stopped"), ("aborted", "stopped"), ("paused", "moving")])
def test_a_stop_of_the_job_is_one_of_its_arms(state: str, activity: str) -> None:
    record = record_of(MotionBegun(4, {"left": Q0}, {"left": Q1}, 2.5), StateChange(state, "why"))  # type: ignore[arg-type]
    assert (record.state, record.reason) == (state, "why")
    assert record.arms["left"].activity == activity
    record.end()
    assert record.state is None
    assert record.arms["left"].activity == "resting"


def test_the_note_of_a_step_stands_until_the_next_one() -> None:
    record = JobRecord()
    record.begin("collect")
    record.add(Progress("collect", 3, 9, "stop 4"))
    record.add(Progress("collect", 3, 9, detail=AirReport(21.0)))
    assert record.progress["collect"].note == "stop 4"
    record.add(Progress("collect", 4, 9, "stop 5"))
    assert record.progress["collect"].note == "stop 5"
    record.add(Progress("collect", 4, 9))
    assert record.progress["collect"].note == ""


def test_a_new_job_forgets_all_but_the_log() -> None:
    record = record_of(Suspicion("drift", "look", "left"), ReferenceReport({"arm left": 0.1}, 0.2), AirReport(20.0))
    lines = list(record.log)
    record.begin("push")
    assert record == JobRecord(
        "push", "running", log=record.log, log_written=2, changes=record.changes, since=record.since
    )
    assert list(record.log) == lines


def test_lines_have_the_level_of_what_happened_and_steps_of_a_stop_have_none() -> None:
    quiet = (
        MotionBegun(4, {"left": Q0}, {"left": Q1}, 2.5),
        MotionEnded(4, {"left": Q1}, {}),
        MeasurementBegun(4, "left"),
        PointMeasured(4, "left", Q1, (1.0, 2.0, 3.0)),
        PointMissed(4, "left", "broken"),
        AirReport(20.0),
    )
    assert not record_of(*quiet).log
    loud = (
        (None, "debug"),
        (StopReport(4, "left", 0.05, 0.01), "debug"),
        (LogReport("note", "planned"), "info"),
        (LogReport("warning", "late"), "warning"),
        (LogReport("error", "gone"), "error"),
        (StateChange("running", "resumed"), "info"),
        (StateChange("suspended", "beam"), "warning"),
        (Suspicion("drift", "look"), "warning"),
        (ReferenceReport({"arm left": 0.1}, 0.2), "info"),
        (ReferenceReport({"arm left": 0.3}, 0.2), "warning"),
    )
    record = record_of(*(detail for detail, _ in loud))
    assert [row.level for row in record.log] == [level for _, level in loud]
    assert level_of("unheard of") == "info"


@given(steps=st.lists(st.integers(0, 40), max_size=20))
def test_newest_lines_are_each_heard_once(steps: list[int]) -> None:
    record, heard, written = JobRecord(), [], 0
    for count in steps:
        for _ in range(count):
            record.note(f"line {record.log_written}")
        heard += record.newest_lines(written)
        written = record.log_written
    assert [row.text for row in heard] == [f"line {number}" for number in range(sum(steps))]


def test_lines_that_are_kept_no_more_are_not_heard() -> None:
    record = JobRecord()
    for number in range(MOST_LINES + 10):
        record.note(f"line {number}")
    newest = record.newest_lines(0)
    assert len(newest) == MOST_LINES
    assert newest[0].text == "line 10"
