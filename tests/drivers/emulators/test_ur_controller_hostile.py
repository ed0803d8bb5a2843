"""Whatever clients and the control channel send, the emulated controllers go on to serve everybody else.

Conversations are drawn with a seed: mostly valid messages with hostile values, in any order, cut anywhere. Most are fed
to the handlers of connections in this thread, with time in the hand of the test; some go over real sockets.
"""

from __future__ import annotations

import json
import math
import random
import socket
import struct
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest

from drivers.emulators.ur_controller import (
    FREE_PORTS,
    Control,
    ControllerConfig,
    Refused,
    UrControllerServer,
    personality,
)
from drivers.emulators.ur_controller.control import _COMMANDS
from drivers.emulators.ur_controller.links import FAULTS, Link, Port
from drivers.emulators.ur_controller.script import ControlScript
from drivers.emulators.ur_controller.variables import INPUTS, OUTPUTS, layout
from drivers.plant import Plant
from tests.drivers.emulators.test_ur_controller_state import control_text
from tests.drivers.emulators.test_ur_controller_wire import commanding, finish_move, send_move

SEEDS = [*range(2), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 10))]
CONVERSATIONS = 250
"""Of each seed."""
ARMS = [
    ControllerConfig(name, "127.0.0.1", who, ports=FREE_PORTS, boot_s=0.3, brake_release_s=0.2)
    for name, who in (
        ("left", personality("CB3", "UR10", "20153012345")),
        ("right", personality("e-Series", "UR5", "20205501234")),
    )
]
NUMBERS = (0.0, -0.0, 1.0, -1.0, 0.5, 3.0, 1e-3, 1e-9, 5e-324, 1e6, 1e200, -1.7e308, math.inf, -math.inf, math.nan)
WORDS = ("0", "1", "-1", "0.5", "1e9", "1e308", "1e400", "inf", "-inf", "nan", "9" * 400, "", "x", "\x00", "é", "*")
QUICK_COMMANDS = (1, 11, 15, 16, 17, 20, 26, 27, 29, 31, 33, 34, 35, 37, 38, 39, 40, 43, 44, 47, 56, 58, 59, 65, 255)
DASHBOARD = (
    "stop", "pause", "play", "power on", "power off", "brake release", "unlock protective stop", "robotmode", "quit",
    "programState", "load x.urp", "addToLog x", "popup y", "safetystatus", "restart safety", "get serial number",
)  # fmt: skip

Draw = random.Random


# -- what a hostile client says ----------------------------------------------------------------------------------------


def number(draw: Draw) -> float:
    return draw.choice([*NUMBERS, draw.uniform(-7.0, 7.0), draw.uniform(0.0, 0.3), draw.uniform(0.0, 1000.0)])


def package(kind: int, payload: bytes) -> bytes:
    return struct.pack(">HB", min(3 + len(payload), 65535), kind) + payload[: 65535 - 3]


def names(draw: Draw, known: list[str]) -> list[str]:
    count = draw.choice([0, 1, 1, 2, 5, 40, 300])
    drawn = [draw.choice([*known[-96:], *known, "nothing", "", " ", "\xff"]) for _ in range(count)]
    return draw.choice([drawn, drawn, drawn, ["actual_q"] * 1366, ["a"] * 32000, ["actual_q"] * 1364 + ["actual_qd"]])


def rtde(draw: Draw) -> Iterator[bytes]:
    """Recipes that may be refused, and data for them."""
    inputs: list[list[str]] = []
    if draw.random() < 0.9:
        yield package(ord("V"), struct.pack(">H", draw.choice([2, 2, 2, 2, 1, 65535])))
    for _ in range(draw.randrange(1, 12)):
        match draw.choice("OIISPUUUUVvMx"):
            case "O":
                yield package(ord("O"), struct.pack(">d", number(draw)) + ",".join(names(draw, list(OUTPUTS))).encode())
            case "I":
                offset = draw.choice([0, 24])
                command = [f"input_int_register_{offset}", f"input_int_register_{offset + 1}"]
                command += [f"input_double_register_{offset + i}" for i in range(12)]
                inputs.append(draw.choice([command, command, command, names(draw, list(INPUTS))]))
                yield package(ord("I"), ",".join(inputs[-1]).encode())
            case "U":
                yield package(ord("U"), data(draw, inputs))
            case "x":
                yield package(draw.randrange(256), draw.randbytes(draw.choice([0, 1, 8, 300])))
            case other:
                yield package(ord(other), b"" if draw.random() < 0.8 else draw.randbytes(5))


def data(draw: Draw, inputs: list[list[str]]) -> bytes:
    if not inputs or draw.random() < 0.1:
        return draw.randbytes(draw.choice([0, 1, 2, 5, 50]))
    recipe = draw.randrange(len(inputs))
    values = bytearray()
    for name in inputs[recipe]:
        kind = INPUTS.get(name, "UINT8")
        packer = layout([kind])
        if kind == "DOUBLE":
            values += packer.pack(number(draw))
        elif kind == "INT32":
            values += packer.pack(draw.choice([*QUICK_COMMANDS, 0, 1, draw.randrange(-(2**31), 2**31)]))
        elif kind == "VECTOR6D":
            values += packer.pack(*(number(draw) for _ in range(6)))
        else:
            values += draw.randbytes(packer.size)
    return bytes((recipe + 1,)) + bytes(values)


def dashboard(draw: Draw) -> Iterator[bytes]:
    for _ in range(draw.randrange(1, 8)):
        line = (
            draw.choice(DASHBOARD).encode() if draw.random() < 0.8 else draw.randbytes(draw.choice([0, 3, 100, 5000]))
        )
        yield line + draw.choice([b"\n", b"\n", b"\r\n", b""])


def script(draw: Draw) -> Iterator[bytes]:
    for _ in range(draw.randrange(1, 4)):
        match draw.randrange(4):
            case 0 | 1:
                yield control_text(draw.choice([0, 24]))
            case 2:
                digits = b"7" * draw.choice([1, 9, 5000])
                head = b"# float register offset\n%s\n# int register offset\n%s\n" % (digits, digits)
                yield b"def x():\n" + head + b"end\n"
            case _:
                yield draw.choice([b"def", b"end\n", b"def f():\n" * 50, draw.randbytes(2000), b"d" * 70000])


def control(draw: Draw) -> Iterator[bytes]:
    for _ in range(draw.randrange(1, 8)):
        words = [draw.choice(["left", "right", "*", "nobody"]), draw.choice([*_COMMANDS, "pace", "nothing"])]
        known = [*WORDS, *FAULTS, "rtde", "dashboard", "script", "primary", "fin", "rst", "now", "off", "on", "speed"]
        words += [draw.choice([*known, "travel", "playing", "paused"]) for _ in range(draw.randrange(5))]
        yield " ".join(words).encode() + draw.choice([b"\n", b"\n", b"\n", b""])


SPEAKS: dict[str, Callable[[Draw], Iterator[bytes]]] = {
    "rtde": rtde,
    "dashboard": dashboard,
    "script": script,
    "primary": script,
    "control": control,
}


def cut(draw: Draw, said: bytes) -> list[bytes]:
    """The bytes in pieces, some damaged."""
    if draw.random() < 0.1:
        said = bytes(byte ^ (draw.random() < 0.01) * draw.randrange(256) for byte in said[:3000])
    if draw.random() < 0.1:
        said = said[: draw.randrange(len(said) + 1)]
    if draw.random() < 0.7:
        return [said]
    at = draw.randrange(len(said) + 1)
    return [said[:at], said[at:]]


# -- the handlers, with time in the hand of the test ------------------------------------------------------------------


class Stage:
    """Controllers whose ports nobody listens on: connections are socket pairs."""

    def __init__(self, plant: Plant | None = None) -> None:
        self.server = UrControllerServer(ARMS, plant)
        self.now_s = 1000.0
        for arm in self.server._arms.values():
            arm.due_s = self.now_s
        self.cycles(3)

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.now_s += 0.008
            self.server.cell.catch_up(self.now_s)
            for arm in self.server._arms.values():
                arm.cycle(self.now_s)

    def port(self, arm: str, name: str) -> Port:
        return self.server._control if name == "control" else self.server._arms[arm].ports[name]  # type: ignore[index]

    @contextmanager
    def connected(self, arm: str, name: str) -> Iterator[tuple[Link, socket.socket]]:
        """A connection to a port that refuses nobody; both of its ends."""
        port = self.port(arm, name)
        theirs, ours = socket.socketpair()
        theirs.setblocking(False)
        link = Link(port, theirs)
        port.links.append(link)
        link.session = port._open_session(link)
        with ours:
            ours.setblocking(False)
            try:
                yield link, ours
            finally:
                port.drop(link)

    def say(self, link: Link, ours: socket.socket, said: bytes) -> bytes:
        if link.session is not None and not link.gone:
            link.session.received(said)
        try:
            return ours.recv(1 << 20)
        except OSError:
            return b""

    def ask(self, line: str) -> str:
        with self.connected("left", "control") as (link, ours):
            return self.say(link, ours, f"{line}\n".encode()).decode()

    def set_right(self) -> None:
        """What a person does to use the cell again."""
        for line in (
            "* pace 1", "* fault * none", "* start-delay 0", "* short-packets swallow", "* protective off",
            "* remote on", "* estop-release", "* foreign off", "* slider 1", "* brake-release",
        ):  # fmt: skip
            assert self.ask(line).startswith("ok "), line
        self.cycles(100)
        assert self.ask("* release").startswith("ok ")
        self.cycles(2)


@pytest.fixture
def stage() -> Iterator[Stage]:
    made = Stage()
    yield made
    made.server._close()  # 'fault none' opens a port


def well_served(stage: Stage, arm: str) -> None:
    """A client that behaves has its identity, modes, stream of states, program and motion."""
    with stage.connected(arm, "dashboard") as (link, ours):
        assert stage.say(link, ours, b"robotmode\n").decode().splitlines()[-1] == "Robotmode: RUNNING"
    with stage.connected(arm, "rtde") as (link, ours):
        stage.say(link, ours, package(ord("V"), b"\x00\x02"))
        outputs = struct.pack(">d", 500.0) + b"actual_q,runtime_state"
        assert stage.say(link, ours, package(ord("O"), outputs))[3:4] == b"\x01"
        inputs = ["input_int_register_0", *(f"input_double_register_{i}" for i in range(8)), "input_int_register_1"]
        assert stage.say(link, ours, package(ord("I"), ",".join(inputs).encode()))[3:4] == b"\x01"
        stage.say(link, ours, package(ord("S"), b""))
        stage.say(link, ours, package(ord("U"), b"\x01" + bytes(4 + 8 * 8 + 4)))  # registers keep what others wrote
        with stage.connected(arm, "primary") as (primary, state):
            assert len(stage.say(primary, state, control_text(0))) > 500

        def states(count: int) -> tuple[float, ...]:
            stage.cycles(count)
            return struct.unpack(">6dI", ours.recv(1 << 20)[-52:])

        *q, runtime = states(100)
        assert runtime == 2  # playing
        assert all(map(math.isfinite, q))
        goal = [math.copysign(min(abs(value), 1.0), value) for value in q]
        goal[0] = -goal[0] if goal[0] else 0.5
        for command in (0, 1):
            stage.say(link, ours, package(ord("U"), b"\x01" + struct.pack(">i8di", command, *goal, 2.0, 5.0, 0)))
            stage.cycles(2)
        assert states(1000)[:6] == pytest.approx(goal)


@pytest.mark.parametrize("seed", SEEDS)
def test_no_conversation_ends_the_controllers(
    seed: int, make_arm: Callable[..., Any], make_plant: Callable[..., Plant]
) -> None:
    draw = random.Random(seed)
    stage = Stage(make_plant(make_arm(), make_arm("ur5", "right", 1.2)) if seed % 4 == 0 else None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(CONVERSATIONS):
            arm, name = draw.choice(["left", "right"]), draw.choice(list(SPEAKS))
            if draw.random() < 0.15:  # else most would find a controller without power
                stage.set_right()
                offset = draw.choice([0, 24])
                stage.server._arms[arm].controller.upload(ControlScript(offset, offset))
                name = "rtde"
            with stage.connected(arm, name) as (link, ours):
                for said in SPEAKS[name](draw):
                    for piece in cut(draw, said):
                        stage.say(link, ours, piece)
                    stage.cycles(draw.choice([0, 1, 1, 2, 8]))
        stage.set_right()
        for arm in ("left", "right"):
            well_served(stage, arm)
    for arm in ("left", "right"):
        json.loads(stage.ask(f"{arm} journal").removeprefix("ok "))
    stage.server._close()


# -- single cases ------------------------------------------------------------------------------------------------------


def recipe(stage: Stage, kind: str, payload: bytes) -> tuple[int, list[str]]:
    with stage.connected("left", "rtde") as (link, ours):
        stage.say(link, ours, package(ord("V"), b"\x00\x02"))
        reply = stage.say(link, ours, package(ord(kind), payload))
        size, answered = struct.unpack_from(">HB", reply)
        assert (size, answered) == (len(reply), ord(kind))
        return reply[3], reply[4:].decode().split(",")


def test_outputs_that_no_package_holds_are_refused(stage: Stage) -> None:
    most = (65535 - 4) // 48
    hz = struct.pack(">d", 125.0)
    assert recipe(stage, "O", hz + b",".join([b"actual_q"] * most)) == (1, ["VECTOR6D"] * most)
    assert recipe(stage, "O", hz + b",".join([b"actual_q"] * (most + 1))) == (0, ["VECTOR6D"] * (most + 1))
    assert "outputs refused" in stage.ask("left log")


@pytest.mark.parametrize("kind", ["O", "I"])
def test_the_answer_to_a_recipe_of_countless_names_fits_a_package(stage: Stage, kind: str) -> None:
    number_, types = recipe(stage, kind, (struct.pack(">d", 125.0) if kind == "O" else b"") + b"a," * 32000)
    assert number_ == 0
    assert set(types) == {"NOT_FOUND"}
    assert len(types) == (65535 - 4 + 1) // 10


def test_inputs_of_a_connection_that_was_ended_in_the_middle_are_free(stage: Stage) -> None:
    claim = package(ord("I"), b"input_int_register_0")
    with stage.connected("left", "rtde") as (link, ours):
        stage.say(link, ours, package(ord("V"), b"\x00\x02") + b"\x00\x00\x00" + claim)
        assert link.gone
    assert recipe(stage, "I", b"input_int_register_0") == (1, ["INT32"])


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("start-delay inf", "inf is not between 0 and 1e+06"),
        ("drop rtde fin inf", "argument 3: inf is not between 0 and 1e+06"),
        ("fault rtde silent 1e7", "argument 3: 10000000.0 is not between"),
        ("protective travel nan", "argument 2: nan is not between"),
        ("pace inf", "inf is not between 0 and 1000"),
        ("pace 0", "expected more than 0"),
        ("journal inf", "inf is not between"),
        ("load 1 0 0 1e9", "each coordinate between -10 and 10 m"),
    ],
)
def test_numbers_of_the_control_channel_are_finite_and_have_a_limit(stage: Stage, line: str, why: str) -> None:
    answer = stage.ask(f"left {line}")
    assert answer.startswith("error ")
    assert why in answer


def journal(stage: Stage) -> list[tuple[str, str]]:
    answer = json.loads(stage.ask("left journal").removeprefix("ok "))
    assert [event["at_s"] for event in answer] == sorted(event["at_s"] for event in answer)
    return [(event["kind"], event["how"]) for event in answer]


def test_the_journal_tells_each_stop_with_its_way_and_each_motion(stage: Stage) -> None:
    began_s = time.monotonic()
    well_served(stage, "left")
    assert journal(stage) == [("begun", "move"), ("ended", "at rest")]
    with stage.connected("left", "rtde") as (link, ours):
        stage.say(link, ours, package(ord("V"), b"\x00\x02"))
        stage.say(link, ours, package(ord("I"), b"input_int_register_0"))
        for command in (0, 34, 34, 0, 255):
            stage.say(link, ours, package(ord("U"), b"\x01" + struct.pack(">i", command)))
            stage.cycles(2)
    assert journal(stage)[2:] == [("stop", "rtde: stopj"), ("stop", "rtde: end of the script"), ("stop", "it ended")]
    for asked in (b"stop\n", b"pause\n", b"power off\n"):
        with stage.connected("left", "dashboard") as (link, ours):
            stage.say(link, ours, asked)
    stage.set_right()
    for order in ("left protective now", "left estop"):
        assert stage.ask(order) == "ok null\n"
    ways = [how for _, how in journal(stage)[5:]]
    assert ways[:3] == ["dashboard: stop", "dashboard: pause", "dashboard: power off"]
    assert ways[-2:] == ["protective stop: commanded", "emergency stop"]
    later = json.loads(stage.ask(f"left journal {time.monotonic()!r}").removeprefix("ok "))
    assert later == []
    assert json.loads(stage.ask("left journal").removeprefix("ok "))[0]["at_s"] >= began_s


# -- over real sockets -------------------------------------------------------------------------------------------------


def hostile_client(draw: Draw, address: tuple[str, int], name: str) -> None:
    """One conversation over TCP, ended in one of three ways."""
    try:
        with socket.create_connection(address, 5.0) as link:
            link.settimeout(0.02)
            for said in SPEAKS[name](draw):
                for piece in cut(draw, said):
                    link.sendall(piece)
            if draw.random() < 0.5:
                link.recv(65536)
            if draw.random() < 0.3:
                link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    except OSError:
        pass  # the emulator may refuse, end the connection, or not read


def test_the_others_are_served_meanwhile() -> None:
    draw = random.Random(8)
    with UrControllerServer(ARMS) as server, closing(server.control()) as asked, commanding(server, "right") as client:
        goal = tuple(value + 0.3 for value in client.state()[3:])
        send_move(client, goal, 0.3, 1.0)
        for _ in range(40):
            name = draw.choice(["rtde", "dashboard", "script", "primary"])
            hostile_client(draw, server.addresses.arms["left"][name], name)  # type: ignore[index]
        finish_move(client)
        assert client.state()[3:] == goal
        assert server.failure is None
        refused(asked)


def refused(asked: Control) -> None:
    with pytest.raises(Refused, match="not between 0 and"):
        asked("left", "start-delay", "inf")
