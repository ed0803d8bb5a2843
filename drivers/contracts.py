"""What any driver of an arm or of a tracker must hold, for authors of drivers too: each raises ``AssertionError``.

Each takes a connected device that is ready, and leaves it so, an arm where it stood. A test of a driver calls all of
``ARM`` or ``TRACKER`` with the device and a place to go to or an SMR to measure.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import Arm, ArmError, LimitExceeded, LinkLost, MotionStopped
from drivers.trackers.protocol import TargetLost, Tracker, TrackerLinkLost, WrongTarget

WAIT_S = 20.0
"""Longest motion of a contract."""
NEAR_RAD, NEAR_M = 2e-4, 5e-4
Array = NDArray[np.float64]
Errors = type[Exception] | tuple[type[Exception], ...]


def raises(error: Errors, call: Callable[..., object], *given: object) -> None:
    """Assert that a call raises an error of this kind."""
    try:
        call(*given)
    except error:
        return
    raise AssertionError(f"{call.__qualname__} raised none of {error}")


def _rates(arm: Arm) -> tuple[Array, Array]:
    limits = arm.limits()
    return 0.5 * limits.speed, 0.5 * limits.acceleration


def _rests(arm: Arm) -> Array:
    """Wait until nobody doubts that the arm rests; return where."""
    until_s = time.monotonic() + WAIT_S
    while (state := arm.state()).moving:
        assert time.monotonic() < until_s, "it does not come to rest"
    return state.q


def moves_to_its_goal_and_rests_there(arm: Arm, goal: Array) -> None:
    """Nobody gets "at rest" before; a second motion must wait; one to where it stands ends well."""
    home, rates = arm.state().q, _rates(arm)
    for q in (goal, goal, home):
        arm.confirm()
        arm.start_move(q, *rates)
        if not np.allclose(arm.state().q, q, atol=NEAR_RAD):
            assert arm.state().moving
            assert arm.live().moving
            raises(ArmError, arm.start_move, home, *rates)
        state = arm.wait_settled(WAIT_S)
        assert (state.moving, state.ready, state.reason) == (False, True, "")
        assert np.abs(state.q - q).max() < NEAR_RAD
    assert arm.live().age_s < WAIT_S


def refuses_what_is_beyond_its_limits(arm: Arm, goal: Array) -> None:
    """Nothing moves."""
    home, limits, (speed, acceleration) = arm.state().q, arm.limits(), _rates(arm)
    for q, its_speed, its_acceleration in (
        (np.where(np.arange(len(goal)) == 1, np.nan, goal), speed, acceleration),
        (limits.position[:, 1] + 0.1, speed, acceleration),
        (goal, limits.speed * 1.1, acceleration),
        (goal, speed * np.nan, acceleration),
        (goal, speed, limits.acceleration * 1.1),
    ):
        raises(LimitExceeded, arm.start_move, q, its_speed, its_acceleration)
    assert np.abs(_rests(arm) - home).max() < NEAR_RAD


def stays_stopped_until_it_is_connected_again(arm: Arm, goal: Array) -> None:
    """Refused, braked in a motion, and at rest."""
    home, rates = arm.state().q, _rates(arm)
    for stop in (arm.brake, arm.refuse_motion):  # which need not stop what goes on
        arm.start_move(goal, *rates)
        stop()
        arm.brake()
        raises(MotionStopped, arm.wait_settled, WAIT_S)
        _rests(arm)
        raises(MotionStopped, arm.start_move, home, *rates)
        arm.connect()
    arm.start_move(home, *rates)
    assert np.abs(arm.wait_settled(WAIT_S).q - home).max() < NEAR_RAD
    arm.stop()
    arm.connect()


def lets_go_of_its_link(arm: Arm, goal: Array) -> None:
    """Disconnecting and connecting twice are harmless; without a link nothing is answered."""
    home, rates = arm.state().q, _rates(arm)
    arm.disconnect()
    arm.disconnect()
    raises(LinkLost, arm.state)
    raises(LinkLost, arm.confirm)
    raises(ArmError, arm.start_move, goal, *rates)
    arm.connect()
    arm.connect()
    assert np.abs(_rests(arm) - home).max() < NEAR_RAD


ARM: tuple[Callable[[Arm, Array], None], ...] = (
    moves_to_its_goal_and_rests_there,
    refuses_what_is_beyond_its_limits,
    stays_stopped_until_it_is_connected_again,
    lets_go_of_its_link,
)


def measures_an_smr(tracker: Tracker, p_M: Array) -> None:
    """Near where it is expected, each point with a covariance and a later time than the one before."""
    points = (tracker.measure(p_M, 1.0), tracker.measure(p_M + 1e-3, 1.0))
    for one in points:
        assert np.linalg.norm(one.p_M - p_M) < NEAR_M
        assert np.linalg.eigvalsh(one.covariance_M).min() > 0.0
        assert one.averaging_s >= 0.0
    assert points[0].time_s < points[1].time_s


def refuses_what_it_cannot_measure(tracker: Tracker, p_M: Array) -> None:
    """Nonsense, and places without an SMR; a halt at rest is harmless."""
    for wrong in (p_M[:2], np.where(np.arange(3) == 1, np.nan, p_M)):
        raises(ValueError, tracker.measure, wrong, 1.0)
    for averaging_s in (0.0, -1.0, np.nan, np.inf):
        raises(ValueError, tracker.measure, p_M, averaging_s)
    raises((TargetLost, WrongTarget), tracker.measure, p_M + 1.0, 1.0)
    tracker.halt()
    assert tracker.unmet() == []
    assert np.linalg.norm(tracker.measure(p_M, 1.0).p_M - p_M) < NEAR_M


def answers_while_its_link_is_open(tracker: Tracker, p_M: Array) -> None:
    """Disconnecting twice is harmless; without a link nothing is answered."""
    tracker.confirm(WAIT_S)
    assert tracker.data_age_s() < WAIT_S
    tracker.disconnect()
    tracker.disconnect()
    raises(TrackerLinkLost, tracker.measure, p_M, 1.0)
    raises(TrackerLinkLost, tracker.unmet)
    tracker.connect()
    assert np.linalg.norm(tracker.measure(p_M, 1.0).p_M - p_M) < NEAR_M


TRACKER: tuple[Callable[[Tracker, Array], None], ...] = (
    measures_an_smr,
    refuses_what_it_cannot_measure,
    answers_while_its_link_is_open,
)
