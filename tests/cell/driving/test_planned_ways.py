"""A stop is reached as planned: legs, start of the approach, last motion; around where the gate refuses a leg."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell import Cell, one_by_one, open_cell
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.motion import MotionRefused, Mover
from cellapp.cell.driving.reaction import StopReaction
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.planning.planned_stops import STOP_CONDITIONS_RESULT, PlannedStops, write_planned_stops
from cellapp.cell.planning.view import check_plan_run
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, refuse_motion
from cellapp.ground.control import JobControl, Stopped
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Cancelled, MotionBegun, Progress
from drivers.arms.simulated import SimulatedArm
from drivers.clock import RealClock
from tests.cell.planning.planned_cells import drivable_stops
from tests.sure import sure
from tests.twin import small_twin
from tests.verbs import collect_by

STOPS = 5
STEP = np.array([0.04, -0.03, 0.02, -0.02, 0.03, 0.05])
"""Last motion to every stop of the arm left; of the right one the opposite."""
Refuse = Callable[[Mapping[str, np.ndarray], Mapping[str, np.ndarray]], str]


@pytest.fixture(scope="module")
def plan() -> PlannedStops:
    """Visible stops with an approach each, and a way through two more positions to the third one."""
    stops = drivable_stops(STOPS, STEP)
    middle = {name: 0.5 * (q[1] + q[2]) for name, q in stops.q.items()}
    legs: list[tuple[Mapping[str, np.ndarray], ...]] = [()] * STOPS
    legs[2] = (middle, {"right": middle["right"] + 0.02})
    return replace(stops, legs=tuple(legs))


def goals_sent(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, np.ndarray]]:
    """Goals that are sent to the simulated arms from now on, each with its arm."""
    goals: list[tuple[str, np.ndarray]] = []

    class Arm(SimulatedArm):
        def start_move(self, q: Any, *rest: Any) -> None:
            goals.append((self.name, np.array(q)))
            super().start_move(q, *rest)

    monkeypatch.setattr("drivers.arms.simulated.SimulatedArm", Arm)
    return goals


class Driven:
    """Collects a run and keeps the goals of all motions; ``refuse`` adds what the gate refuses."""

    def __init__(self, run: RunFile, monkeypatch: pytest.MonkeyPatch) -> None:
        self.run = run
        self.goals = goals_sent(monkeypatch)
        self.motions: list[MotionBegun] = []
        self.refuse: Refuse = lambda start, end: ""
        self.control = JobControl()

    @contextmanager
    def opened(self, profile: Profile, **options: Any) -> Iterator[Cell]:
        def gate(bodies: CellBodies, start: Mapping[str, np.ndarray], end: Mapping[str, np.ndarray]) -> str:
            return self.refuse(start, end) or refuse_motion(bodies, start, end)

        with open_cell(profile, **options) as cell:
            yield replace(cell, gate=gate)

    def hear(self, event: Progress) -> None:
        if isinstance(event.detail, MotionBegun):
            self.motions.append(event.detail)

    def collect(self, **options: Any) -> tuple[str, ...]:
        with self.control.heard_by(lambda event, _: self.hear(event)):
            return collect_by(self.opened, self.run, self.control, **options).notes

    def places(self, name: str, *qs: np.ndarray) -> list[int]:
        """Where goals of an arm stand among all of its goals; -1 for one to which it never went."""
        goals = [goal for arm, goal in self.goals if arm == name]
        return [next((k for k, goal in enumerate(goals) if np.allclose(goal, q)), -1) for q in qs]


@pytest.fixture
def driven(plan: PlannedStops, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Driven]:
    with RunFile.create(tmp_path / "run", small_twin(STOPS)) as run:
        write_planned_stops(run, plan)
        yield Driven(run, monkeypatch)


def arrived_by_the_planned_step(run: RunFile, stops: int = STOPS) -> None:
    for name, sign in (("left", 1.0), ("right", -1.0)):
        readings = run.readings(name)
        assert len(readings) == stops
        np.testing.assert_allclose(sure(readings.step), np.tile(sign * STEP, (stops, 1)), atol=1e-9)
        np.testing.assert_array_equal(readings.approach, np.tile(np.sign(sign * STEP), (stops, 1)))


def test_stops_are_reached_along_their_legs_and_by_the_planned_last_motion(driven: Driven, plan: PlannedStops) -> None:
    assert check_plan_run(driven.run).refused == ()
    driven.collect()
    arrived_by_the_planned_step(driven.run)
    for name in plan.q:
        way = [leg[name] for leg in plan.legs[2] if name in leg]
        places = driven.places(name, plan.q[name][1], *way, plan.approach_from[name][2], plan.q[name][2])
        assert places == sorted(places)
        assert len(set(places)) == len(places)
        assert -1 not in places


def test_a_refused_leg_is_never_driven_and_the_stop_is_reached_straight(driven: Driven, plan: PlannedStops) -> None:
    into_the_floor = np.array([0.0, 0.9, 0.0, 0.0, 0.0, 0.0])
    legs = list(plan.legs)
    legs[1], legs[3] = ({"left": into_the_floor},), ({"left": np.full(6, 50.0)},)
    write_planned_stops(driven.run, replace(plan, legs=tuple(legs)))
    check = check_plan_run(driven.run)
    assert [(one.configuration, one.detour) for one in check.refused] == [(1, "straight"), (3, "straight")]
    assert "motion 1 of 3: arm left: collides with the floor" in check.refused[0].reason
    assert check.is_safe
    assert driven.collect() == ()
    arrived_by_the_planned_step(driven.run)
    assert driven.places("left", into_the_floor, np.full(6, 50.0)) == [-1, -1]


def test_a_last_motion_that_is_refused_defers_the_stop_then_leaves_it_out(driven: Driven, plan: PlannedStops) -> None:
    driven.refuse = lambda start, end: "a column" if np.allclose(end["left"], plan.q["left"][1]) else ""
    (note,) = driven.collect()
    assert note.startswith("stop 2: left out: refused to move: a column")
    arrived_by_the_planned_step(driven.run, STOPS - 1)
    assert driven.places("left", plan.q["left"][1], plan.approach_from["left"][1]) == [-1, -1]


@pytest.mark.parametrize("moment", range(4, 10))
def test_the_side_holds_after_a_stop_on_the_way_and_a_resume(driven: Driven, plan: PlannedStops, moment: int) -> None:
    began = 0

    def stop_in_the_midst(event: Progress) -> None:
        nonlocal began
        began += isinstance(event.detail, MotionBegun)
        if isinstance(event.detail, MotionBegun) and began == moment:
            driven.control.stop()

    driven.control = JobControl(stop_in_the_midst)
    with pytest.raises(Stopped):
        collect_by(driven.opened, driven.run, driven.control)
    driven.control = JobControl()
    driven.collect(resume=True)
    arrived_by_the_planned_step(driven.run)


def test_controllers_are_asked_about_legs_and_starts_of_last_motions(
    driven: Driven, plan: PlannedStops, monkeypatch: pytest.MonkeyPatch
) -> None:
    forbidden = (plan.legs[2][1]["right"], plan.approach_from["right"][4])

    def refused(self: SimulatedArm, q: np.ndarray) -> np.ndarray:
        return np.array([any(np.allclose(row, one) for one in forbidden) for row in q])

    monkeypatch.setattr(SimulatedArm, "refused_by_controller", refused)
    notes = driven.collect()
    assert [note[:19] for note in notes] == ["stop 3: left out: a", "stop 5: left out: a"]
    assert driven.places("right", *forbidden) == [-1, -1]
    arrived_by_the_planned_step(driven.run, STOPS - 2)


def test_a_person_confirms_the_first_leg_and_nothing_moves_without(driven: Driven, plan: PlannedStops) -> None:
    first = {name: 0.5 * (home + plan.q[name][0]) for name, home in home_positions(driven.run.profile).items()}
    write_planned_stops(driven.run, replace(plan, legs=((first,), *plan.legs[1:])))
    asked: list[Mapping[str, np.ndarray]] = []

    def refuse(start: Mapping[str, np.ndarray], goal: Mapping[str, np.ndarray]) -> bool:
        asked.append(goal)
        return False

    with pytest.raises(InputError, match="nothing was moved"):
        driven.collect(confirm=refuse)
    assert driven.goals == []
    for name in first:
        np.testing.assert_array_equal(asked[0][name], first[name])
    driven.collect(confirm=lambda start, goal: True)
    for name in first:
        assert driven.places(name, first[name]) == [0]


# -- Conditions of single stops ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plan_of_conditions() -> dict[str, np.ndarray]:
    return plan_stops(small_twin(3))


def test_nothing_moves_that_the_gate_refuses(
    plan_of_conditions: dict[str, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    goals = goals_sent(monkeypatch)

    def went(name: str, q: np.ndarray) -> bool:
        return any(arm == name and np.allclose(goal, q) for arm, goal in goals)

    few = {name: q[:3] for name, q in plan_of_conditions.items()}
    into_the_floor = np.array([0.0, 0.9, 0.0, 0.0, 0.0, 0.0])
    beyond = few["right"][2] + 20.0
    with RunFile.create(tmp_path / "run", small_twin(3)) as run:
        run.write_plan(few)
        conditions = {1: {"left": {"via": into_the_floor.tolist()}}, 2: {"right": {"via": beyond.tolist()}}}
        run.write_document(STOP_CONDITIONS_RESULT, json.dumps(conditions))
        notes = collect_run(run).notes
        assert run.stops_done() == {0}
        assert [note[:34] for note in notes[:2]] == [
            "stop 2: left out: refused to move:",
            "stop 3: left out: refused to move:",
        ]
        assert "floor" in notes[0]
        assert "limits" in notes[1]
        assert [event.text for event in run.events() if event.level == "warning"] == list(notes[:2])
    assert not went("left", into_the_floor)
    assert not went("right", beyond)
    for name in few:
        assert not went(name, few[name][1])
        assert not went(name, few[name][2])


def test_the_rest_of_a_real_arm_ends_on_cancellation() -> None:
    profile = small_twin(2)
    with open_cell(profile) as cell:
        real = replace(cell, clock=RealClock())
        reaction = StopReaction(cell.arms, cell.tracker, one_by_one)
        control = JobControl()
        mover = Mover(profile, real, cell_bodies(profile), reaction, control)
        mover.rest("left", 0.0)
        control.cancel()
        with pytest.raises(Cancelled):
            mover.rest("left", 600.0)


def test_once_an_arm_has_moved_no_other_way_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, other = ({"left": np.full(6, value)} for value in (0.1, 0.2, 0.3))
    tried: list[Mapping[str, np.ndarray]] = []

    def move(mover: Mover, targets: Mapping[str, np.ndarray]) -> dict[str, bool]:
        tried.append(targets)
        if targets is second:
            raise MotionRefused("somebody stands there now")
        return {"left": True}

    monkeypatch.setattr(Mover, "move", move)
    monkeypatch.setattr(Mover, "refusal", lambda mover, *legs: "")
    with pytest.raises(MotionRefused, match="stands there"):
        Mover.__new__(Mover).along([[first, second], [other]])
    assert tried == [first, second]
