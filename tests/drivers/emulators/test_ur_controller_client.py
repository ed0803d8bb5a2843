"""The real ur_rtde client, in a separate process because it holds the interpreter's lock, against the emulator."""

from __future__ import annotations

import importlib
import importlib.util
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from drivers.emulators.ur_controller import ControllerConfig, EmulatorProcess, personality, start_in_process
from tests.latency import attempts
from tests.loopback import own_arms
from tests.waiting import until

ROOT = Path(__file__).parents[3]
LONGEST_S = 40.0
MEANWHILE_S = 4 * LONGEST_S
"""All scenarios that run meanwhile, one after the other."""
HOSTS, MEANWHILE_HOSTS = own_arms(61), own_arms(65)
MEANWHILE = ("late_start", "watchdog", "emergency_stop")
"""Scenarios that run meanwhile, because they wait longest."""

pytestmark = [
    pytest.mark.waits,
    pytest.mark.skipif(sys.platform != "linux", reason="needs loopback addresses beyond 127.0.0.1"),
]


@contextmanager
def controllers(hosts: Mapping[str, str]) -> Iterator[EmulatorProcess]:
    left = personality("CB3", "UR10", "20153012345")
    arms = [
        ControllerConfig("left", hosts["left"], left, boot_s=0.2, brake_release_s=0.1),
        ControllerConfig("right", hosts["right"], personality("e-Series", "UR5", "20205501234")),
    ]
    with start_in_process(arms) as process:
        yield process


def reset(process: EmulatorProcess) -> None:
    """Let controllers work without faults, wherever their arms stand; their time passes three times as fast."""
    control = process.control
    control("*", "pace", 3)
    control("*", "fault", "*", "none")
    control("*", "start-delay", 0.05)
    control("*", "remote", "on")
    control("*", "protective", "off")
    for command in ("release", "estop-release", "brake-release"):
        control("*", command)

    def ready() -> bool:
        return all(s["robot_mode"] == "RUNNING" and s["safety_mode"] == "NORMAL" for s in control("*", "status"))

    until(ready, "controllers that can move")


Found = dict[str, Any]


@pytest.fixture(scope="module")
def meanwhile() -> Iterator[Mapping[str, Future[Found]]]:
    """What the scenarios that wait longest found with other controllers, while the other tests run."""

    def alone(process: EmulatorProcess, scenario: str) -> Found:
        reset(process)
        return client(process, scenario, MEANWHILE_HOSTS)

    with controllers(MEANWHILE_HOSTS) as process, ThreadPoolExecutor(1) as one_after_the_other:
        yield {scenario: one_after_the_other.submit(alone, process, scenario) for scenario in MEANWHILE}
        one_after_the_other.shutdown(cancel_futures=True)


@pytest.fixture(scope="module")
def process() -> Iterator[EmulatorProcess]:
    with controllers(HOSTS) as process:
        yield process


@pytest.fixture
def emulator(meanwhile: object, process: EmulatorProcess) -> EmulatorProcess:
    reset(process)
    return process


def client(emulator: EmulatorProcess, scenario: str, hosts: Mapping[str, str] = HOSTS) -> Found:
    """What a scenario found."""
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "tests.drivers.emulators.ur_rtde_scenario",
            scenario,
            str(emulator.addresses.control[1]),
            *hosts.values(),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=LONGEST_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found: Found = json.loads(done.stdout.splitlines()[-1])
    return found


def test_two_arms_at_once_and_all_that_a_driver_asks_for(emulator: EmulatorProcess) -> None:
    found = client(emulator, "both_arms")
    assert found["done"] == [True, True]
    assert found["together"] is True
    assert found["temperatures"] == [20.0] * 6
    assert found["modes"] == [7, 1, True]
    assert (found["payload"], found["tcp"]) == (True, True)
    assert found["tcp_offset"] == [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    assert (found["asynchronous"], found["back"]) == (True, True)
    moving, gone = found["stopped"]
    assert moving is False
    assert 0.15 < gone < 2.0


def test_states_come_at_125_and_500_a_second(emulator: EmulatorProcess) -> None:
    for took in attempts(old=0.008 * 1.3):  # of the faster states a busy computer loses some
        took["old"], new = client(emulator, "rates")["steps_s"]
        assert took["old"] > 0.008 * 0.7
        assert new > 0.002 * 0.7


def test_a_protective_stop_and_its_release(emulator: EmulatorProcess) -> None:
    found = client(emulator, "protective_stop")
    assert (found["outcome"], found["refused"]) == (False, False)
    assert found["mode"] == "PROTECTIVE_STOP"
    assert 0.2 <= found["gone"] < 0.6
    assert "Cannot unlock protective stop until 5s" in found["unlocked_early"]
    assert (found["still"], found["next"], found["moves"]) == (True, True, 2)


def test_an_arm_goes_on_when_the_link_is_cut(emulator: EmulatorProcess) -> None:
    found = client(emulator, "dropped")
    assert found["seen"] is True
    assert found["gone"] == pytest.approx(0.5, abs=1e-9)


def test_a_late_start_local_control_and_a_second_client_fail_as_on_a_real_controller(
    emulator: EmulatorProcess, meanwhile: Mapping[str, Future[Found]]
) -> None:
    assert "remote control" in client(emulator, "local_control")["error"]
    second = client(emulator, "second_client")
    assert "already in use" in second["error"]
    assert second["first"] is True
    assert "Failed to start control script" in meanwhile["late_start"].result(MEANWHILE_S)["error"]


def test_the_watchdog_brings_the_arm_of_a_silent_client_to_rest(meanwhile: Mapping[str, Future[Found]]) -> None:
    found = meanwhile["watchdog"].result(MEANWHILE_S)
    assert found["fed"] is True
    assert found["moving"] is False
    assert found["gone"] < 2.4, "it went all the way"


def test_an_emergency_stop_and_its_release(meanwhile: Mapping[str, Future[Found]]) -> None:
    assert meanwhile["emergency_stop"].result(MEANWHILE_S) == {"refused": False, "still": True, "next": True}


@pytest.mark.skipif(
    importlib.util.find_spec("rtde") is None,
    reason="Universal Robots' own client library is not installed; it is not on the package index",
)
def test_universal_robots_own_client_streams_and_writes(emulator: EmulatorProcess) -> None:
    rtde, serialize = (importlib.import_module(f"rtde.{module}") for module in ("rtde", "serialize"))

    for host, hz in zip(HOSTS.values(), (125.0, 500.0), strict=True):
        connection = rtde.RTDE(host)
        connection.connect()
        assert connection.get_controller_version()[0] in (3, 5)
        names = ["timestamp", "actual_q", "robot_mode", "input_int_register_30"]
        kinds = ["DOUBLE", "VECTOR6D", "INT32", "INT32"]
        assert connection.send_output_setup(names, kinds, frequency=hz)
        command = connection.send_input_setup(["input_int_register_30"], ["INT32"])
        assert isinstance(command, serialize.DataObject)
        assert connection.send_start()
        states = [connection.receive() for _ in range(20)]
        assert states[-1].robot_mode == 7
        assert len(states[-1].actual_q) == 6
        assert states[-1].timestamp > states[0].timestamp
        command.input_int_register_30 = 12
        connection.send(command)
        for _ in range(1000):
            if connection.receive().input_int_register_30 == 12:
                break
        else:
            pytest.fail("what was written did not come back")
        connection.send_pause()
        connection.disconnect()
