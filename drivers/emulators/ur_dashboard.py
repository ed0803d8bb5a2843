"""A stand-in for the dashboard and primary ports of a UR controller (PolyScope 3.15 on CB3, or 5.11 on e-Series).

What it does as the real one: greets; answers the questions listed in ``_answers`` line by line; says which commands it
could not understand (for CB3 this includes the questions of the e-Series only); takes several clients at once; sends
each client of the primary port a robot state with the kinematics information when it connects.

What it does not: nothing moves and nothing changes, so ``play``, ``stop``, ``power on``, ``load`` and the like are all
answered with "Failed to execute". The robot state holds the kinematics alone and comes once, not ten times a second,
and no version message precedes it. Bytes sent to the primary port are dropped. There is no script port and no RTDE
port. The wording of refusals, and which questions each version knows, were not compared with a real controller.
"""

from __future__ import annotations

import ipaddress
import math
import os
import selectors
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal, Self

Series = Literal["CB3", "e-Series"]
Fault = Literal["none", "silent", "refuse", "garbage", "flood", "trickle"]
Port = Literal["dashboard", "primary"]
Rows = tuple[tuple[float, float, float, float], ...]

DASHBOARD_PORT = 29999
PRIMARY_PORT = 30001

_BOTH: tuple[Port, Port] = ("dashboard", "primary")
_GREETING = "Connected: Universal Robots Dashboard Server"
_GARBAGE = b"\x00\xff\x17 this is no robot \xfe\x80\n"
_SOFTWARE = {  # the form counts; the dates mean nothing
    "CB3": "URSoftware 3.15.8.106339 (Jun 20 2022)",
    "e-Series": "URSoftware 5.11.1.1108318 (Nov 11 2021)",
}
_CHANGES_STATE = (
    "play",
    "stop",
    "pause",
    "load",
    "load installation",
    "shutdown",
    "power on",
    "power off",
    "brake release",
    "unlock protective stop",
    "close safety popup",
    "close popup",
    "popup",
    "restart safety",
    "addToLog",
    "set operational mode",
    "clear operational mode",
)
_LONGEST_LINE = 4096
_MOST_CLIENTS = 64
_MOST_QUEUED = 65536
_TRICKLE_S = 0.05
_PATIENCE_S = 5.0


def _rows(d: tuple[float, ...], a2: float, a3: float) -> Rows:
    """Nominal rows theta, d, a, alpha of a UR arm: all of them share the twists."""
    a = (0.0, a2, a3, 0.0, 0.0, 0.0)
    alpha = (math.pi / 2.0, 0.0, 0.0, math.pi / 2.0, -math.pi / 2.0, 0.0)
    return tuple((0.0, d[i], a[i], alpha[i]) for i in range(6))


_PUBLISHED: dict[tuple[str, str], Rows] = {
    ("CB3", "UR5"): _rows((0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823), -0.425, -0.39225),
    ("CB3", "UR10"): _rows((0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922), -0.612, -0.5723),
    ("e-Series", "UR5"): _rows((0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996), -0.425, -0.3922),
    ("e-Series", "UR10"): _rows((0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655), -0.6127, -0.57155),
}


@dataclass(frozen=True)
class Personality:
    """The controller that is stood in for, and the state it is in.

    Attributes
    ----------
    model : str
        As a controller gives it: "UR10" on both series.
    serial : str
        Digits.
    rows : tuple
        D-H rows theta, d, a, alpha of the six joints [rad, m, m, rad].
    checksums, calibration_status : tuple of int, int
        As in the kinematics information; the defaults say that there is no calibration.
    """

    series: Series
    model: str
    serial: str
    rows: Rows
    robot_mode: str = "RUNNING"
    safety_mode: str = "NORMAL"
    remote_control: bool = True
    program_running: bool = False
    checksums: tuple[int, ...] = (0xFFFFFFFF,) * 6
    calibration_status: int = 0

    def __post_init__(self) -> None:
        if len(self.rows) != 6 or len(self.checksums) != 6:
            raise ValueError(f"a UR arm has six joints; got {len(self.rows)} rows and {len(self.checksums)} checksums")

    @property
    def software(self) -> str:
        """The answer to ``PolyscopeVersion``."""
        return _SOFTWARE[self.series]


def personality(series: Series, model: str, serial: str) -> Personality:
    """A UR5 or UR10 as published, powered and at rest. Raises ``ValueError`` for other models."""
    rows = _PUBLISHED.get((series, model))
    if rows is None:
        known = sorted({name for _, name in _PUBLISHED})
        raise ValueError(f"no published D-H for '{model}' of series {series} here; known are {', '.join(known)}")
    return Personality(series=series, model=model, serial=serial, rows=rows)


@dataclass(eq=False)
class _Client:
    port: Port
    link: socket.socket
    held: bytearray = field(default_factory=bytearray)
    queued: bytearray = field(default_factory=bytearray)
    leaving: bool = False


@dataclass(eq=False)
class _Order:
    """A fault to be shown from now on; ``refusal`` says why it cannot be, once it is done."""

    port: Port
    fault: Fault
    done: threading.Event = field(default_factory=threading.Event)
    refusal: OSError | None = None


class UrDashboardEmulator:
    """The server. It works from ``start`` to ``close`` in a thread of its own; use ``with``.

    Attributes
    ----------
    personality : Personality
        May be replaced at any time; the next answer follows it.
    received : deque of str
        The last thousand lines that clients sent to the dashboard.
    """

    def __init__(
        self,
        personality: Personality,
        host: str = "127.0.0.1",
        dashboard_port: int = 0,
        primary_port: int = 0,
        *,
        beyond_loopback: bool = False,
    ) -> None:
        """Prepare for an IPv4 address ``host``; port 0 takes a free one, which the attributes tell after ``start``.

        Raises ``ValueError`` if ``host`` is no IPv4 address, or no loopback address unless ``beyond_loopback``.
        """
        if not (beyond_loopback or ipaddress.IPv4Address(host).is_loopback):
            raise ValueError(f"{host} is not a loopback address; an emulator open to the network needs beyond_loopback")
        self.personality = personality
        self.host = host
        self.dashboard_port = dashboard_port
        self.primary_port = primary_port
        self.received: deque[str] = deque(maxlen=1000)
        self._faults: dict[Port, Fault] = {"dashboard": "none", "primary": "none"}
        self._orders: deque[_Order] = deque()
        self._listening: dict[Port, socket.socket] = {}
        self._clients: set[_Client] = set()
        self._selector: selectors.BaseSelector | None = None
        self._wake: socket.socket | None = None
        self._woken: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._closing = False

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Listen. Raises ``OSError`` that names the address if it cannot be taken; then nothing is left open."""
        if self._thread is not None:
            raise RuntimeError("the emulator was started already")
        try:
            for port in _BOTH:
                self._listen(port)
        except OSError:
            self._close_listening()
            raise
        self._wake, self._woken = socket.socketpair()
        self._wake.setblocking(False)
        self._woken.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._woken, selectors.EVENT_READ)
        for port, listening in self._listening.items():
            self._selector.register(listening, selectors.EVENT_READ, port)
        self._closing = False
        self._thread = threading.Thread(target=self._serve, name=f"UR emulator {self.host}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop, close all links and wait for the thread; harmless when closed."""
        if self._thread is None:
            return
        self._closing = True
        self._ring()
        self._thread.join(_PATIENCE_S)
        self._thread = None

    def fail(self, fault: Fault, ports: Collection[Port] = _BOTH) -> None:
        """Misbehave from now on; ``"none"`` mends. It holds when this returns, for new clients and those connected.

        silent: accept and say nothing. refuse: drop the clients and listen no more. garbage: answer nonsense. flood:
        bytes without a line's end, as fast as they are taken. trickle: a byte now and then, for ever.

        Raises ``OSError`` if somebody else took the port while it was refused.
        """
        if self._thread is None:
            raise RuntimeError("the emulator is not running")
        for port in ports:
            order = _Order(port, fault)
            self._orders.append(order)
            self._ring()
            if not order.done.wait(_PATIENCE_S):
                raise RuntimeError("the emulator's thread does not answer")
            if order.refusal is not None:
                raise order.refusal

    # -- below: called by the server's thread alone, except _listen and _close_listening from start ----------------

    def _number(self, port: Port) -> int:
        return self.dashboard_port if port == "dashboard" else self.primary_port

    def _listen(self, port: Port) -> None:
        number = self._number(port)
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            if os.name == "posix":  # elsewhere it would share the port with whoever has it
                listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind((self.host, number))
            listening.listen(16)
            listening.setblocking(False)
        except OSError as error:
            listening.close()
            raise OSError(error.errno, f"cannot listen on {self.host}:{number}: {error.strerror}") from error
        number = listening.getsockname()[1]
        if port == "dashboard":
            self.dashboard_port = number
        else:
            self.primary_port = number
        self._listening[port] = listening

    def _close_listening(self) -> None:
        for listening in self._listening.values():
            listening.close()
        self._listening.clear()

    def _ring(self) -> None:
        if self._wake is not None:
            with suppress(OSError):  # full: it is awake already; closed: it is gone
                self._wake.send(b"!")

    def _serve(self) -> None:
        assert self._selector is not None
        assert self._woken is not None
        assert self._wake is not None
        next_trickle = time.monotonic()
        try:
            while not self._closing:
                trickling = any(self._faults[client.port] == "trickle" for client in self._clients)
                wait = max(0.0, next_trickle - time.monotonic()) if trickling else None
                for key, events in self._selector.select(wait):
                    if key.fileobj is self._woken:
                        self._woken.recv(4096)
                    elif isinstance(key.data, _Client):
                        self._attend(key.data, events)
                    else:
                        self._accept(key.data)
                while self._orders:
                    self._obey(self._orders.popleft())
                if trickling and time.monotonic() >= next_trickle:
                    next_trickle = time.monotonic() + _TRICKLE_S
                    for client in list(self._clients):
                        if self._faults[client.port] == "trickle":
                            self._send(client, b"\x00")
        finally:
            for client in list(self._clients):
                self._drop(client)
            self._close_listening()
            self._selector.close()
            self._woken.close()
            self._wake.close()

    def _obey(self, order: _Order) -> None:
        assert self._selector is not None
        port = order.port
        listening = self._listening.get(port)
        clients = [client for client in self._clients if client.port == port]
        if order.fault == "refuse" and listening is not None:
            self._selector.unregister(listening)
            del self._listening[port]
            listening.close()
            for client in clients:
                self._drop(client)
        if order.fault != "refuse" and listening is None:
            try:
                self._listen(port)
            except OSError as error:
                order.refusal = error
                order.done.set()
                return
            self._selector.register(self._listening[port], selectors.EVENT_READ, port)
        self._faults[port] = order.fault
        if order.fault == "flood":
            for client in clients:
                self._send(client, b"")
        order.done.set()

    def _accept(self, port: Port) -> None:
        assert self._selector is not None
        listening = self._listening.get(port)
        if listening is None:
            return
        try:
            link, _ = listening.accept()
        except OSError:
            return  # gone before it was greeted
        if len(self._clients) >= _MOST_CLIENTS:
            link.close()
            return
        link.setblocking(False)
        client = _Client(port, link)
        self._clients.add(client)
        self._selector.register(link, selectors.EVENT_READ, client)
        if port == "dashboard":
            self._say(client, _GREETING)
        else:
            self._reply(client, robot_state(self.personality))

    def _attend(self, client: _Client, events: int) -> None:
        if client not in self._clients:
            return
        if events & selectors.EVENT_READ:
            try:
                data = client.link.recv(_LONGEST_LINE)
            except BlockingIOError:
                data = None
            except OSError:
                data = b""
            if data == b"":
                self._drop(client)
                return
            if data and client.port == "dashboard":
                client.held += data
                self._read_lines(client)
        if client in self._clients and events & selectors.EVENT_WRITE:
            self._send(client, b"")

    def _read_lines(self, client: _Client) -> None:
        while not client.leaving and client in self._clients:
            end = client.held.find(b"\n")
            if end < 0:
                if len(client.held) > _LONGEST_LINE:
                    self._drop(client)
                return
            line = client.held[:end].decode("utf-8", errors="replace").strip()
            del client.held[: end + 1]
            self.received.append(line)
            client.leaving = line == "quit"
            self._say(client, _answer(self.personality, line))

    def _say(self, client: _Client, line: str) -> None:
        self._reply(client, f"{line}\n".encode())

    def _reply(self, client: _Client, data: bytes) -> None:
        match self._faults[client.port]:
            case "none":
                self._send(client, data)
            case "garbage":
                self._send(client, _GARBAGE)
            case "flood":
                self._send(client, b"")
            case _:
                pass

    def _send(self, client: _Client, data: bytes) -> None:
        assert self._selector is not None
        flood = self._faults[client.port] == "flood"
        client.queued += data
        if flood and len(client.queued) < _LONGEST_LINE:
            client.queued += b"x" * _LONGEST_LINE
        try:
            sent = client.link.send(client.queued) if client.queued else 0
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(client)
            return
        del client.queued[:sent]
        if len(client.queued) > _MOST_QUEUED or (client.leaving and not client.queued):
            self._drop(client)
            return
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.queued or flood else 0)
        self._selector.modify(client.link, events, client)

    def _drop(self, client: _Client) -> None:
        assert self._selector is not None
        if client in self._clients:
            self._clients.discard(client)
            self._selector.unregister(client.link)
            client.link.close()


def _answers(who: Personality) -> dict[str, str]:
    known = {
        "PolyscopeVersion": who.software,
        "get robot model": who.model,
        "get serial number": who.serial,
        "robotmode": f"Robotmode: {who.robot_mode}",
        "safetymode": f"Safetymode: {who.safety_mode}",
        "running": f"Program running: {str(who.program_running).lower()}",
        "programState": f"{'PLAYING' if who.program_running else 'STOPPED'} <unnamed>",
        "get loaded program": "No program loaded",
        "isProgramSaved": "true <unnamed>",
        "quit": "Disconnected",
    }
    if who.series == "e-Series":
        known |= {
            "safetystatus": f"Safetystatus: {who.safety_mode}",
            "is in remote control": str(who.remote_control).lower(),
            "get operational mode": "NONE",
        }
    return known


def _answer(who: Personality, line: str) -> str:
    known = _answers(who).get(line)
    if known is not None:
        return known
    if any(line == command or line.startswith(f"{command} ") for command in _CHANGES_STATE):
        return f"Failed to execute: {line}"
    return f"could not understand: '{line}'"


def robot_state(who: Personality) -> bytes:
    """A robot-state package of the primary interface that holds the kinematics information alone."""
    theta, d, a, alpha = zip(*who.rows, strict=True)
    values = struct.pack(">6I24dI", *who.checksums, *theta, *a, *d, *alpha, who.calibration_status)
    kinematics = struct.pack(">IB", 5 + len(values), 5) + values
    return struct.pack(">iB", 5 + len(kinematics), 16) + kinematics
