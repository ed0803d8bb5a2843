"""Two or four emulated UR controllers in a separate process, and drivers for them with the real client."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arms.protocol import ArmError, ArmState, HostStalled, JointLimits
from drivers.arms.ur import UrArm
from drivers.arms.ur_checks import UrExpectation
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import ControllerConfig, EmulatorProcess, Series, personality, start_in_process
from tests.at_once import in_parallel
from tests.latency import patiently
from tests.loopback import own_address, own_arms
from tests.sure import sure
from tests.waiting import WAIT_S, until, within

PATIENT_S = WAIT_S
ROOT = Path(__file__).parents[3]
SERIALS = {"left": "20153012345", "right": "20205501234", "left2": "20153012346", "right2": "20205501235"}
HOSTS = own_arms(41)
FOUR_HOSTS = {**HOSTS, "left2": own_address(63), "right2": own_address(64)}
"""Of four arms, for tests that mostly wait: four of them wait at the same time. A second one is like the first."""
MODELS = {"left": "UR10", "right": "UR5e", "left2": "UR10", "right2": "UR5e"}
HOME = np.array([0.0, -np.pi / 2.0, 0.0, -np.pi / 2.0, 0.0, 0.0])
SPEED, ACCELERATION = np.full(6, 2.0), np.full(6, 8.0)
UNHURRIED = 0.5 * SPEED
"""Of motions that are interrupted on the way: on a busy computer a fault may come late."""
AWAY = HOME + np.array([0.25, 0.1, -0.2, 0.15, 0.3, -0.35])
FAR = HOME + np.array([2.4, 0.3, -0.5, 1.0, 1.5, -2.0])
"""More than a second away."""
WATCHDOG_HZ = 2.0
"""A busy computer may stall for longer than the usual period of 0.2 s; a test of the watchdog sets its own."""
Episode = Callable[[EmulatorProcess, UrArm], None]
"""What happens to one arm, without fault and connected before it; it mostly waits."""
SETTLE_S = 0.05
"""Of the emulated arms, which do not swing; usually 0.2 s after each motion."""


def expectation(name: str, **changes: Any) -> UrExpectation:
    limits = JointLimits(np.tile([-2.0 * np.pi, 2.0 * np.pi], (6, 1)), np.full(6, 3.0), np.full(6, 8.0))
    expected = UrExpectation(
        MODELS[name], SERIALS[name], limits, payload_kg=0.35, payload_center_m=np.array([0, 0, 0.03])
    )
    return replace(expected, **changes)


def configs(hosts: Mapping[str, str] = HOSTS, **changes: Any) -> list[ControllerConfig]:
    """The controllers: CB3 ones on the left, e-Series ones on the right."""
    series: dict[str, tuple[Series, str]] = {"left": ("CB3", "UR10"), "right": ("e-Series", "UR5")}
    load: dict[str, Any] = {"payload_mass": 0.35, "payload_center": (0.0, 0.0, 0.03)}
    quick: dict[str, Any] = {"boot_s": 0.2, "brake_release_s": 0.1, "unlock_after_s": 0.2}
    return [
        ControllerConfig(
            name, host, personality(*series[name.removesuffix("2")], SERIALS[name]), **(load | quick | changes)
        )
        for name, host in hosts.items()
    ]


@contextmanager
def emulated_cell(hosts: Mapping[str, str] = HOSTS) -> Iterator[EmulatorProcess]:
    with start_in_process(configs(hosts)) as emulator:
        yield emulator


@contextmanager
def driven(name: str, settings: UrSettings | None = None, **changes: Any) -> Iterator[UrArm]:
    """A driver that is not connected yet; disconnected at the end."""
    patient = UrSettings(host=FOUR_HOSTS[name], watchdog_hz=WATCHDOG_HZ, settle_time=SETTLE_S)
    arm = UrArm(name, settings or patient, expectation(name, **changes), rest_s=1.0)
    try:
        yield arm
    finally:
        arm.disconnect()


@contextmanager
def drivers_of(hosts: Mapping[str, str]) -> Iterator[dict[str, UrArm]]:
    """A driver an arm, not connected yet; all are disconnected at the end."""
    with ExitStack() as stack:
        yield {name: stack.enter_context(driven(name)) for name in hosts}


def warnings_about(arm: UrArm) -> list[str]:
    """Return the arm's warnings without those about this computer, which may be busy."""
    return [note for note in arm.warnings() if "heartbeats: " not in note]


def of_each_arm(
    emulator: EmulatorProcess,
    arms: Mapping[str, UrArm],
    episodes: Mapping[str, Sequence[Episode]],
    make_ready: Callable[[EmulatorProcess, UrArm], object],
) -> None:
    """Let all arms have their episodes at the same time, each one after the other and from an arm that is ready; one
    that ends with a stall of this computer again. A second arm without episodes of its own shares those of the first.
    """
    its_own = {name: iter(its) for name, its in episodes.items()}

    def one_after_the_other(arm: UrArm) -> None:
        for episode in its_own.get(arm.name, its_own[arm.name.removesuffix("2")]):

            def act(attempt: int, episode: Episode = episode) -> None:
                with no_fault_set():
                    make_ready(emulator, arm)
                episode(emulator, arm)

            try:
                patiently(act, ArmError, is_stall)
            except BaseException as error:
                error.add_note(f"the emulated arm: {emulator.control(arm.name, 'journal', time.monotonic() - 3.0)}")
                raise

    in_parallel(one_after_the_other, [(arm,) for arm in arms.values()])


@contextmanager
def no_fault_set() -> Iterator[None]:
    """What an arm without a fault reports is a stall of this computer: its driver or its emulator got no turn."""
    try:
        yield
    except ArmError as error:
        raise HostStalled(f"no fault was set: {error}") from error


def is_stall(error: ArmError) -> bool:
    """Return whether this computer kept a worker from its arm or from its heartbeats; no test ends with these."""
    stalls = ("its driver process was silent for", "or this computer stood still meanwhile")
    return isinstance(error, HostStalled) or any(words in str(error) for words in stalls)


class Heard:
    """A listener that keeps what it was told, and when."""

    def __init__(self, arm: UrArm) -> None:
        self.faults: list[tuple[float, ArmError]] = []
        arm.watch(lambda error: self.faults.append((time.monotonic(), error)))

    def first(self) -> tuple[float, ArmError]:
        until(lambda: bool(self.faults), "the listener is told")
        return self.faults[0]


def go(arm: UrArm, q: np.ndarray) -> ArmState:
    """Move to ``q``, rest there, and return the state."""
    arm.start_move(q, SPEED, ACCELERATION)
    state = arm.wait_settled(PATIENT_S)
    assert not state.moving
    np.testing.assert_allclose(state.q, q, atol=1e-6)
    return state


def set_out(arm: UrArm) -> None:
    """Be on the way from HOME to FAR."""
    arm.start_move(FAR, UNHURRIED, ACCELERATION)
    until(lambda: abs(arm.state().q[0] - HOME[0]) > 0.1, "the arm moves")


@contextmanager
def peer_that_says(data: bytes) -> Iterator[int]:
    """A port that sends ``data`` to its first client and then closes."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENT_S)

        def serve() -> None:
            link, _ = server.accept()
            with link, suppress(ConnectionError):  # the client may have given up
                link.settimeout(PATIENT_S)
                link.sendall(data)
                link.shutdown(socket.SHUT_WR)
                while link.recv(4096):
                    pass

        thread = threading.Thread(target=serve)
        thread.start()
        yield server.getsockname()[1]
        thread.join(PATIENT_S)
        assert not thread.is_alive()


@contextmanager
def application(text: str, name: str) -> Iterator[tuple[subprocess.Popen[str], Callable[[str], str]]]:
    """A program in a process of its own that drives an arm, and what it says next, which is asked for in words."""
    command = [sys.executable, "-c", text, name]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as started:
        yield started, lambda what: within(sure(started.stdout).readline, what)


def pause(seconds: float) -> None:
    threading.Event().wait(seconds)


def connected(emulator: EmulatorProcess, arm: UrArm) -> None:
    """Let an arm be without fault and connected, and nobody listen to it."""
    arm.watch(lambda error: None)
    repair(emulator, arm.name)
    arm.connect()


def at_home(emulator: EmulatorProcess, arm: UrArm) -> None:
    """Let an arm be without fault, connected and at HOME."""
    connected(emulator, arm)
    go(arm, HOME)


def repair(emulator: EmulatorProcess, name: str) -> None:
    """Repair an arm as a person would: release stops, power on, raise the slider, end all faults."""
    control = emulator.control
    control(name, "fault", "*", "none")
    control(name, "slider", 1.0)
    control(name, "network", 0)
    control(name, "protective", "off")
    control(name, "release")
    control(name, "estop-release")
    control(name, "brake-release")
    control(name, "remote", "on")
    control(name, "start-delay", 0.05)
    until(lambda: ready(control(name, "status")), "the arm may move")


def ready(status: dict[str, Any]) -> bool:
    return status["robot_mode"] == "RUNNING" and status["safety_mode"] == "NORMAL" and not status["moving"]


def assert_stays_at_rest(emulator: EmulatorProcess, name: str, for_s: float = 0.15) -> None:
    """Assert that the arm comes to rest and stays at rest; 0.15 s are 19 states of a CB3 controller."""
    until(lambda: not emulator.control(name, "status")["moving"], "the arm has braked")
    before = emulator.control(name, "status")
    pause(for_s)
    after = emulator.control(name, "status")
    assert not after["moving"]
    assert (after["moves"], after["q"]) == (before["moves"], before["q"])


def assert_braked(emulator: EmulatorProcess, name: str, since_s: float) -> None:
    """Assert that a stop since ``since_s`` (``time.monotonic``) met the arm in motion, and that it stays at rest."""
    assert_stays_at_rest(emulator, name)
    stops = emulator.control(name, "stops", since_s)
    assert any(stop["ideal_s"] > 0.0 for stop in stops), f"no stop met it in motion: {stops}"


def received_stop_s(emulator: EmulatorProcess, name: str, since_s: float) -> float:
    """Return when the controller received the first stop after ``since_s`` (``time.monotonic``)."""
    stops = [stop for stop in emulator.control(name, "stops") if stop["received_s"] >= since_s]
    return float(stops[0]["received_s"])


def at_rest(emulator: EmulatorProcess, name: str) -> bool:
    return not emulator.control(name, "status")["moving"]
