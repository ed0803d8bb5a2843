"""Stops and faults of a UR arm with the real client: what reaches the controller, how soon, and what is reported."""

from __future__ import annotations

import math
import os
import random
import re
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from drivers.arms.protocol import (
    ArmError,
    ArmTimeout,
    HostStalled,
    LinkLost,
    MotionStopped,
    NotInRemoteControl,
    ProtectiveStop,
)
from drivers.arms.ur import UrArm
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import EmulatorProcess
from tests.at_once import in_parallel
from tests.drivers.arms.emulated_ur_cell import (
    ACCELERATION,
    AWAY,
    FAR,
    HOME,
    HOSTS,
    PATIENT_S,
    SPEED,
    UNHURRIED,
    Episode,
    Heard,
    application,
    assert_braked,
    assert_stays_at_rest,
    at_rest,
    connected,
    driven,
    go,
    of_each_arm,
    received_stop_s,
    repair,
)
from tests.latency import attempts
from tests.sure import sure
from tests.waiting import until, within

pytestmark = pytest.mark.waits

COMMANDED_WITHIN_S = 0.1
"""From a request to stop until the controller has received it."""
KNOWN_WITHIN_S = 0.3
"""Until an arm whose state is unknown counts as in doubt."""
TOLD_WITHIN_S = 0.2
"""From there until the listener is told."""
FROZEN_S = 0.2
"""A stall that is longer than the watchdog's period of 0.1 s, and shorter than what makes the state unknown."""
MORE_THAN_A_PIPE_TAKES = 5000
"""Messages of 16 bytes; a pipe takes 64 KiB."""
MOST_LOST = 3
"""Of 24 starts that are braked, on a computer too busy to exchange heartbeats or to feed the watchdog."""


def start(emulator: EmulatorProcess, arm: UrArm, speed: np.ndarray = UNHURRIED) -> None:
    """Begin a long motion and return while it lasts."""
    here = arm.state().q
    goal = FAR if np.abs(here - FAR).max() > np.abs(here - HOME).max() else HOME
    arm.start_move(goal, speed, ACCELERATION)
    until(lambda: float(np.abs(arm.state().q - here).max()) > 0.1, "the arm moves")


# -- brake ------------------------------------------------------------------------------------------------------------


def test_a_brake_during_a_wait_stops_the_arm_and_ends_the_wait(
    emulator: EmulatorProcess, drivers: dict[str, UrArm]
) -> None:
    in_parallel(brake_ends_a_wait, [(emulator, drivers[name]) for name in ("left", "right")])


def brake_ends_a_wait(emulator: EmulatorProcess, arm: UrArm) -> None:
    for took in attempts(woken=COMMANDED_WITHIN_S, returned=0.05, received=COMMANDED_WITHIN_S):
        connected(emulator, arm)
        took.update(brake_during_a_wait(emulator, arm))
    for call in (lambda: arm.wait_settled(PATIENT_S), lambda: arm.start_move(HOME, SPEED, ACCELERATION)):
        with pytest.raises(MotionStopped, match="connect again"):
            call()
    pid = arm.worker_pid
    arm.connect()
    assert arm.worker_pid == pid, "the client was started again"
    go(arm, AWAY)


def brake_during_a_wait(emulator: EmulatorProcess, arm: UrArm) -> dict[str, float]:
    """Return the latencies until the wait ends, ``brake`` returns and the controller has received the stop [s]."""
    start(emulator, arm)
    asked: list[float] = []

    def brake() -> None:
        asked.append(time.monotonic())
        with suppress(LinkLost):  # a dashboard that answers too late also shows as a late return
            arm.brake()
        asked.append(time.monotonic())

    stopper = threading.Timer(0.1, brake)
    stopper.start()
    with pytest.raises(MotionStopped, match=f"arm {arm.name}: "):
        arm.wait_settled(PATIENT_S)
    woken_s = time.monotonic()
    within(stopper.join, "the end of the brake")
    assert_braked(emulator, arm.name, asked[0])
    received_s = received_stop_s(emulator, arm.name, asked[0])
    return {"woken": woken_s - asked[0], "returned": asked[1] - asked[0], "received": received_s - asked[0]}


def test_no_motion_survives_a_brake_at_any_moment_of_its_start(
    emulator: EmulatorProcess, drivers: dict[str, UrArm]
) -> None:
    ends: list[type[ArmError]] = []
    moments = random.Random(11)
    moments_s = [moments.uniform(0.0, 0.2) for _ in range(12)]  # shared by the two arms of a series

    def hammer(name: str, arm: UrArm) -> None:
        connected(emulator, arm)
        for after_s in moments_s[6:] if name.endswith("2") else moments_s[:6]:
            ends.append(brake_while_it_starts(emulator, arm, after_s))

    in_parallel(hammer, drivers.items())
    assert len(ends) == 24
    assert len(ends) - ends.count(MotionStopped) <= MOST_LOST, ends


def brake_while_it_starts(emulator: EmulatorProcess, arm: UrArm, after_s: float) -> type[ArmError]:
    """Return how the motion ended: ``MotionStopped``, or what a busy computer may add."""
    arm.stop()  # the next motion uploads the program first, which takes a tenth of a second
    here = arm.state().q
    goal = FAR if np.abs(here - FAR).max() > np.abs(here - HOME).max() else HOME

    def brake() -> None:
        with suppress(LinkLost):
            arm.brake()

    def move() -> None:
        go(arm, goal)

    stopper = threading.Timer(after_s, brake)
    stopper.start()
    with pytest.raises(ArmError) as ended:
        move()
    within(stopper.join, "the end of the brake")
    assert_stays_at_rest(emulator, arm.name, for_s=0.3)
    assert np.abs(np.array(emulator.control(arm.name, "status")["q"]) - goal).max() > 0.3, "it went all the way"
    with pytest.raises(ArmError):
        arm.start_move(goal, SPEED, ACCELERATION)
    arm.connect()
    assert at_rest(emulator, arm.name), "connecting moved the arm"
    return ended.type


def brake_without_its_open_line(emulator: EmulatorProcess, arm: UrArm) -> None:
    stopped_beside(emulator, arm, ("drop", "dashboard", "rst"), arm.brake)


def unconfirmed_brake_says_so_and_stops_all_the_same(emulator: EmulatorProcess, arm: UrArm) -> None:
    def brake() -> None:
        with pytest.raises(LinkLost, match=rf"arm {arm.name}: its stop was not confirmed: .*29999"):
            arm.brake()

    stopped_beside(emulator, arm, ("fault", "dashboard", "silent"), brake)


def stopped_beside(emulator: EmulatorProcess, arm: UrArm, fault: tuple[str, ...], brake: Callable[[], None]) -> None:
    """Assert that a brake stops a motion in time beside a fault."""
    for took in attempts(received=COMMANDED_WITHIN_S):
        connected(emulator, arm)
        start(emulator, arm)
        emulator.control(arm.name, *fault)
        asked = time.monotonic()
        brake()
        assert_braked(emulator, arm.name, asked)
        took["received"] = received_stop_s(emulator, arm.name, asked) - asked


def slider_at_0_keeps_a_braked_arm_stopped(emulator: EmulatorProcess, arm: UrArm) -> None:
    arm.brake()
    emulator.control(arm.name, "slider", 0.0)
    with pytest.raises(ArmError, match=f"arm {arm.name}: not moved: speed slider: at 0 %"):
        arm.connect()
    with pytest.raises(MotionStopped):
        arm.start_move(HOME, SPEED, ACCELERATION)
    emulator.control(arm.name, "slider", 1.0)
    arm.connect()
    go(arm, AWAY)


# -- faults -----------------------------------------------------------------------------------------------------------

PUSHED: dict[str, tuple[tuple[Any, ...] | None, type[ArmError], float]] = {
    "fin": (("drop", "rtde", "fin"), LinkLost, 0.0),
    "rst": (("drop", "rtde", "rst"), LinkLost, 0.0),
    "silent": (("fault", "rtde", "silent"), LinkLost, KNOWN_WITHIN_S),
    "all silent": (("fault", "*", "silent"), LinkLost, KNOWN_WITHIN_S),
    "killed": (None, LinkLost, 0.0),
    "protective": (("protective", "now"), ProtectiveStop, 0.0),
}
PUSHED_AT_ONCE = {
    "left": ["silent"],
    "right": ["all silent"],
    "left2": ["fin", "protective"],
    "right2": ["rst", "killed"],
}


def test_a_fault_is_pushed_before_it_is_diagnosed(emulator: EmulatorProcess, drivers: dict[str, UrArm]) -> None:
    in_parallel(faults_are_pushed, [(emulator, drivers[name], faults) for name, faults in PUSHED_AT_ONCE.items()])


def faults_are_pushed(emulator: EmulatorProcess, arm: UrArm, faults: list[str]) -> None:
    for fault in faults:
        fault_is_pushed(emulator, arm, fault)


def fault_is_pushed(emulator: EmulatorProcess, arm: UrArm, fault: str) -> None:
    for took in attempts(told=PUSHED[fault][2] + TOLD_WITHIN_S):
        connected(emulator, arm)
        heard = Heard(arm)
        took["told"] = told_of(emulator, arm, fault, heard)
    arm.connect()
    go(arm, AWAY)
    emulator.control(arm.name, "drop", "rtde", "rst")
    until(lambda: len(heard.faults) == 2, "the first doubt after the next connect is told")


def told_of(emulator: EmulatorProcess, arm: UrArm, fault: str, heard: Heard) -> float:
    """Inject a fault during a motion and check what is heard, raised and done; return when it was heard [s]."""
    command, error, _ = PUSHED[fault]
    start(emulator, arm)
    pid = sure(arm.worker_pid)
    began_s = time.monotonic()
    if command is None:
        os.kill(pid, signal.SIGKILL)
    else:
        emulator.control(arm.name, *command)
    with pytest.raises(error):
        arm.wait_settled(PATIENT_S)
    raised_s = time.monotonic()
    heard_s, told = heard.first()
    assert type(told) is error
    assert str(told).startswith(f"arm {arm.name}: ")
    assert heard_s <= raised_s
    repair(emulator, arm.name)
    assert_braked(emulator, arm.name, began_s)
    assert len(heard.faults) == 1
    return heard_s - began_s


def worker_that_does_not_run_is_a_fault(emulator: EmulatorProcess, arm: UrArm) -> None:
    for took in attempts(told=KNOWN_WITHIN_S + TOLD_WITHIN_S, received=COMMANDED_WITHIN_S):
        connected(emulator, arm)
        heard = Heard(arm)
        start(emulator, arm)
        began_s = time.monotonic()
        os.kill(sure(arm.worker_pid), signal.SIGSTOP)
        heard_s, told = heard.first()
        assert isinstance(told, LinkLost | HostStalled)
        asked_s = time.monotonic()
        arm.brake()
        assert_braked(emulator, arm.name, began_s)
        took.update(told=heard_s - began_s, received=received_stop_s(emulator, arm.name, began_s) - asked_s)
        with pytest.raises(LinkLost, match="seen at rest"):
            arm.wait_settled(PATIENT_S)
    arm.connect()
    go(arm, AWAY)


def test_a_stall_of_this_computer_is_named(emulator: EmulatorProcess, drivers: dict[str, UrArm]) -> None:
    """The worker does not run until the watchdog has expired, but not long enough for other faults."""
    drivers["right"].disconnect()
    with driven("right", UrSettings(host=HOSTS["right"], watchdog_hz=10.0)) as arm:
        for took in attempts(frozen=FROZEN_S):
            connected(emulator, arm)
            heard = Heard(arm)
            start(emulator, arm)
            began_s = time.monotonic()
            took["frozen"] = freeze_until_stopped(emulator, arm)
            with pytest.raises((HostStalled, LinkLost)) as raised:
                arm.wait_settled(PATIENT_S)
            if "or this computer stood still meanwhile" in str(raised.value):
                took["frozen"] = math.inf  # it was frozen while it waited for an answer: either may have been late
        text = r"arm right: this computer was silent for 0.* nothing is wrong at the arm"
        assert re.match(text, str(raised.value))
        assert type(raised.value) is type(heard.first()[1]) is HostStalled
        assert_braked(emulator, "right", began_s)
        gaps = arm.heartbeat_gaps()
        assert gaps.late >= 1
        assert gaps.longest_s > 0.08  # the worker may see two states of 8 ms less of it than the controller
        assert any("heartbeats: this computer was late" in note for note in arm.warnings())
        arm.connect()
        go(arm, AWAY)


def freeze_until_stopped(emulator: EmulatorProcess, arm: UrArm) -> float:
    """Let the arm's worker not run until the controller has ended its program; return for how long [s]."""
    frozen_s = time.monotonic()
    os.kill(sure(arm.worker_pid), signal.SIGSTOP)
    until(lambda: emulator.control(arm.name, "status")["runtime_state"] != "PLAYING", "the watchdog expires")
    os.kill(sure(arm.worker_pid), signal.SIGCONT)
    return time.monotonic() - frozen_s


APPLICATION = """
import sys
from tests.drivers.arms.emulated_ur_cell import ACCELERATION, AWAY, FAR, HOME, SPEED, driven

with driven(sys.argv[1]) as arm:
    arm.connect()
    far = FAR if abs(arm.state().q - FAR).max() > abs(arm.state().q - HOME).max() else HOME
    arm.start_move(far, SPEED * 0.3, ACCELERATION)
    print("moving", flush=True)
    try:
        arm.wait_settled(60.0)
    except Exception as error:
        print(type(error).__name__, flush=True)
"""


def suspended_application_does_not_leave_its_arm_moving(emulator: EmulatorProcess, arm: UrArm) -> None:
    arm.disconnect()
    name = arm.name
    with application(APPLICATION, name) as (started, says):
        assert says("the motion") == "moving\n"
        until(lambda: not at_rest(emulator, name), "the arm moves")
        suspended_s = time.monotonic()
        started.send_signal(signal.SIGSTOP)
        assert_braked(emulator, name, suspended_s)
        started.send_signal(signal.SIGCONT)
        assert says("what it notices") == "HostStalled\n"
        started.wait(PATIENT_S)


# -- what the controller says -----------------------------------------------------------------------------------------


def paused_program_of_somebody_else_is_left_alone(emulator: EmulatorProcess, arm: UrArm) -> None:
    arm.disconnect()
    emulator.control(arm.name, "foreign", "paused")
    until(lambda: emulator.control(arm.name, "status")["runtime_state"] == "PAUSED", "the program is paused")
    with pytest.raises(ArmError, match=rf"arm {arm.name}: not moved: program: .* is paused"):
        arm.connect()
    assert emulator.control(arm.name, "status")["runtime_state"] == "PAUSED"
    emulator.control(arm.name, "foreign", "off")
    until(lambda: emulator.control(arm.name, "status")["runtime_state"] == "STOPPED", "the program has ended")


def test_a_slider_that_is_moved_during_a_motion_is_no_fault(
    emulator: EmulatorProcess, drivers: dict[str, UrArm]
) -> None:
    arms = [drivers[name] for name in ("left", "right")]
    in_parallel(connected, [(emulator, arm) for arm in arms])
    chosen = [(emulator, arm, Heard(arm)) for arm in arms]
    in_parallel(slider_to_zero, chosen)
    emulator.control("*", "pace", 4.0)  # what is left of the motion is nothing to wait for
    try:
        in_parallel(slider_up_again, chosen)
    finally:
        emulator.control("*", "pace", 1.0)


def slider_to_zero(emulator: EmulatorProcess, arm: UrArm, heard: Heard) -> None:
    start(emulator, arm, SPEED)
    emulator.control(arm.name, "slider", 0.0)
    with pytest.raises(ArmTimeout, match=f"arm {arm.name}: .* stands, because the speed slider is at 0 %"):
        arm.wait_settled(1.6)  # a motion that stands at full speed is a fault after 1 s
    state = arm.state()
    assert (state.speed_fraction, state.ready, state.moving) == (0.0, True, True)
    assert heard.faults == []


def slider_up_again(emulator: EmulatorProcess, arm: UrArm, heard: Heard) -> None:
    emulator.control(arm.name, "slider", 0.5)
    arm.wait_settled(PATIENT_S)
    assert arm.state().speed_fraction == 0.5
    assert heard.faults == []
    emulator.control(arm.name, "slider", 0.0)
    with pytest.raises(ArmError, match=f"arm {arm.name}: the speed slider is at 0 %"):
        arm.start_move(AWAY, SPEED, ACCELERATION)


def local_control_is_named_when_a_stop_is_refused(emulator: EmulatorProcess, arm: UrArm) -> None:
    start(emulator, arm)
    asked = time.monotonic()
    emulator.control(arm.name, "remote", "off")
    with pytest.raises(
        LinkLost, match=rf"arm {arm.name}: its stop was not confirmed: .*the pendant is in local control"
    ):
        arm.brake()
    assert_braked(emulator, arm.name, asked)  # its program still obeys
    with pytest.raises(NotInRemoteControl, match="from Local to Remote"):
        arm.connect()


def local_control_is_named_after_a_stop(emulator: EmulatorProcess, arm: UrArm) -> None:
    start(emulator, arm)
    arm.stop()
    emulator.control(arm.name, "remote", "off")
    with pytest.raises(NotInRemoteControl, match=f"arm {arm.name}: the pendant is in local control"):
        arm.start_move(HOME, SPEED, ACCELERATION)


def asked_about_joint_positions(emulator: EmulatorProcess, arm: UrArm) -> None:
    moves = emulator.control(arm.name, "status")["moves"]
    rows = np.vstack([HOME, AWAY, HOME + 7.0, FAR])
    assert arm.refused_by_controller(rows).tolist() == [False, False, True, False]
    assert arm.refused_by_controller(np.tile(HOME, (45, 1))).tolist() == [False] * 45
    assert arm.refused_by_controller(np.empty((0, 6))).shape == (0,)
    assert emulator.control(arm.name, "status")["moves"] == moves
    arm.brake()
    with pytest.raises(MotionStopped):
        arm.refused_by_controller(rows)


# -- four arms at a time, because each of these episodes mostly waits --------------------------------------------------


def refusal_brakes_without_a_thread(emulator: EmulatorProcess, arm: UrArm) -> None:
    """On a busy computer the thread that brakes may begin a quarter of a second later."""
    start(emulator, arm)
    since_s = time.monotonic()
    arm.refuse_motion()
    assert_braked(emulator, arm.name, since_s)
    with pytest.raises(MotionStopped, match="connect again"):
        arm.wait_settled(PATIENT_S)
    arm.brake()
    arm.connect()
    go(arm, AWAY)


def refusal_does_not_wait_for_a_worker_that_reads_nothing(emulator: EmulatorProcess, arm: UrArm) -> None:
    pid = sure(arm.worker_pid)
    os.kill(pid, signal.SIGSTOP)
    try:
        began_s = time.monotonic()
        for _ in range(MORE_THAN_A_PIPE_TAKES):
            arm.refuse_motion()
        assert time.monotonic() - began_s < PATIENT_S
        with suppress(LinkLost):  # the worker takes no message, and is killed
            arm.brake()
        until(lambda: at_rest(emulator, arm.name), "the arm has braked")
    finally:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


EPISODES: dict[str, list[Episode]] = {
    "left": [
        asked_about_joint_positions, refusal_brakes_without_a_thread, slider_at_0_keeps_a_braked_arm_stopped,
        paused_program_of_somebody_else_is_left_alone, refusal_does_not_wait_for_a_worker_that_reads_nothing,
    ],
    "right": [
        suspended_application_does_not_leave_its_arm_moving, asked_about_joint_positions,
        brake_without_its_open_line, local_control_is_named_after_a_stop,
        unconfirmed_brake_says_so_and_stops_all_the_same, local_control_is_named_when_a_stop_is_refused,
        worker_that_does_not_run_is_a_fault, refusal_brakes_without_a_thread,
    ],
}  # fmt: skip


def test_of_each_arm(emulator: EmulatorProcess, drivers: dict[str, UrArm]) -> None:
    of_each_arm(emulator, drivers, EPISODES, connected)
