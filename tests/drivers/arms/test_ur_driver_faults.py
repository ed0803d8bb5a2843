"""Faults of a UR arm before, during and after a motion, with the real client: one error, arm at rest, recovery."""

from __future__ import annotations

import os
import re
import signal
import threading
import time
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np
import pytest

from drivers.arms.protocol import ArmError, ArmTimeout, EmergencyStop, LinkLost, MotionStopped, ProtectiveStop
from drivers.arms.ur import UrArm
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import EmulatorProcess
from tests.at_once import in_parallel
from tests.drivers.arms.emulated_ur_cell import (
    ACCELERATION,
    AWAY,
    FAR,
    FOUR_HOSTS,
    HOME,
    PATIENT_S,
    SPEED,
    UNHURRIED,
    Episode,
    application,
    assert_braked,
    assert_stays_at_rest,
    at_home,
    driven,
    go,
    is_stall,
    no_fault_set,
    of_each_arm,
    repair,
    set_out,
)
from tests.latency import attempts
from tests.sure import sure
from tests.waiting import until

pytestmark = pytest.mark.waits

_BROKEN = r"its RTDE client crashed \(signal (6|11)(: .*)?\); possible: a malformed packet came|the RTDE link broke"
"""A client that crashes while it tells of a crash may leave no last words."""
MALFORMED = {
    "size 0": ("000055", _BROKEN),
    "size 2": ("000255", _BROKEN),
    "no state": ("000455", r"a malformed packet came from the controller: its state has no safety mode"),
}
LATE = {
    "commands": ((0.1,), "its controller took .* for an answer .* so the controller's watchdog .* stopped its program"),
    "all": (
        (0.2, 0.1),
        "the dashboard, over which|the network is late|the network lost messages|for an answer|RTDE link|no state came",
    ),
}
"""Delay [s] and share of lost messages of a network, and what is said of it."""
FALSE_CAUSES = ("was stopped on the pendant;", "close other programs", "driver process")

FAULTS: dict[str, tuple[tuple[Any, ...], type[ArmError]]] = {
    "fin": (("drop", "rtde", "fin"), LinkLost),
    "rst": (("drop", "rtde", "rst"), LinkLost),
    "refused": (("drop", "rtde", "fin", 1.5), LinkLost),
    "silence": (("fault", "rtde", "silent"), LinkLost),
    "all silent": (("fault", "*", "silent"), LinkLost),
    "protective": (("protective", "now"), ProtectiveStop),
    "emergency": (("estop",), EmergencyStop),
}


LONGEST_DOUBT_S = 12.0
"""A wait that ended with a timeout after this would have missed the fault."""


def inject(emulator: EmulatorProcess, name: str, fault: str) -> type[ArmError]:
    command, error = FAULTS[fault]
    emulator.control(name, *command)
    return error


def go_again(emulator: EmulatorProcess, arm: UrArm) -> None:
    """After a person has repaired it, the next connect and a motion succeed."""
    repair(emulator, arm.name)
    assert_stays_at_rest(emulator, arm.name)
    moves = emulator.control(arm.name, "status")["moves"]
    with no_fault_set():
        arm.connect()
        assert emulator.control(arm.name, "status")["moves"] == moves, "connecting moved the arm"
        go(arm, HOME)


def fault_during_a_motion(emulator: EmulatorProcess, arm: UrArm, *, fault: str) -> None:
    set_out(arm)
    error = inject(emulator, arm.name, fault)
    with pytest.raises(error, match=f"arm {arm.name}: "):
        arm.wait_settled(LONGEST_DOUBT_S)
    assert np.abs(np.array(emulator.control(arm.name, "status")["q"]) - FAR).max() > 0.3, "it went all the way"
    assert_stays_at_rest(emulator, arm.name)
    with pytest.raises(ArmError):
        arm.start_move(HOME, SPEED, ACCELERATION)
    assert_stays_at_rest(emulator, arm.name)
    go_again(emulator, arm)


def fault_before_a_motion(emulator: EmulatorProcess, arm: UrArm, *, fault: str) -> None:
    moves = emulator.control(arm.name, "status")["moves"]
    error = inject(emulator, arm.name, fault)
    with pytest.raises(error, match=f"arm {arm.name}: "):
        go(arm, AWAY)  # a link may break so late that only waiting detects it
    assert emulator.control(arm.name, "status")["moves"] == moves
    assert_stays_at_rest(emulator, arm.name)
    go_again(emulator, arm)


def fault_after_a_motion(emulator: EmulatorProcess, arm: UrArm, *, fault: str) -> None:
    go(arm, AWAY)
    error = inject(emulator, arm.name, fault)
    if error is LinkLost:
        with pytest.raises(LinkLost):  # after states that came before the link broke
            until(lambda: not arm.state(), "the broken link is seen")
    else:
        until(lambda: not arm.state().ready, "the fault is seen")
        assert "stop: " in arm.state().reason
        # a person clears it before the application asks: it is recorded all the same
        repair(emulator, arm.name)
        assert not arm.state().ready
        with pytest.raises(error):
            arm.start_move(HOME, SPEED, ACCELERATION)
    assert_stays_at_rest(emulator, arm.name)
    go_again(emulator, arm)


def malformed_packet(emulator: EmulatorProcess, arm: UrArm, *, kind: str) -> None:
    packet, words = MALFORMED[kind]
    set_out(arm)
    emulator.control(arm.name, "send", "rtde", packet)
    assert_true_cause(arm, words)
    go_again(emulator, arm)


def late_network(emulator: EmulatorProcess, arm: UrArm, *, kind: str) -> None:
    arm.disconnect()
    network, words = LATE[kind]
    with ExitStack() as stack:
        watched = stack.enter_context(driven(arm.name, UrSettings(host=FOUR_HOSTS[arm.name], watchdog_hz=5.0)))
        stack.callback(emulator.control, arm.name, "network", 0)
        watched.connect()
        go(watched, AWAY)
        emulator.control(arm.name, "network", *network)
        assert_true_cause(watched, words)


def assert_true_cause(arm: UrArm, words: str) -> None:
    """Assert that the motion, or one of the next, ends with a cause that was seen, and none that was not."""

    def go_to_and_fro() -> None:
        for goal in (HOME, AWAY) * 10:
            arm.wait_settled(LONGEST_DOUBT_S)
            arm.start_move(goal, SPEED, ACCELERATION)

    with pytest.raises(ArmError) as raised:
        go_to_and_fro()
    if not (named := re.search(words, str(raised.value))) and is_stall(raised.value):
        raise raised.value
    assert named, raised.value
    assert not [cause for cause in FALSE_CAUSES if cause in str(raised.value)], raised.value


def protective_stop_stays(emulator: EmulatorProcess, arm: UrArm) -> None:
    """A protective stop is never released by the program."""
    emulator.control(arm.name, "protective", "travel", 0.3)
    arm.start_move(FAR, UNHURRIED, ACCELERATION)
    with pytest.raises(ProtectiveStop, match="see what stopped it"):
        arm.wait_settled(PATIENT_S)
    for _ in range(2):
        with pytest.raises(ProtectiveStop, match="PROTECTIVE_STOP"):
            arm.connect()
        assert emulator.control(arm.name, "status")["safety_mode"] == "PROTECTIVE_STOP"
    received = emulator.control(arm.name, "received")
    assert not [line for line in received if line.startswith(("unlock", "play", "power", "brake", "close", "restart"))]
    go_again(emulator, arm)


def stop_on_the_pendant(emulator: EmulatorProcess, arm: UrArm) -> None:
    """It ends the motion and the job."""
    set_out(arm)
    emulator.control(arm.name, "power-off")
    with pytest.raises(ArmError):
        arm.wait_settled(PATIENT_S)
    go_again(emulator, arm)


def signal_to_the_worker(emulator: EmulatorProcess, arm: UrArm, *, number: signal.Signals) -> None:
    """The client may crash or hang when its link breaks at the wrong moment: signals simulate that."""
    set_out(arm)
    os.kill(sure(arm.worker_pid), number)
    # the application has not looked yet: the controller stops the arm by itself
    until(lambda: not emulator.control(arm.name, "status")["moving"], "the watchdog stops the arm")
    assert np.abs(np.array(emulator.control(arm.name, "status")["q"]) - FAR).max() > 0.3
    with pytest.raises(LinkLost, match="seen at rest"):
        arm.wait_settled(0.2)
    go_again(emulator, arm)


APPLICATION = """
import sys, threading
from tests.drivers.arms.emulated_ur_cell import ACCELERATION, FAR, UNHURRIED, driven

with driven(sys.argv[1]) as arm:
    arm.connect()
    arm.start_move(FAR, UNHURRIED, ACCELERATION)
    print(arm.worker_pid, flush=True)
    threading.Event().wait(60.0)
"""


def kill_the_application(emulator: EmulatorProcess, arm: UrArm, *, with_worker: bool) -> None:
    """The arm comes to rest when the application is killed during a motion, with its worker process or without it."""
    arm.disconnect()
    name = arm.name
    with application(APPLICATION, name) as (started, says):
        worker = int(says("the worker of the application"))
        until(lambda: abs(emulator.control(name, "status")["q"][0] - HOME[0]) > 0.1, "the arm moves")
        started.kill()
        if with_worker:
            os.kill(worker, signal.SIGKILL)
        started.wait(PATIENT_S)
        until(lambda: not emulator.control(name, "status")["moving"], "the arm rests")
    until(lambda: emulator.control(name, "status")["runtime_state"] == "STOPPED", "the program has ended")
    status = emulator.control(name, "status")
    assert np.abs(np.array(status["q"]) - FAR).max() > 0.3, "it went all the way"
    until(lambda: not alive(worker), "the worker is gone")
    assert_stays_at_rest(emulator, name)
    arm.connect()
    go(arm, HOME)


def alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as stat:
            return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def stop_from_another_thread(emulator: EmulatorProcess, arm: UrArm) -> None:
    set_out(arm)
    stopper = threading.Thread(target=arm.stop)
    stopper.start()
    with pytest.raises(MotionStopped, match=f"arm {arm.name}: "):
        arm.wait_settled(PATIENT_S)
    stopper.join(PATIENT_S)
    assert not stopper.is_alive()
    state = arm.state()
    assert not state.moving
    assert np.abs(state.q - FAR).max() > 0.3
    with pytest.raises(MotionStopped):
        arm.wait_settled(PATIENT_S)
    assert_stays_at_rest(emulator, arm.name)
    go(arm, HOME)


def slow_start(emulator: EmulatorProcess, arm: UrArm) -> None:
    """A slow start of the program is waited for."""
    arm.disconnect()
    emulator.control(arm.name, "start-delay", 0.5)
    arm.connect()
    go(arm, AWAY)
    arm.stop()
    go(arm, HOME)  # the program is uploaded again
    assert_stops_with_its_driver(emulator, arm)


def slower_start(emulator: EmulatorProcess, arm: UrArm) -> None:
    """A program that does not start within the time limit is reported."""
    arm.disconnect()
    emulator.control(arm.name, "start-delay", 30.0)
    with pytest.raises(ArmTimeout, match="did not start within 5 s"):
        arm.connect()
    repair(emulator, arm.name)
    arm.connect()
    go(arm, AWAY)
    assert_stops_with_its_driver(emulator, arm)


def late_start(emulator: EmulatorProcess, arm: UrArm) -> None:
    """A program that starts after the time limit is ended by the next connect."""
    arm.disconnect()
    emulator.control(arm.name, "fault", "script", "silent")
    with pytest.raises(ArmTimeout, match=f"arm {arm.name}: its control program did not start within 5 s"):
        arm.connect()
    emulator.control(arm.name, "fault", "script", "none")
    until(lambda: emulator.control(arm.name, "status")["runtime_state"] == "PLAYING", "the program starts after all")
    arm.connect()
    assert arm.state().ready
    assert_stops_with_its_driver(emulator, arm)


def assert_stops_with_its_driver(emulator: EmulatorProcess, arm: UrArm) -> None:
    arm.disconnect()
    status = emulator.control(arm.name, "status")
    assert (status["runtime_state"], status["moving"]) == ("STOPPED", False)


def slower_than_the_wait(emulator: EmulatorProcess, arm: UrArm) -> None:
    """It goes on."""
    arm.start_move(AWAY, SPEED * 0.1, ACCELERATION)
    with pytest.raises(ArmTimeout):
        arm.wait_settled(0.2)
    with pytest.raises(ArmError, match="still moving"):
        arm.start_move(HOME, SPEED, ACCELERATION)
    np.testing.assert_allclose(arm.wait_settled(PATIENT_S).q, AWAY, atol=1e-6)
    go(arm, HOME)


def dashboard_that_is_dead_when_the_link_breaks(emulator: EmulatorProcess, arm: UrArm) -> None:
    """Only the watchdog is left to stop the arm."""
    set_out(arm)
    emulator.control(arm.name, "fault", "dashboard", "refuse")
    inject(emulator, arm.name, "rst")
    with pytest.raises(LinkLost):
        arm.wait_settled(PATIENT_S)
    until(lambda: not emulator.control(arm.name, "status")["moving"], "the watchdog stops the arm")
    assert np.abs(np.array(emulator.control(arm.name, "status")["q"]) - FAR).max() > 0.3
    with pytest.raises(LinkLost):
        arm.connect()
    go_again(emulator, arm)


def rate_of_the_watchdog(emulator: EmulatorProcess, arm: UrArm) -> None:
    """At 1 Hz the controller stops a program later after the worker was killed than at 5 Hz."""
    arm.disconnect()
    with driven(arm.name, UrSettings(host=FOUR_HOSTS[arm.name], watchdog_hz=1.0)) as slow:
        assert stopped_after_kill_s(emulator, slow) > 0.5  # the last kick is 0.2 s old, or more on a busy computer
    with driven(arm.name, UrSettings(host=FOUR_HOSTS[arm.name], watchdog_hz=5.0)) as quick:
        for took in attempts(stopped=0.4):
            took["stopped"] = stopped_after_kill_s(emulator, quick)


def stopped_after_kill_s(emulator: EmulatorProcess, arm: UrArm) -> float:
    """Connect, kill the worker during a motion, and return when the controller stopped its program [s]."""
    at_home(emulator, arm)
    arm.start_move(FAR, UNHURRIED, ACCELERATION)
    until(lambda: emulator.control(arm.name, "status")["moving"], "the arm moves")
    killed_s = time.monotonic()
    os.kill(sure(arm.worker_pid), signal.SIGKILL)
    until(lambda: not emulator.control(arm.name, "status")["moving"], "the watchdog stops the arm")
    (stop,) = emulator.control(arm.name, "stops", killed_s)
    assert stop["ideal_s"] > 0.0, "it went all the way"
    return float(stop["received_s"]) - killed_s


# -- four arms at a time, because each of these episodes mostly waits --------------------------------------------------


def before(fault: str) -> Episode:
    return partial(fault_before_a_motion, fault=fault)


def during(fault: str) -> Episode:
    return partial(fault_during_a_motion, fault=fault)


def after(fault: str) -> Episode:
    return partial(fault_after_a_motion, fault=fault)


def killed(number: signal.Signals) -> Episode:
    return partial(signal_to_the_worker, number=number)


ROUNDS: dict[str, dict[str, list[Episode]]] = {
    "of links": {
        "left": [
            during("all silent"), after("all silent"), before("silence"), partial(late_network, kind="commands"),
            partial(malformed_packet, kind="size 0"), partial(malformed_packet, kind="size 2"), during("refused"),
            before("rst"), during("fin"), after("fin"),
        ],
        "right": [
            during("silence"), partial(late_network, kind="all"), dashboard_that_is_dead_when_the_link_breaks,
            partial(malformed_packet, kind="no state"), after("refused"), before("refused"), before("fin"),
            during("rst"), after("rst"),
        ],
    },
    "of arms and programs": {
        "left": [
            late_start, partial(kill_the_application, with_worker=False), killed(signal.SIGSEGV), slower_than_the_wait,
            protective_stop_stays, stop_from_another_thread, before("protective"), during("emergency"),
            after("emergency"),
        ],
        "right": [
            slower_start, rate_of_the_watchdog, partial(kill_the_application, with_worker=True), killed(signal.SIGSTOP),
            slow_start, stop_on_the_pendant, protective_stop_stays, stop_from_another_thread, before("emergency"),
            during("protective"), after("protective"),
        ],
    },
}  # fmt: skip
"""Arms of one series take the next that is left of theirs, the longest first."""


@pytest.mark.parametrize("episodes", ROUNDS.values(), ids=ROUNDS)
def test_of_each_arm(emulator: EmulatorProcess, drivers: dict[str, UrArm], episodes: dict[str, list[Episode]]) -> None:
    of_each_arm(emulator, drivers, episodes, at_home)


def test_the_other_arm_goes_on_when_one_link_breaks(emulator: EmulatorProcess, drivers: dict[str, UrArm]) -> None:
    left, right = drivers["left"], drivers["right"]
    in_parallel(at_home, [(emulator, left), (emulator, right)])
    began_s = time.monotonic()
    for driver in (left, right):
        driver.start_move(AWAY, SPEED * 0.2, ACCELERATION)
    until(lambda: float(np.abs(left.state().q - HOME).max()) > 0.02, "the left arm moves")
    inject(emulator, "left", "rst")
    np.testing.assert_allclose(right.wait_settled(PATIENT_S).q, AWAY, atol=1e-6)
    with pytest.raises(LinkLost):
        left.wait_settled(PATIENT_S)
    assert_braked(emulator, "left", began_s)
    go_again(emulator, left)
    go(right, HOME)
