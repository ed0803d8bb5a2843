"""Motions over time: braking along the path, and a speed slider that scales a motion in progress."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from drivers.arms.protocol import ArmError, MotionStopped, ProtectiveStop
from drivers.arms.simulated import SimulatedArm
from drivers.plant import Plant
from drivers.plant.motion import Motion, braked, travel
from drivers.plant.transforms import rigid, transform_points
from drivers.trackers.protocol import TargetLost, TrackerLinkLost
from drivers.trackers.simulated import SimulatedTracker
from tests.twin import PROFILES, small_twin

START, END = np.array([0.0, 1.0]), np.array([2.0, 0.0])


def motion() -> Motion:
    made = travel(10.0, START, END, np.full(2, 1.0), np.full(2, 2.0))
    assert made is not None
    return made


def at(moved: Motion, time_s: float) -> np.ndarray:
    return moved.position(np.array([time_s]))[0]


def speed(moved: Motion, time_s: float) -> np.ndarray:
    return moved.velocity(np.array([time_s]))[0]


def test_a_scaled_motion_follows_the_same_path_more_slowly() -> None:
    full = motion()
    slow = full.scaled(11.0, 0.25)
    assert np.array_equal(at(slow, 11.0), at(full, 11.0))
    assert np.allclose(speed(slow, 11.2), 0.25 * speed(full, 11.05))
    assert slow.end_s == pytest.approx(11.0 + (full.end_s - 11.0) / 0.25)
    assert np.array_equal(at(slow, slow.end_s), END)
    assert np.allclose(slow.mean_speed, 0.25 * full.mean_speed)


def test_a_motion_scaled_to_zero_stands_and_goes_on() -> None:
    full = motion()
    stands = full.scaled(11.0, 0.0)
    assert stands.end_s == np.inf
    assert np.array_equal(at(stands, 500.0), at(full, 11.0))
    assert not speed(stands, 12.0).any()
    again = stands.scaled(20.0, 1.0)
    assert again.end_s == pytest.approx(full.end_s + 9.0)
    assert np.allclose(at(again, 20.3), at(full, 11.3))


def test_a_scaled_motion_brakes_from_its_own_speed() -> None:
    slow = motion().scaled(10.8, 0.5)
    stopping = braked(slow, 11.0, np.full(2, 2.0))
    assert stopping is not None
    assert stopping.duration_s == pytest.approx(np.abs(speed(slow, 11.0)).max() / 2.0)
    assert braked(motion().scaled(11.0, 0.0), 12.0, np.full(2, 2.0)) is None


def test_a_stop_brakes_as_gently_as_asked(make_arm, make_plant) -> None:
    rests = []
    for deceleration in (None, np.full(6, 1.0)):
        plant = make_plant(make_arm())
        plant.start_move("left", plant.q("left") + 2.0, np.full(6, 1.0), np.full(6, 3.0))
        plant.advance(1.0)
        assert np.abs(plant.speeds("left")).max() == pytest.approx(1.0)
        plant.stop("left", deceleration)
        rests.append(plant.rest_s("left") - plant.clock_s)
        plant.advance(2.0)
        assert not plant.speeds("left").any()
    assert rests == pytest.approx([1.0 / 3.0, 1.0])


# -- Scheduled actions happen at their time, in the middle of what a device does ---------------------------------------

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


# -- Hidden effects of time and temperature: growth, drift, slip and sway ----------------------------------------------

Q = np.random.default_rng(3).uniform(-2.5, 2.5, (5, 6))
SHIFT, TURN = [1e-4, -2e-4, 5e-5], [1e-4, 2e-5, -3e-4]
GROWTH = {"expansion": 23e-6, "share": 0.8, "lag": 900.0}


def _positions(make_arm, make_plant, effects, q=Q, **situation):
    return make_plant(make_arm(effects=effects)).smr_positions("left", q, **situation)


def _moved_base(make_plant, shares):
    """SMR (n, 3) with the base gone the given shares (n,) of SHIFT and TURN."""
    ideal = make_plant()
    pose = ideal.true_T_M_B("left")
    p_B = transform_points(np.linalg.inv(pose), ideal.smr_positions("left", Q))
    return transform_points(pose, transform_points(rigid(np.outer(shares, SHIFT + TURN)), p_B))


# -- warmth ------------------------------------------------------------------------------------------------------------


def test_a_uniformly_warmer_arm_is_larger(make_arm, make_plant):
    found = _positions(
        make_arm, make_plant, {"thermal_growth": GROWTH}, joints_c=np.full((5, 6), 30.0), air_c=np.full(5, 30.0)
    )
    rows = make_arm().rows.copy()
    rows[:, 1:3] *= 1.0 + 10.0 * 23e-6
    assert np.abs(found - make_plant(make_arm(rows=rows)).smr_positions("left", Q)).max() < 1e-13


def test_at_the_reference_nothing_grows(make_arm, make_plant):
    values = GROWTH | {"reference": 25.0, "motor": 2e-6}
    found = _positions(
        make_arm, make_plant, {"thermal_growth": values}, joints_c=np.full((5, 6), 25.0), air_c=np.full(5, 25.0)
    )
    assert np.abs(found - make_plant().smr_positions("left", Q)).max() < 1e-15


def test_a_link_takes_its_share_of_the_rise_of_its_two_joints(make_arm, make_plant):
    joints_c = np.full((5, 6), 20.0)
    joints_c[:, 2] += 12.0  # the elbow warms both beams by half
    found = _positions(make_arm, make_plant, {"thermal_growth": GROWTH}, joints_c=joints_c, air_c=np.full(5, 20.0))
    rows = make_arm().rows.copy()
    rows[1:3, 2] *= 1.0 + 0.8 * 6.0 * 23e-6
    assert np.abs(found - make_plant(make_arm(rows=rows)).smr_positions("left", Q)).max() < 1e-13


def test_the_housing_of_a_warm_motor_grows_along_its_axis(make_arm, make_plant):
    joints_c = np.full((5, 6), 20.0)
    joints_c[:, 3] += 10.0
    values = {"expansion": 0.0, "share": 1.0, "lag": 900.0, "motor": 2e-6}
    found = _positions(make_arm, make_plant, {"thermal_growth": values}, joints_c=joints_c, air_c=np.full(5, 20.0))
    rows = make_arm().rows.copy()
    rows[3, 1] += 20e-6
    assert np.abs(found - make_plant(make_arm(rows=rows)).smr_positions("left", Q)).max() < 1e-13


def test_links_follow_a_jump_of_temperature_with_their_lag(make_arm, make_plant):
    time_s = np.array([0.0, 1.0, 901.0, 1801.0, 1e5])
    air_c = np.array([20.0, 30.0, 30.0, 30.0, 30.0])
    q = np.tile(Q[0], (5, 1))
    order = np.array([3, 0, 4, 2, 1])  # the stops need not be given in the order of time
    found = _positions(
        make_arm,
        make_plant,
        {"thermal_growth": GROWTH},
        q,
        time_s=time_s[order],
        air_c=air_c[order],
        joints_c=np.tile(air_c[order, None], (1, 6)),
    )[np.argsort(order)]
    grown = np.linalg.norm(found - found[0], axis=1) / np.linalg.norm(found[-1] - found[0])
    assert grown == pytest.approx([0.0, 0.0, 1.0 - np.exp(-1.0), 1.0 - np.exp(-2.0), 1.0], abs=2e-3)


def test_a_given_history_agrees_with_a_simulated_one(make_arm, make_plant):
    values = GROWTH | {"motor": 1e-6}
    lived = make_plant(make_arm(effects={"thermal_growth": values}), holding_k=10.0)
    told = make_plant(make_arm(effects={"thermal_growth": values}), holding_k=10.0)
    q, seen, time_s, air_c, joints_c = lived.q("left"), [], [], [], []
    for _ in range(60):
        time_s.append(lived.clock_s)
        air_c.append(lived.air_temperature_c)
        joints_c.append(lived.joint_temperatures_c("left"))
        seen.append(lived.targets()[0].p_M)
        lived.advance(60.0)
    found = told.smr_positions(
        "left", np.tile(q, (60, 1)), time_s=np.array(time_s), air_c=np.array(air_c), joints_c=np.array(joints_c)
    )
    growth = np.linalg.norm(found[-1] - found[0])
    assert growth > 50e-6
    assert np.abs(found - np.array(seen)).max() < 0.02 * growth


def test_the_zeros_of_joints_drift_as_they_warm_up(make_arm, make_plant):
    drift, tau = np.array([5e-5, -4e-5, 3e-5, 0.0, 2e-5, -6e-5]), 1800.0
    values = {"drift": drift.tolist(), "time_constant": [tau] * 6}
    time_s = np.array([0.0, 900.0, 1800.0, 3600.0, 1e6])
    found = _positions(make_arm, make_plant, {"joint_drift": values}, time_s=time_s)
    joints = Q + (1.0 - np.exp(-time_s / tau))[:, None] * drift
    assert np.abs(found - make_plant().smr_positions("left", joints)).max() < 1e-13


def test_or_by_the_temperature_of_each_joint(make_arm, make_plant):
    joints_c = 20.0 + np.random.default_rng(0).uniform(0, 15, (5, 6))
    values = {"per_kelvin": [4e-6] * 6}
    found = _positions(make_arm, make_plant, {"joint_drift": values}, joints_c=joints_c)
    assert np.abs(found - make_plant().smr_positions("left", Q + 4e-6 * (joints_c - 20.0))).max() < 1e-13
    moved = _positions(make_arm, make_plant, {"joint_drift": values | {"reference": 30.0}}, joints_c=joints_c)
    assert np.abs(moved - make_plant().smr_positions("left", Q + 4e-6 * (joints_c - 30.0))).max() < 1e-13


# -- what walks and slips ----------------------------------------------------------------------------------------------

TIMES = np.array([0.0, 500.0, 1000.0, 2000.0, 4000.0])


@pytest.mark.parametrize(
    ("law", "shares"),
    [
        ("linear", TIMES / 1000.0),
        ("exponential", 1.0 - np.exp(-TIMES / 1000.0)),
        ("creep", np.log(1.0 + TIMES / 1000.0)),
    ],
)
def test_the_base_drifts_by_its_law(make_arm, make_plant, law, shares):
    values = {"shift": SHIFT, "turn": TURN, "law": law, "time": 1000.0}
    found = _positions(make_arm, make_plant, {"base_drift": values}, time_s=TIMES)
    assert np.abs(found - _moved_base(make_plant, shares)).max() < 1e-13


def test_a_drifting_tracker_sees_the_arm_drift_the_opposite_way(make_arm, make_plant):
    values = {"shift": SHIFT, "turn": TURN, "law": "exponential", "time": 1000.0}
    found = _positions(make_arm, make_plant, {"tracker_drift": values}, time_s=TIMES)
    p_M, share = make_plant().smr_positions("left", Q), (1.0 - np.exp(-TIMES / 1000.0))[:, None]
    first_order = p_M - share * (np.array(SHIFT) + np.cross(TURN, p_M))
    assert np.abs(found - first_order).max() < 1e-6
    assert np.array_equal(found[0], p_M[0])


def test_a_bolt_slips_once(make_arm, make_plant):
    values = {"shift": SHIFT, "turn": TURN, "time": 1000.0}
    found = _positions(make_arm, make_plant, {"base_step": values}, time_s=TIMES)
    assert np.abs(found - _moved_base(make_plant, TIMES >= 1000.0)).max() < 1e-13
    plant = make_plant(make_arm(effects={"base_step": values}))
    before = plant.targets()[0].p_M
    plant.advance(999.0)
    assert np.array_equal(plant.targets()[0].p_M, before)
    plant.advance(2.0)
    assert np.linalg.norm(plant.targets()[0].p_M - before) > 1e-4


def test_the_seat_slips_with_the_flange(make_arm, make_plant):
    found = _positions(make_arm, make_plant, {"target_slip": {"shift": SHIFT, "time": 1000.0}}, time_s=TIMES)
    slipped = make_plant(make_arm(smr_offset=make_arm().smr_offset + SHIFT)).smr_positions("left", Q)
    expected = np.where((TIMES >= 1000.0)[:, None], slipped, make_plant().smr_positions("left", Q))
    assert np.abs(found - expected).max() < 1e-13


def test_the_floor_sways_with_its_period(make_arm, make_plant):
    values = {"shift": SHIFT, "period": 2820.0, "phase": 0.4}
    found = _positions(make_arm, make_plant, {"base_sway": values}, time_s=TIMES)
    swing = np.sin(2 * np.pi * TIMES / 2820.0 + 0.4)
    pose = make_plant().true_T_M_B("left")
    expected = make_plant().smr_positions("left", Q) + np.outer(swing, pose[:3, :3] @ SHIFT)
    assert np.abs(found - expected).max() < 1e-13
    later = _positions(make_arm, make_plant, {"base_sway": values}, time_s=TIMES + 2820.0)
    assert np.abs(found - later).max() < 1e-13


def test_a_draught_deflects_the_beam_horizontally(make_arm, make_plant):
    values = {"angle": 2e-5, "period": 1800.0, "phase": 0.0}
    time_s = np.array([0.0, 450.0, 900.0, 1350.0, 1800.0])
    found = _positions(make_arm, make_plant, {"draught": values}, time_s=time_s)
    p_M = make_plant().smr_positions("left", Q)
    moved = found - p_M
    level = np.hypot(p_M[:, 0], p_M[:, 1])
    assert np.linalg.norm(moved, axis=1) == pytest.approx(2e-5 * level * [0, 1, 0, 1, 0], abs=1e-12)
    assert np.abs(moved[:, 2]).max() == 0.0
    assert np.abs((moved * p_M).sum(axis=1)).max() < 1e-8


WALK = {"shift": SHIFT, "turn": TURN, "law": "linear", "time": 100.0}


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"thermal_growth": GROWTH | {"share": 1.5}}, "share must be from 0 to 1, not 1.5"),
        ({"thermal_growth": GROWTH | {"lag": 0.0}}, "lag must be greater than 0, not 0"),
        ({"thermal_growth": GROWTH | {"heat": 1.0}}, r"unknown parameter 'heat'; .*lag, motor \(optional\), reference"),
        ({"joint_drift": {"drift": [1e-5] * 6}}, "parameter 'time_constant' is missing"),
        ({"joint_drift": {"per_kelvin": [1e-5] * 6, "drift": [1e-5] * 6}}, "unknown parameter 'drift'"),
        (
            {"base_drift": WALK | {"law": "random"}},
            "law must be one of linear, exponential, creep, sinusoidal, wandering, not 'random'",
        ),
        ({"base_drift": WALK | {"time": -1}}, "time must be greater than 0, not -1"),
        ({"tracker_drift": WALK | {"shift": [0.0, 0.0]}}, "shift must be a list of 3 numbers"),
        ({"base_step": {"shift": SHIFT, "turn": TURN, "time": None}}, "time must be a number in SI units, not None"),
        ({"target_slip": {"shift": SHIFT}}, "parameter 'time' is missing"),
        ({"base_sway": {"shift": SHIFT, "period": 0, "phase": 0}}, "period must be greater than 0"),
        ({"draught": {"angle": True, "period": 1, "phase": 0}}, "angle must be a number in SI units, not True"),
    ],
)
def test_a_wrong_parameter_is_one_clear_error(make_arm, make_plant, effects, message):
    with pytest.raises(ValueError, match=f"arm left, effect {next(iter(effects))}: .*{message}"):
        make_plant(make_arm(effects=effects))
