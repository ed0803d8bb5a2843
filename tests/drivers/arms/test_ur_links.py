"""What a UR arm knows of its links with the real client: asked before a motion, watched at rest, and without asking."""

from __future__ import annotations

import math
import os
import signal
import time
from contextlib import suppress
from functools import partial
from typing import Any

import pytest

from drivers.arms.protocol import ArmError, LinkLost, ProtectiveStop
from drivers.arms.ur import UrArm
from drivers.emulators.ur_controller import EmulatorProcess
from tests.drivers.arms.emulated_ur_cell import (
    ACCELERATION,
    AWAY,
    HOME,
    PATIENT_S,
    SPEED,
    Episode,
    Heard,
    connected,
    go,
    of_each_arm,
    pause,
    repair,
)
from tests.latency import attempts
from tests.sure import sure
from tests.waiting import until

pytestmark = pytest.mark.waits

BUSY_S = 0.1
"""What a busy computer may add to a latency."""


# -- confirm ----------------------------------------------------------------------------------------------------------


def links_that_answer_are_confirmed_quickly(emulator: EmulatorProcess, arm: UrArm) -> None:
    for took in attempts(confirmed=0.05):
        began_s = time.monotonic()
        arm.confirm()
        took["confirmed"] = time.monotonic() - began_s
    arm.start_move(AWAY, SPEED * 0.2, ACCELERATION)
    arm.confirm()  # of an arm that moves, too
    arm.wait_settled(PATIENT_S)
    go(arm, HOME)
    emulator.control(arm.name, "drop", "dashboard", "fin")  # it is opened again at once
    arm.confirm()
    arm.stop()
    arm.confirm()  # its program has ended on purpose


UNCONFIRMED: dict[str, tuple[Any, ...] | signal.Signals] = {
    "dashboard silent": ("fault", "dashboard", "silent"),
    "dashboard refused": ("fault", "dashboard", "refuse"),
    "rtde silent": ("fault", "rtde", "silent"),
    "worker hung": signal.SIGSTOP,
    "worker killed": signal.SIGKILL,
}


def strike(emulator: EmulatorProcess, arm: UrArm, fault: tuple[Any, ...] | signal.Signals) -> None:
    if isinstance(fault, signal.Signals):
        os.kill(sure(arm.worker_pid), fault)
    else:
        emulator.control(arm.name, *fault)


def link_that_does_not_answer_is_a_fault(emulator: EmulatorProcess, arm: UrArm, *, what: str) -> None:
    for took in attempts(raised=0.3 + BUSY_S):
        connected(emulator, arm)
        heard = Heard(arm)
        strike(emulator, arm, UNCONFIRMED[what])
        began_s = time.monotonic()
        with pytest.raises(LinkLost, match=f"arm {arm.name}: "):
            arm.confirm()
        took["raised"] = time.monotonic() - began_s
        assert heard.faults
        with pytest.raises(LinkLost):
            arm.confirm()
        repair(emulator, arm.name)
    arm.disconnect()


def fault_is_no_confirmation(emulator: EmulatorProcess, arm: UrArm) -> None:
    emulator.control(arm.name, "protective", "now")
    until(lambda: not arm.state().ready, "the fault is seen")
    with pytest.raises(ProtectiveStop):
        arm.confirm()
    arm.disconnect()
    with pytest.raises(LinkLost, match="not connected"):
        arm.confirm()


# -- the dashboard at rest --------------------------------------------------------------------------------------------

LOST = {"refuse": 0.2, "silent": 0.6}


def lost_dashboard_is_noticed(emulator: EmulatorProcess, arm: UrArm, *, how: str) -> None:
    for took in attempts(told=LOST[how]):
        connected(emulator, arm)
        pause(0.15)  # the last question was answered
        heard = Heard(arm)
        began_s = time.monotonic()
        emulator.control(arm.name, "fault", "dashboard", how)
        told_s, told = heard.first()
        assert isinstance(told, LinkLost)
        assert "the dashboard, over which it is stopped, does not answer" in str(told)
        took["told"] = told_s - began_s


def stop_does_not_wait_for_the_answer_to_a_question(emulator: EmulatorProcess, arm: UrArm) -> None:
    """Questions are asked all the time; a stop among them is confirmed in the time of one answer."""
    for took in attempts(longest=0.04):
        took["longest"] = 0.0
        for number in range(10):
            connected(emulator, arm)
            pause(0.01 * number)
            began_s = time.monotonic()
            arm._stop_line.stop()
            took["longest"] = max(took["longest"], time.monotonic() - began_s)
            with suppress(ArmError):
                arm.brake()


def dashboard_that_closes_and_opens_again_is_no_fault(emulator: EmulatorProcess, arm: UrArm) -> None:
    heard = Heard(arm)
    for _ in range(5):
        emulator.control(arm.name, "drop", "dashboard", "fin")
        until(lambda: emulator.control(arm.name, "status")["connections"]["dashboard"] == 1, "it is open again")
        pause(0.2)  # a question was answered
    assert heard.faults == []


# -- live -------------------------------------------------------------------------------------------------------------


def live_is_fresh_and_knows_a_motion(emulator: EmulatorProcess, arm: UrArm) -> None:
    until(lambda: arm.live().age_s < 0.3, "its state is fresh")  # the first one comes some time after the connection
    until(lambda: not arm.live().moving, "it rests")
    arm.start_move(AWAY, SPEED * 0.3, ACCELERATION)
    assert arm.live().moving
    arm.wait_settled(PATIENT_S)
    until(lambda: not arm.live().moving, "it rests")
    go(arm, HOME)
    arm.disconnect()
    live = arm.live()
    assert (live.age_s, live.moving) == (math.inf, False)


def live_grows_old(emulator: EmulatorProcess, arm: UrArm, *, what: str) -> None:
    strike(emulator, arm, UNCONFIRMED[what])
    until(lambda: arm.live().age_s > 0.5, "it is old")
    repair(emulator, arm.name)
    arm.disconnect()


# -- four arms at a time ----------------------------------------------------------------------------------------------


def unconfirmed(what: str) -> Episode:
    return partial(link_that_does_not_answer_is_a_fault, what=what)


def lost(how: str) -> Episode:
    return partial(lost_dashboard_is_noticed, how=how)


def old(what: str) -> Episode:
    return partial(live_grows_old, what=what)


EPISODES: dict[str, list[Episode]] = {
    "left": [
        links_that_answer_are_confirmed_quickly, unconfirmed("dashboard refused"), unconfirmed("rtde silent"),
        unconfirmed("worker killed"), lost("refuse"), live_is_fresh_and_knows_a_motion, old("worker hung"),
        dashboard_that_closes_and_opens_again_is_no_fault, old("rtde silent"),
    ],
    "right": [
        links_that_answer_are_confirmed_quickly, unconfirmed("dashboard silent"), unconfirmed("worker hung"),
        fault_is_no_confirmation, lost("silent"), old("worker killed"), stop_does_not_wait_for_the_answer_to_a_question,
    ],
}  # fmt: skip


def test_of_each_arm(emulator: EmulatorProcess, drivers: dict[str, UrArm]) -> None:
    of_each_arm(emulator, drivers, EPISODES, connected)
