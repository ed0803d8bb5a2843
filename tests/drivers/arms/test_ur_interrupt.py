"""A connection of a UR arm that a refusal of motion or a brake ends: at once, with nothing started afterwards."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest

from drivers.arms.protocol import LinkLost, MotionStopped
from drivers.arms.ur import UrArm
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import EmulatorProcess
from tests.drivers.arms.emulated_ur_cell import (
    AWAY,
    FOUR_HOSTS,
    PATIENT_S,
    Episode,
    driven,
    go,
    of_each_arm,
    pause,
    repair,
)
from tests.latency import attempts
from tests.waiting import until

pytestmark = pytest.mark.waits

ENDS_WITHIN_S = 0.5
DELAYS_S = (0.05, 0.3, 0.6, 1.0)
"""From the upload of a program to its start. A stop before the start does not keep it from starting."""
TIMES = 2

Refuse = Callable[[UrArm], None]
REFUSE: dict[str, Refuse] = {"refuse_motion": UrArm.refuse_motion, "brake": UrArm.brake}


def make_ready(emulator: EmulatorProcess, arm: UrArm) -> None:
    repair(emulator, arm.name)
    arm.disconnect()


def interrupted(arm: UrArm, refuse: Refuse, when: Callable[[], object]) -> float:
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


def in_a_program_start(emulator: EmulatorProcess, arm: UrArm, *, how: str, delay_s: float) -> None:
    """Its process is killed while its program is about to start; the end of the driver waits for it, and ends it."""
    for _ in range(TIMES):
        for took in attempts(ended=ENDS_WITHIN_S, disconnected=delay_s + ENDS_WITHIN_S):
            emulator.control(arm.name, "start-delay", delay_s)

            def uploaded() -> None:
                until(lambda: arm._program.awaited, "it is being uploaded")
                pause(0.02)

            took["ended"] = interrupted(arm, REFUSE[how], uploaded)
            began_s = time.monotonic()
            close(arm)
            took["disconnected"] = time.monotonic() - began_s
            assert_nothing_runs(emulator, arm, delay_s + 0.1)
    emulator.control(arm.name, "start-delay", 0.05)
    arm.connect()
    go(arm, AWAY)


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
    """A program that was sent before the refusal is read and starts later: it moves nothing, and is ended."""
    emulator.control(arm.name, "fault", "script", "silent")
    for took in attempts(ended=ENDS_WITHIN_S):

        def sent() -> None:
            until(lambda: arm._program.awaited, "it is being uploaded")
            pause(0.2)

        took["ended"] = interrupted(arm, UrArm.refuse_motion, sent)
    moves = emulator.control(arm.name, "status")["moves"]
    with ThreadPoolExecutor(1) as pool:
        ending = pool.submit(close, arm)
        pause(0.1)
        emulator.control(arm.name, "fault", "script", "none")
        ending.result()
    assert emulator.control(arm.name, "status")["moves"] == moves
    assert_nothing_runs(emulator, arm, 0.2)


def not_seen_to_start(emulator: EmulatorProcess, arm: UrArm) -> None:
    """The end waits for it as long as for a start, and says so; the program ends itself when it starts."""
    emulator.control(arm.name, "start-delay", 3.0)
    status = partial(emulator.control, arm.name, "status")
    with driven(arm.name, UrSettings(host=FOUR_HOSTS[arm.name], startup_timeout=1.0)) as hurried:
        interrupted(hurried, UrArm.refuse_motion, lambda: until(lambda: status()["starting"], "uploaded"))
        with pytest.raises(LinkLost, match=r"was not seen to start and end within 1 s .*; look at the pendant"):
            hurried.disconnect()
        until(lambda: not status()["starting"], "it starts after all")
        until(lambda: status()["runtime_state"] == "STOPPED", "its watchdog ends it")
        emulator.control(arm.name, "start-delay", 0.05)
        hurried.connect()  # a program that is seen to run ends the doubt


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
            close(arm)
        assert_nothing_runs(emulator, arm, 0.15)


def close(arm: UrArm) -> None:
    """Disconnect. A program whose process was killed between its announcement and its upload is never seen: the next
    connection has one that is."""
    try:
        arm.disconnect()
    except LinkLost as error:
        assert "was not seen to start and end within" in str(error)  # noqa: PT017 - most often nothing is raised
        arm.connect()
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


def start(how: str, delay_s: float) -> Episode:
    return partial(in_a_program_start, how=how, delay_s=delay_s)


def silent(port: str) -> Episode:
    return partial(while_a_port_is_silent, port=port)


EPISODES: dict[str, list[Episode]] = {
    "left": [
        partial(at_any_moment, again=False), partial(at_any_moment, again=True), silent("dashboard"),
        *(start("refuse_motion", DELAYS_S[k]) for k in (0, 1, 3)),
    ],
    "right": [
        partial(at_any_moment, again=False), partial(at_any_moment, again=True), start("brake", DELAYS_S[2]),
        silent("primary"), silent("rtde"), not_seen_to_start, while_programs_are_not_read,
    ],
}  # fmt: skip


def test_of_each_arm(emulator: EmulatorProcess, drivers: dict[str, UrArm]) -> None:
    of_each_arm(emulator, drivers, EPISODES, make_ready)
