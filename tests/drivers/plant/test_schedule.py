"""Scheduled actions happen at their time, in the middle of what a device does."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from drivers.arms.protocol import ArmError, MotionStopped, ProtectiveStop
from drivers.arms.simulated import SimulatedArm
from drivers.plant import Plant
from drivers.trackers.protocol import TargetLost, TrackerLinkLost
from drivers.trackers.simulated import SimulatedTracker
from tests.twin import PROFILES, small_twin

SLOW = np.full(6, 0.5)


@pytest.fixture
def plant() -> Plant:
    return build_plant(small_twin())


def moving_arm(plant: Plant) -> SimulatedArm:
    """The left arm, connected, in the middle of a motion of some seconds."""
    arm = SimulatedArm(plant, "left")
    arm.connect()
    arm.start_move(plant.q("left") + 0.5, SLOW, SLOW)
    return arm


def test_actions_happen_at_their_times_and_in_their_order(plant: Plant) -> None:
    seen: list[tuple[str, float]] = []
    for name, time_s in (("late", 2.0), ("early", 0.5), ("also late", 2.0), ("never", 9.0)):
        plant.schedule.at(time_s, lambda name=name: seen.append((name, plant.clock_s)))  # type: ignore[misc]
    plant.advance(1.0)
    assert seen == [("early", 0.5)]
    plant.advance(2.0)
    assert seen == [("early", 0.5), ("late", 2.0), ("also late", 2.0)]
    assert plant.clock_s == 3.0


def test_an_action_may_enter_another_one(plant: Plant) -> None:
    seen: list[float] = []
    plant.schedule.at(1.0, lambda: plant.schedule.at(1.5, lambda: seen.append(plant.clock_s)))
    plant.advance(2.0)
    assert seen == [1.5]


def test_an_error_of_an_action_passes_through_at_its_time(plant: Plant) -> None:
    def fail() -> None:
        raise ArmError("now")

    plant.schedule.at(1.0, fail)
    with pytest.raises(ArmError):
        plant.advance(2.0)
    assert plant.clock_s == 1.0


def test_a_fault_in_the_middle_of_a_motion_ends_the_wait(plant: Plant) -> None:
    arm = moving_arm(plant)
    plant.schedule.at(0.7, arm.protective_stop)
    with pytest.raises(ProtectiveStop):
        arm.wait_settled(10.0)
    assert plant.clock_s == 0.7


def test_a_brake_in_the_middle_of_a_motion_ends_the_wait(plant: Plant) -> None:
    arm = moving_arm(plant)
    plant.schedule.at(0.7, arm.brake)
    with pytest.raises(MotionStopped):
        arm.wait_settled(10.0)
    assert plant.clock_s == 0.7


def test_an_action_that_changes_nothing_changes_nothing(plant: Plant) -> None:
    undisturbed = build_plant(small_twin())
    states = []
    for cell in (plant, undisturbed):
        arm = moving_arm(cell)
        if cell is plant:
            cell.schedule.at(0.7, lambda: None)
        states.append(arm.wait_settled(10.0))
    assert np.array_equal(states[0].q, states[1].q)
    assert states[0].rest_since_s == states[1].rest_since_s


def test_what_happens_during_a_measurement_breaks_it(plant: Plant) -> None:
    tracker = SimulatedTracker(plant)
    tracker.connect()
    profile = load_profile(PROFILES / "twin.yaml")
    q = plan_stops(small_twin(2))
    arm = SimulatedArm(plant, "left")
    arm.connect()
    arm.start_move(q["left"][0], SLOW, SLOW)
    arm.wait_settled(60.0)
    target = next(target for target in plant.targets() if target.arm == "left")
    assert tracker.measure(target.p_M, profile.tracker.averaging).averaging_s == 1.0
    plant.schedule.at(plant.clock_s + 1.0, lambda: tracker.covered.add("left"))
    with pytest.raises(TargetLost, match="broke in mid-measurement"):
        tracker.measure(target.p_M, 1.0)
    tracker.covered.clear()
    plant.schedule.at(plant.clock_s + 1.0, tracker.cut_link)
    with pytest.raises(TrackerLinkLost):
        tracker.measure(target.p_M, 1.0)
