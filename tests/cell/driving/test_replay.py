"""A run that plays back: the stream that it was collected with, its pace, requests of a person, runs that lack much."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.recording import UNTIMED_STOP_S, read_recording
from cellapp.cell.driving.replay import TimedEvent, replay_events, replay_run
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.run import RunFile
from cellapp.commands.view.progress_words import detail_words
from cellapp.estimation.readings import Readings
from cellapp.ground.control import Aborted, JobControl, Request, Stopped
from cellapp.ground.errors import InputError
from cellapp.ground.profile.collection import Collection, Reference, Suspend, Suspension
from cellapp.ground.progress import (
    LogReport,
    MotionBegun,
    MotionEnded,
    PointMeasured,
    PointMissed,
    Progress,
    ReferenceReport,
    StateChange,
    StopReport,
)
from tests.cell.driving.test_session import Bench, Person
from tests.cell.run.two_arm_cell import two_arms
from tests.twin import small_twin

STOPS = 8
SCHEMA_2 = Path(__file__).parents[2] / "fixtures" / "run-schema-2"


class Collected:
    """A run that was collected with a pause, a missed SMR and references, and what its listener heard."""

    def __init__(self, folder: Path) -> None:
        profile = small_twin(STOPS, plan={"reserve": 1})
        practice = Collection(
            reference=Reference(every=3, drift=1e-3), suspend=Suspend(target=Suspension(times=0, wait=5.0, retry=1.0))
        )
        self.folder = folder
        with RunFile.create(folder, profile.model_copy(update={"collection": practice})) as run:
            run.write_plan(plan_stops(profile))
            bench = Bench(run)
            bench.control = Person(lambda request: bench.control.resume())
            bench.before_measuring[9] = lambda bench: bench.control.pause()
            bench.before_measuring[11] = lambda bench: bench.tracker.covered.add("left")
            bench.before_measuring[13] = lambda bench: bench.tracker.covered.clear()
            bench.collect()
        self.heard = bench.heard

    def events(self) -> list[TimedEvent]:
        with RunFile.open(self.folder) as run:
            return list(replay_events(run.profile, read_recording(run)))


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Collected:
    """No test may write to it."""
    return Collected(tmp_path_factory.mktemp("replay") / "run")


class FakeTime(JobControl):
    """A control whose waits advance a clock at once; ``acts`` are done at their times [s], with the job waiting."""

    def __init__(self, acts: dict[float, Callable[[FakeTime], None]] | None = None) -> None:
        super().__init__()
        self.now_s = 0.0
        self.acts = acts or {}

    def wait_while(self, *requests: Request, timeout_s: float | None = None) -> Request:
        until_s = np.inf if timeout_s is None else self.now_s + timeout_s
        for at_s in sorted(self.acts):
            if at_s <= until_s and self.request in requests:
                self.now_s = max(self.now_s, at_s)
                self.acts.pop(at_s)(self)
        if self.request in requests:
            assert timeout_s is not None, "the job waits for ever"
            self.now_s = until_s
        return self.request


def played(folder: Path, control: FakeTime, speed: float) -> list[tuple[float, Progress]]:
    """Times and events that a listener got; those before the end if a request ends the replay."""
    heard: list[tuple[float, Progress]] = []
    with RunFile.open(folder) as run:
        replay_run(
            run,
            lambda event: heard.append((control.now_s, event)),
            control,
            speed=speed,
            clock=lambda: control.now_s,
        )
    return heard


def new_run(folder: Path, rows: dict[str, Readings]) -> Path:
    """A run of two small arms without a plan, as an import makes it."""
    with RunFile.create(folder, two_arms()) as run:
        for name, readings in rows.items():
            run.add_readings(name, readings)
    return folder


def rows(stops: list[int], joints: int, **more: Any) -> Readings:
    """Readings at stops, all different."""
    n = len(stops)
    q = 0.1 * np.arange(n * joints).reshape(n, joints)
    given: dict[str, Any] = {
        "configuration": np.array(stops),
        "time_s": np.full(n, np.nan),
        "q": q,
        "approach": np.zeros((n, joints), np.int8),
        "p_M": np.column_stack([np.cos(q[:, 0]), np.sin(q[:, 0]), 0.2 * q[:, -1]]),
    }
    return Readings(**(given | more))


# -- the stream -------------------------------------------------------------------------------------------------------


def test_a_replay_emits_what_the_session_emitted(collected: Collected) -> None:
    def of(events: Iterator[Progress], *left_out: type) -> list[tuple[int, object]]:
        return [(one.done, one.detail) for one in events if one.detail and not isinstance(one.detail, left_out)]

    ways = (MotionBegun, MotionEnded, LogReport)
    live = of(iter(collected.heard), *ways)
    assert of((one.event for one in collected.events()), *ways) == live
    kinds = {type(detail) for _, detail in live}
    assert {PointMeasured, PointMissed, StopReport, ReferenceReport, StateChange} <= kinds
    assert sum(isinstance(detail, PointMeasured) for _, detail in live) == 2 * (STOPS + 1) - 1, "a reserve for the miss"


def test_motions_lead_to_the_same_stops(collected: Collected) -> None:
    def by_stop(events: list[Progress]) -> tuple[dict[int | None, MotionBegun], dict[int | None, MotionEnded]]:
        details = [event.detail for event in events]
        begun = {one.stop: one for one in details if isinstance(one, MotionBegun)}
        return begun, {one.stop: one for one in details if isinstance(one, MotionEnded)}

    begun, ended = by_stop(collected.heard)
    begun_again, ended_again = by_stop([one.event for one in collected.events()])
    assert set(begun) == set(begun_again) == set(ended_again) == {None, *range(STOPS + 1)}
    for stop in range(STOPS + 1):
        one, again = begun[stop], begun_again[stop]
        assert (again.q_start, again.q_target) == (one.q_start, one.q_target)
        assert again.expected_s == pytest.approx(one.expected_s)
        assert ended_again[stop].q == ended[stop].q
        assert ended_again[stop].joint_temperature_c.items() <= ended[stop].joint_temperature_c.items()


def test_lines_are_those_of_the_log(collected: Collected) -> None:
    replayed = [one.event for one in collected.events()]
    live, again = (
        [one.detail for one in events if isinstance(one.detail, LogReport)] for events in (collected.heard, replayed)
    )
    assert live == again
    assert any("not measured" in line.text for line in live)


def test_times_increase_and_the_last_event_is_the_end(collected: Collected) -> None:
    events = collected.events()
    times_s = [one.time_s for one in events]
    assert times_s[0] == 0.0
    assert times_s == sorted(times_s)
    assert all(one.event.eta_s == pytest.approx(times_s[-1] - one.time_s) for one in events)
    last = events[-1].event
    assert (last.done, last.total, last.eta_s) == (STOPS + 1, STOPS + 1, 0.0)
    measured = [one for one in events if isinstance(one.event.detail, PointMeasured)]
    with RunFile.open(collected.folder) as run:
        recorded_s = np.sort(np.concatenate([run.readings(name).time_s for name in run.arms()]))
    np.testing.assert_allclose(np.diff([one.time_s for one in measured]), np.diff(recorded_s), atol=1e-9)


def test_a_log_without_run_times_keeps_its_order(collected: Collected, tmp_path: Path) -> None:
    """Earlier versions stored no time on the run's clock with their lines."""
    folder = tmp_path / "old"
    folder.mkdir()
    (folder / "run.sqlite").write_bytes((collected.folder / "run.sqlite").read_bytes())
    connection = sqlite3.connect(folder / "run.sqlite")
    connection.execute("UPDATE event SET time_s = NULL")
    connection.commit()
    connection.close()
    with RunFile.open(folder) as run:
        events = [one.event for one in replay_events(run.profile, read_recording(run))]
    told = [event.detail for event in events if isinstance(event.detail, LogReport | StateChange | PointMissed)]
    assert told == [
        event.detail for event in collected.heard if isinstance(event.detail, LogReport | StateChange | PointMissed)
    ]
    assert [event.detail for event in events if isinstance(event.detail, StopReport)] == [
        event.detail for event in collected.heard if isinstance(event.detail, StopReport)
    ]


def test_a_stop_at_which_nothing_was_measured_counts(tmp_path: Path) -> None:
    profile = small_twin(4)
    with RunFile.create(tmp_path / "run", profile) as run:
        run.write_plan(plan_stops(profile))
        bench = Bench(run)
        run.profile = profile.model_copy(
            update={"collection": Collection(suspend=Suspend(target=Suspension(times=0, wait=5.0, retry=1.0)))}
        )
        bench.before_measuring[3] = lambda bench: bench.tracker.covered.update({"left", "right"})
        bench.before_measuring[7] = lambda bench: bench.tracker.covered.clear()
        bench.collect()
        recording = read_recording(run)
        events = [one.event for one in replay_events(run.profile, recording)]
    assert (recording.visits, recording.readings) == (4, {"left": 3, "right": 3})
    missed = [(one.done, one.detail.arm) for one in events if isinstance(one.detail, PointMissed)]
    assert missed == [(1, "left"), (1, "right")]
    assert [one.detail.stop for one in events if isinstance(one.detail, MotionBegun)] == [0, 1, 2, 3]


def test_sessions_follow_one_another_and_say_how_they_ended(tmp_path: Path) -> None:
    profile = small_twin(6)
    with RunFile.create(tmp_path / "run", profile) as run:
        run.write_plan(plan_stops(profile))
        bench = Bench(run)
        bench.before_measuring[6] = lambda bench: bench.control.stop()
        with pytest.raises(Stopped):
            bench.collect()
        bench.control = JobControl()
        bench.collect(resume=True)
        recording = read_recording(run)
        events = [one.event for one in replay_events(run.profile, recording)]
    assert recording.visits == 6
    told = [event.detail for event in events if isinstance(event.detail, StateChange | LogReport | PointMeasured)]
    assert [one.stop for one in told if isinstance(one, PointMeasured)] == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    first = [one for one in told if isinstance(one, StateChange | LogReport) or one.stop <= 1]
    assert [type(one) for one in first] == [*[PointMeasured] * 4, StateChange, LogReport]
    assert first[-2] == StateChange("stopped", "a person stopped the arms")
    assert first[-1] == LogReport("info", "collecting stopped: stopped on request")


def test_steps_of_a_stop_leave_the_log_alone(collected: Collected) -> None:
    worded = {type(one.detail) for one in collected.heard if one.detail and detail_words(one.detail)}
    assert worded == {StateChange, StopReport, ReferenceReport, LogReport}


# -- the pace ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [1.0, 25.0, 100.0])
def test_events_come_when_they_are_due(collected: Collected, speed: float) -> None:
    control = FakeTime()
    heard = played(collected.folder, control, speed)
    for (now_s, event), timed in zip(heard, collected.events(), strict=True):
        assert now_s == pytest.approx(timed.time_s / speed)
        assert timed.event.eta_s is not None
        assert event == replace(timed.event, eta_s=timed.event.eta_s / speed)
    assert control.now_s == pytest.approx(collected.events()[-1].time_s / speed)


def test_the_result_says_what_was_played(collected: Collected) -> None:
    control = FakeTime()
    before = (collected.folder / "run.sqlite").read_bytes()
    with RunFile.open(collected.folder) as run:
        result = replay_run(run, control=control, speed=50.0, clock=lambda: control.now_s)
    assert (result.stops, result.readings) == (STOPS + 1, {"left": STOPS, "right": STOPS + 1})
    assert (result.duration_s, result.speed, result.timed) == (collected.events()[-1].time_s, 50.0, True)
    assert (collected.folder / "run.sqlite").read_bytes() == before
    assert [path.name for path in collected.folder.iterdir()] == ["run.sqlite"]


def test_the_time_of_a_pause_does_not_count(collected: Collected) -> None:
    control = FakeTime({20.0: lambda control: control.pause(), 500.0: lambda control: control.resume()})
    heard = played(collected.folder, control, 1.0)
    states = [
        (now_s, event.detail.state)
        for now_s, event in heard
        if isinstance(event.detail, StateChange) and "replay" in event.detail.reason
    ]
    assert states == [(20.0, "paused"), (500.0, "running")]
    assert control.now_s == pytest.approx(collected.events()[-1].time_s + 480.0)


@pytest.mark.parametrize(("verb", "error"), [("stop", Stopped), ("abort", Aborted)])
@pytest.mark.parametrize("holds", [False, True])
def test_a_request_ends_it_between_two_events(
    collected: Collected, verb: Any, error: type[Exception], holds: bool
) -> None:
    control = FakeTime({20.0: lambda control: control.ask(verb)})
    control.holds = holds
    with pytest.raises(error):
        played(collected.folder, control, 2.0)
    assert control.now_s == 20.0, "the wait ends at once"


def test_a_paused_replay_can_be_stopped(collected: Collected) -> None:
    control = FakeTime({20.0: lambda control: control.pause(), 60.0: lambda control: control.stop()})
    with pytest.raises(Stopped):
        played(collected.folder, control, 2.0)
    assert control.now_s == 60.0


# -- runs that lack much ----------------------------------------------------------------------------------------------


def test_a_run_without_times_plays_at_a_fixed_pace_in_its_order(tmp_path: Path) -> None:
    folder = new_run(
        tmp_path / "run",
        {"left": rows([3, 5, 9], 2, sequence=np.array([2.0, 0.0, 1.0])), "right": rows([20, 21], 3)},
    )
    control = FakeTime()
    heard = played(folder, control, 10.0)
    points = [(now_s, event.detail) for now_s, event in heard if isinstance(event.detail, PointMeasured)]
    assert [(point.stop, point.arm) for _, point in points] == [
        (5, "left"), (9, "left"), (3, "left"), (20, "right"), (21, "right"),
    ]  # fmt: skip
    np.testing.assert_allclose(np.diff([now_s for now_s, _ in points]), UNTIMED_STOP_S / 10.0)
    assert all(point.sigma_mm is None and point.temperature_c is None for _, point in points)


def test_arms_that_were_measured_one_after_the_other_are_played_so(tmp_path: Path) -> None:
    """Rows of an imported file may share a stop and not its time."""
    stops = [0, 1, 2, 3, 4]
    times_s = np.arange(5) * 60.0
    left = rows(stops, 2, time_s=1.7e9 + times_s, sigma_m=np.full(5, 2e-5))
    folder = new_run(tmp_path / "run", {"left": left, "right": rows(stops, 3, time_s=1.7e9 + 1e4 + times_s)})
    with RunFile.open(folder) as run:
        recording = read_recording(run)
        events = list(replay_events(run.profile, recording))
    assert recording.visits == 10
    points = [one.event.detail for one in events if isinstance(one.event.detail, PointMeasured)]
    assert [point.arm for point in points] == ["left"] * 5 + ["right"] * 5
    assert points[0].sigma_mm == pytest.approx(1e3 * np.sqrt(3.0) * 2e-5)
    assert events[-1].time_s == pytest.approx(1e4 + 240.0, abs=60.0)


def test_a_run_of_an_older_schema_plays() -> None:
    control = FakeTime()
    heard = played(SCHEMA_2, control, 100.0)
    with RunFile.open(SCHEMA_2) as run:
        readings = sum(len(run.readings(name)) for name in run.arms())
    assert sum(isinstance(event.detail, PointMeasured) for _, event in heard) == readings


def test_a_run_without_readings_and_a_damaged_time_are_named(collected: Collected, tmp_path: Path) -> None:
    with (
        RunFile.create(tmp_path / "run", two_arms()) as run,
        pytest.raises(InputError, match="no readings to play back"),
    ):
        replay_run(run)
    folder = tmp_path / "damaged"
    folder.mkdir()
    (folder / "run.sqlite").write_bytes((collected.folder / "run.sqlite").read_bytes())
    connection = sqlite3.connect(folder / "run.sqlite")
    connection.execute("UPDATE session SET began = 'yesterday'")
    connection.commit()
    connection.close()
    with RunFile.open(folder) as run, pytest.raises(InputError, match=r"'yesterday' is not a time.*restore"):
        replay_run(run)


@pytest.mark.parametrize("speed", [0.0, 0.99, 100.1, -1.0, float("nan"), float("inf")])
def test_other_speeds_are_refused(collected: Collected, speed: float) -> None:
    with RunFile.open(collected.folder) as run, pytest.raises(InputError, match="from 1 to 100 times"):
        replay_run(run, speed=speed)
