"""The emulated controller over plain sockets: protocol, faults on command, and a plant moved by it."""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.emulators.ur_controller import (
    FREE_PORTS,
    Control,
    ControllerConfig,
    PortName,
    Refused,
    UrControllerServer,
    personality,
    start_in_process,
)
from drivers.emulators.ur_controller.rtde import RtdeServer, RtdeSession
from drivers.plant import Plant
from tests.approved import assert_refused
from tests.drivers.emulators.test_ur_controller_state import Bench, control_text
from tests.waiting import until

pytestmark = pytest.mark.waits

PATIENT_S = 10.0
MOVES_RECIPE = [f"input_double_register_{i}" for i in range(8)]
CB3 = ControllerConfig("old", "127.0.0.1", personality("CB3", "UR10", "20153012345"), ports=FREE_PORTS)
E_SERIES = ControllerConfig("new", "127.0.0.1", personality("e-Series", "UR5", "20205501234"), ports=FREE_PORTS)


class Rtde:
    """An RTDE client written from the description of the protocol."""

    def __init__(self, address: tuple[str, int]) -> None:
        self.link = socket.create_connection(address, PATIENT_S)
        self._held = b""
        self._layout = struct.Struct("")

    def __enter__(self) -> Rtde:
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()

    def send(self, kind: str, payload: bytes = b"") -> None:
        self.link.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def receive(self) -> tuple[str, bytes]:
        while len(self._held) < 3 or len(self._held) < struct.unpack_from(">H", self._held)[0]:
            more = self.link.recv(65536)
            if not more:
                raise ConnectionResetError("closed")
            self._held += more
        size, kind = struct.unpack_from(">HB", self._held)
        payload, self._held = self._held[3:size], self._held[size:]
        return chr(kind), payload

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        self.send(kind, payload)
        while True:
            answered, reply = self.receive()
            if answered == kind:
                return reply

    def agree(self) -> Rtde:
        assert self.ask("V", struct.pack(">H", 2)) == b"\x01"
        return self

    def outputs(self, names: list[str], hz: float = 500.0) -> tuple[int, list[str]]:
        reply = self.ask("O", struct.pack(">d", hz) + ",".join([*names, ""]).encode())
        types = reply[1:].decode().split(",")
        sizes = {"DOUBLE": "d", "VECTOR6D": "6d", "INT32": "i", "UINT32": "I", "VECTOR6INT32": "6i", "UINT64": "Q"}
        self._layout = struct.Struct(">" + "".join(sizes.get(kind, "") for kind in types))
        return reply[0], types

    def inputs(self, names: list[str]) -> tuple[int, list[str]]:
        reply = self.ask("I", ",".join(names).encode())
        return reply[0], reply[1:].decode().split(",")

    def start(self) -> None:
        assert self.ask("S") == b"\x01"

    def state(self) -> tuple[float, ...]:
        while True:
            kind, payload = self.receive()
            if kind == "U":
                return self._layout.unpack(payload[1:])

    def until(self, condition: Callable[[tuple[float, ...]], bool]) -> tuple[float, ...]:
        end = time.monotonic() + PATIENT_S
        while time.monotonic() < end:
            state = self.state()
            if condition(state):
                return state
        raise AssertionError("it did not happen")


@pytest.fixture(scope="module")
def emulator() -> Iterator[UrControllerServer]:
    with UrControllerServer([CB3, E_SERIES]) as server:
        yield server


@pytest.fixture
def control(emulator: UrControllerServer) -> Iterator[Control]:
    with closing(emulator.control()) as channel:
        yield channel
        channel("*", "fault", "*", "none")


@contextmanager
def alone(
    config: ControllerConfig, plant: Plant | None = None, pace: float = 1.0
) -> Iterator[tuple[UrControllerServer, Control]]:
    with UrControllerServer([config], plant, pace) as server, closing(server.control()) as control:
        yield server, control


def at(server: UrControllerServer, arm: str, port: PortName) -> tuple[str, int]:
    return server.addresses.arms[arm][port]


def talk(address: tuple[str, int], *lines: str) -> list[str]:
    """Greeting and answers of the dashboard; the connection is closed by ``quit``."""
    with socket.create_connection(address, PATIENT_S) as link:
        link.sendall("".join(f"{line}\n" for line in (*lines, "quit")).encode())
        with link.makefile("r", encoding="utf-8") as answers:
            return answers.read().splitlines()


# -- RTDE --------------------------------------------------------------------------------------------------------------


def test_an_input_belongs_to_one_connection_until_it_ends(emulator: UrControllerServer, control: Control) -> None:
    address = at(emulator, "old", "rtde")
    with Rtde(address).agree() as first:
        assert first.inputs(["input_int_register_5"]) == (1, ["INT32"])
        assert first.inputs(["input_int_register_5", "input_int_register_6"])[0] == 2, "its own it may use again"
        with Rtde(address).agree() as second:
            taken = (0, ["INT32", "IN_USE"])
            assert second.inputs(["input_int_register_7", "input_int_register_6"]) == taken
            with Rtde(address).agree() as third:
                assert third.inputs(["input_int_register_7"])[0] == 1, "a refused recipe takes nothing"
            first.send("U", b"\x01" + struct.pack(">i", 42))
            first.ask("v")
            first.link.close()
            until(lambda: control("old", "status")["connections"]["rtde"] < 3, "the end of a link")
            until(lambda: second.inputs(["input_int_register_5"])[0] > 0, "registers that are free again")
            second.outputs(["input_int_register_5"])
            second.start()
            assert second.state() == (42,), "the last value stays"


@pytest.mark.parametrize("keep", ["swallow", "close"])
def test_packets_of_the_wrong_length_are_swallowed_or_end_the_link(keep: str) -> None:
    with alone(CB3) as (server, control), Rtde(at(server, "old", "rtde")).agree() as client:
        control("old", "short-packets", keep)
        assert client.inputs(["input_int_register_0", "input_double_register_0"])[0] == 1
        client.send("U", b"\x01" + struct.pack(">i", 7))
        if keep == "close":
            with pytest.raises(ConnectionResetError):
                client.ask("v")
            return
        client.send("U", b"\x09" + struct.pack(">id", 8, 8.0))
        client.send("U")
        client.outputs(["input_int_register_0"])
        client.start()
        assert client.state() == (0,)
        assert sum("ignored" in line for line in control("old", "log")) == 3


@given(st.lists(st.binary(max_size=80), max_size=10))
def test_no_bytes_break_the_rtde_server(pieces: list[bytes]) -> None:
    sent: list[bytes] = []
    server = RtdeServer(Bench().controller)
    session = RtdeSession(server, sent.append, sent.append, lambda: sent.append(b"closed"))
    session.received(struct.pack(">HBH", 5, ord("V"), 2))
    for kind, piece in enumerate(pieces):
        session.received(piece)
        session.received(struct.pack(">HB", 3 + len(piece), b"VvMOISPU"[kind % 8]) + piece)
        session.cycle()
    session.closed()
    assert sent[0] == struct.pack(">HBB", 4, ord("V"), 1)
    assert not server._owners, "a closed session keeps its inputs"


# -- the other ports ---------------------------------------------------------------------------------------------------


def test_the_dashboard_answers_line_by_line(emulator: UrControllerServer) -> None:
    asked = ["robotmode", "is in remote control", "stop", "load /a b.urp", "stopp", "running", "programState"]
    assert talk(at(emulator, "old", "dashboard"), *asked) == [
        "Connected: Universal Robots Dashboard Server",
        "Robotmode: RUNNING",
        "could not understand: 'is in remote control'",
        "Stopped",
        "Failed to execute: load /a b.urp",
        "could not understand: 'stopp'",
        "Program running: false",
        "STOPPED <unnamed>",
        "Disconnected",
    ]
    said = talk(at(emulator, "new", "dashboard"), "is in remote control", "safetystatus", "PolyscopeVersion")
    assert said[1:3] == ["true", "Safetystatus: NORMAL"]
    assert said[3].startswith("URSoftware 5.11.1.1108318")


def test_the_dashboard_serves_several_clients_and_drops_endless_lines(emulator: UrControllerServer) -> None:
    address = at(emulator, "old", "dashboard")
    with socket.create_connection(address, PATIENT_S) as idle, idle.makefile("r") as lines:
        assert lines.readline().startswith("Connected")
        assert talk(address, "get robot model")[1] == "UR10"
        idle.sendall(b"x" * 10_000)
        assert lines.read() == ""


# -- motion ------------------------------------------------------------------------------------------------------------


def send_move(client: Rtde, q: tuple[float, ...], speed: float, acceleration: float) -> None:
    """The exchange of a blocking moveJ up to where it runs; recipes 1 and 2 as set up in ``commanding``."""
    client.until(lambda s: s[0] == 1)
    client.send("U", b"\x01" + struct.pack(">i8di", 1, *q, speed, acceleration, 0))


@contextmanager
def commanding(server: UrControllerServer, arm: str) -> Iterator[Rtde]:
    """A client with the script running; its states are script state, runtime state, timestamp, q."""
    with Rtde(at(server, arm, "rtde")).agree() as client:
        client.outputs(["output_int_register_0", "runtime_state", "timestamp", "actual_q"])
        assert client.inputs(["input_int_register_0", *MOVES_RECIPE, "input_int_register_1"])[0] == 1
        assert client.inputs(["input_int_register_0"])[0] == 2
        client.start()
        with socket.create_connection(at(server, arm, "script"), PATIENT_S) as script:
            script.sendall(control_text(0))
            client.until(lambda s: s[1] == 2 and s[0] == 1)
            yield client


def test_an_arm_moves_on_when_its_client_has_gone() -> None:
    with alone(E_SERIES) as (server, control):
        goal = tuple(q + 0.4 for q in E_SERIES.home)
        with commanding(server, "new") as client:
            send_move(client, goal, 0.4, 4.0)
            client.until(lambda s: s[3] > E_SERIES.home[0] + 0.05)
        assert control("new", "status")["moving"]
        until(lambda: not control("new", "status")["moving"], "rest")
        assert control("new", "status")["q"] == pytest.approx(goal, abs=1e-12)


# -- faults on command -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["fin", "rst"])
def test_links_are_dropped_and_new_ones_refused_for_a_while(ending: str) -> None:
    with alone(CB3) as (server, control), Rtde(at(server, "old", "rtde")).agree() as client:
        client.outputs(["timestamp"])
        client.start()
        client.state()
        control("old", "drop", "rtde", ending, 1.0)
        with pytest.raises(ConnectionResetError, match="closed" if ending == "fin" else "reset by peer"):
            client.until(lambda _: False)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(at(server, "old", "rtde"), PATIENT_S)
        assert talk(at(server, "old", "dashboard"), "running")[1] == "Program running: false"

        def back() -> bool:
            try:
                Rtde(at(server, "old", "rtde")).agree().link.close()
            except ConnectionRefusedError:
                return False
            return True

        until(back, "the way back")


def test_operators_actions_over_the_control_channel() -> None:
    quick = replace(E_SERIES, boot_s=0.05, brake_release_s=0.05)
    with alone(quick) as (_, control):
        control("new", "estop")
        assert control("new", "status")["safety_mode"] == "ROBOT_EMERGENCY_STOP"
        control("new", "estop-release")
        control("new", "power-on")
        control("new", "brake-release")
        until(lambda: control("new", "status")["robot_mode"] == "RUNNING", "the brakes are released")
        control("new", "remote", "off")
        control("new", "protective", "now")
        status = control("new", "status")
        assert (status["safety_mode"], status["remote_control"]) == ("PROTECTIVE_STOP", False)
        control("new", "release")
        until(lambda: control("new", "status")["safety_mode"] == "NORMAL", "the safety stop is over")
        assert control("new", "log")[-1] == "protective stop released"
        control("new", "power-off")
        assert control("*", "status")[0]["robot_mode"] == "POWER_OFF"


def test_the_slider_and_the_stops_over_the_control_channel() -> None:
    with alone(CB3) as (server, control):
        control("old", "slider", 0.25)
        until(lambda: control("old", "status")["speed_scaling"] == 0.25, "the slider")
        assert control("old", "status")["speed_fraction"] == 0.25
        for wrong in ("nan", "inf", "-1", "2", "x"):
            with pytest.raises(Refused):
                control("old", "slider", wrong)
        assert control("old", "stops") == control("old", "starts") == []
        control("old", "foreign", "playing")
        before_s = time.monotonic()
        assert talk(at(server, "old", "dashboard"), "stop")[1] == "Stopped"
        (stop,) = control("old", "stops", before_s)
        assert before_s <= stop["received_s"] == stop["rest_s"] <= time.monotonic()
        assert control("old", "status")["stop"] == stop
        assert control("old", "stops", stop["received_s"] + 1.0) == []
        assert control("old", "clearance") is None, "ideal joints have no bodies"


def test_a_foreign_program_is_loaded_paused_and_ended_on_command() -> None:
    with alone(CB3) as (server, control):
        address = at(server, "old", "dashboard")
        control("old", "foreign", "playing")
        assert talk(address, "programState", "running")[1:3] == ["PLAYING palletizing.urp", "Program running: true"]
        control("old", "foreign", "paused")
        until(lambda: control("old", "status")["runtime_state"] == "PAUSED", "the pause")
        control("old", "foreign", "playing")
        until(lambda: control("old", "status")["runtime_state"] == "PLAYING", "the program")
        control("old", "foreign", "off")
        until(lambda: control("old", "status")["runtime_state"] == "STOPPED", "the program's end")
        control("old", "foreign", "off")
        control("old", "foreign", "paused")
        until(lambda: control("old", "status")["runtime_state"] == "PAUSED", "the pause")


def test_the_true_load_is_the_operators_and_the_believed_one_the_clients(make_arm, make_plant) -> None:
    plant = make_plant(make_arm())
    with alone(replace(CB3, name="left", payload_mass=0.3), plant=plant) as (server, control):
        control("left", "load", 2.5, 0.01, 0.0, 0.05)
        with server.cell.lock:
            mass, center = plant.payload("left")
        assert (mass, center.tolist()) == (2.5, [0.01, 0.0, 0.05])
        assert control("left", "status")["payload"] == 0.3


def test_commands_that_make_no_sense_are_refused(control: Control) -> None:
    def refused(*words: str) -> str:
        with pytest.raises(Refused) as caught:
            control(*words)
        assert control("old", "status")["robot_mode"] == "RUNNING"
        return str(caught.value)

    assert_refused(Path(__file__).parent / "approved" / "refused-commands.txt", refused)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(["dashboard", "primary", "script", "rtde"]), st.binary(min_size=1, max_size=200))
def test_no_bytes_break_a_port(emulator: UrControllerServer, control: Control, port: PortName, junk: bytes) -> None:
    with socket.create_connection(at(emulator, "new", port), PATIENT_S) as link:
        link.sendall(junk + b"\n")
    assert control("new", "status")["robot_mode"] in ("RUNNING", "POWER_OFF", "BOOTING", "IDLE")


# -- the server --------------------------------------------------------------------------------------------------------


def test_a_server_stays_on_this_machine_and_names_a_port_in_use() -> None:
    with pytest.raises(ValueError, match="beyond_loopback"):
        replace(CB3, host="0.0.0.0")
    assert replace(CB3, host="0.0.0.0", beyond_loopback=True).host == "0.0.0.0"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        server = UrControllerServer([replace(CB3, ports={**FREE_PORTS, "script": number})])
        with pytest.raises(OSError, match=rf"arm old: cannot listen on 127\.0\.0\.1:{number}"):
            server.open()
        with pytest.raises(OSError, match=f"{number}"):
            start_in_process([replace(CB3, ports={**FREE_PORTS, "script": number})])


@pytest.mark.parametrize(
    ("changes", "why"),
    [({"home": (0.0,)}, "home has 1 entries"), ({"ports": {"rtde": 1}}, "ports are"), ({"tcp": ()}, "tcp has 0")],
)
def test_a_controller_that_makes_no_sense_is_refused(changes: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        replace(CB3, **changes)


def test_arms_and_plant_must_fit(make_arm, make_plant) -> None:
    with pytest.raises(ValueError, match="not in the plant; its arms are left"):
        UrControllerServer([CB3], make_plant(make_arm()))
    with pytest.raises(ValueError, match="each with its own name"):
        UrControllerServer([CB3, CB3])
    for pace in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="pace"):
            UrControllerServer([CB3], pace=pace)


def test_an_unknown_model_and_a_wrong_number_of_joints_are_refused() -> None:
    with pytest.raises(ValueError, match="known are UR10, UR5"):
        personality("CB3", "UR7", "1")
    with pytest.raises(ValueError, match="six joints"):
        replace(CB3.personality, rows=CB3.personality.rows[:5])


def test_waiting_for_the_cells_time(monkeypatch: pytest.MonkeyPatch) -> None:
    with alone(CB3, pace=50.0) as (server, control):
        before = control("old", "status")["clock_s"]
        server.cell.wait(1.0)
        assert control("old", "status")["clock_s"] >= before + 1.0
        with server.cell.passed:
            assert server.cell.passed.wait(PATIENT_S), "time passes while the lock is let go of"
    monkeypatch.setattr("drivers.emulators.ur_controller.motion._STANDSTILL_S", 0.1)
    with pytest.raises(TimeoutError, match="its server does not run"):
        server.cell.wait(1.0)
