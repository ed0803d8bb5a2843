"""The control channel: faults and operator's actions on command, a line in, a line out, over TCP on loopback.

A request is ``ARM COMMAND [ARGUMENT ...]`` (ARM ``*``: every one), the answer ``ok JSON`` or ``error TEXT``.

    status                                how it is: modes, program, motion, connections
    received                              the lines that clients sent to the dashboard
    log                                   what happened, newest last
    drop PORT fin|rst [SECONDS]           end its connections; refuse new ones for SECONDS
    fault PORT none|silent|refuse|garbage|flood|trickle [SECONDS]
    start-delay SECONDS                   from an uploaded program to its start, from now on
    short-packets swallow|close           what becomes of RTDE data of the wrong length
    protective now|off|speed V|travel V   stop now, or once a moving arm does V rad/s or has gone V rad
    release                               the operator releases a protective stop
    estop | estop-release                 the button
    power-on | brake-release | power-off  the operator at the pendant
    remote on|off                         the switch of the e-Series
    load MASS [X Y Z]                     what truly hangs on the flange [kg, m]; the controller is told nothing

PORT is dashboard, primary, script, rtde or ``*``. ``pace FACTOR`` needs no arm but ``*``.
"""

from __future__ import annotations

import json
import math
import socket
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, get_args

import numpy as np

from drivers.emulators.ur_controller.controller import Controller
from drivers.emulators.ur_controller.links import FAULTS, Ending, Port
from drivers.emulators.ur_controller.motion import PacedCell
from drivers.emulators.ur_controller.personality import PortName
from drivers.emulators.ur_controller.rtde import RtdeServer

_LONGEST_LINE = 4096
_TIMEOUT_S = 10.0


class Refused(ValueError):
    """The emulator did not understand a command or could not carry it out."""


class Emulated:
    """One controller with its ports, as the control channel sees it."""

    def __init__(
        self, controller: Controller, rtde: RtdeServer, ports: Mapping[PortName, Port], received: deque[str]
    ) -> None:
        self.controller = controller
        self.rtde = rtde
        self.ports = ports
        self.received = received


def obey(line: str, arms: Mapping[str, Emulated], cell: PacedCell, now_s: float) -> str:
    """Carry out one line; the answer, without its end."""
    try:
        words = line.split()
        if len(words) < 2:
            raise Refused("expected ARM COMMAND [ARGUMENT ...]")
        name, command, *arguments = words
        if command == "pace":
            cell.pace = _number(arguments, 0)
            return "ok null"
        if name != "*" and name not in arms:
            raise Refused(f"no arm '{name}'; there are {', '.join(arms)}")
        chosen = list(arms.values()) if name == "*" else [arms[name]]
        if command not in _COMMANDS:
            raise Refused(f"no command '{command}'; there are pace, {', '.join(_COMMANDS)}")
        answers = [_COMMANDS[command](arm, arguments, now_s) for arm in chosen]
        return f"ok {json.dumps(answers if name == '*' else answers[0])}"
    except (ValueError, OSError) as error:
        return f"error {' '.join(str(error).split())}"


def _number(arguments: Sequence[str], at: int, *, most: float = math.inf, default: float | None = None) -> float:
    if at >= len(arguments) and default is not None:
        return default
    try:
        value = float(arguments[at])
    except (IndexError, ValueError):
        raise Refused(f"argument {at + 1}: expected a number") from None
    if not 0.0 <= value <= most:
        raise Refused(f"argument {at + 1}: {value!r} is not between 0 and {most:g}")
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
        "program": None if c.program is None else c.program.name,
        "remote_control": c.remote_control,
        "moving": c.moving,
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
    refuse_s = _number(arguments, 2, default=0.0)
    for port in _ports(arm, arguments):
        for link in list(port.links):
            port.drop(link, "rst" if ending == "rst" else "fin")
        if refuse_s > 0.0:
            port.fail("refuse", now_s + refuse_s)


def _fault(arm: Emulated, arguments: Sequence[str], now_s: float) -> None:
    _word(arguments, 1, FAULTS)
    fault = next(fault for fault in FAULTS if fault == arguments[1])
    for port in _ports(arm, arguments):
        port.fail(fault, now_s + _number(arguments, 2) if len(arguments) > 2 else None)


def _start_delay(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    arm.controller.start_delay_s = _number(arguments, 0)


def _short_packets(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    arm.rtde.short_packets = "close" if _word(arguments, 0, ("swallow", "close")) == "close" else "swallow"


def _protective(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    match _word(arguments, 0, ("now", "off", "speed", "travel")):
        case "now":
            arm.controller.protective_stop("commanded")
        case "off":
            arm.controller.arm_protective_stop()
        case "speed":
            arm.controller.arm_protective_stop(speed=_number(arguments, 1))
        case _:
            arm.controller.arm_protective_stop(travel=_number(arguments, 1))


def _remote(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    arm.controller.remote_control = _word(arguments, 0, ("on", "off")) == "on"


def _load(arm: Emulated, arguments: Sequence[str], _: float) -> None:
    mass = _number(arguments, 0)
    try:
        center = [float(word) for word in arguments[1:4]] or [0.0, 0.0, 0.0]
    except ValueError:
        center = []
    if len(center) != 3 or not all(map(math.isfinite, center)):
        raise Refused("expected MASS [X Y Z]")
    arm.controller.motions.set_payload(arm.controller.name, mass, np.array(center))


def _simply(action: Callable[[Controller], object]) -> Callable[[Emulated, Sequence[str], float], object]:
    def act(arm: Emulated, _: Sequence[str], __: float) -> None:
        action(arm.controller)

    return act


_COMMANDS: dict[str, Callable[[Emulated, Sequence[str], float], object]] = {
    "status": _status,
    "received": lambda arm, _, __: list(arm.received),
    "log": lambda arm, _, __: list(arm.controller.log),
    "drop": _drop,
    "fault": _fault,
    "start-delay": _start_delay,
    "short-packets": _short_packets,
    "protective": _protective,
    "release": _simply(lambda controller: controller.unlock(at_once=True)),
    "estop": _simply(Controller.emergency_stop),
    "estop-release": _simply(Controller.release_emergency_stop),
    "power-on": _simply(Controller.power_on),
    "brake-release": _simply(Controller.release_brakes),
    "power-off": _simply(Controller.power_off),
    "remote": _remote,
    "load": _load,
}


class ControlSession:
    """One connection to the control channel."""

    def __init__(self, send: Callable[[bytes], None], obey_line: Callable[[str], str]) -> None:
        self._send, self._obey = send, obey_line
        self._held = bytearray()

    def received(self, data: bytes) -> None:
        """Bytes from the client."""
        self._held += data
        while (end := self._held.find(b"\n")) >= 0:
            line = self._held[:end].decode("utf-8", errors="replace").strip()
            del self._held[: end + 1]
            self._send(f"{self._obey(line)}\n".encode())
        if len(self._held) > _LONGEST_LINE:
            self._held.clear()

    def closed(self) -> None:
        """Nothing to tidy."""


class Control:
    """The other end of the control channel, for tests and trials; from one thread at a time."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._link = socket.create_connection(address, _TIMEOUT_S)
        self._lines = self._link.makefile("r", encoding="utf-8")

    def __call__(self, arm: str, command: str, *arguments: object) -> Any:
        """Send a command and return what was answered. Raises ``Refused``, or ``OSError`` if the emulator is gone."""
        self._link.sendall(f"{' '.join(map(str, (arm, command, *arguments)))}\n".encode())
        line = self._lines.readline()
        if line.startswith("ok "):
            return json.loads(line[3:])
        if not line:
            raise ConnectionResetError("the emulator is gone")
        raise Refused(line.removeprefix("error ").strip())

    def close(self) -> None:
        """Close the connection."""
        self._lines.close()
        self._link.close()
