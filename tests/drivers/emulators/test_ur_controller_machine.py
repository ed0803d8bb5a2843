"""The emulated controller under random sequences of commands, faults and operators: what never happens."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from drivers.emulators.ur_controller import Series
from drivers.emulators.ur_controller.controller import RobotMode, Runtime, SafetyMode
from drivers.emulators.ur_controller.dashboard import answer
from drivers.emulators.ur_controller.script import ControlScript, ForeignProgram
from tests.drivers.emulators.test_ur_controller_state import MOVE, STOP_JOINTS, WATCHDOG, Bench

SPEED = 2.0
BRAKED_S = 0.024 + 0.5
"""Longest time from a stop to rest, from full speed."""
ANGLES = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6)
ODD = st.sampled_from([math.nan, math.inf, -1.0, 0.0, 0.3, 1.0, 2.0])


class ControllerMachine(RuleBasedStateMachine):
    """One controller, its client and its operator."""

    series: Series = "e-Series"

    def __init__(self) -> None:
        super().__init__()
        self.bench = Bench(self.series, speed=(SPEED,) * 6, boot_s=0.2, brake_release_s=0.1, unlock_after_s=0.1)
        self.arm = self.bench.controller
        self.unlocked = False
        self.stopped_at_s: float | None = None
        self.rest: tuple[int, tuple[float, ...]] | None = None

    @initialize()
    def begin(self) -> None:
        self.upload()

    # -- time, with what must hold in every cycle ----------------------------------------------------------------------

    @rule(count=st.integers(1, 150))
    def cycles(self, count: int) -> None:
        for _ in range(count):
            moves, allowed = self.arm.moves, self.may_move()
            self.bench.cycles(1)
            assert self.arm.moves == moves or allowed, "a motion began while the controller was stopped"
            self.check_cycle()

    def may_move(self) -> bool:
        arm = self.arm
        powered = arm.robot_mode is RobotMode.RUNNING and arm.safety_mode is SafetyMode.NORMAL
        return powered and arm.runtime in (Runtime.PLAYING, Runtime.RESUMING)

    def check_cycle(self) -> None:
        arm, now_s = self.arm, self.bench.now_s
        assert max(map(abs, arm.values["actual_qd"])) <= SPEED * (1.0 + 1e-6)
        if not arm.moving or arm.runtime in (Runtime.PLAYING, Runtime.RESUMING):
            self.stopped_at_s = None
        elif self.stopped_at_s is None:
            self.stopped_at_s = now_s
        assert self.stopped_at_s is None or now_s - self.stopped_at_s < BRAKED_S + 3 * arm.period_s
        if self.rest is not None and self.rest[0] == arm.moves:
            assert arm.q == self.rest[1], "an arm at rest moved without a start"
        self.rest = None if arm.moving else (arm.moves, arm.q)

    # -- the client ----------------------------------------------------------------------------------------------------

    @rule()
    def upload(self) -> None:
        accepted = self.arm.upload(ControlScript(0, 0))
        assert not accepted or self.arm.safety_mode is SafetyMode.NORMAL
        assert not accepted or self.arm.accepts_commands
        self.cycles(int(2.0 * self.arm.start_delay_s / self.arm.period_s))

    @rule(q=ANGLES, asynchronous=st.booleans())
    def move(self, q: list[float], asynchronous: bool) -> None:
        self.bench.write(0)
        self.cycles(3)
        self.bench.write(MOVE, (*q, 1.5, 4.0), int(asynchronous))
        self.cycles(60)

    @rule()
    def answer_seen(self) -> None:
        self.bench.write(0)
        self.cycles(2)

    @rule(deceleration=ODD)
    def stop_joints(self, deceleration: float) -> None:
        self.bench.write(STOP_JOINTS, (deceleration,), 1)
        self.cycles(2)

    @rule()
    def watchdog(self) -> None:
        self.bench.write(WATCHDOG, (10.0,))
        self.cycles(2)

    @rule(line=st.sampled_from(["stop", "pause", "play", "power off", "restart safety", "running", "programState"]))
    def dashboard(self, line: str) -> None:
        said = answer(self.arm, line)
        local = not self.arm.accepts_commands
        assert ("not allowed" in said) == (local and line not in ("running", "programState"))

    @rule(fraction=ODD)
    def slider(self, fraction: float) -> None:
        self.bench.controller.write_input("speed_slider_mask", (1,))
        self.bench.controller.write_input("speed_slider_fraction", (fraction,))
        assert 0.0 <= self.arm.slider.fraction <= 1.0

    @precondition(lambda self: self.arm.slider.scaling == self.arm.slider.fraction == 0.0)
    @rule()
    def stands_at_slider_zero(self) -> None:
        before = self.arm.q
        self.cycles(50)
        assert np.abs(np.array(self.arm.q) - before).max() < 1e-9

    # -- the operator and the world ------------------------------------------------------------------------------------

    @rule()
    def protective_stop(self) -> None:
        if self.arm.safety_mode is SafetyMode.NORMAL:
            self.unlocked = False
        self.arm.protective_stop()

    @rule()
    def unlock(self) -> None:
        if "releasing" in answer(self.arm, "unlock protective stop"):
            self.unlocked = True

    @rule()
    def emergency_stop(self) -> None:
        self.arm.emergency_stop()

    @precondition(lambda self: self.arm.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP)
    @rule()
    def release_emergency_stop(self) -> None:
        self.arm.release_emergency_stop()
        assert self.arm.robot_mode is not RobotMode.RUNNING, "power stays off"

    @rule()
    def release_brakes(self) -> None:
        self.arm.release_brakes()

    @rule()
    def repair(self) -> None:
        """All that an operator does after a fault."""
        self.unlocked = True
        self.arm.unlock(at_once=True)
        self.arm.release_emergency_stop()
        self.arm.release_brakes()
        self.arm.set_slider(1.0)
        self.arm.remote_control = True
        self.cycles(200)
        assert self.may_start()

    @rule(on=st.booleans())
    def remote(self, on: bool) -> None:
        self.arm.remote_control = on

    @precondition(lambda self: self.arm.runtime is Runtime.STOPPED and self.may_start())
    @rule()
    def foreign(self) -> None:
        self.arm.start_locally(ForeignProgram())

    def may_start(self) -> bool:
        return self.arm.robot_mode is RobotMode.RUNNING and self.arm.safety_mode is SafetyMode.NORMAL

    # -- what must hold between any two of them ------------------------------------------------------------------------

    @invariant()
    def is_consistent(self) -> None:
        arm = self.arm
        assert all(map(math.isfinite, arm.q))
        assert arm.runtime is not Runtime.STOPPED or arm.program is None or not arm.moving
        assert arm.safety_mode is SafetyMode.NORMAL or arm.runtime is not Runtime.PLAYING
        for record in arm.brakes.records:
            assert record.ideal_s <= 0.5 / 0.1
            if record.began_s is not None:
                assert record.received_s <= record.began_s
            if record.rest_s is not None:
                assert record.received_s <= record.rest_s

    @precondition(lambda self: self.arm.safety_mode is SafetyMode.PROTECTIVE_STOP)
    @rule()
    def a_protective_stop_stays(self) -> None:
        """Nothing but an unlock clears it."""
        for line in ("stop", "play", "power on", "brake release", "restart safety", "close safety popup"):
            answer(self.arm, line)
        self.arm.upload(ControlScript(0, 0))
        self.cycles(20)
        assert self.arm.safety_mode is SafetyMode.PROTECTIVE_STOP or self.unlocked


class Cb3Machine(ControllerMachine):
    """The same for the older series, which has no remote switch."""

    series: Series = "CB3"


MODEST = settings(max_examples=60, stateful_step_count=20, deadline=None, derandomize=True)
ControllerMachine.TestCase.settings = MODEST
Cb3Machine.TestCase.settings = MODEST
TestControllerMachine = ControllerMachine.TestCase
TestCb3Machine = Cb3Machine.TestCase
TestCb3Machine.pytestmark = [pytest.mark.slow]  # type: ignore[attr-defined]
