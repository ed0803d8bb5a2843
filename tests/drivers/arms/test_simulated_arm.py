"""The simulated arm: motions, refusals, faults, temperatures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.arms.path_checks import driven
from drivers.arms.protocol import ArmError, EmergencyStop, LimitExceeded, LinkLost, MotionStopped, ProtectiveStop
from drivers.arms.simulated import CYCLE_S, SimulatedArm
from drivers.plant.motion import braked, travel
from drivers.plant.servo import GAIN, LOOKAHEAD_S, ServoMotion, servo_rate
from tests.sure import sure

SPEED, ACCELERATION = np.full(6, 1.0), np.full(6, 2.0)


@pytest.fixture
def plant(make_arm, make_plant):
    return make_plant(make_arm(effects={"backlash": {"play": [2e-4] * 6}}), make_arm("ur5", "right", 1.2))


@pytest.fixture
def arm(plant):
    simulated = SimulatedArm(plant, "left")
    simulated.connect()
    return simulated


angles = st.lists(st.floats(-6, 6), min_size=6, max_size=6).map(np.array)
limits = st.lists(st.floats(0.05, 3), min_size=6, max_size=6).map(np.array)


@settings(max_examples=80)
@given(start=angles, goal=angles, speed=limits, acceleration=limits)
def test_a_motion_is_straight_and_within_limits(start, goal, speed, acceleration):
    motion = travel(3.0, start, goal, speed, acceleration)
    if motion is None:
        assert np.abs(goal - start).max() < 1e-12
        return
    t = np.linspace(3.0, motion.end_s, 401)
    q, velocity = motion.position(t), motion.velocity(t)
    assert np.array_equal(q[0], start)
    assert np.array_equal(q[-1], goal)
    assert (np.abs(velocity) <= speed * (1 + 1e-9)).all()
    step = t[1] - t[0]
    assert (np.abs(np.diff(velocity[1:-1], axis=0)) <= acceleration * step * (1 + 1e-6) + 1e-12).all()
    # the trapezium rule is exact where the speed is linear; three corners are not
    travelled = (0.5 * (velocity[1:] + velocity[:-1]) * step).sum(axis=0)
    assert travelled == pytest.approx(goal - start, abs=3e-2 * float(np.abs(goal - start).max()) + 1e-12)
    way = goal - start
    share = (q - start) @ way / (way @ way)
    assert np.abs(q - start - share[:, None] * way).max() < 1e-12
    assert (np.diff(share) >= -1e-12).all()


@settings(max_examples=60)
@given(goal=angles, speed=limits, acceleration=limits, share=st.floats(0.01, 0.99))
def test_braking_follows_the_path_and_never_passes_its_end(goal, speed, acceleration, share):
    motion = travel(0.0, np.zeros(6), goal, speed, acceleration)
    if motion is None:
        return
    now = share * motion.duration_s
    rest = sure(braked(motion, now, acceleration))
    q, velocity = motion.position(np.array([now]))[0], motion.velocity(np.array([now]))[0]
    assert rest.position(np.array([now]))[0] == pytest.approx(q, abs=1e-12)
    assert rest.velocity(np.array([now + 1e-9]))[0] == pytest.approx(velocity, abs=1e-6)
    assert (np.abs(velocity) <= acceleration * rest.duration_s * (1 + 1e-9)).all()
    end = rest.position(np.array([rest.end_s]))[0]
    assert (np.abs(end) <= np.abs(goal) + 1e-12).all()
    assert (np.abs(end) >= np.abs(q) - 1e-12).all()
    again = sure(braked(rest, now, acceleration))  # two stop commands at the same time
    assert again.end_s == pytest.approx(rest.end_s, rel=1e-9)
    assert again.position(np.array([again.end_s]))[0] == pytest.approx(end, abs=1e-9)


@pytest.mark.parametrize(
    ("q", "speed", "acceleration", "message"),
    [
        (np.full(6, 7.0), SPEED, ACCELERATION, "position 7.0000 rad of joint 1 is outside"),
        (np.array([0, 0, np.nan, 0, 0, 0]), SPEED, ACCELERATION, "position of joint 3 is not a finite number"),
        (np.zeros(5), SPEED, ACCELERATION, "expected one number for each of 6 joints"),
        (np.ones(6), np.array([1, 1, 1, 1, 1, 2.1]), ACCELERATION, "speed 2.1 rad/s of joint 6"),
        (np.ones(6), np.zeros(6), ACCELERATION, "speed 0 rad/s of joint 1"),
        (np.ones(6), SPEED, np.full(6, 3.1), "acceleration 3.1 rad/s\\^2 of joint 1"),
        (np.ones(6), SPEED, np.full(6, np.inf), "acceleration of joint 1 is not a finite number"),
    ],
)
def test_a_goal_outside_the_limits_moves_nothing(plant, arm, q, speed, acceleration, message):
    with pytest.raises(LimitExceeded, match=f"arm left: .*{message}"):
        arm.start_move(q, speed, acceleration)
    assert not plant.moving("left")


# -- Paths are followed with a lag, and every stop ends them -----------------------------------------------------------


WAY = np.array([0.2, 0.1, -0.1, 0.1, 0.1, -0.2])


def path_of(plant, duration_s=2.0, name="left"):
    x = np.linspace(0.0, 1.0, round(duration_s / CYCLE_S) + 1)[:, None]
    return plant.q(name) + x**3 * (10.0 - x * (15.0 - 6.0 * x)) * WAY


def test_a_path_is_followed_late_and_to_its_end(plant, arm):
    path = path_of(plant)
    arm.start_recording()
    arm.start_path(path, arm.path_period_s)
    assert arm.state().moving
    with pytest.raises(ArmError, match="still moving"):
        arm.start_path(path, CYCLE_S)
    state = arm.wait_settled(10.0)
    np.testing.assert_array_equal(state.q, path[-1])
    followed = arm.end_recording()
    late = LOOKAHEAD_S / np.sqrt(GAIN / 300.0) + 0.5 * CYCLE_S  # a position holds for a cycle
    time_s = followed.time_s - followed.time_s[0] - late
    wanted = np.array([np.interp(time_s, CYCLE_S * np.arange(len(path)), column) for column in path.T])
    assert np.abs(followed.q - wanted.T).max() < 5e-4
    assert np.abs(followed.q[: len(path)] - path).max() > 3e-3


@given(
    away=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array),
    speed=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array),
    rate=st.floats(5.0, 100.0),
)
def test_the_lag_is_a_smooth_way_to_the_goal(away, speed, rate):
    goal = np.array([0.1, 0.2, 0.3])
    motion = ServoMotion.towards(goal, 5.0, goal + away, speed, rate)
    t = np.linspace(5.0, motion.end_s, 4001)
    q, v = motion.position(t), motion.velocity(t)
    np.testing.assert_allclose(q[0], goal + away, atol=1e-12)
    np.testing.assert_allclose(v[0] if len(t) > 1 else speed, speed, atol=1e-12)
    np.testing.assert_allclose(q[-2:], np.stack([goal, goal]), atol=1e-6)
    h = t[1] - t[0]
    middle = 0.5 * (v[1:-1] + v[:-2]) * h
    np.testing.assert_allclose(np.diff(q, axis=0)[:-1], middle, atol=4.0 * (rate * h) ** 2 * (1.0 + rate) * h + 1e-9)


def test_no_controller_takes_another_look_ahead():
    with pytest.raises(ValueError, match="look-ahead"):
        servo_rate(0.01, 300.0)
    assert servo_rate(0.1, 1200.0) == pytest.approx(40.0)


STOPS = {
    "brake": (SimulatedArm.brake, MotionStopped),
    "stop": (SimulatedArm.stop, MotionStopped),
    "protective stop": (SimulatedArm.protective_stop, ProtectiveStop),
    "emergency stop": (SimulatedArm.emergency_stop, EmergencyStop),
    "lost link": (SimulatedArm.cut_link, LinkLost),
}


@pytest.mark.parametrize("how", STOPS, ids=STOPS)
def test_every_stop_ends_a_path(how, plant, arm):
    stop, error = STOPS[how]
    path = path_of(plant)
    arm.start_path(path, CYCLE_S)
    plant.schedule.at(plant.clock_s + 1.0, lambda: stop(arm))
    with pytest.raises(error):
        arm.wait_settled(10.0)
    plant.advance(1.0)
    rested = plant.q("left")
    assert 0.2 < (rested - path[0])[0] / WAY[0] < 0.95
    plant.advance(2.0)  # no later position of the path moves it
    np.testing.assert_array_equal(plant.q("left"), rested)


def test_a_path_that_is_ended_early_is_left_nowhere(plant, arm):
    path = path_of(plant)
    arm.end_path()  # harmless at rest
    arm.start_recording()
    arm.start_path(path, CYCLE_S)
    plant.schedule.at(plant.clock_s + 0.7, arm.end_path)
    state = arm.wait_settled(10.0)
    reached = arm.reached()
    part = driven(path, reached)
    assert 80 < reached < 160
    np.testing.assert_allclose(state.q, part[-1], atol=1e-6)
    record = arm.end_recording()
    assert record.missing == 0
    np.testing.assert_allclose(np.diff(record.time_s), CYCLE_S, rtol=1e-6)
    # no joint leaves the path, and none is faster or slows down harder than on it
    along = np.abs(record.q - path[0]) / np.abs(WAY)
    assert np.ptp(along, axis=1).max() < 1e-3
    assert np.abs(record.qd).max() <= np.abs(np.diff(path, axis=0)).max() / CYCLE_S
    arm.start_move(path[0], np.full(6, 1.0), np.full(6, 1.0))
    arm.wait_settled(10.0)
    arm.start_path(path, CYCLE_S)
    arm.wait_settled(10.0)
    assert arm.reached() == np.inf


def test_nothing_moves_where_a_path_is_wrong(plant, arm):
    path = path_of(plant)
    cases = {
        "not a finite number": (np.where(np.arange(len(path))[:, None] == 9, np.nan, path), CYCLE_S),
        "speed .* beyond its limit": (path_of(plant, 0.1), CYCLE_S),
        "from the beginning of the path": (path + 0.01, CYCLE_S),
        "outside its limits": (path + 20.0, CYCLE_S),
        "takes one each": (path, 0.004),
        "two or more rows": (path[:1], CYCLE_S),
    }
    for words, (wrong, period_s) in cases.items():
        with pytest.raises(LimitExceeded, match=words):
            arm.start_path(wrong, period_s)
    assert not plant.moving("left")
