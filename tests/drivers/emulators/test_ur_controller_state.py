"""The emulated controller as a state machine: no sockets, no waiting; the test passes wall and cell time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from drivers.arms.ur_rtde_reader import ProgramState, RobotMode, SafetyMode
from drivers.emulators.ur_controller import ControllerConfig, Series, ideal, personality, poses
from drivers.emulators.ur_controller.controller import Controller
from drivers.emulators.ur_controller.dashboard import answer
from drivers.emulators.ur_controller.script import ControlScript, ForeignProgram, Upload
from tests.arms import dh_frames
from tests.sure import sure

READY, DONE = 1, 2
RUNNING_BIT = 1 << 15
MOVE, STOP_JOINTS, PAYLOAD, TCP, WATCHDOG, STEADY, SERVO = 1, 34, 17, 29, 35, 47, 11


class Bench:
    """A controller with time in the hand of the test; ``offset`` is that of the script's registers."""

    def __init__(self, series: Series = "CB3", offset: int = 0, pace: float = 1.0, **changes: Any) -> None:
        who = personality(series, "UR5", "20150001")
        self.config = ControllerConfig("arm", "127.0.0.1", who, **changes)
        self.motions = ideal([self.config])
        self.controller = Controller(self.config, self.motions, lambda: self.now_s)
        self.offset = offset
        self.pace = pace
        self.now_s = 100.0
        self.cycles(1)

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.now_s += self.controller.period_s
            self.motions.advance(self.controller.period_s * self.pace)
            self.controller.cycle(self.now_s)

    def until(self, condition: Callable[[], bool], longest_s: float = 20.0) -> float:
        """Cycles until something holds; how long that took by the wall [s]."""
        began = self.now_s
        while not condition():
            assert self.now_s - began < longest_s, "it did not happen"
            self.cycles(1)
        return self.now_s - began

    def write(self, command: int, doubles: tuple[float, ...] = (), argument: int = 0) -> None:
        """Registers as a client writes them: arguments first, the command last."""
        for i, value in enumerate(doubles):
            self.controller.write_input(f"input_double_register_{self.offset + i}", (value,))
        self.controller.write_input(f"input_int_register_{self.offset + 1}", (argument,))
        self.controller.write_input(f"input_int_register_{self.offset}", (command,))

    def output(self, register: int) -> int:
        return int(self.controller.values[f"output_int_register_{self.offset + register}"][0])

    def command(self, command: int, doubles: tuple[float, ...] = (), argument: int = 0) -> float:
        """A whole exchange, as the client has it; how long it took."""
        self.until(lambda: self.output(0) == READY)
        self.write(command, doubles, argument)
        took = self.until(lambda: self.output(0) == DONE)
        self.write(0)
        self.until(lambda: self.output(0) == READY)
        return took

    def start_script(self) -> None:
        assert self.controller.upload(ControlScript(self.offset, self.offset))
        self.until(lambda: self.controller.runtime is ProgramState.PLAYING)

    @property
    def bits(self) -> tuple[int, int]:
        values = self.controller.values
        return int(values["robot_status_bits"][0]), int(values["safety_status_bits"][0])


def goal(bench: Bench, **changes: float) -> tuple[float, ...]:
    q = list(bench.config.home)
    for joint, change in changes.items():
        q[int(joint[1:]) - 1] += change
    return tuple(q)


@pytest.fixture(params=[("CB3", 0), ("e-Series", 24)], ids=["CB3", "e-Series, upper registers"])
def bench(request: pytest.FixtureRequest) -> Bench:
    made = Bench(*request.param)
    made.start_script()
    return made


# -- the control script ------------------------------------------------------------------------------------------------


def test_an_asynchronous_move_counts_operations(bench: Bench) -> None:
    first = bench.output(2)
    took = bench.command(MOVE, (*goal(bench, j1=0.4), 1.0, 2.0), argument=1)
    assert took <= 3 * bench.controller.period_s, "it does not wait for the arm"
    bench.until(lambda: bool(bench.output(2) & RUNNING_BIT))
    operation = bench.output(2) >> 24
    assert operation == (first >> 24) + 1
    assert bench.controller.moving
    bench.until(lambda: not bench.output(2) & RUNNING_BIT)
    assert not bench.controller.moving
    assert bench.output(2) >> 24 == operation
    assert bench.controller.q == goal(bench, j1=0.4)
    assert bench.output(2) >> 16 & 0x7F != first >> 16 & 0x7F


def test_a_second_move_takes_the_place_of_the_first(bench: Bench) -> None:
    bench.command(MOVE, (*goal(bench, j1=2.0), 1.0, 2.0), argument=1)
    bench.until(lambda: bench.controller.q[0] > 0.3)
    bench.command(MOVE, (*goal(bench, j1=-0.1), 1.0, 2.0))
    assert bench.controller.q == goal(bench, j1=-0.1)
    assert bench.controller.moves == 2


def test_steadiness_payload_and_tcp_are_reported(bench: Bench) -> None:
    bench.command(MOVE, (*goal(bench, j1=0.2), 1.0, 2.0))
    bench.command(STEADY)
    assert bench.output(1) == 0, "it has only just come to rest"
    bench.cycles(int(0.2 / bench.controller.period_s))
    bench.command(STEADY)
    assert bench.output(1) == 1
    bench.command(PAYLOAD, (1.5, 0.01, 0.02, 0.03))
    bench.command(TCP, (0.0, 0.0, 0.1, 0.0, 0.0, 0.0))
    values = bench.controller.values
    assert (values["payload"], values["payload_cog"]) == ((1.5,), (0.01, 0.02, 0.03))
    assert values["tcp_offset"] == (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)


TOOL = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
ANSWERS: dict[str, tuple[int, tuple[float, ...], Callable[[Controller], tuple[float, ...]]]] = {
    "step time": (26, (), lambda arm: (arm.period_s,)),
    "joints": (27, (), lambda arm: arm.q),
    "torques": (38, (), lambda arm: (0.0,) * 6),
    "flange": (58, (), lambda arm: arm.tool_pose(arm.q, (0.0,) * 6)),
    "tool": (43, (), lambda arm: arm.tool_pose(arm.q, TOOL)),
    "tool elsewhere": (44, (0.1,) * 6 + TOOL, lambda arm: arm.tool_pose((0.1,) * 6, TOOL)),
    "product": (39, TOOL + TOOL, lambda arm: (0.0, 0.0, 0.2, 0.0, 0.0, 0.0)),
}


@pytest.mark.parametrize("asked", ANSWERS)
def test_what_a_client_asks_of_the_script(bench: Bench, asked: str) -> None:
    bench.command(TCP, TOOL)
    command, doubles, expected = ANSWERS[asked]
    bench.write(command, doubles)
    bench.cycles(1)
    values = expected(bench.controller)
    found = [bench.controller.values[f"output_double_register_{bench.offset + k}"][0] for k in range(len(values))]
    assert found == pytest.approx(values)


def test_what_a_client_sets_by_the_script(bench: Bench) -> None:
    bench.command(65, (1.5, 0.0, 0.0, 0.03, 0.01, 0.02, 0.03, 0.0, 0.0, 0.0))
    assert bench.controller.values["payload_inertia"][:3] == (0.01, 0.02, 0.03)
    bench.write(31)
    bench.until(lambda: bench.controller.safety_mode is SafetyMode.PROTECTIVE_STOP)


@pytest.mark.parametrize(
    ("command", "doubles", "why"),
    [
        (MOVE, (math.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0), "not a finite number"),
        (MOVE, (7.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0), "7.0000 rad of joint 1 is outside"),
        (MOVE, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "above 0"),
        (PAYLOAD, (-1.0, 0.0, 0.0, 0.0), "mass"),
        (SERVO, (7.0, *(0.0,) * 7, 0.008, 0.1, 300.0), "servoj: 7.0000 rad of joint 1 is outside"),
        (SERVO, (*(0.0,) * 8, 0.008, 0.0, 300.0), "servoj: look-ahead 0.0 s"),
        (3, (0.0,) * 8, "command 3 of ur_rtde is not emulated"),
        (9, (0.0,) * 8, "command 9 of ur_rtde is not emulated"),
    ],
)
def test_an_impossible_request_ends_the_program(command: int, doubles: tuple[float, ...], why: str) -> None:
    bench = Bench()
    bench.start_script()
    bench.write(command, doubles)
    bench.until(lambda: bench.controller.runtime is ProgramState.STOPPED)
    assert why in bench.controller.log[-1]
    assert bench.controller.moves == 0


# -- safety and power --------------------------------------------------------------------------------------------------


def test_a_protective_stop_pauses_and_play_goes_on_where_it_was() -> None:
    bench = Bench(unlock_after_s=1.0)
    bench.start_script()
    target = goal(bench, j1=1.5)
    bench.write(MOVE, (*target, 1.0, 2.0))
    bench.until(lambda: bench.controller.q[0] > 0.4)
    bench.controller.protective_stop()
    bench.until(lambda: bench.controller.runtime is ProgramState.PAUSED)
    assert bench.controller.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert bench.controller.robot_mode is RobotMode.RUNNING
    assert bench.bits[1] == 1 << 2 | 1 << 10
    rest = bench.controller.q
    assert 0.4 < rest[0] < 1.0
    assert answer(bench.controller, "unlock protective stop").startswith("Cannot unlock protective stop until 5s")
    assert answer(bench.controller, "play") == "Failed to execute: play"
    assert not bench.controller.upload(ControlScript(0, 0))
    bench.cycles(int(1.1 / bench.controller.period_s))
    assert bench.controller.q == rest
    assert answer(bench.controller, "unlock protective stop") == "Protective stop releasing"
    bench.cycles(2)
    assert bench.bits[1] == 1
    assert bench.controller.q == rest, "a release alone moves nothing"
    assert answer(bench.controller, "play") == "Starting program"
    bench.until(lambda: bench.output(0) == DONE)
    assert bench.controller.q == target


def test_an_emergency_stop_takes_the_power_and_coming_back_goes_in_order() -> None:
    bench = Bench("e-Series", boot_s=2.0, brake_release_s=1.0)
    bench.start_script()
    bench.command(MOVE, (*goal(bench, j1=2.0), 1.0, 2.0), argument=1)
    bench.until(lambda: bench.controller.q[0] > 0.3)
    speed, at = bench.controller.values["actual_qd"][0], bench.controller.q[0]
    bench.controller.emergency_stop()
    braking = bench.until(lambda: bench.controller.runtime is ProgramState.STOPPED)
    assert not bench.controller.moving
    ramp = math.pi / 0.5  # from the speed limit to rest in half a second
    assert braking == pytest.approx(speed / ramp + 0.024, abs=2 * bench.controller.period_s)
    assert bench.controller.q[0] - at == pytest.approx(0.5 * speed**2 / ramp + 0.022 * speed, rel=0.1)
    assert bench.bits == (0, 1 << 6 | 1 << 7 | 1 << 10)
    assert answer(bench.controller, "robotmode") == "Robotmode: POWER_OFF"
    assert answer(bench.controller, "power on") == "Failed to execute: power on"
    assert answer(bench.controller, "brake release") == "Failed to execute: brake release"
    bench.controller.release_emergency_stop()
    assert not bench.controller.upload(ControlScript(0, 0)), "no program without power"
    assert answer(bench.controller, "power on") == "Powering on"
    assert bench.controller.robot_mode is RobotMode.BOOTING
    assert bench.until(lambda: bench.controller.robot_mode is RobotMode.IDLE) == pytest.approx(2.0, abs=0.01)
    assert answer(bench.controller, "brake release") == "Brake releasing"
    assert bench.until(lambda: bench.controller.robot_mode is RobotMode.RUNNING) == pytest.approx(1.0, abs=0.01)
    rest = bench.controller.q
    bench.start_script()
    bench.cycles(200)
    assert bench.controller.q == rest


def test_local_control_refuses_network_commands_on_the_e_series_only() -> None:
    local = Bench("e-Series", remote_control=False)
    assert not local.controller.upload(ControlScript(0, 0))
    assert answer(local.controller, "is in remote control") == "false"
    for command in ("stop", "play", "pause", "power on", "unlock protective stop"):
        assert answer(local.controller, command).startswith("Command is not allowed due to safety reasons")
    assert answer(local.controller, "running") == "Program running: false"
    local.controller.remote_control = True
    assert answer(local.controller, "stop") == "Stopped"
    assert "not allowed" in answer(local.controller, "stop", opened_in_remote=False)
    old = Bench("CB3", remote_control=False)
    old.start_script()
    assert answer(old.controller, "is in remote control").startswith("could not understand")


# -- poses -------------------------------------------------------------------------------------------------------------


@given(st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6))
def test_poses_are_those_of_the_d_h_table(q: list[float]) -> None:
    rows = personality("CB3", "UR10", "1").rows
    frames = poses.chain(rows, q)
    assert np.allclose(np.array(frames[-1]).T, dh_frames(rows, q)[-1][:3], atol=1e-12)
    again = poses.frame(poses.pose(frames[-1]))
    assert np.allclose(np.array(again), np.array(frames[-1]), atol=1e-9)


# -- texts of programs -------------------------------------------------------------------------------------------------


def control_text(offset: int) -> bytes:
    return (
        b"def rtde_control():\n"
        b"    global reg_offset_float = # float register offset\n%d\n"
        b"    global reg_offset_int = # int register offset\n%d\n"
        b"    while True:\n        sync()\n    end\nend\n"
    ) % (offset, offset)


def test_endless_text_does_not_keep_a_later_program_from_being_found() -> None:
    upload = Upload()
    for _ in range(40):
        assert upload.take(b"def never():\n" + b"x" * 65536) == []
    upload.take(b"\nend\n")
    assert [program.name for program in upload.take(b"def now():\nend\n")] == ["now"]


# -- The emulated controller under random sequences of commands, faults and operators: what never happens --------------

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
        return powered and arm.runtime in (ProgramState.PLAYING, ProgramState.RESUMING)

    def check_cycle(self) -> None:
        arm, now_s = self.arm, self.bench.now_s
        assert max(map(abs, arm.values["actual_qd"])) <= SPEED * (1.0 + 1e-6)
        if not arm.moving or arm.runtime in (ProgramState.PLAYING, ProgramState.RESUMING):
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

    @precondition(lambda self: self.arm.runtime is ProgramState.STOPPED and self.may_start())
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
        assert arm.runtime is not ProgramState.STOPPED or arm.program is None or not arm.moving
        assert arm.safety_mode is SafetyMode.NORMAL or arm.runtime is not ProgramState.PLAYING
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


# -- Stops and the speed slider ----------------------------------------------------------------------------------------


UR10_SPEED = math.radians(120.0)


def moving_bench(rate: float = 1.0, **changes: Any) -> Bench:
    """An arm in the middle of a long motion at a constant speed of its first joint."""
    bench = Bench("e-Series", **changes)
    bench.start_script()
    bench.command(MOVE, (*goal(bench, j1=4.0), rate, 8.0), argument=1)
    bench.until(lambda: bench.controller.q[0] > 0.5)
    return bench


def test_a_ur10_at_full_speed_takes_half_a_second_to_stop() -> None:
    bench = moving_bench(UR10_SPEED, speed=(UR10_SPEED,) * 6)
    received_s = bench.now_s
    assert answer(bench.controller, "stop") == "Stopped"
    took = bench.until(lambda: not bench.controller.moving)
    assert took == pytest.approx(0.5 + 0.02, abs=3 * bench.controller.period_s)
    (record,) = bench.controller.brakes.records
    assert (record.kind, record.received_s) == ("program", received_s)
    assert record.ideal_s == pytest.approx(0.5)
    assert sure(record.began_s) - received_s == pytest.approx(0.02, abs=2 * bench.controller.period_s)
    assert sure(record.rest_s) - sure(record.began_s) == pytest.approx(0.5, abs=2 * bench.controller.period_s)


def test_braking_follows_the_path() -> None:
    bench = Bench()
    bench.start_script()
    target, start = np.array(goal(bench, j1=4.0, j2=-2.0, j5=1.0)), np.array(bench.config.home)
    bench.command(MOVE, (*target, 1.0, 8.0), argument=1)
    bench.until(lambda: bench.controller.q[0] > 0.5)
    bench.controller.stop_program()
    bench.until(lambda: not bench.controller.moving)
    share = (np.array(bench.controller.q) - start)[[0, 1, 4]] / (target - start)[[0, 1, 4]]
    assert np.ptp(share) < 1e-12


@pytest.mark.parametrize(("stated", "acts"), [(2.0, 2.0), (100.0, 10.0)], ids=["stated", "more than the joints can"])
def test_stopj_brakes_at_its_stated_deceleration(stated: float, acts: float) -> None:
    bench = moving_bench()
    bench.command(STOP_JOINTS, (stated,))
    record = bench.controller.brakes.records[-1]
    assert record.kind == "stopj"
    assert sure(record.rest_s) - sure(record.began_s) == pytest.approx(1.0 / acts, abs=2 * bench.controller.period_s)


# -- speed slider ------------------------------------------------------------------------------------------------------


def test_the_slider_scales_a_motion_in_progress_and_at_zero_the_arm_stands() -> None:
    bench = moving_bench()
    bench.controller.set_slider(0.0)
    bench.cycles(int(0.6 / bench.controller.period_s))
    stands = bench.controller.q
    assert bench.controller.at_rest
    assert bench.controller.moving, "its motion is not over"
    assert bench.controller.runtime is ProgramState.PLAYING
    assert bench.controller.values["speed_scaling"] == (0.0,)
    assert bench.controller.values["actual_qd"] == (0.0,) * 6
    bench.cycles(500)
    assert bench.controller.q == stands
    bench.controller.set_slider(0.25)
    bench.cycles(int(0.6 / bench.controller.period_s))
    assert bench.controller.values["target_speed_fraction"] == bench.controller.values["speed_scaling"] == (0.25,)
    assert bench.controller.values["actual_qd"][0] == pytest.approx(0.25)
    bench.controller.set_slider(1.0)
    bench.until(lambda: not bench.controller.moving)
    assert bench.controller.values["actual_q"] == goal(bench, j1=4.0)
