"""Probe of a Universal Robots controller over plain sockets, without changing the robot's state.

The dashboard receives a fixed list of questions. The primary port is only read; over RTDE the state is read once. On
the script port a connection is opened and closed without sending a byte.
"""

from __future__ import annotations

import enum
import math
import re
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import median
from typing import Any

import numpy as np

from drivers.arms.protocol import JointLimits, LinkLost
from drivers.arms.ur_links import (
    DASHBOARD_PORT,
    PRIMARY_PORT,
    RTDE_PORT,
    SCRIPT_PORT,
    Connection,
    Dashboard,
    printable,
    resolve,
)
from drivers.arms.ur_rtde_reader import UrSample, read_sample, samples
from drivers.findings import DeviceReport, DhRow
from drivers.patience import Patience

_LARGEST_PACKAGE = 65536
_MAX_PACKAGES = 200
_MAX_STATES = 20  # the first state has the kinematics; 20 states last two seconds
_PACKAGE_HEADER = struct.Struct(">iB")
_SUB_HEADER = struct.Struct(">IB")
_ROBOT_STATE = 16
_MESSAGE = 20
_VERSION_MESSAGE = 3
_VERSION = struct.Struct(">QbbB")  # time, source, kind of message, length of the name that follows
_WITHOUT_DASHBOARD = 10
"""Major version of PolyScope X, which has no dashboard server."""
_MODE_DATA = 0
_MODE = struct.Struct(">Q7?")  # time; connected to and enabled: the real robot; then power, stops, program
_CARTESIAN_INFO = 4
_CARTESIAN = struct.Struct(">12d")  # the tool's pose in the base, then the TCP in the flange
_KINEMATICS_INFO = 5
_KINEMATICS = struct.Struct(">6I24dI")
_CONFIGURATION = 6
_JOINT_LIMITS = struct.Struct(">24d")  # lowest and highest position of each joint, then speed and acceleration of each
_SERIES = {3: "CB3", 5: "e-Series", 10: "PolyScope X"}
_MODELS_WITH_E_SUFFIX = ("UR3", "UR5", "UR10", "UR16")


class _Query(enum.StrEnum):
    """All texts that are ever sent to a dashboard: questions only; names are those of fields of ``UrProbe``."""

    VERSION = "PolyscopeVersion"
    MODEL = "get robot model"
    SERIAL = "get serial number"
    ROBOT_MODE = "robotmode"
    SAFETY_MODE = "safetymode"
    SAFETY_STATUS = "safetystatus"
    PROGRAM_RUNNING = "running"
    PROGRAM = "programState"
    REMOTE_CONTROL = "is in remote control"


_ANSWERS = {
    _Query.VERSION: re.compile(r"(?:URSoftware )?([0-9]{1,3}(?:\.[0-9]{1,9}){2,3})\b"),
    _Query.MODEL: re.compile(r"(UR[0-9A-Za-z]{1,10})$"),
    _Query.SERIAL: re.compile(r"([0-9]{4,20})$"),
    _Query.ROBOT_MODE: re.compile(r"Robotmode: ([A-Z_]{1,40})$"),
    _Query.SAFETY_MODE: re.compile(r"Safetymode: ([A-Z_]{1,40})$"),
    _Query.SAFETY_STATUS: re.compile(r"Safetystatus: ([A-Z_0-9]{1,60})$"),
    _Query.PROGRAM_RUNNING: re.compile(r"(?:Program|Robot) running: (true|false)$", re.IGNORECASE),
    _Query.PROGRAM: re.compile(r"(?:PLAYING|PAUSED) (.{1,200})$"),
    _Query.REMOTE_CONTROL: re.compile(r"(true|false)$", re.IGNORECASE),
}


@dataclass(frozen=True)
class UrKinematics:
    """D-H parameters that the controller uses: nominal values plus its factory calibration.

    Attributes
    ----------
    rows : tuple of rows
        Rows theta, d, a, alpha of ``A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha)`` [rad, m, m, rad].
    checksum : str
        The checksums of the six joints as one text; empty without calibration (a simulator).
    """

    rows: tuple[DhRow, ...]
    checksum: str


@dataclass(frozen=True)
class UrPrimary:
    """Data from the primary interface; a field is None if not received.

    Attributes
    ----------
    limits : JointLimits or None
    tcp : tuple of float or None
        Tool centre point in the flange frame: position [m], rotation vector [rad].
    real_robot : bool or None
        Whether motions move the real arm; False in simulation mode.
    kinematics_note : str
        Why no kinematics were read; empty if they were.
    """

    kinematics: UrKinematics | None = None
    limits: JointLimits | None = None
    tcp: tuple[float, ...] | None = None
    real_robot: bool | None = None
    kinematics_note: str = ""


@dataclass(frozen=True, kw_only=True)
class UrProbe(UrPrimary):
    """Result of a probe. None: not reported, or not supported by the software version.

    Attributes
    ----------
    software : str
        PolyScope version, e.g. "3.15.8.106339".
    series : str
        "CB3", "e-Series" or "PolyScope X", from the version's first number; else "unknown".
    model : str or None
        As reported by the controller, without the "e" of the e-Series; see ``full_model``.
    robot_mode, safety_mode, safety_status : str or None
        As named by the controller, e.g. "RUNNING", "NORMAL".
    remote_control : bool or None
        Whether it accepts commands over the network; None if it has no such switch (CB3).
    ports : mapping
        Primary, script and RTDE port -> whether it accepts a connection.
    sample : UrSample or None
        The arm's state over RTDE.
    sample_note : str
        Why no state was read; empty if one was.
    program : str or None
        Name of the program that runs or is paused.
    """

    host: str
    software: str
    series: str
    model: str | None = None
    serial: str | None = None
    robot_mode: str | None = None
    safety_mode: str | None = None
    safety_status: str | None = None
    remote_control: bool | None = None
    program_running: bool | None = None
    program: str | None = None
    ports: Mapping[int, bool]
    sample: UrSample | None = None
    sample_note: str = ""

    @property
    def full_model(self) -> str | None:
        """The model including the "e" of the e-Series, whose D-H differs from the CB3 arm of the same name."""
        if self.series != "CB3" and self.model in _MODELS_WITH_E_SUFFIX:
            return f"{self.model}e"
        return self.model

    def report(self) -> DeviceReport:
        """Return identity, modes, joint temperatures and the D-H rows that the controller uses."""
        kinematics = self.kinematics
        modes = [mode for mode in (self.robot_mode, self.safety_mode) if mode is not None]
        return DeviceReport(
            model=self.full_model,
            serial=self.serial,
            software=f"PolyScope {self.software}",
            state=", ".join(modes) or None,
            joints_c=None if self.sample is None else self.sample.joints_c,
            dh_rows=None if kinematics is None else kinematics.rows,
            dh_checksum=None if kinematics is None else kinematics.checksum,
        )


def probe_ur(
    host: str,
    timeout_s: float,
    *,
    ports: Sequence[int] = (DASHBOARD_PORT, PRIMARY_PORT, SCRIPT_PORT, RTDE_PORT),
    look: Callable[[], None] | None = None,
) -> UrProbe:
    """Read identity and state of a UR controller. Returns or raises within ``timeout_s`` in all cases.

    IPv4 only, like the RTDE client. ``ports`` are those of dashboard, primary interface, script and RTDE. ``look`` is
    called while this waits and may raise.

    Raises
    ------
    LinkLost
        If no UR dashboard answers at ``host``; the message says what happened and what to do.
    ValueError
        If ``timeout_s`` is not a positive number.
    """
    if not (math.isfinite(timeout_s) and timeout_s > 0.0):
        raise ValueError(f"timeout_s: expected a positive number of seconds, got {timeout_s!r}")
    patience = Patience(timeout_s, look=look)
    address = resolve(host, patience)
    with ExitStack() as stack:
        # in parallel, so that a dead port takes no time from the others
        dashboard, primary, script, rtde = (stack.enter_context(Connection(host, address, port)) for port in ports)
        try:
            software, answers = _ask_dashboard(dashboard, patience)
        except LinkLost as error:
            raise _with_open_ports(error, (primary, script, rtde), patience) from error.__cause__
        sample, sample_note = _state(rtde, patience.share(0.5))
        primary_state = _read_primary(primary, patience)
        accepting = {link.port: not link.refusal(patience) for link in (primary, script, rtde)}
    return UrProbe(
        **vars(primary_state),
        **answers,
        host=host,
        software=software,
        series=_series(software),
        ports=accepting,
        sample=sample,
        sample_note=sample_note,
    )


def _with_open_ports(error: LinkLost, others: Sequence[Connection], patience: Patience) -> LinkLost:
    """Return the error for a lost dashboard. If other ports accept a connection, name them: only the server is off.

    PolyScope X has no dashboard. It is recognized by its version, the first message of the primary port
    (``others[0]``).
    """
    soon = Patience(0.5, patience)
    major = _major_version(others[0], soon)
    if major is not None and major >= _WITHOUT_DASHBOARD:
        return LinkLost(
            f"{others[0].where}: PolyScope X (version {major}) has no dashboard server, over which this program asks"
            " for modes and stops an arm whose program hangs; such a controller is not driven. Readings that were taken"
            " with it are calibrated: 'cellapp import PROFILE CSV --run NEW'; to be driven it needs PolyScope 5"
        )
    accepting = [str(link.port) for link in others if not link.refusal(soon)]
    if not accepting:
        return error
    return LinkLost(
        f"{error}. Other UR ports accept a connection there ({', '.join(accepting)}): see whether the dashboard"
        " server is switched on (Settings > Security > Services)"
    )


def _major_version(primary: Connection, patience: Patience) -> int | None:
    """Return the major software version from the primary port; None if it does not arrive."""
    received = bytearray()
    try:
        if primary.refusal(patience):
            return None
        while len(received) < _PACKAGE_HEADER.size or len(received) < _PACKAGE_HEADER.unpack_from(received)[0]:
            more = primary.receive(patience)
            if not more or len(received) > _LARGEST_PACKAGE:
                return None
            received += more
    except OSError:
        return None
    size, kind = _PACKAGE_HEADER.unpack_from(received)
    message = bytes(received[_PACKAGE_HEADER.size : max(size, 0)])
    if kind != _MESSAGE or len(message) < _VERSION.size:
        return None
    _, _, subtype, length = _VERSION.unpack_from(message)
    at = _VERSION.size + length
    return message[at] if subtype == _VERSION_MESSAGE and at < len(message) else None


def _series(software: str) -> str:
    return _SERIES.get(int(software.split(".")[0]), "unknown")


# -- dashboard --------------------------------------------------------------------------------------------------------


def _ask_dashboard(link: Connection, patience: Patience) -> tuple[str, dict[str, Any]]:
    """Return the version, and the answers that could be read as fields of ``UrProbe``."""
    dashboard = Dashboard(link, patience)
    version = dashboard.ask(_Query.VERSION)
    found = _ANSWERS[_Query.VERSION].match(version)
    if found is None:
        raise LinkLost(
            f"{link.where}: expected a PolyScope version such as 'URSoftware 3.15.8.106339', got"
            f" '{printable(version)}'; check that this is a UR controller"
        )
    software = found.group(1)
    answers: dict[str, Any] = {}
    for query in _Query:
        if query is _Query.VERSION or (query is _Query.REMOTE_CONTROL and _series(software) == "CB3"):
            continue
        # older software answers an unknown question with an error line, which counts as no answer
        match = _ANSWERS[query].match(dashboard.ask(query))
        if match:
            truth = query in (_Query.PROGRAM_RUNNING, _Query.REMOTE_CONTROL)
            answers[query.name.lower()] = match.group(1).lower() == "true" if truth else match.group(1)
    return software, answers


def _state(link: Connection, patience: Patience) -> tuple[UrSample | None, str]:
    try:
        return read_sample(link, patience), ""
    except LinkLost as error:
        return None, str(error)


# -- primary interface ------------------------------------------------------------------------------------------------


def _read_primary(link: Connection, patience: Patience) -> UrPrimary:
    """Read packages until one contains the kinematics; return the contents of all packages up to it."""
    refusal = link.refusal(patience)
    if refusal:
        return UrPrimary(kinematics_note=f"port {link.port}: no connection ({refusal})")
    received = bytearray()
    packages = states = 0
    primary_state = UrPrimary()

    def incomplete(why: str) -> UrPrimary:
        return replace(primary_state, kinematics_note=f"port {link.port}: {why}")

    while packages < _MAX_PACKAGES and states < _MAX_STATES:
        if len(received) >= _PACKAGE_HEADER.size:
            size, kind = _PACKAGE_HEADER.unpack_from(received)
            if not _PACKAGE_HEADER.size <= size <= _LARGEST_PACKAGE:
                return incomplete(f"its data are not UR packages (one of {size} bytes)")
            if len(received) >= size:
                package = bytes(received[_PACKAGE_HEADER.size : size])
                del received[:size]
                packages += 1
                if kind == _ROBOT_STATE:
                    states += 1
                    try:
                        now = parse_robot_state(package)
                    except ValueError as error:
                        return incomplete(str(error))
                    primary_state = UrPrimary(
                        kinematics=now.kinematics or primary_state.kinematics,
                        limits=now.limits or primary_state.limits,
                        tcp=now.tcp or primary_state.tcp,
                        real_robot=primary_state.real_robot if now.real_robot is None else now.real_robot,
                    )
                    if primary_state.kinematics is not None:
                        return primary_state
                continue
        try:
            more = link.receive(patience)
        except OSError as error:
            return incomplete(f"the link broke ({error})")
        if more is None:
            return incomplete("connected, but no kinematics came in time")
        if not more:
            return incomplete("the controller closed the connection before kinematics came")
        received += more
    return incomplete(f"no kinematics in the first {packages} packages")


def parse_robot_state(state: bytes) -> UrPrimary:
    """Parse a robot-state package (its payload, after size and type); every part of it is optional.

    Sub-packages of other types are skipped by their size; bytes that later software appends are ignored.

    Raises
    ------
    ValueError
        If the sizes are inconsistent, or a value is not a finite number.
    """
    kinematics, limits, tcp, real_robot = None, None, None, None
    for kind, payload in _sub_packages(state):
        if kind == _MODE_DATA:
            if len(payload) >= _MODE.size:
                real_robot = bool(_MODE.unpack_from(payload)[2])
        elif kind == _CARTESIAN_INFO:
            if len(payload) >= _CARTESIAN.size:  # older software omits the TCP
                tcp = _values(_CARTESIAN, payload, "tool's position")[6:]
        elif kind == _KINEMATICS_INFO:
            values = _values(_KINEMATICS, payload, "kinematics")
            theta, a, d, alpha = np.reshape(values[6:30], (4, 6)).tolist()
            calibrated = values[30] and set(values[:6]) != {0xFFFFFFFF}
            checksum = "-".join(f"{value:08x}" for value in values[:6]) if calibrated else ""
            kinematics = UrKinematics(tuple(zip(theta, d, a, alpha, strict=True)), checksum)
        elif kind == _CONFIGURATION:
            numbers = np.array(_values(_JOINT_LIMITS, payload, "joint limits")).reshape(12, 2)
            limits = JointLimits(position=numbers[:6], speed=numbers[6:, 0], acceleration=numbers[6:, 1])
    return UrPrimary(kinematics, limits, tcp, real_robot)


def _sub_packages(state: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield type and payload of each sub-package."""
    at = 0
    while at < len(state):
        if len(state) - at < _SUB_HEADER.size:
            raise ValueError(f"the robot state ends inside a sub-package's header, at byte {at}")
        size, kind = _SUB_HEADER.unpack_from(state, at)
        if not _SUB_HEADER.size <= size <= len(state) - at:
            raise ValueError(f"sub-package of type {kind} claims {size} bytes of {len(state) - at} that are left")
        yield kind, state[at + _SUB_HEADER.size : at + size]
        at += size


def _values(form: struct.Struct, payload: bytes, what: str) -> tuple[Any, ...]:
    if len(payload) < form.size:
        needed = _SUB_HEADER.size + form.size
        raise ValueError(f"the {what} have {_SUB_HEADER.size + len(payload)} bytes, expected {needed}")
    values = form.unpack_from(payload)
    if not all(map(math.isfinite, values)):
        raise ValueError(f"the {what} hold a value that is not a finite number")
    return values


# -- The timing of the link: round trips on the dashboard, silences between the states ---------------------------------


_TIMED_S = 2.0
_ASK_EVERY_S = 0.05


def time_link(host: str, timeout_s: float, look: Callable[[], None]) -> tuple[float, str]:
    """Measure the link for 2 s; return by how much a message may be late [s], and the figures in words.

    ``look`` is called meanwhile and may raise. Raises ``LinkLost``.
    """
    patience, ended = Patience(_TIMED_S + timeout_s, look=look), threading.Event()
    address, trips_s, arrived_s, stamps_s = resolve(host, patience), list[float](), list[float](), list[float]()
    with Connection(host, address, DASHBOARD_PORT) as line, Connection(host, address, RTDE_PORT) as stream:
        dashboard = Dashboard(line, Patience(_TIMED_S + timeout_s))

        def ask() -> None:
            with suppress(LinkLost):
                while not ended.wait(_ASK_EVERY_S):
                    asked_s = time.monotonic()
                    dashboard.ask(_Query.PROGRAM_RUNNING)
                    trips_s.append(time.monotonic() - asked_s)

        asking = threading.Thread(target=ask, name=f"round trips to {host}", daemon=True)
        asking.start()
        try:
            for sample in samples(stream, patience):
                stamps_s.append(sample.time_s)
                arrived_s.append(time.monotonic())
                if arrived_s[-1] - arrived_s[0] > _TIMED_S:
                    break
        finally:
            ended.set()
            asking.join()
    if not trips_s:
        raise LinkLost(f"{host}: its dashboard does not answer")
    gaps_s, steps_s = ([after - before for before, after in pairwise(one)] for one in (arrived_s, stamps_s))
    late_s, usual_s = max(gaps_s) - median(gaps_s), max(median(steps_s), 1e-3)
    missed = sum(max(round(step_s / usual_s) - 1, 0) for step_s in steps_s)
    return max(late_s, *trips_s), (
        f"round trip {1e3 * median(trips_s):.1f} ms, at most {1e3 * max(trips_s):.1f} ms; states at most"
        f" {1e3 * late_s:.1f} ms late, {missed} of {len(stamps_s) + missed} missed in {_TIMED_S:g} s"
    )
