"""Driving a check: which stops may be measured, how arms go there, when it ends, what is given up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell import Cell, open_cell
from cellapp.cell.driving.check import CheckTask, DrivenCheck, check_candidates, drive_check
from cellapp.cell.driving.measuring import APART_M
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import refuse_motion, refuse_stop
from cellapp.commands.locate.station import excess_of_readings
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.estimation.monitoring.check import SequentialState
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Progress
from cellapp.robot.kinematics.transforms import Array
from drivers.trackers.simulated import SimulatedTracker


@dataclass
class Fed:
    """A test that remembers what it is fed, and is sure after so many stops."""

    sure_after: int = 100
    stops: list[Mapping[str, Readings]] = field(default_factory=list)

    def add(self, readings: Mapping[str, Readings]) -> SequentialState:
        self.stops.append(readings)
        count = len(self.stops)
        sure = count >= self.sure_after
        return SequentialState(
            stops=count, sure=sure, changed=False, valid=sure, log_evidence=0.0, log_valid=0.0, p_value=1.0
        )


@pytest.fixture(scope="module")
def task(finished_run: Path) -> CheckTask:
    """Six stops of the finished run, 20 deg apart at least."""
    with RunFile.open(finished_run) as run:
        model = model_of(run, stage_in_force(run, read_stages(run)))
        candidates = check_candidates(run.profile, model, {name: run.readings(name) for name in run.profile.arms})
        stops = [{name: q[row] for name, q in candidates.items()} for row in range(0, 60, 10)]
        return CheckTask(run.profile, model, stops, excess_of_readings(run, model))


def driven(task: CheckTask, test: Fed, **options: Any) -> DrivenCheck:
    return drive_check(task, test, **options)


@contextmanager
def refusing(profile: Profile, *, together: bool, alone: Sequence[str] = ()) -> Iterator[Cell]:
    """A cell whose gate refuses that both arms leave home together, and some arms to leave it at all."""
    homes = home_positions(profile)

    def away(q: Mapping[str, Array]) -> set[str]:
        return {name for name in q if np.abs(q[name] - homes[name]).max() > 1e-3}

    with open_cell(profile) as cell:

        def gate(bodies: Any, start: Mapping[str, Array], end: Mapping[str, Array]) -> str:
            if (together and len(away(end)) > 1) or away(end) & set(alone):
                return "too near"
            return refuse_motion(bodies, start, end)

        yield replace(cell, gate=gate)


def test_it_ends_when_the_test_is_sure(task: CheckTask) -> None:
    events: list[Progress] = []
    test = Fed(sure_after=3)
    found = driven(task, test, listener=events.append)
    assert len(found.stops) == len(test.stops) == 3
    assert (found.lost, found.notes) == ([], [])
    assert [event.done for event in events if event.job == "check"] == [0, 1, 2, 6]
    times = [stop.time_s for stop in found.stops]
    assert times == sorted(times)
    assert times[-1] < found.seconds


def test_the_test_is_told_what_collecting_would_store(task: CheckTask) -> None:
    test = Fed(sure_after=2)
    driven(task, test)
    for number, stop in enumerate(test.stops):
        assert list(stop) == ["left", "right"]
        for name, readings in stop.items():
            assert readings.configuration.tolist() == [number]
            np.testing.assert_allclose(readings.q[0], task.stops[number][name], atol=1e-6)
            assert readings.step is not None
            assert readings.covariance_M is not None
            moved = np.abs(readings.step[0]) > 1e-6
            np.testing.assert_array_equal(np.sign(readings.step[0])[moved], readings.approach[0][moved])
    for stop in test.stops:
        left_s, right_s = stop["left"].dwell_s, stop["right"].dwell_s
        assert left_s is not None
        assert right_s is not None
        assert left_s[0] > 0.0
        assert right_s[0] > task.profile.tracker.averaging, "both arms rest before the first one is measured"


def test_the_last_motion_is_short_where_the_model_depends_on_it(task: CheckTask) -> None:
    """The right arm has play, the left one only bends."""
    test = Fed(sure_after=2)
    driven(task, test)
    steps = {name: test.stops[1][name].step for name in ("left", "right")}
    assert steps["right"] is not None
    assert steps["left"] is not None
    assert np.degrees(np.abs(steps["right"]).max()) < 1.5
    assert np.degrees(np.abs(steps["left"]).max()) > 5.0


def test_where_the_gate_refuses_both_each_arm_goes_alone(task: CheckTask) -> None:
    test = Fed(sure_after=4)
    found = driven(task, test, open_with=lambda profile: refusing(profile, together=True))
    assert [list(stop) for stop in test.stops] == [["left"], ["right"]] * 2
    assert [stop.number for stop in found.stops] == [0, 0, 1, 1]
    numbers = [next(iter(stop.values())).configuration[0] for stop in test.stops]
    assert numbers == [0, 1, 2, 3], "they did not stand there together"
    homes = home_positions(task.profile)
    beside = found.stops[0].found["left"].others["right"]
    np.testing.assert_allclose(beside, homes["right"], atol=1e-6)


def test_an_arm_that_cannot_go_anywhere_is_noted(task: CheckTask) -> None:
    test = Fed()
    found = driven(task, test, open_with=lambda profile: refusing(profile, together=True, alone=["left"]))
    assert [list(stop) for stop in test.stops] == [["right"]] * len(task.stops)
    assert found.notes[0].startswith("stop 1, arm left: refused to move: too near")
    with pytest.raises(HardwareError, match="no SMR could be measured at any stop"):
        driven(task, Fed(), open_with=lambda profile: refusing(profile, together=True, alone=["left", "right"]))


def test_a_lost_smr_is_given_up_after_some_stops_and_the_other_arm_goes_on(task: CheckTask) -> None:
    opened: list[Cell] = []

    def cover(event: Progress) -> None:
        tracker = opened[0].tracker
        assert isinstance(tracker, SimulatedTracker)
        if event.done == 2:
            tracker.covered |= {"right"}

    test = Fed()
    found = driven(task, test, listener=cover, opened=opened.append)
    assert found.lost == ["right"]
    assert [list(stop) for stop in test.stops] == [["left", "right"]] * 2 + [["left"]] * 4
    assert sum("no SMR within" in note for note in found.notes) == 3
    # arms at home from then on
    assert found.stops[-1].found["left"].others["right"] == pytest.approx(home_positions(task.profile)["right"])


def test_candidates_are_free_seen_and_apart(task: CheckTask, finished_run: Path) -> None:
    with RunFile.open(finished_run) as run:
        readings = {name: run.readings(name) for name in run.profile.arms}
    found = check_candidates(task.profile, task.model, readings)
    count = {len(q) for q in found.values()}
    assert count == {len(found["left"])}
    assert 0 < len(found["left"]) <= len(readings["left"])
    bodies = cell_bodies(task.profile, task.model)
    assert all(not refuse_stop(bodies, {name: q[row] for name, q in found.items()}) for row in range(0, 50, 10))
    p_M = [task.model.predict(name, q) for name, q in found.items()]
    assert np.linalg.norm(p_M[0] - p_M[1], axis=1).min() >= APART_M


def test_readings_without_common_stops_are_paired(task: CheckTask, finished_run: Path) -> None:
    with RunFile.open(finished_run) as run:
        readings = {name: run.readings(name) for name in run.profile.arms}
    apart = {**readings, "right": replace(readings["right"], configuration=readings["right"].configuration + 1000)}
    found = check_candidates(task.profile, task.model, apart)
    assert 0 < len(found["left"]) == len(found["right"])
    again = check_candidates(task.profile, task.model, apart)
    np.testing.assert_array_equal(found["left"], again["left"])


def test_a_cell_without_a_free_stop_is_refused(task: CheckTask, finished_run: Path) -> None:
    with RunFile.open(finished_run) as run:
        readings = {name: run.readings(name) for name in run.profile.arms}
    lying = {name: replace(arm, q=np.zeros_like(arm.q)) for name, arm in readings.items()}
    with pytest.raises(InputError, match="nothing was moved"):
        check_candidates(task.profile, task.model, lying)
