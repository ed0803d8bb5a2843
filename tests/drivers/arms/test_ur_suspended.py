"""A program that was suspended says so, and blames neither the network nor an arm: suspensions of a real process."""

from __future__ import annotations

import random
import signal

import pytest

from drivers.emulators.ur_controller import EmulatorProcess
from tests.at_once import in_parallel
from tests.drivers.arms.emulated_ur_cell import FOUR_HOSTS, PATIENT_S, application, assert_stays_at_rest, pause
from tests.waiting import until

pytestmark = pytest.mark.waits

SUSPENDED_S = 2.0
TIMES = 2
"""Of each of four programs: eight suspensions."""

APPLICATION = """
import sys
import time
from drivers.arms.protocol import ArmError, ArmTimeout
from tests.drivers.arms.emulated_ur_cell import ACCELERATION, FAR, HOME, SPEED, driven

def report(error):
    sys.stdout.write(f"{type(error).__name__} {error}\\n")  # at once: two threads report
    sys.stdout.flush()

def settle(arm):
    while True:  # in short rounds, as jobs do
        try:
            return arm.wait_settled(1.0)
        except ArmTimeout:
            arm.state()

resting = sys.argv[1].endswith("2")
with driven(sys.argv[1]) as arm:
    arm.watch(report)
    while True:
        try:
            arm.connect()
            for goal in (FAR, HOME):
                if resting:  # about to begin the next motion
                    sys.stdout.write("resting\\n")
                    sys.stdout.flush()
                    time.sleep(1.0)
                arm.confirm()
                arm.start_move(goal, SPEED * 0.3, ACCELERATION)
                if not resting:
                    sys.stdout.write("moving\\n")
                    sys.stdout.flush()
                settle(arm)
        except ArmError as error:
            report(error)
"""


def test_a_program_that_was_suspended_says_so(emulator: EmulatorProcess) -> None:
    in_parallel(suspended_again_and_again, [(emulator, name) for name in FOUR_HOSTS])


def suspended_again_and_again(emulator: EmulatorProcess, name: str) -> None:
    moments, resting = random.Random(name), name.endswith("2")
    with application(APPLICATION, name) as (started, says):
        try:
            for _ in range(TIMES):
                assert says("the motion") == ("resting\n" if resting else "moving\n")
                until(lambda: emulator.control(name, "status")["moving"] is not resting, "the arm moves, or rests")
                pause(moments.uniform(0.0, 0.5))
                started.send_signal(signal.SIGSTOP)
                pause(SUSPENDED_S)
                assert_stays_at_rest(emulator, name)  # it was stopped meanwhile
                moves = emulator.control(name, "status")["moves"]
                started.send_signal(signal.SIGCONT)
                for _ in ("the listener", "the call that waited"):
                    assert_says_so(says("what it notices"), name)
                assert emulator.control(name, "status")["moves"] == moves, "it moved unasked"
        finally:
            started.send_signal(signal.SIGCONT)
            started.terminate()
            started.wait(PATIENT_S)


def assert_says_so(line: str, name: str) -> None:
    assert line.startswith(f"HostStalled arm {name}: this "), line
    assert "silent for" in line
    assert "nothing is wrong at the arm" in line
    for blamed in ("network", "link", "dashboard", "controller is on"):
        assert blamed not in line
