"""Control channel: faults and operator's actions on command, one line per request and answer, TCP on loopback.

A request is ``ARM COMMAND [ARGUMENT ...]`` (ARM ``*``: all arms), the answer ``ok JSON`` or ``error TEXT``.

    status                                modes, program, motion, connections
    received                              the lines that clients sent to the dashboard
    log                                   events, newest last
    drop PORT fin|rst [SECONDS]           end its connections; refuse new ones for SECONDS
    fault PORT none|silent|refuse|garbage|flood|trickle [SECONDS]
    network DELAY [LOSS]                  messages take DELAY s each way, a share LOSS of them 0.2 s more
    send PORT HEX                         send bytes on its connections: a malformed packet
    start-delay SECONDS                   from an uploaded program to its start, from now on
    short-packets swallow|close           reaction to RTDE data of the wrong length
    push RAD SPEED [JOINT]                something turns a joint (1) of the arm at rest by RAD at SPEED [rad/s]
    protective now|off|speed V|travel V   stop now, or when the arm reaches V rad/s or has moved by V rad
    release                               the operator releases a protective stop
    estop | estop-release                 the emergency stop button
    power-on | brake-release | power-off  the operator at the pendant
    remote on|off                         the switch of the e-Series
    slider FRACTION                       the speed slider, 0 to 1; at 0 the arm stands and its program runs
    foreign playing|paused|off            a person's own program: started, paused, ended
    stops [SINCE]                         the stops received: kind, times of ``time.monotonic``, ideal braking time
    starts [SINCE]                        the times of ``time.monotonic`` at which motions began
    journal [SINCE]                       every stop received and in which way, every motion begun and ended, with times
    clearance                             smallest distance [m] between the arms and to the floor, if watched
    load MASS [X Y Z]                     true load of the flange [kg, m], unknown to the controller

PORT is dashboard, primary, script, rtde or ``*``. ``pace FACTOR`` applies to all arms. Every number is finite and has
a limit, which a refusal names. Times SINCE are of ``time.monotonic``.
"""

from __future__ import annotations

import json
import math
import socket
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, get_args

import numpy as np

from drivers.arms.ur_rtde_reader import ProgramState
from drivers.emulators.ur_controller.controller import Controller
from drivers.emulators.ur_controller.links import FAULTS, Ending, Port
from drivers.emulators.ur_controller.motion import PacedCell
from drivers.emulators.ur_controller.personality import PortName
from drivers.emulators.ur_controller.rtde import RtdeServer
from drivers.emulators.ur_controller.script import ForeignProgram

_LONGEST_LINE = 4096
_TIMEOUT_S = 10.0
_MOST_S = 1e6
"""Longest delay and duration [s]: eleven days, practically infinite."""
_LATEST_S = 1e12
"""Latest time of ``time.monotonic`` [s]."""
_FASTEST = 1e3
"""Largest joint speed [rad/s] and travel [rad] of a trigger."""
_HEAVIEST_KG, _FARTHEST_M = 1e3, 10.0
"""Largest load and its largest distance from the flange along an axis."""


class Refused(ValueError):
    """The emulator did not understand a command or could not execute it."""


class Emulated:
    """One controller with its ports, as used by the control channel."""

    def __init__(
        self, controller: Controller, rtde: RtdeServer, ports: Mapping[PortName, Port], received: deque[str]
    ) -> None:
        self.controller = controller
        self.rtde = rtde
        self.ports = ports
        self.received = received


def execute(line: str, arms: Mapping[str, Emulated], cell: PacedCell, now_s: float) -> str:
    """Execute one line and return the answer without its line end."""
    try:
        words = line.split()
        if len(words) < 2:
            raise Refused("expected ARM COMMAND [ARGUMENT ...]")
        name, command, *arguments = words
        if command == "pace":
            cell.pace = _number(arguments, 0, limit=1000.0)
            return "ok null"
        if name != "*" and name not in arms:
            raise Refused(f"no arm '{name}'; arms are {', '.join(arms)}")
        chosen = list(arms.values()) if name == "*" else [arms[name]]
        if command not in _COMMANDS:
            raise Refused(f"no command '{command}'; commands are pace, {', '.join(_COMMANDS)}")
        answers = [_COMMANDS[command](arm, arguments, now_s) for arm in chosen]
        return f"ok {json.dumps(answers if name == '*' else answers[0])}"
    except (ValueError, OSError) as error:
        return f"error {' '.join(str(error).split())}"


def _number(arguments: Sequence[str], at: int, *, limit: float, default: float | None = None) -> float:
    if at >= len(arguments) and default is not None:
        return default
    try:
        value = float(arguments[at])
    except (IndexError, ValueError):
        raise Refused(f"argument {at + 1}: expected a number") from None
    if not 0.0 <= value <= limit:
        raise Refused(f"argument {at + 1}: {value!r} is not between 0 and {limit:g}")
    return value


def _word(arguments: Sequence[str], at: int, known: Sequence[str]) -> str:
    if at >= len(arguments) or arguments[at] not in known:
        raise Refused(f"argument {at + 1}: expected one of {', '.join(known)}")
    return arguments[at]


def _ports(arm: Emulated, arguments: Sequence[str]) -> list[Port]:
    name = _word(arguments, 0, [*arm.ports, "*"])
    return [port for known, port in arm.ports.items() if name in (known, "*")]


def _status(arm: Emulated, _: Sequence[str], now_s: float) -> dict[str, Any]:
    c = arm.controller
    return {
        "robot_mode": c.robot_mode.name,
        "safety_mode": c.safety_mode.name,
        "runtime_state": c.runtime.name,
        "starting": c.starting,
        "program": None if c.program is None else c.program.name,
        "remote_control": c.remote_control,
        "moving": not c.at_rest,
        "speed_fraction": c.slider.fraction,
        "speed_scaling": c.slider.scaling,
        "stop": asdict(c.brakes.records[-1]) if c.brakes.records else None,
        "q": c.motions.q(c.name).tolist(),
        "moves": c.moves,
        "clock_s": c.motions.clock_s,
        "payload": c.payload_mass,
        "payload_center": list(c.payload_center),
        "tcp": list(c.tcp),
        "connections": {name: len(port.links) for name, port in arm.ports.items()},
    }


def _drop(arm: Emulated, arguments: Sequence[str], now_s: float) -> None:
    ending = _word(arguments, 1, get_args(Ending))
    refuse_s = _number(arguments, 2, limit=_MOST_S, default=0.0)
    for port in _ports(arm, arguments):
        for link in list(port.links):
            port.drop(link, "rst" if ending == "rst" else "fin")
        if refuse_s > 0.0:
            port.fail("refuse", now_s + refuse_s)


def _fault(arm: Emulated, arguments: Sequence[str], now_s: float) -> None:
    _word(arguments, 1, FAULTS)
    fault = next(fault for fault in FAULTS if fault == arguments[1])
    for port in _ports(arm, arguments):
        port.fail(fault, now_s + _number(arguments, 2, limit=_MOST_S) if len(arguments) > 2 else None)


def _network(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    network = (_number(arguments, 0, limit=_MOST_S), _number(arguments, 1, limit=1.0, default=0.0))
    for port in arm.ports.values():
        port.network = network


def _send(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    data = bytes.fromhex(arguments[1] if len(arguments) > 1 else "")
    for port in _ports(arm, arguments):
        for link in list(port.links):
            link.send(data)


def _start_delay(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    arm.controller.start_delay_s = _number(arguments, 0, limit=_MOST_S)


def _short_packets(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    arm.rtde.short_packets = "close" if _word(arguments, 0, ("swallow", "close")) == "close" else "swallow"


def _protective(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    how = _word(arguments, 0, ("now", "off", "speed", "travel"))
    if how == "now":
        arm.controller.protective_stop("commanded")
    else:
        arm.controller.arm_protective_stop(**({} if how == "off" else {how: _number(arguments, 1, limit=_FASTEST)}))


def _push(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    back = -1.0 if arguments and arguments[0].startswith("-") else 1.0
    by = back * _number([arguments[0].removeprefix("-")] if arguments else [], 0, limit=_FASTEST)
    joint = int(_number(arguments, 2, limit=6.0, default=1.0))
    arm.controller.push(max(joint, 1) - 1, by, _number(arguments, 1, limit=_FASTEST))


def _remote(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    arm.controller.remote_control = _word(arguments, 0, ("on", "off")) == "on"


def _slider(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    arm.controller.set_slider(_number(arguments, 0, limit=1.0))


def _foreign(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    controller = arm.controller
    wanted = _word(arguments, 0, ("playing", "paused", "off"))
    mine = isinstance(controller.program, ForeignProgram)
    if wanted == "off":
        if mine:
            controller.stop_program("on the pendant")
        return
    if not mine:
        controller.start_locally(ForeignProgram())
    if wanted == "paused":
        controller.pause_program("on the pendant")
    elif controller.runtime is ProgramState.PAUSED:
        controller.resume_program()


def _stops(arm: Emulated, arguments: Sequence[str], _: float) -> list[dict[str, Any]]:
    since_s = _number(arguments, 0, limit=_LATEST_S, default=0.0)
    return [asdict(record) for record in arm.controller.brakes.records if record.received_s >= since_s]


def _starts(arm: Emulated, arguments: Sequence[str], _: float) -> list[float]:
    return [event["at_s"] for event in _journal(arm, arguments, _) if event["kind"] == "begun"]


def _journal(arm: Emulated, arguments: Sequence[str], _: float) -> list[dict[str, Any]]:
    return arm.controller.journal.since(_number(arguments, 0, limit=_LATEST_S, default=0.0))


def _clearance(arm: Emulated, _: Sequence[str], __: float) -> list[float] | None:
    seen = arm.controller.motions.clearance
    return None if seen is None or not math.isfinite(seen.arms_m) else [seen.arms_m, seen.floor_m]


def _load(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    mass = _number(arguments, 0, limit=_HEAVIEST_KG)
    try:
        center = [float(word) for word in arguments[1:4]] or [0.0, 0.0, 0.0]
    except ValueError:
        center = []
    if len(center) != 3 or not all(abs(value) <= _FARTHEST_M for value in center):
        raise Refused(f"expected MASS [X Y Z], each coordinate between -{_FARTHEST_M:g} and {_FARTHEST_M:g} m")
    arm.controller.motions.set_payload(arm.controller.name, mass, np.array(center))


def _without_arguments(action: Callable[[Controller], object]) -> Callable[[Emulated, Sequence[str], float], object]:
    def act(arm: Emulated, _: Sequence[str], __: float) -> None:
        action(arm.controller)

    return act


_COMMANDS: dict[str, Callable[[Emulated, Sequence[str], float], object]] = {
    "status": _status,
    "received": lambda arm, _, __: list(arm.received),
    "log": lambda arm, _, __: list(arm.controller.log),
    "drop": _drop,
    "fault": _fault,
    "network": _network,
    "send": _send,
    "start-delay": _start_delay,
    "short-packets": _short_packets,
    "protective": _protective,
    "release": _without_arguments(lambda controller: controller.unlock(at_once=True)),
    "estop": _without_arguments(Controller.emergency_stop),
    "estop-release": _without_arguments(Controller.release_emergency_stop),
    "power-on": _without_arguments(Controller.power_on),
    "brake-release": _without_arguments(Controller.release_brakes),
    "power-off": _without_arguments(Controller.power_off),
    "push": _push,
    "remote": _remote,
    "slider": _slider,
    "foreign": _foreign,
    "stops": _stops,
    "starts": _starts,
    "journal": _journal,
    "clearance": _clearance,
    "load": _load,
}


class ControlSession:
    """One connection to the control channel."""

    def __init__(self, send: Callable[[bytes], None], execute_line: Callable[[str], str]) -> None:
        self._send, self._execute = send, execute_line
        self._received = bytearray()

    def received(self, data: bytes) -> None:
        """Process bytes from the client."""
        self._received += data
        while (end := self._received.find(b"\n")) >= 0:
            line = self._received[:end].decode("utf-8", errors="replace").strip()
            del self._received[: end + 1]
            self._send(f"{self._execute(line)}\n".encode())
        if len(self._received) > _LONGEST_LINE:
            self._received.clear()

    def closed(self) -> None:
        """Do nothing: the session holds no resources."""


class Control:
    """Client of the control channel, for tests and trials; any thread may use it."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._link = socket.create_connection(address, _TIMEOUT_S)
        self._lines = self._link.makefile("r", encoding="utf-8")
        self._lock = threading.Lock()

    def __call__(self, arm: str, command: str, *arguments: object) -> Any:
        """Send a command and return its answer. Raises ``Refused``, or ``OSError`` if the emulator has ended."""
        with self._lock:
            self._link.sendall(f"{' '.join(map(str, (arm, command, *arguments)))}\n".encode())
            line = self._lines.readline()
        if line.startswith("ok "):
            return json.loads(line[3:])
        if not line:
            raise ConnectionResetError("the emulator has ended")
        raise Refused(line.removeprefix("error ").strip())

    def close(self) -> None:
        """Close the connection."""
        self._lines.close()
        self._link.close()
