"""Probing a UR controller: answers are parsed, only questions are sent, every host is given up in bounded time."""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.arms.protocol import LinkLost
from drivers.arms.ur_probe import UrProbe, parse_robot_state, probe_ur
from drivers.emulators.ur_controller import (
    FREE_PORTS,
    Control,
    ControllerConfig,
    Fault,
    Personality,
    UrControllerServer,
    kinematics_info,
    personality,
)
from tests.drivers.arms.emulated_ur_cell import peer_that_says
from tests.latency import attempts
from tests.sure import sure

PATIENT_S = 10.0
SHORT_S = 0.3
MARGIN_S = 1.0
"""Beyond its time limit, for a probe to look at the other ports."""
QUESTIONS = {
    "PolyscopeVersion", "get robot model", "get serial number", "robotmode", "safetymode", "safetystatus", "running",
    "programState",
    "is in remote control",
}  # fmt: skip
CB3 = personality("CB3", "UR10", "20153012345")
E_SERIES = personality("e-Series", "UR5", "20205501234")


@contextmanager
def open_port() -> Iterator[int]:
    """A port that accepts connections and sends nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


@contextmanager
def closed_port() -> Iterator[int]:
    """A port that is bound but does not listen."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield taken.getsockname()[1]


@dataclass(frozen=True)
class Emulator:
    """One emulated controller on free ports, and its control channel."""

    control: Control
    host: str
    dashboard_port: int
    primary_port: int

    def fail(self, fault: Fault, port: str = "*") -> None:
        self.control("arm", "fault", port, fault)


@contextmanager
def emulated(controller: Personality, **changes: Any) -> Iterator[Emulator]:
    config = replace(ControllerConfig("arm", "127.0.0.1", controller, ports=FREE_PORTS), **changes)
    with UrControllerServer([config]) as server, closing(server.control()) as control:
        ports = server.addresses.arms["arm"]
        yield Emulator(control, "127.0.0.1", ports["dashboard"][1], ports["primary"][1])


def ask(emulator: Emulator, timeout_s: float = PATIENT_S) -> UrProbe:
    """Probe an emulator, with an open script port and a closed RTDE port."""
    with open_port() as script, closed_port() as rtde:
        ports = (emulator.dashboard_port, emulator.primary_port, script, rtde)
        return probe_ur(emulator.host, timeout_s, ports=ports)


def lost(dashboard_port: int, timeout_s: float = PATIENT_S, host: str = "127.0.0.1") -> str:
    """The message of a probe that finds no dashboard; the other ports are closed."""
    with closed_port() as first, closed_port() as second, closed_port() as third, pytest.raises(LinkLost) as caught:
        probe_ur(host, timeout_s, ports=(dashboard_port, first, second, third))
    return str(caught.value)


@pytest.mark.parametrize(
    ("controller", "software", "full_model"),
    [(CB3, "3.15.8.106339", "UR10"), (E_SERIES, "5.11.1.1108318", "UR5e")],
    ids=["CB3", "e-Series"],
)
def test_identity_and_state_of_a_controller_are_probed(controller: Personality, software: str, full_model: str) -> None:
    with emulated(controller) as emulator:
        probe = ask(emulator)
        sent = set(emulator.control("arm", "received"))
    assert {"PolyscopeVersion", "safetymode"} <= sent <= QUESTIONS, "only questions are sent"
    assert (probe.software, probe.series, probe.full_model) == (software, controller.series, full_model)
    assert (probe.model, probe.serial) == (controller.model, controller.serial)
    assert (probe.robot_mode, probe.safety_mode, probe.program_running) == ("RUNNING", "NORMAL", False)
    e_series = controller.series == "e-Series"
    assert probe.remote_control is (True if e_series else None)
    assert probe.safety_status == ("NORMAL" if e_series else None)
    assert list(probe.ports.values()) == [True, True, False]
    assert sure(probe.kinematics).rows == tuple(map(tuple, controller.rows))
    assert probe.kinematics_note == ""


def test_calibrated_kinematics_come_with_their_checksums() -> None:
    rows = tuple((1e-4 * i, d + 1e-3 * i, a - 2e-4, alpha + 3e-5) for i, (_, d, a, alpha) in enumerate(CB3.rows))
    calibrated = replace(CB3, rows=rows, checksums=(1, 2, 3, 4, 5, 0xDEADBEEF), calibration_status=2)
    with emulated(calibrated) as emulator:
        found = ask(emulator).kinematics
    assert sure(found).rows == rows
    assert sure(found).checksum == "00000001-00000002-00000003-00000004-00000005-deadbeef"


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("silent", "its greeting did not come in time"),
        ("trickle", "its greeting did not come in time"),
        ("refuse", "no connection to the UR dashboard"),
        ("garbage", "the peer is not a UR dashboard"),
        ("flood", "longer than 4096 bytes"),
    ],
)
def test_a_faulty_dashboard_is_named_in_bounded_time(fault: Fault, expected: str) -> None:
    timeout_s = SHORT_S if fault in ("silent", "trickle") else PATIENT_S
    with emulated(CB3) as emulator:
        emulator.fail(fault)
        for took in attempts(named=SHORT_S + MARGIN_S):
            began = time.monotonic()
            message = lost(emulator.dashboard_port, timeout_s)
            took["named"] = time.monotonic() - began
        assert f"127.0.0.1:{emulator.dashboard_port}: " in message
        assert expected in message
        emulator.fail("none")
        assert ask(emulator).model == "UR10"


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("silent", "no kinematics came in time"),
        ("trickle", "not UR packages"),  # five zero bytes are a package of no size
        ("refuse", "no connection"),
        ("garbage", "not UR packages"),
        ("flood", "not UR packages"),
    ],
)
def test_a_faulty_primary_port_costs_only_the_kinematics(fault: Fault, expected: str) -> None:
    with emulated(CB3) as emulator:
        emulator.fail(fault, "primary")
        probe = ask(emulator, 1.0)
        primary = emulator.primary_port
    assert probe.model == "UR10"
    assert probe.ports[primary] is (fault != "refuse")
    assert probe.kinematics is None
    assert expected in probe.kinematics_note


def test_other_open_ports_are_named_when_the_dashboard_is_closed() -> None:
    with emulated(CB3) as emulator:
        emulator.fail("refuse", "dashboard")
        with pytest.raises(LinkLost, match=rf"Other UR ports .*\({emulator.primary_port}, \d+\).*switched on"):
            ask(emulator)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", "closed the connection before its greeting"),
        (b"Connected: Universal Robots Dashboard", "closed the connection before its greeting"),
        (b"SSH-2.0-OpenSSH_9\r\n", "greeting is 'SSH-2.0-OpenSSH_9'"),
        (b"\x1b[2J\x00\n", "greeting is '?[2J?'"),
        (b"\n\nConnected: Universal Robots Dashboard Server\n\nhello\n", "expected a PolyScope version"),
        (b"Connected: Universal Robots Dashboard Server\n", "before the answer to 'PolyscopeVersion'"),
        (b"Connected: Universal Robots Dashboard Server\n" + 5000 * b"5" + b"\n", "longer than 4096 bytes"),
    ],
)
def test_a_peer_that_is_not_a_dashboard_is_refused(data: bytes, expected: str) -> None:
    with peer_that_says(data) as port:
        assert expected in lost(port)


def test_a_host_that_does_not_exist_is_named() -> None:
    assert "no-such-host.invalid: no IPv4 host of that name" in lost(1, host="no-such-host.invalid")
    assert "host is empty" in lost(1, host=" ")
    assert "no IPv4 host of that name" in lost(1, host="a" * 80)


@pytest.mark.parametrize("timeout_s", [-1.0, math.nan])
def test_a_timeout_must_be_a_time(timeout_s: float) -> None:
    with pytest.raises(ValueError, match="timeout_s"):
        probe_ur("127.0.0.1", timeout_s)


# -- the primary interface's bytes ------------------------------------------------------------------------------------


def sub_package(kind: int, payload: bytes) -> bytes:
    return struct.pack(">IB", 5 + len(payload), kind) + payload


KINEMATICS = kinematics_info(CB3)


def test_the_kinematics_sub_package_has_its_published_size_and_order() -> None:
    assert struct.unpack_from(">IB", KINEMATICS) == (225, 5)
    assert struct.unpack_from(">6d", KINEMATICS, 5 + 24 + 48)[1:3] == (-0.612, -0.5723)  # a after theta
    assert struct.unpack_from(">6d", KINEMATICS, 5 + 24 + 96)[0] == 0.1273


@given(
    before=st.lists(st.tuples(st.integers(7, 255), st.binary(max_size=60)), max_size=5), appended=st.binary(max_size=20)
)
def test_unknown_sub_packages_and_appended_fields_are_skipped(before: list[tuple[int, bytes]], appended: bytes) -> None:
    longer = sub_package(5, KINEMATICS[5:] + appended)
    found = parse_robot_state(b"".join(sub_package(kind, payload) for kind, payload in before) + longer).kinematics
    assert (sure(found).rows, sure(found).checksum) == (tuple(map(tuple, CB3.rows)), "")


@given(st.binary(max_size=400))
def test_any_bytes_are_parsed_or_refused(state: bytes) -> None:
    try:
        found = parse_robot_state(state)
    except ValueError:
        return
    assert found.kinematics is None or len(state) >= 225


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (KINEMATICS[:-1], "claims 225 bytes of 224"),
        (struct.pack(">IB", 0, 7), "claims 0 bytes"),
        (b"\x00\x00", "inside a sub-package's header"),
        (sub_package(5, KINEMATICS[5:-4]), "have 221 bytes, expected 225"),
        (sub_package(5, KINEMATICS[5:29] + struct.pack(">d", math.nan) + KINEMATICS[37:]), "not a finite number"),
    ],
)
def test_broken_packages_are_refused(state: bytes, expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        parse_robot_state(state)


def test_polyscope_x_is_refused_by_name_with_what_to_do() -> None:
    """It has no dashboard server: its version comes from the primary port."""
    with (
        emulated(replace(E_SERIES, series="PolyScope X")) as emulator,
        closed_port() as dashboard,
        open_port() as script,
        closed_port() as rtde,
        pytest.raises(LinkLost) as caught,
    ):
        probe_ur(emulator.host, PATIENT_S, ports=(dashboard, emulator.primary_port, script, rtde))
    words = str(caught.value)
    assert "PolyScope X (version 10) has no dashboard server" in words
    assert "not driven" in words
    assert "cellapp import" in words
