"""A UR arm driven by the real RTDE client: motions, limits, refusals, and the state after disconnecting."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from drivers.arms import ur_supervisor
from drivers.arms.protocol import ArmError, JointLimits, LimitExceeded, LinkLost, ProtectiveStop, WrongRobot
from drivers.arms.settings import ArmContext
from drivers.arms.ur import UrArm
from drivers.arms.ur_links import RTDE_PORT, Connection, stop_program
from drivers.arms.ur_motion import MAX_SPEED, Kicks, leading_rates
from drivers.arms.ur_rtde_reader import inputs_taken, wait_at_rest
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import EmulatorProcess, UrControllerServer, script, start_in_process
from drivers.emulators.ur_controller.controller import Controller, Program
from drivers.emulators.ur_controller.script import UnknownProgram
from drivers.patience import Patience
from tests.at_once import in_parallel
from tests.drivers.arms.emulated_ur_cell import (
    ACCELERATION,
    AWAY,
    FAR,
    HOME,
    HOSTS,
    MODELS,
    PATIENT_S,
    SERIALS,
    SETTLE_S,
    SPEED,
    WATCHDOG_HZ,
    configs,
    connected,
    driven,
    expectation,
    go,
    peer_that_says,
    repair,
    set_out,
    warnings_about,
)
from tests.latency import attempts
from tests.loopback import own_address, own_arms
from tests.sure import sure
from tests.waiting import WAIT_S, until, within

pytestmark = pytest.mark.waits

ARMS = ("left", "right")
SWAPPED_HOSTS = own_arms(45)


@pytest.fixture
def both(emulator: EmulatorProcess, drivers: dict[str, UrArm]) -> dict[str, UrArm]:
    """Both arms, without a fault; they stay connected until a test needs the controllers without clients."""
    in_parallel(connected, [(emulator, drivers[name]) for name in ARMS])
    return drivers


@pytest.fixture
def unconnected(emulator: EmulatorProcess, drivers: dict[str, UrArm]) -> EmulatorProcess:
    """The controllers without clients and faults, for tests that connect themselves."""
    for name in ARMS:
        drivers[name].disconnect()
        repair(emulator, name)
    return emulator


# -- motions ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_identity_state_and_tool_are_those_of_the_controller(both: dict[str, UrArm], name: str) -> None:
    arm = both[name]
    who, state, tool = arm.identify(), arm.state(), arm.tool()
    assert (who.model, who.serial) == (MODELS[name], SERIALS[name])
    assert who.software.startswith({"left": "3.", "right": "5."}[name])
    assert np.shape(sure(who.dh_rows)) == (6, 4)
    assert sure(who.dh_rows)[1][2] == {"left": -0.612, "right": -0.425}[name]
    assert (state.robot_mode, state.safety_mode, state.program) == ("RUNNING", "NORMAL", "PLAYING")
    assert state.payload_kg == pytest.approx(0.35)
    assert sure(state.joint_temperature_c).shape == (6,)
    np.testing.assert_allclose(sure(tool.payload_center_m), [0, 0, 0.03], atol=1e-12)
    np.testing.assert_array_equal(sure(tool.tcp), np.zeros(6))
    limits = arm.limits()
    np.testing.assert_array_equal(limits.speed, np.full(6, 3.0))
    assert warnings_about(arm) == []
    assert arm.state().time_s > state.time_s


positive = st.lists(st.floats(0.01, 10.0), min_size=6, max_size=6)
angles = st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6)


@example(here=[0.0] * 6, goal=[0.0] * 5 + [5e-324], speed=[1.0] * 5 + [0.5], acceleration=[1.0] * 6)
@given(here=angles, goal=angles, speed=positive, acceleration=positive)
def test_leading_rates_keep_every_joint_within_its_limits(
    here: list[float], goal: list[float], speed: list[float], acceleration: list[float]
) -> None:
    led_speed, led_acceleration = leading_rates(here, goal, speed, acceleration)
    assert 0.0 < led_speed <= MAX_SPEED
    ways = np.abs(np.array(goal) - np.array(here))
    if ways.max() == 0.0:
        return
    shares = ways / ways.max()
    assert (led_speed * shares <= np.array(speed) * (1 + 1e-9)).all()
    assert (led_acceleration * shares <= np.array(acceleration) * (1 + 1e-9)).all()
    # and not slower than necessary: some joint, or the client, is at its limit
    assert led_speed == MAX_SPEED or np.isclose(led_speed * shares, speed, rtol=1e-9).any()


# -- refusals before anything is sent ---------------------------------------------------------------------------------


TIGHT = JointLimits(np.tile([-7.0, 7.0], (6, 1)), np.full(6, 3.0), np.full(6, 8.0))
FAST = JointLimits(np.tile([-6.0, 6.0], (6, 1)), np.full(6, 3.2), np.full(6, 8.0))
MISMATCHES: dict[str, tuple[dict[str, Any], type[ArmError], str]] = {
    "model": ({"model": "UR3e"}, WrongRobot, "drives a UR5e, the profile names a UR3e"),
    "serial": ({"serial": "20209999999"}, WrongRobot, "20205501234, the profile states 20209999999"),
    "payload": ({"payload_kg": 1.0}, ArmError, "configured with 0.350 kg .* the profile states 1.000 kg"),
    "centre": ({"payload_center_m": np.array([0.0, 0.0, 0.08])}, ArmError, r"30\.0\] mm, .*80\.0\] mm"),
    "tcp": ({"tcp": np.array([0, 0, 0.1, 0, 0, 0])}, ArmError, r"TCP: the controller's is .*100\.0\] mm"),
    "limits": ({"limits": TIGHT}, LimitExceeded, "joint 1 may go from -360.0 to 360.0 deg, .*-401.1 to 401.1"),
    "speed": ({"limits": FAST}, LimitExceeded, "joint 1 may rotate at 180.0 deg/s"),
}


@pytest.mark.parametrize("other", MISMATCHES)
def test_another_arm_than_the_stated_one_is_refused(unconnected: EmulatorProcess, other: str) -> None:
    changes, error, words = MISMATCHES[other]
    with driven("right", **changes) as arm, pytest.raises(error, match=f"arm right: not moved: .*{words}"):
        arm.connect()
    assert_untouched(unconnected, "right")


def test_all_reasons_are_given_at_once(unconnected: EmulatorProcess) -> None:
    unconnected.control("right", "remote", "off")
    unconnected.control("right", "protective", "now")
    with driven("right", payload_kg=1.0) as arm, pytest.raises(ProtectiveStop) as caught:
        arm.connect()
    for words in ("safety: PROTECTIVE_STOP", "remote control: off", "payload: "):
        assert words in str(caught.value)
    assert_untouched(unconnected, "right")


def test_a_changed_calibration_only_warns(unconnected: EmulatorProcess) -> None:
    with driven("right", checksum="0000000a-0000000b") as arm:
        arm.connect()
        (note,) = warnings_about(arm)
        assert note.startswith("arm right: ")
        assert arm.state().ready


@contextmanager
def other_clients_program(host: str) -> Iterator[None]:
    """The control program of another client, in a process of its own."""
    code = (
        "import sys, rtde_control; c = rtde_control.RTDEControlInterface(sys.argv[1]); print('up', flush=True);"
        " sys.stdin.read(); import os; os._exit(0)"
    )
    command = [sys.executable, "-c", code, host]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        while within(sure(other.stdout).readline, "the program of the other client").strip() != "up":
            assert other.poll() is None
        try:
            yield
        finally:
            other.kill()


def test_a_program_of_another_client_is_left_alone(unconnected: EmulatorProcess) -> None:
    with other_clients_program(HOSTS["left"]), driven("left") as arm:
        with pytest.raises(ArmError, match=r"a program \(rtde_control\) that is not this driver.s runs, and"):
            arm.connect()
        assert unconnected.control("left", "status")["runtime_state"] == "PLAYING"
    stop_program(HOSTS["left"], 1.0)
    until(lambda: unconnected.control("left", "status")["runtime_state"] == "STOPPED", "it has stopped")


def test_inputs_that_another_client_holds_are_told(unconnected: EmulatorProcess) -> None:
    host, patience, found = HOSTS["left"], Patience(WAIT_S), {}
    limits = JointLimits(np.tile([-6.0, 6.0], (6, 1)), np.full(6, 2.0), np.full(6, 2.0))
    arm = ArmContext("left", "UR10", 6, limits, 0.35, np.zeros(3))
    for holds in (True, False):
        with Connection.to(host, RTDE_PORT, patience) as link:
            assert not holds or not inputs_taken(link, patience)
            findings = UrSettings(host=host).probe(arm, WAIT_S)
        found[holds] = next(one.status for one in findings if one.subject == "RTDE inputs")
    assert found == {True: "failed", False: "ok"}


def test_of_two_that_begin_together_one_is_refused_and_stops_nothing(unconnected: EmulatorProcess) -> None:
    """The program of the other may not have started yet, when one is refused; it is told who the other one is."""
    settings = UrSettings(host=HOSTS["left"], watchdog_hz=WATCHDOG_HZ, settle_time=SETTLE_S)
    unconnected.control("left", "start-delay", 0.3)
    for _ in range(6):
        two = {user: UrArm("left", settings, expectation("left"), user=user) for user in ("day", "night")}
        with ThreadPoolExecutor(2) as pool:
            ends = {user: pool.submit(arm.connect) for user, arm in two.items()}
            refused = {user: error for user, end in ends.items() if (error := end.exception()) is not None}
        (first,) = two.keys() - refused.keys()
        ((second, error),) = refused.items()
        assert f"another cellapp, on {socket.gethostname()}, run {first}, holds the arm: its program runs" in str(error)
        two[second].disconnect()
        until_s = time.monotonic() + 0.4
        while time.monotonic() < until_s:
            assert two[first].state().ready
        assert unconnected.control("left", "status")["runtime_state"] == "PLAYING"
        two[first].disconnect()
    unconnected.control("left", "start-delay", 0.05)


def test_a_controller_that_takes_only_the_clients_own_name_is_driven(monkeypatch: pytest.MonkeyPatch) -> None:
    def strict(name: str, block: bytes) -> Program[Controller]:
        return script_program(name, block) if name == "rtde_control" else UnknownProgram(name)

    script_program = script.program_of
    monkeypatch.setattr(script, "program_of", strict)
    host = own_address(44)
    settings = UrSettings(host=host, watchdog_hz=WATCHDOG_HZ, settle_time=SETTLE_S)
    with UrControllerServer(configs({"left": host})), driven("left", settings) as arm:
        arm.connect()
        arm.start_move(AWAY, SPEED, ACCELERATION)
        np.testing.assert_allclose(arm.wait_settled(PATIENT_S).q, AWAY, atol=1e-6)


def test_a_program_that_was_left_is_known_by_its_name_and_can_be_ended(unconnected: EmulatorProcess) -> None:
    settings = UrSettings(host=HOSTS["left"], watchdog_hz=WATCHDOG_HZ)
    assert settings.left_program() == ""
    arm = UrArm("left", settings, expectation("left"), user="my run.2")
    with ExitStack() as stack:
        stack.callback(arm.disconnect)
        arm.connect()
        assert settings.left_program() == f"another cellapp, on {socket.gethostname()}, run my_run_2"
        settings.end_program()
        until(lambda: unconnected.control("left", "status")["runtime_state"] == "STOPPED", "it has stopped")
        assert settings.left_program() == ""


def assert_untouched(emulator: EmulatorProcess, name: str) -> None:
    """Assert that nothing was uploaded, started or moved."""
    status = emulator.control(name, "status")
    assert status["runtime_state"] == "STOPPED"
    assert not status["moving"]


# -- connecting and disconnecting ------------------------------------------------------------------------------------


def test_disconnecting_restores_the_state_before_connecting(unconnected: EmulatorProcess) -> None:
    before = unconnected.control("left", "status")
    with driven("left") as arm:
        arm.connect()
        arm.connect()  # harmless
        arm.disconnect()
        assert arm.worker_pid is None
        arm.disconnect()
        arm.stop()
        with pytest.raises(LinkLost, match="not connected; connect first"):
            arm.state()
        with pytest.raises(LinkLost, match="not connected; connect first"):
            arm.start_move(AWAY, SPEED, ACCELERATION)
        with pytest.raises(LinkLost, match="not connected; connect first"):
            arm.identify()
    until(lambda: not any(unconnected.control("left", "status")["connections"].values()), "all links are closed")
    after = unconnected.control("left", "status")
    same = ("q", "moves", "runtime_state", "payload", "payload_center", "tcp", "robot_mode", "safety_mode")
    assert {key: after[key] for key in same} == {key: before[key] for key in same}


def test_disconnecting_while_it_moves_stops_it(unconnected: EmulatorProcess) -> None:
    with driven("left") as arm:
        arm.connect()
        set_out(arm)
        arm.disconnect()
        status = unconnected.control("left", "status")
        assert not status["moving"]
        assert np.abs(np.array(status["q"]) - FAR).max() > 0.3
        arm.connect()
        go(arm, HOME)


def test_another_controller_at_the_same_address_is_refused() -> None:
    """The cables were swapped after a fault."""
    left, right = (replace(config, host=SWAPPED_HOSTS[config.name]) for config in configs())
    with start_in_process([left, right]):
        arm = UrArm("left", UrSettings(host=SWAPPED_HOSTS["left"]), expectation("left", serial=None), rest_s=1.0)
        arm.connect()
    with pytest.raises(LinkLost):
        until(lambda: not arm.state(), "the broken link is seen")
    swapped = replace(left, personality=replace(left.personality, serial="20159999999"))
    with start_in_process([swapped, right]):
        with pytest.raises(WrongRobot, match="is now 20159999999, it was 20153012345"):
            arm.connect()
        arm.disconnect()


# -- hosts that do not answer -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("silent", ["dashboard", "primary", "rtde", "*"])
def test_a_silent_host_is_reported_within_its_time_limit(unconnected: EmulatorProcess, silent: str) -> None:
    assert UrSettings(host=HOSTS["right"]).timeout <= 5.0
    unconnected.control("right", "fault", silent, "silent")
    with driven("right", UrSettings(host=HOSTS["right"], timeout=0.5)) as arm:
        if silent == "primary":  # its data are optional
            arm.connect()
            return
        for took in attempts(reported=1.0):
            began = time.monotonic()
            with pytest.raises(LinkLost, match=f"arm right: .*{re.escape(HOSTS['right'])}"):
                arm.connect()
            took["reported"] = time.monotonic() - began
        unconnected.control("right", "fault", "*", "none")
    assert_untouched(unconnected, "right")


@pytest.mark.parametrize("closed", ["dashboard", "script", "rtde"])
def test_a_closed_port_is_named(unconnected: EmulatorProcess, closed: str) -> None:
    unconnected.control("right", "fault", closed, "refuse")
    number = {"dashboard": 29999, "script": 30003, "rtde": 30004}[closed]
    with driven("right") as arm, pytest.raises(LinkLost, match=f"{number}"):
        arm.connect()
    assert_untouched(unconnected, "right")


def test_a_wrong_host_is_named() -> None:
    with pytest.raises(LinkLost, match=r"arm left: no-such-robot\.invalid: no IPv4 host"):
        UrArm("left", UrSettings(host="no-such-robot.invalid"), expectation("left")).connect()
    nobody = own_address(47)
    with pytest.raises(LinkLost, match=f"arm left: {re.escape(nobody)}:29999: no connection"):
        UrArm("left", UrSettings(host=nobody), expectation("left")).connect()


# -- the plain readers ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("answer", [b"", b"\x00\x00\x00", b"\x00\x04V\x00", b"HTTP/1.1 400 Bad Request\r\n\r\n"])
def test_a_peer_that_is_not_an_rtde_server_is_refused(answer: bytes) -> None:
    with peer_that_says(answer) as port, pytest.raises(LinkLost, match="RTDE"):
        wait_at_rest("127.0.0.1", 0.15, port=port)


# -- delayed positions ------------------------------------------------------------------------------------------------


MOVE = {"do": "move", "q": list(HOME), "speed": [1.0] * 6, "acceleration": [1.0] * 6}
COMMANDS = [("moveJ", MOVE), ("isJointsWithinSafetyLimits", {"do": "allowed", "q": [list(HOME)]})]


def test_positions_from_before_a_motion_do_not_end_it(delayed: Any) -> None:
    client, monitor = delayed
    assert monitor(0.2) == []
    client.q = list(AWAY)
    (answer,) = monitor(0.2)
    assert answer["ok"]["q"] == list(AWAY)


def test_a_stop_by_the_application_is_not_a_fault_even_if_its_message_comes_late(delayed: Any) -> None:
    client, monitor = delayed
    client.playing = False
    assert monitor(0.04) == []
    (stopped,) = monitor(2.0, {"brake": True})
    assert (stopped["id"], stopped["error"]) == (7, "stopped")
    assert monitor(0.1, {"do": "state"})[-1]["ok"]["fault"] is None


@pytest.mark.parametrize("moves_at_once", [False, True], ids=["waited for", "moved at once"])
def test_a_stop_by_something_else_is_a_fault(delayed: Any, moves_at_once: bool) -> None:
    client, monitor = delayed
    if moves_at_once:
        client.q = list(AWAY)
        assert "ok" in monitor(0.2)[-1]
    client.playing = False
    if moves_at_once:
        monitor(0.02)
        told, answer = monitor(0.01, MOVE)[-2:]
    else:
        told, answer = monitor(0.4)
    assert "its program ended; possible: it was stopped on the pendant" in answer["text"]
    assert told["fault"] == "failed"


def test_an_application_that_falls_silent_stops_its_arm(delayed: Any) -> None:
    client, monitor = delayed
    client.running, client.q = True, list(AWAY)
    assert monitor(0.4, beats=False) == []
    told, answer = monitor(0.3, beats=False)
    assert (told["fault"], answer["error"]) == ("stalled", "stalled")
    assert "silent for 0.5 s" in told["text"]


def test_an_application_that_falls_silent_at_rest_needs_a_person_too(delayed: Any) -> None:
    client, monitor = delayed
    client.q = list(AWAY)
    monitor(0.3)
    assert "stalled" in [message.get("fault") for message in monitor(2.0, beats=False)]
    assert monitor(0.1, {"do": "state"})[-1]["ok"]["fault"]["kind"] == "stalled"


@pytest.mark.parametrize(("command", "asked"), COMMANDS)
def test_a_command_that_is_not_served_because_of_a_brake_that_is_read_later_was_stopped(
    delayed: Any, monkeypatch: pytest.MonkeyPatch, command: str, asked: dict[str, Any]
) -> None:
    """The client holds the interpreter's lock while it sends a command: the brake's message waits."""
    client, monitor = delayed
    client.q = list(AWAY)
    monitor(0.3)

    def sleep(seconds: float) -> None:
        client.tick(seconds)
        if not client.playing:
            monitor(0.0, {"brake": True})

    monkeypatch.setattr(vars(ur_supervisor)["time"], "sleep", sleep)
    monkeypatch.setattr(client, command, client.end_program)
    assert monitor(0.02, asked)[-1]["error"] == "stopped"
    assert monitor(0.1, {"do": "state"})[-1]["ok"]["fault"] is None


@pytest.mark.parametrize(("command", "asked"), COMMANDS)
def test_a_command_that_is_not_served_because_this_computer_stalled_says_so(
    delayed: Any, monkeypatch: pytest.MonkeyPatch, command: str, asked: dict[str, Any]
) -> None:
    client, monitor = delayed
    client.q = list(AWAY)
    monitor(0.3)
    clock = vars(ur_supervisor)["time"]
    now = clock.monotonic

    def stalled(*_: object) -> bool:
        monkeypatch.setattr(clock, "monotonic", lambda: now() + 0.3)
        return bool(client.end_program())

    monkeypatch.setattr(client, command, stalled)
    told, answer = monitor(0.01, asked)[-2:]
    assert (told["fault"], answer["error"]) == ("stalled", "stalled")
    assert "this computer was silent for 0.3" in answer["text"]


def test_a_motion_that_stands_at_full_speed_is_a_fault(delayed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    client, monitor = delayed
    monkeypatch.setattr(os, "_exit", sys.exit)
    client.running = True
    with pytest.raises(SystemExit):
        monitor(5.0)


# -- heartbeats -------------------------------------------------------------------------------------------------------


def test_a_silence_longer_than_the_watchdogs_period_explains_a_stop_just_after_it() -> None:
    kicks = Kicks()
    kicks.start(0.0, 0.2)
    for now in (0.04, 0.08, 0.3):  # the last one late by 0.22 s
        kicks.kicked(now)
    assert kicks.late == 1
    assert kicks.longest_s == pytest.approx(0.22)
    assert kicks.expired_before(0.32) == pytest.approx(0.22)
    for step in range(20):
        kicks.kicked(0.34 + 0.04 * step)
    assert kicks.expired_before(1.12) is None  # much later: on the pendant
    assert kicks.expired_before(None) is None


def test_threads_and_processes_are_gone_afterwards(unconnected: EmulatorProcess) -> None:
    before = threading.active_count()
    with driven("right") as arm:
        arm.connect()
        pid = arm.worker_pid
    assert threading.active_count() == before
    assert not Path(f"/proc/{pid}").exists()
