"""Paths of a UR arm with the real client against emulated controllers: followed, interrupted, refused."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from drivers.arms.path_checks import driven
from drivers.arms.protocol import (
    ArmError,
    EmergencyStop,
    LimitExceeded,
    LinkLost,
    MotionStopped,
    PathFollower,
    ProtectiveStop,
)
from drivers.arms.recording import RecordingArm
from drivers.arms.ur import UrArm
from drivers.emulators.ur_controller import EmulatorProcess
from tests.drivers.arms.emulated_ur_cell import (
    HOME,
    PATIENT_S,
    Episode,
    assert_stays_at_rest,
    at_home,
    go,
    is_stall,
    of_each_arm,
)
from tests.waiting import until

pytestmark = pytest.mark.waits

WAY = np.array([0.5, 0.2, -0.3, 0.2, 0.3, -0.4])


def smooth_path(period_s: float, duration_s: float) -> np.ndarray:
    """From HOME and back again, at rest at both ends."""
    x = np.linspace(0.0, 1.0, round(duration_s / period_s) + 1)[:, None]
    return HOME + 0.5 * (1.0 - np.cos(2.0 * np.pi * x)) * WAY * x * (1.0 - x) * 4.0


def begun(arm: UrArm, duration_s: float = 3.0) -> UrArm:
    """The arm in the middle of a path."""
    arm.start_path(smooth_path(arm.path_period_s, duration_s), arm.path_period_s)
    wait_until_under_way(arm)
    return arm


def wait_until_under_way(arm: UrArm) -> None:
    """Wait until the arm is far from the beginning of its path; raise what has stopped it: a stall of this computer,
    perhaps."""

    def under_way() -> bool:
        state = arm.state()
        if not state.ready:
            arm.wait_settled(PATIENT_S)
        return bool(abs(state.q[0] - HOME[0]) > 0.05)

    until(under_way, "the arm follows the path")


def path_is_followed_to_its_end(emulator: EmulatorProcess, arm: UrArm) -> None:
    assert isinstance(arm, PathFollower)
    assert arm.path_period_s == {"left": 0.008, "right": 0.002}[arm.name.removesuffix("2")]
    path = smooth_path(arm.path_period_s, 1.6)
    arm.start_recording()
    arm.start_path(path, arm.path_period_s)
    with pytest.raises(ArmError, match="still moving"):
        arm.start_path(path, arm.path_period_s)
    wait_until_under_way(arm)
    with pytest.raises(ArmError, match="still moving"):
        arm.start_path(path, arm.path_period_s)
    state = arm.wait_settled(PATIENT_S)
    np.testing.assert_allclose(state.q, path[-1], atol=1e-3)
    followed = arm.end_recording()
    assert arm.reached() == np.inf
    assert (np.diff(followed.time_s) > 0.0).all()
    farthest = np.abs(followed.q - HOME).max(axis=0)
    np.testing.assert_allclose(farthest, np.abs(path - HOME).max(axis=0), rtol=0.1)
    # another motion is possible at once, and the program is the same
    assert go(arm, HOME + 0.05).program == "PLAYING"


FAULTS: dict[str, tuple[tuple[Any, ...], type[ArmError]]] = {
    "protective stop": (("protective", "now"), ProtectiveStop),
    "emergency stop": (("estop",), EmergencyStop),
    "lost link": (("drop", "rtde", "fin"), LinkLost),
    "slider": (("slider", 0.5), ArmError),
}


def fault_in_mid_path(emulator: EmulatorProcess, arm: UrArm, *, fault: str) -> None:
    """It stops the arm."""
    command, error = FAULTS[fault]
    heard: list[ArmError] = []
    arm.watch(heard.append)
    begun(arm)
    emulator.control(arm.name, *command)
    with pytest.raises(error):
        arm.wait_settled(PATIENT_S)
    if is_stall(heard[0]):
        raise heard[0]
    assert isinstance(heard[0], error)
    assert_stays_at_rest(emulator, arm.name)
    with pytest.raises(ArmError):  # nothing moves until a person connects again
        arm.start_path(smooth_path(0.008, 1.6), 0.008)


STOPS: dict[str, Callable[[UrArm], None]] = {"brake": UrArm.brake, "stop": UrArm.stop}


def stop_from_another_thread(emulator: EmulatorProcess, arm: UrArm, *, how: str) -> None:
    """It ends the path."""
    begun(arm)
    thread = threading.Thread(target=STOPS[how], args=(arm,))
    thread.start()
    with pytest.raises(MotionStopped):
        arm.wait_settled(PATIENT_S)
    thread.join(PATIENT_S)
    assert_stays_at_rest(emulator, arm.name)


def path_is_ended_early(emulator: EmulatorProcess, arm: UrArm) -> None:
    """The arm slows down along the path, rests on it, and moves on from there without connecting again."""
    path = smooth_path(arm.path_period_s, 3.0)
    begun(arm)
    thread = threading.Thread(target=arm.end_path)
    thread.start()
    state = arm.wait_settled(PATIENT_S)
    thread.join(PATIENT_S)
    part = driven(path, arm.reached())
    assert 10 < len(part) < len(path)
    np.testing.assert_allclose(state.q, part[-1], atol=1e-3)
    arm.end_path()  # harmless at rest
    go(arm, HOME)


def every_sample_is_recorded(emulator: EmulatorProcess, arm: UrArm) -> None:
    """At the controller's own rate, with its stamps."""
    assert isinstance(arm, RecordingArm)
    arm.start_recording()
    path = smooth_path(arm.path_period_s, 1.6)
    arm.start_path(path, arm.path_period_s)
    arm.wait_settled(PATIENT_S)
    record = arm.end_recording()
    assert record.period_s == arm.path_period_s
    steps = np.diff(record.time_s)
    assert (steps > 0.0).all()
    assert np.median(steps) == pytest.approx(arm.path_period_s, rel=0.01)
    # what is missing the emulated controller has not sent: this computer was busy
    assert record.missing == int(np.maximum(np.rint(steps / record.period_s) - 1, 0).sum())
    crowded = int((np.rint(steps / record.period_s) == 0).sum())  # after one that a busy computer sent late
    uneven = int((np.abs(steps / record.period_s - np.rint(steps / record.period_s)) > 0.2).sum())  # as above
    assert len(record.time_s) - crowded + record.missing == pytest.approx(
        np.ptp(record.time_s) / record.period_s + 1.0, abs=1.5 + 0.5 * uneven
    )
    np.testing.assert_allclose(np.abs(record.q - HOME).max(axis=0), np.abs(path - HOME).max(axis=0), rtol=0.1)
    assert np.abs(record.qd).max() > 0.1
    assert len(record.time_s) > 100
    with pytest.raises(LinkLost, match="not being recorded"):
        arm.end_recording()


def recording_loses_its_link(emulator: EmulatorProcess, arm: UrArm) -> None:
    """The record says so; the arm has its own links, and a fault of its own."""
    arm.start_recording()
    emulator.control(arm.name, "drop", "rtde", "fin")
    until(lambda: arm._recorder is not None and arm._recorder._problem is not None, "the connection has ended")
    with pytest.raises(LinkLost, match="ended early"):
        arm.end_recording()


def wrong_path(emulator: EmulatorProcess, arm: UrArm) -> None:
    """Nothing moves."""
    period_s, moves = arm.path_period_s, emulator.control(arm.name, "status")["moves"]
    good = smooth_path(period_s, 1.6)
    cases: dict[str, tuple[np.ndarray, float]] = {
        "not a finite number": (np.where(np.arange(len(good))[:, None] == 9, np.nan, good), period_s),
        "outside its limits": (good + 20.0, period_s),
        "speed .* beyond its limit": (np.concatenate([good[:50], good[50:] + 0.1]), period_s),
        "from the beginning of the path": (good + 0.01, period_s),
        "its controller takes one each": (good, 2.0 * period_s),
        "two or more rows of 6": (good[:, :5], period_s),
    }
    for words, (path, every_s) in cases.items():
        with pytest.raises(LimitExceeded, match=words):
            arm.start_path(path, every_s)
    assert emulator.control(arm.name, "status")["moves"] == moves


def fault(name: str) -> Episode:
    return partial(fault_in_mid_path, fault=name)


EPISODES: dict[str, list[Episode]] = {
    "left": [
        path_is_followed_to_its_end, every_sample_is_recorded, path_is_ended_early, fault("slider"),
        fault("emergency stop"), partial(stop_from_another_thread, how="brake"),
    ],
    "right": [
        path_is_followed_to_its_end, every_sample_is_recorded, path_is_ended_early, recording_loses_its_link,
        fault("lost link"), fault("protective stop"), partial(stop_from_another_thread, how="stop"), wrong_path,
    ],
}  # fmt: skip


def test_of_each_arm(emulator: EmulatorProcess, drivers: dict[str, UrArm]) -> None:
    of_each_arm(emulator, drivers, EPISODES, at_home)
