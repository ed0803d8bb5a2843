"""A UR arm that a person leads is read over RTDE: nothing is written, and only an arm at rest is read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np
import pytest

from drivers.arms import ur_led
from drivers.arms.protocol import ArmError, ArmState, ArmTimeout, LinkLost, WrongRobot
from drivers.arms.ur_led import read_led_arm
from drivers.arms.ur_rtde_reader import UrSample
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import FREE_PORTS, Control, ControllerConfig, UrControllerServer, personality
from tests.drivers.arms.emulated_ur_cell import expectation

pytestmark = pytest.mark.fast
REST_S = 0.05
SERIAL = "20153012345"


@contextmanager
def emulated() -> Iterator[tuple[Control, dict[str, int]]]:
    config = replace(
        ControllerConfig("left", "127.0.0.1", personality("CB3", "UR10", SERIAL), ports=FREE_PORTS), payload_mass=0.35
    )
    with UrControllerServer([config]) as server, closing(server.control()) as control:
        ports = server.addresses.arms["left"]
        yield control, {f"{name}_port": ports[name][1] for name in ("dashboard", "primary", "script", "rtde")}


def read(ports: dict[str, int], *, timeout_s: float = 5.0, serial: str = SERIAL) -> ArmState:
    settings = UrSettings(host="127.0.0.1", timeout=timeout_s)
    return read_led_arm(settings, expectation("left", serial=serial), REST_S, 1.0, **ports)


def test_the_joints_of_a_resting_arm_are_read_and_nothing_is_begun() -> None:
    with emulated() as (control, ports):
        before = control("left", "status")
        state = read(ports)
        after = control("left", "status")
    assert state.q == pytest.approx(before["q"])
    assert state.payload_kg == pytest.approx(0.35)
    assert not state.moving
    assert (after["moves"], after["runtime_state"], after["program"]) == (before["moves"], "STOPPED", None)


def test_a_stopped_arm_is_read_and_its_stop_stays() -> None:
    with emulated() as (control, ports):
        control("left", "protective", "now")
        assert len(read(ports).q) == 6
        assert control("left", "status")["safety_mode"] == "PROTECTIVE_STOP"


def test_an_arm_without_power_another_robot_and_a_lost_link_are_named() -> None:
    with emulated() as (control, ports):
        with pytest.raises(WrongRobot, match=f"the controller's is {SERIAL}, the profile states 1234"):
            read(ports, serial="1234")
        control("left", "power-off")
        with pytest.raises(ArmError, match="POWER_OFF: its joints are not read; switch it on"):
            read(ports)
        control("left", "fault", "rtde", "silent")
        with pytest.raises(LinkLost):
            read(ports, timeout_s=0.3)


def samples(speeds: list[float], drift: float = 0.0) -> list[UrSample]:
    """States every 10 ms, joint 2 at these speeds [rad/s], its encoder drifting by some [rad] from one to the next."""
    zeros = (0.0,) * 6
    return [
        UrSample(
            0.01 * k, (0.0, drift * k, *zeros[2:]), (0.0, v, *zeros[2:]), "RUNNING", "NORMAL", "STOPPED", 1.0, 1.0, None
        )
        for k, v in enumerate(speeds)
    ]


@pytest.mark.parametrize(("speeds", "drift"), [([0.1] * 250, 0.0), ([0.1, *[0.0] * 4] * 50, 0.0), ([0.0] * 250, 1e-4)])
def test_an_arm_that_moves_is_refused(monkeypatch: pytest.MonkeyPatch, speeds: list[float], drift: float) -> None:
    monkeypatch.setattr(ur_led, "samples", lambda link, patience: iter(samples(speeds, drift)))
    with emulated() as (_, ports), pytest.raises(ArmTimeout, match="the arm moves"):
        read(ports)


def test_an_arm_is_read_once_it_has_come_to_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ur_led, "samples", lambda link, patience: iter(samples([0.1] * 20 + [0.0] * 20, 1e-6)))
    with emulated() as (_, ports):
        q = read(ports).q
    assert q == pytest.approx(np.array([0.0, 22.5e-6, 0.0, 0.0, 0.0, 0.0]), abs=0.6e-6)
