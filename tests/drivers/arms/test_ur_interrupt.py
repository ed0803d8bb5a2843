"""A connection of a UR arm that a refusal of motion or a brake ends: at once, with nothing started afterwards."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from drivers.arms.protocol import ArmError, MotionStopped
from drivers.arms.ur import UrArm
from drivers.emulators.ur_controller import EmulatorProcess
from tests.drivers.arms.emulated_ur_cell import (
    ACCELERATION,
    AWAY,
    FOUR_HOSTS,
    PATIENT_S,
    SPEED,
    Episode,
    drivers_of,
    emulated_cell,
    of_each_arm,
    pause,
    repair,
)
from tests.latency import attempts
from tests.waiting import until

pytestmark = pytest.mark.waits

ENDS_WITHIN_S = 0.5
HANGS_S = 1.0
"""Start of a program that is uploaded: a client waits for it in one call that nothing interrupts."""

Refuse = Callable[[UrArm], None]
REFUSE: dict[str, Refuse] = {"refuse_motion": UrArm.refuse_motion, "brake": UrArm.brake}


@pytest.fixture(scope="module")
def emulator() -> Iterator[EmulatorProcess]:
    with emulated_cell(FOUR_HOSTS) as started:
        yield started


@pytest.fixture(scope="module")
def drivers(emulator: EmulatorProcess) -> Iterator[dict[str, UrArm]]:
    with drivers_of(FOUR_HOSTS) as drivers:
        yield drivers


def make_ready(emulator: EmulatorProcess, arm: UrArm) -> None:
    repair(emulator, arm.name)
    arm.disconnect()


def interrupted(arm: UrArm, refuse: Refuse, when: Callable[[], None]) -> float:
    """Connect, refuse motion when ``when`` returns, and return how long after that the connection ended [s]."""
    asked: list[float] = []

    def interrupt() -> None:
        when()
        asked.append(time.monotonic())
        refuse(arm)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(MotionStopped, match=f"arm {arm.name}: "):
        arm.connect()
    ended_s = time.monotonic()
    thread.join(PATIENT_S)
    return ended_s - asked[0]


def assert_nothing_runs(emulator: EmulatorProcess, arm: UrArm, for_s: float) -> None:
    """Assert that no program starts any more, and that the arm has no process and can be disconnected quickly."""
    assert arm.worker_pid is None
    until_s = time.monotonic() + for_s
    moves = emulator.control(arm.name, "status")["moves"]
    while time.monotonic() < until_s:
        status = emulator.control(arm.name, "status")
        assert (status["runtime_state"], status["moves"], status["moving"]) == ("STOPPED", moves, False)
        pause(0.01)


def in_a_program_start(emulator: EmulatorProcess, arm: UrArm, *, how: str) -> None:
    """The client waits for its program in a call that cannot be interrupted: its process is killed."""
    for took in attempts(ended=ENDS_WITHIN_S, disconnected=ENDS_WITHIN_S):
        emulator.control(arm.name, "start-delay", HANGS_S)

        def uploaded() -> None:
            until(lambda: emulator.control(arm.name, "status")["connections"]["script"] > 0, "it is being uploaded")
            pause(0.1)

        took["ended"] = interrupted(arm, REFUSE[how], uploaded)
        assert_nothing_runs(emulator, arm, HANGS_S + 0.2)
        began_s = time.monotonic()
        arm.disconnect()
        took["disconnected"] = time.monotonic() - began_s
    emulator.control(arm.name, "start-delay", 0.05)
    arm.connect()
    arm.start_move(AWAY, SPEED, ACCELERATION)
    arm.wait_settled(PATIENT_S)


def while_a_port_is_silent(emulator: EmulatorProcess, arm: UrArm, *, port: str) -> None:
    for took in attempts(ended=ENDS_WITHIN_S, disconnected=ENDS_WITHIN_S):
        emulator.control(arm.name, "fault", port, "silent")
        took["ended"] = interrupted(arm, UrArm.refuse_motion, lambda: pause(0.1))
        began_s = time.monotonic()
        arm.disconnect()  # nothing was started: no word about an arm that was not seen at rest
        took["disconnected"] = time.monotonic() - began_s
        emulator.control(arm.name, "fault", port, "none")
        assert_nothing_runs(emulator, arm, 0.2)


def while_programs_are_not_read(emulator: EmulatorProcess, arm: UrArm) -> None:
    """A program that was sent before the refusal may be read and start later: it moves nothing, and is not ignored."""
    for took in attempts(ended=ENDS_WITHIN_S):
        emulator.control(arm.name, "fault", "script", "silent")
        took["ended"] = interrupted(arm, UrArm.refuse_motion, lambda: pause(0.1))
        arm.disconnect()
        moves = emulator.control(arm.name, "status")["moves"]
        emulator.control(arm.name, "fault", "script", "none")
        pause(0.2)
        status = emulator.control(arm.name, "status")
        assert (status["moves"], status["moving"]) == (moves, False)
        if status["runtime_state"] == "PLAYING":
            with pytest.raises(ArmError, match="program: a program runs, and the arm may move; stop it on the pendant"):
                arm.connect()
            arm.disconnect()
        emulator.control(arm.name, "power-off")  # ends the program
        make_ready(emulator, arm)


def at_any_moment(emulator: EmulatorProcess, arm: UrArm, *, again: bool) -> None:
    """Of a first connection, or of one after a brake. Nothing runs afterwards, and nothing has moved."""
    moments = random.Random(17)
    for _ in range(8):
        if again:
            arm.connect()
            arm.brake()
        for took in attempts(ended=ENDS_WITHIN_S):
            after_s = moments.uniform(0.0, 0.12 if again else 0.25)
            took["ended"] = ended_after(arm, after_s)
        assert_nothing_runs(emulator, arm, 0.15)
        arm.disconnect()


def ended_after(arm: UrArm, after_s: float) -> float:
    """As ``interrupted``; a connection that was quicker than the refusal is made again."""
    asked: list[float] = []

    def refuse() -> None:
        asked.append(time.monotonic())
        arm.refuse_motion()

    timer = threading.Timer(after_s, refuse)
    timer.start()
    try:
        arm.connect()
    except MotionStopped:
        ended_s = time.monotonic()
    else:
        timer.join(PATIENT_S)
        arm.disconnect()
        ended_s = asked[0] + interrupted(arm, UrArm.refuse_motion, lambda: pause(0.02))
    timer.join(PATIENT_S)
    return ended_s - asked[0]


def start(how: str) -> Episode:
    return partial(in_a_program_start, how=how)


def silent(port: str) -> Episode:
    return partial(while_a_port_is_silent, port=port)


ROUNDS: dict[str, dict[str, list[Episode]]] = {
    "starts": {
        "left": [start("refuse_motion")],
        "right": [start("brake")],
        "left2": [silent("dashboard"), silent("rtde")],
        "right2": [silent("primary"), while_programs_are_not_read],
    },
    "any moment": {
        "left": [partial(at_any_moment, again=False)],
        "right": [partial(at_any_moment, again=False)],
        "left2": [partial(at_any_moment, again=True)],
        "right2": [partial(at_any_moment, again=True)],
    },
}


@pytest.mark.parametrize("episodes", ROUNDS.values(), ids=ROUNDS)
def test_of_each_arm(emulator: EmulatorProcess, drivers: dict[str, UrArm], episodes: dict[str, list[Episode]]) -> None:
    of_each_arm(emulator, drivers, episodes, make_ready)
