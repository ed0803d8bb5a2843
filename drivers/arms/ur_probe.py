"""What a Universal Robots controller says of itself, over plain sockets. Nothing here changes a robot's state.

The dashboard port is asked a fixed list of questions; the primary port is only listened to; on the script and RTDE
ports a connection is opened and closed without a byte. No driver here moves UR arms yet: see ``open_ur_arm``.
"""

from __future__ import annotations

import enum
import errno
import ipaddress
import math
import os
import queue
import re
import selectors
import socket
import struct
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import ArmError, LinkLost

DASHBOARD_PORT = 29999
PRIMARY_PORT = 30001
SCRIPT_PORT = 30003
RTDE_PORT = 30004

_LONGEST_LINE = 4096
_LARGEST_PACKAGE = 65536
_MOST_PACKAGES = 200
_MOST_STATES = 20  # the kinematics come in the first one; 20 are two seconds
_PACKAGE_HEADER = struct.Struct(">iB")
_SUB_HEADER = struct.Struct(">IB")
_ROBOT_STATE = 16
_KINEMATICS_INFO = 5
_KINEMATICS = struct.Struct(">6I24dI")
_SERIES = {3: "CB3", 5: "e-Series", 10: "PolyScope X"}
_SOLD_WITH_AN_E = ("UR3", "UR5", "UR10", "UR16")
_UNDER_WAY = (errno.EINPROGRESS, errno.EWOULDBLOCK)


class _Query(enum.StrEnum):
    """All that is ever sent to a controller. Only questions belong here."""

    VERSION = "PolyscopeVersion"
    MODEL = "get robot model"
    SERIAL = "get serial number"
    ROBOT_MODE = "robotmode"
    SAFETY_MODE = "safetymode"
    SAFETY_STATUS = "safetystatus"
    RUNNING = "running"
    REMOTE_CONTROL = "is in remote control"


_ANSWERS = {
    _Query.VERSION: re.compile(r"(?:URSoftware )?([0-9]{1,3}(?:\.[0-9]{1,9}){2,3})\b"),
    _Query.MODEL: re.compile(r"(UR[0-9A-Za-z]{1,10})$"),
    _Query.SERIAL: re.compile(r"([0-9]{4,20})$"),
    _Query.ROBOT_MODE: re.compile(r"Robotmode: ([A-Z_]{1,40})$"),
    _Query.SAFETY_MODE: re.compile(r"Safetymode: ([A-Z_]{1,40})$"),
    _Query.SAFETY_STATUS: re.compile(r"Safetystatus: ([A-Z_0-9]{1,60})$"),
    _Query.RUNNING: re.compile(r"(?:Program|Robot) running: (true|false)$", re.IGNORECASE),
    _Query.REMOTE_CONTROL: re.compile(r"(true|false)$", re.IGNORECASE),
}


@dataclass(frozen=True)
class UrKinematics:
    """The D-H parameters that the controller itself computes with: nominal ones plus its factory calibration.

    ``A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha)``; each tuple has one value a joint, [rad] or [m].

    Attributes
    ----------
    checksums : tuple of int
        One for each joint; all 0xFFFFFFFF where there is no calibration (a simulator).
    status : int
        Calibration status: 0 none, 2 calibrated.
    """

    theta: tuple[float, ...]
    d: tuple[float, ...]
    a: tuple[float, ...]
    alpha: tuple[float, ...]
    checksums: tuple[int, ...]
    status: int

    @property
    def rows(self) -> NDArray[np.float64]:
        """Rows theta, d, a, alpha, shape (6, 4) [rad, m, m, rad]."""
        return np.column_stack([self.theta, self.d, self.a, self.alpha])


@dataclass(frozen=True)
class UrProbe:
    """What a controller said. None: it did not say, or its software is too old to be asked.

    Attributes
    ----------
    software : str
        PolyScope version, e.g. "3.15.8.106339".
    series : str
        "CB3", "e-Series" or "PolyScope X", from the version's first number; else "unknown".
    model : str or None
        As the controller gives it, which leaves out the "e" of the e-Series; see ``full_model``.
    robot_mode, safety_mode, safety_status : str or None
        In the controller's words, e.g. "RUNNING", "NORMAL".
    remote_control : bool or None
        Whether it takes commands from outside; None where there is no such switch (CB3).
    ports : mapping
        Primary, script and RTDE port -> whether it accepts a connection.
    kinematics : UrKinematics or None
    kinematics_note : str
        Why there are no kinematics; empty when there are.
    """

    host: str
    greeting: str
    software: str
    series: str
    model: str | None
    serial: str | None
    robot_mode: str | None
    safety_mode: str | None
    safety_status: str | None
    remote_control: bool | None
    program_running: bool | None
    ports: Mapping[int, bool]
    kinematics: UrKinematics | None
    kinematics_note: str

    @property
    def full_model(self) -> str | None:
        """The model with the "e" of the e-Series, whose D-H differs from the CB3 arm of the same name."""
        if self.series != "CB3" and self.model in _SOLD_WITH_AN_E:
            return f"{self.model}e"
        return self.model


def open_ur_arm(name: str, host: str) -> NoReturn:
    """Where a driver for UR arms will be opened. Raises ``ArmError``: there is none yet."""
    raise ArmError(
        f"arm {name} at {host}: this version of cellapp can examine a UR controller ('cellapp doctor') but not move its"
        " arm; nothing was sent to it. Use the simulated cell, or import readings measured elsewhere"
    )


def probe_ur(
    host: str,
    timeout_s: float,
    *,
    dashboard_port: int = DASHBOARD_PORT,
    primary_port: int = PRIMARY_PORT,
    script_port: int = SCRIPT_PORT,
    rtde_port: int = RTDE_PORT,
) -> UrProbe:
    """Ask a UR controller who and how it is. Returns or raises within ``timeout_s`` in all, whatever the host does.

    IPv4 only, as the RTDE client that would follow.

    Raises
    ------
    LinkLost
        If no UR dashboard answers at ``host``; says what happened there and what to do.
    ValueError
        If ``timeout_s`` is not a positive number.
    """
    if not (math.isfinite(timeout_s) and timeout_s > 0.0):
        raise ValueError(f"timeout_s: expected a positive number of seconds, got {timeout_s!r}")
    deadline = time.monotonic() + timeout_s
    address = _resolve(host, deadline)
    with ExitStack() as stack:
        # all at once, so that one dead port takes no time from the others
        dashboard, primary, script, rtde = (
            stack.enter_context(_Connection(host, address, port))
            for port in (dashboard_port, primary_port, script_port, rtde_port)
        )
        try:
            said = _converse(dashboard, deadline)
        except LinkLost as error:
            soon = min(deadline, time.monotonic() + 0.2)
            others = [str(link.port) for link in (primary, script, rtde) if not link.refusal(soon)]
            if not others:
                raise
            raise LinkLost(
                f"{error}. Other UR ports accept a connection there ({', '.join(others)}): see whether the dashboard"
                " server is switched on (Settings > Security > Services)"
            ) from error
        kinematics, note = _listen_for_kinematics(primary, deadline)
        ports = {link.port: not link.refusal(deadline) for link in (primary, script, rtde)}
    greeting, software, answers = said
    remote = answers.get(_Query.REMOTE_CONTROL)
    running = answers.get(_Query.RUNNING)
    return UrProbe(
        host=host,
        greeting=greeting,
        software=software,
        series=_series(software),
        model=answers.get(_Query.MODEL),
        serial=answers.get(_Query.SERIAL),
        robot_mode=answers.get(_Query.ROBOT_MODE),
        safety_mode=answers.get(_Query.SAFETY_MODE),
        safety_status=answers.get(_Query.SAFETY_STATUS),
        remote_control=None if remote is None else remote.lower() == "true",
        program_running=None if running is None else running.lower() == "true",
        ports=ports,
        kinematics=kinematics,
        kinematics_note=note,
    )


def _series(software: str) -> str:
    return _SERIES.get(int(software.split(".")[0]), "unknown")


# -- links ------------------------------------------------------------------------------------------------------------


def _resolve(host: str, deadline: float) -> str:
    """The IPv4 address of a host, in bounded time: the system's resolver knows no timeout, so a thread waits for it."""
    try:
        return str(ipaddress.IPv4Address(host))
    except ValueError:
        pass
    if not host.strip():
        raise LinkLost("the UR controller's host is empty; give its address as shown under Setup Robot > Network")
    answer: queue.SimpleQueue[str | None] = queue.SimpleQueue()

    def ask() -> None:
        try:
            found = socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_STREAM)
            answer.put(str(found[0][4][0]))
        except (OSError, ValueError):  # ValueError: a text that can be no host name
            answer.put(None)

    threading.Thread(target=ask, name=f"resolve {_shown(host)}", daemon=True).start()
    try:
        address = answer.get(timeout=_left(deadline))
    except queue.Empty:
        address = None
    if address is None:
        raise LinkLost(
            f"{_shown(host)}: no IPv4 host of that name was found; check the spelling, or give the address as numbers"
        )
    return address


def _left(deadline: float) -> float:
    return max(0.0, deadline - time.monotonic())


class _Connection:
    """A TCP connection that was started and may come up later. Close it, or use ``with``."""

    def __init__(self, host: str, address: str, port: int) -> None:
        self.port = port
        self.where = f"{host}:{port}"
        self._refusal: str | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        code = self._socket.connect_ex((address, port))
        if code not in (0, *_UNDER_WAY):
            self._refusal = os.strerror(code)

    def __enter__(self) -> _Connection:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def refusal(self, deadline: float) -> str:
        """Why there is no connection by ``deadline``; empty if there is one."""
        if self._refusal is None:
            if not self._wait(selectors.EVENT_WRITE, deadline):
                return "no answer in time"
            code = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            self._refusal = os.strerror(code) if code else ""
        return self._refusal

    def receive(self, deadline: float) -> bytes | None:
        """Some bytes; empty when the other side closed; None when nothing came by ``deadline``."""
        if time.monotonic() >= deadline or not self._wait(selectors.EVENT_READ, deadline):
            return None
        return self._socket.recv(_LARGEST_PACKAGE)

    def send(self, data: bytes, deadline: float) -> None:
        """Send a short text. Raises ``OSError``."""
        self._socket.settimeout(max(_left(deadline), 1e-3))
        try:
            self._socket.sendall(data)
        finally:
            self._socket.setblocking(False)

    def _wait(self, event: int, deadline: float) -> bool:
        with selectors.DefaultSelector() as selector:
            selector.register(self._socket, event)
            return bool(selector.select(_left(deadline)))


# -- dashboard --------------------------------------------------------------------------------------------------------


def _converse(link: _Connection, deadline: float) -> tuple[str, str, dict[_Query, str]]:
    """Greeting, version and the answers that could be read."""
    refusal = link.refusal(deadline)
    if refusal:
        raise LinkLost(
            f"{link.where}: no connection to the UR dashboard ({refusal}); is the controller switched on, is this its"
            " address, and does the network between allow it?"
        )
    lines = _Lines(link, deadline)
    greeting = lines.read("its greeting")
    if "universal robots dashboard" not in greeting.lower():
        raise LinkLost(
            f"{link.where}: what answers is no UR dashboard: it greets with '{_shown(greeting)}'; check the address"
        )
    version = lines.ask(_Query.VERSION)
    found = _ANSWERS[_Query.VERSION].match(version)
    if found is None:
        raise LinkLost(
            f"{link.where}: expected a PolyScope version such as 'URSoftware 3.15.8.106339', got '{_shown(version)}';"
            " check that this is a UR controller"
        )
    software = found.group(1)
    answers: dict[_Query, str] = {}
    for query in _Query:
        if query is _Query.VERSION or (query is _Query.REMOTE_CONTROL and _series(software) == "CB3"):
            continue
        # software that does not know a question says so in a line of its own; that counts as no answer
        match = _ANSWERS[query].match(lines.ask(query))
        if match:
            answers[query] = match.group(1)
    return greeting, software, answers


class _Lines:
    """Lines of text from a connection, each of bounded length, all before one deadline."""

    def __init__(self, link: _Connection, deadline: float) -> None:
        self._link, self._deadline = link, deadline
        self._held = bytearray()

    def ask(self, query: _Query) -> str:
        try:
            self._link.send(f"{query.value}\n".encode("ascii"), self._deadline)
        except OSError as error:
            raise self._lost(f"the link broke while '{query.value}' was sent ({error})") from error
        return self.read(f"the answer to '{query.value}'")

    def read(self, what: str) -> str:
        """The next line that is not empty."""
        while True:
            end = self._held.find(b"\n", 0, _LONGEST_LINE)
            if end >= 0:
                line = self._held[:end].decode("utf-8", errors="replace").strip()
                del self._held[: end + 1]
                if line:
                    return line
                continue
            if len(self._held) >= _LONGEST_LINE:
                raise self._lost(f"{what} is longer than {_LONGEST_LINE} bytes; this is no UR dashboard")
            try:
                more = self._link.receive(self._deadline)
            except OSError as error:
                raise self._lost(f"the link broke while waiting for {what} ({error})") from error
            if more is None:
                raise self._lost(f"connected, but {what} did not come in time")
            if not more:
                raise self._lost(f"the controller closed the connection before {what} came")
            self._held += more

    def _lost(self, what: str) -> LinkLost:
        return LinkLost(f"{self._link.where}: {what}; check the address; if it is right, restart the controller")


def _shown(text: str) -> str:
    """Foreign text made fit for a message."""
    clean = "".join(c if c.isprintable() else "?" for c in text[:80])
    return f"{clean}..." if len(text) > 80 else clean


# -- primary interface ------------------------------------------------------------------------------------------------


def _listen_for_kinematics(link: _Connection, deadline: float) -> tuple[UrKinematics | None, str]:
    """Read packages until one tells the kinematics; the kinematics, or why there are none."""
    refusal = link.refusal(deadline)
    if refusal:
        return None, f"port {link.port}: no connection ({refusal})"
    held = bytearray()
    packages = states = 0
    while packages < _MOST_PACKAGES and states < _MOST_STATES:
        if len(held) >= _PACKAGE_HEADER.size:
            size, kind = _PACKAGE_HEADER.unpack_from(held)
            if not _PACKAGE_HEADER.size <= size <= _LARGEST_PACKAGE:
                return None, f"port {link.port}: what it sends are no UR packages (one of {size} bytes)"
            if len(held) >= size:
                package = bytes(held[_PACKAGE_HEADER.size : size])
                del held[:size]
                packages += 1
                if kind == _ROBOT_STATE:
                    states += 1
                    try:
                        kinematics = parse_kinematics(package)
                    except ValueError as error:
                        return None, f"port {link.port}: {error}"
                    if kinematics is not None:
                        return kinematics, ""
                continue
        try:
            more = link.receive(deadline)
        except OSError as error:
            return None, f"port {link.port}: the link broke ({error})"
        if more is None:
            return None, f"port {link.port}: connected, but no kinematics came in time"
        if not more:
            return None, f"port {link.port}: the controller closed the connection before kinematics came"
        held += more
    return None, f"port {link.port}: no kinematics in the first {packages} packages"


def parse_kinematics(state: bytes) -> UrKinematics | None:
    """The kinematics in a robot-state package (its payload, after size and type); None if it has none.

    Sub-packages of other types are skipped by their size, and what a later software appends is left aside.

    Raises
    ------
    ValueError
        If the sizes do not fit together, or a value is not a finite number.
    """
    at = 0
    while at < len(state):
        if len(state) - at < _SUB_HEADER.size:
            raise ValueError(f"the robot state ends inside a sub-package's header, at byte {at}")
        size, kind = _SUB_HEADER.unpack_from(state, at)
        if not _SUB_HEADER.size <= size <= len(state) - at:
            raise ValueError(f"sub-package of type {kind} claims {size} bytes of {len(state) - at} that are left")
        if kind == _KINEMATICS_INFO:
            if size < _SUB_HEADER.size + _KINEMATICS.size:
                raise ValueError(f"the kinematics have {size} bytes, expected {_SUB_HEADER.size + _KINEMATICS.size}")
            values = _KINEMATICS.unpack_from(state, at + _SUB_HEADER.size)
            if not all(map(math.isfinite, values)):
                raise ValueError("the kinematics hold a value that is not a finite number")
            return UrKinematics(
                theta=values[6:12],
                a=values[12:18],
                d=values[18:24],
                alpha=values[24:30],
                checksums=values[:6],
                status=values[30],
            )
        at += size
    return None
