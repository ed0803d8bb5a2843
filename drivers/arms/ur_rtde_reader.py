"""Reader of a UR controller's state over RTDE with a plain socket: outputs only, nothing is written.

Used when the RTDE client that moves the arm has failed or has not been started. Packets are
``size uint16, type uint8, payload``, big-endian; protocol version 2.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from drivers.arms.protocol import ArmError, EmergencyStop, LinkLost, ProtectiveStop
from drivers.arms.ur_links import RTDE_PORT, Connection
from drivers.patience import Patience

_HEADER = struct.Struct(">HB")
_VERSION, _OUTPUTS, _INPUTS, _START, _DATA = ord("V"), ord("O"), ord("I"), ord("S"), ord("U")
_FREQUENCY_HZ = 125.0
"""Rate that every series supports."""
_MAX_PACKETS = 1000
FORMATS = {
    "DOUBLE": "d",
    "INT32": "i",
    "UINT32": "I",
    "UINT64": "Q",
    "UINT8": "B",
    "BOOL": "?",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
}
"""Types of the protocol and their binary layouts."""
_REQUIRED = ("timestamp", "actual_q", "actual_qd", "robot_mode", "safety_mode", "runtime_state")
_OPTIONAL = ("target_speed_fraction", "payload", "payload_cog", "joint_temperatures")
"""Older software versions lack some of these."""
_AT_REST_RAD_S = 0.005
_RETRY_S = 0.1


class SafetyMode(IntEnum):
    """Safety modes as numbered in the protocol."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


class RobotMode(IntEnum):
    """Robot modes as numbered in the protocol."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class ProgramState(IntEnum):
    """States of the program as numbered in the protocol."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


SLIDER_DOWN = 0.005
"""A speed slider below this value is at 0 % on the pendant: the arm does not move."""


@dataclass(frozen=True)
class UrSample:
    """One state. ``q``, ``qd``, ``joints_c``: six joints [rad, rad/s, degC]; None if not reported.

    ``robot_mode``, ``safety_mode`` and ``program`` are named as in the manual, e.g. RUNNING, NORMAL, PLAYING.
    """

    time_s: float
    q: tuple[float, ...]
    qd: tuple[float, ...]
    robot_mode: str
    safety_mode: str
    program: str
    speed_fraction: float | None
    payload_kg: float | None
    payload_center_m: tuple[float, ...] | None
    joints_c: tuple[float, ...] | None = None

    @property
    def at_rest(self) -> bool:
        """Whether no joint moves faster than the encoder noise."""
        return self.speed < _AT_REST_RAD_S

    @property
    def complete(self) -> bool:
        """Whether it has six joints."""
        return len(self.q) == 6 and len(self.qd) == 6

    @property
    def finite(self) -> bool:
        """Whether all positions and speeds are finite numbers."""
        return all(map(math.isfinite, (*self.q, *self.qd)))

    @property
    def speed(self) -> float:
        """Speed of the fastest joint [rad/s]."""
        return max(map(abs, self.qd))

    @property
    def slider_down(self) -> bool:
        """Whether the speed slider is at 0 %: the arm stands still, whatever its program requests."""
        return self.speed_fraction is not None and self.speed_fraction < SLIDER_DOWN

    def distance(self, q: Sequence[float]) -> float:
        """Return the largest difference of a joint from ``q`` [rad]."""
        return max(abs(a - b) for a, b in zip(self.q, q))


def read_sample(link: Connection, patience: Patience) -> UrSample:
    """Return the first state from a new connection to the RTDE port.

    Raises
    ------
    LinkLost
        If none comes in time, or the peer is not an RTDE server.
    """
    return next(samples(link, patience))


def inputs_taken(link: Connection, patience: Patience) -> bool:
    """Return whether another connection holds the input registers of the control client. Nothing is written; they are
    free again when ``link`` ends.

    Raises
    ------
    LinkLost
        If no answer comes in time, or the peer is not an RTDE server.
    """
    if refusal := link.refusal(patience):
        raise LinkLost(f"{link.where}: no RTDE connection ({refusal})")
    packets = _Packets(link, patience)
    packets.ask(_VERSION, struct.pack(">H", 2))
    return b"IN_USE" in packets.ask(_INPUTS, b"input_int_register_0")


def wait_at_rest(
    host: str, timeout_s: float, *, port: int = RTDE_PORT, dwell_s: float = 0.05, look: Callable[[], None] | None = None
) -> UrSample:
    """Watch the arm over a separate connection until it has rested for ``dwell_s``; return the last state.

    Connects again if the controller refuses or drops the connection. ``look`` is called while this waits and may raise.

    Raises
    ------
    LinkLost
        If no state comes, or the arm does not rest, within ``timeout_s``.
    """
    patience = Patience(timeout_s, look=look)
    while True:
        try:
            return _watch_until_rest(host, patience, port, dwell_s)
        except LinkLost:
            if patience.remaining_s < 2.0 * _RETRY_S:
                raise
            time.sleep(_RETRY_S)


def _watch_until_rest(host: str, patience: Patience, port: int, dwell_s: float) -> UrSample:
    since, moves = None, False
    with Connection.to(host, port, patience) as link:
        try:
            for sample in samples(link, patience):
                moves = not sample.at_rest
                if moves:
                    since = None
                elif since is None:
                    since = sample.time_s
                elif sample.time_s - since >= dwell_s:
                    return sample
                if patience.over:
                    break
        except LinkLost:
            if not moves or not patience.over:
                raise
    raise LinkLost(f"{host}: the arm still moves")


def samples(link: Connection, patience: Patience) -> Iterator[UrSample]:
    """Subscribe to the outputs and yield states as they come."""
    for values in RtdeOutputs(link, patience, _REQUIRED, _OPTIONAL, _FREQUENCY_HZ).states(lambda: patience):
        yield _sample(link.where, values)


class RtdeOutputs:
    """A subscription to outputs of the controller.

    Attributes
    ----------
    names : tuple of str
        The outputs that it sends: all ``required`` ones and the available ``optional`` ones.
    """

    def __init__(
        self,
        link: Connection,
        patience: Patience,
        required: tuple[str, ...],
        optional: tuple[str, ...],
        frequency_hz: float,
    ) -> None:
        """Subscribe and start the stream. Raises ``LinkLost`` if a ``required`` output is missing."""
        refusal = link.refusal(patience)
        if refusal:
            raise LinkLost(f"{link.where}: no RTDE connection ({refusal})")
        self._packets = packets = _Packets(link, patience)
        if packets.ask(_VERSION, struct.pack(">H", 2)) != b"\x01":
            raise LinkLost(f"{link.where}: the controller does not speak RTDE protocol 2")
        names: tuple[str, ...] = required + optional
        types = _setup_outputs(packets, names, frequency_hz)
        if "NOT_FOUND" in types:
            names = tuple(name for name, kind in zip(names, types, strict=True) if kind != "NOT_FOUND")
            types = _setup_outputs(packets, names, frequency_hz)
        missing = [name for name in required if name not in names]
        unknown = [kind for kind in types if kind not in FORMATS]
        if missing or unknown:
            raise LinkLost(f"{link.where}: the controller's RTDE does not provide {', '.join(missing or unknown)}")
        if packets.ask(_START, b"") != b"\x01":
            raise LinkLost(f"{link.where}: the controller did not start to send its state")
        self.names = names
        self._formats = [struct.Struct(f">{FORMATS[kind]}") for kind in types]

    def states(self, patience: Callable[[], Patience]) -> Iterator[dict[str, tuple[float, ...]]]:
        """Yield states as they arrive, as output -> its values; ``patience`` returns the time limit of each wait."""
        expected = 1 + sum(part.size for part in self._formats)
        while True:
            payload = self._packets.next_payload(_DATA, patience())
            if len(payload) != expected:
                raise LinkLost(f"{self._packets.where}: a state of {len(payload)} bytes came, expected {expected}")
            values, at = {}, 1
            for name, part in zip(self.names, self._formats, strict=True):
                values[name] = part.unpack_from(payload, at)
                at += part.size
            yield values


def _setup_outputs(packets: _Packets, names: Sequence[str], frequency_hz: float) -> list[str]:
    """Request outputs and return their types, in order."""
    answer = packets.ask(_OUTPUTS, struct.pack(">d", frequency_hz) + ",".join(names).encode("ascii"))
    types = answer[1:].decode("ascii", errors="replace").strip(",").split(",")
    if len(types) != len(names):
        raise LinkLost(f"{packets.where}: {len(types)} types came for {len(names)} RTDE outputs")
    return types


def _sample(where: str, values: Mapping[str, tuple[float, ...]]) -> UrSample:
    numbers = [number for value in values.values() for number in value]
    if not all(map(math.isfinite, numbers)):
        raise LinkLost(f"{where}: the controller's state holds a value that is not a finite number")
    fraction, payload = values.get("target_speed_fraction"), values.get("payload")
    return UrSample(
        time_s=values["timestamp"][0],
        q=values["actual_q"],
        qd=values["actual_qd"],
        robot_mode=mode_name(RobotMode, values["robot_mode"][0]),
        safety_mode=mode_name(SafetyMode, values["safety_mode"][0]),
        program=mode_name(ProgramState, values["runtime_state"][0]),
        speed_fraction=None if fraction is None else fraction[0],
        payload_kg=None if payload is None else payload[0],
        payload_center_m=values.get("payload_cog"),
        joints_c=values.get("joint_temperatures"),
    )


def mode_name(modes: type[IntEnum], code: float) -> str:
    """Return the controller's name of a mode, or ``UNKNOWN_`` and its number."""
    return next((mode.name for mode in modes if mode == code), f"UNKNOWN_{int(code)}")


class _Packets:
    """RTDE packets on a connection, with one limit for all waits together."""

    def __init__(self, link: Connection, patience: Patience) -> None:
        self.where = link.where
        self._link, self._patience = link, patience
        self._received = bytearray()

    def ask(self, kind: int, payload: bytes) -> bytes:
        self.send(kind, payload, self._patience)
        return self.next_payload(kind, self._patience)

    def send(self, kind: int, payload: bytes, patience: Patience | None = None) -> None:
        """Send one packet. Without ``patience`` it never waits and may run beside a reading thread."""
        packet = _HEADER.pack(_HEADER.size + len(payload), kind) + payload
        try:
            if patience is None:
                self._link.send_at_once(packet)
            else:
                self._link.send(packet, patience)
        except OSError as error:
            raise LinkLost(f"{self.where}: the RTDE link broke ({error})") from error

    def next_payload(self, wanted: int, patience: Patience) -> bytes:
        """Return the payload of the next packet of type ``wanted``; skip others."""
        for _ in range(_MAX_PACKETS):
            while True:
                if len(self._received) >= _HEADER.size:
                    size, kind = _HEADER.unpack_from(self._received)
                    if size < _HEADER.size:
                        raise LinkLost(f"{self.where}: the peer is not an RTDE server")
                    if len(self._received) >= size:
                        break
                self._receive(patience)
            payload = bytes(self._received[_HEADER.size : size])
            del self._received[:size]
            if kind == wanted:
                return payload
        raise LinkLost(f"{self.where}: the peer is not an RTDE server")

    def _receive(self, patience: Patience) -> None:
        try:
            more = self._link.receive(patience)
        except OSError as error:
            raise LinkLost(f"{self.where}: the RTDE link broke ({error})") from error
        if more is None:
            raise LinkLost(f"{self.where}: connected, but the RTDE port sent nothing more")
        if not more:
            raise LinkLost(f"{self.where}: the controller closed the RTDE connection")
        self._received += more


# ---------------------------------------------------------------------------------------------------------------------
# What a person must do about the safety modes and robot modes of a UR arm. Loads no numpy: the worker uses it, too.


_SAFETY_REMEDY = {
    "REDUCED": "speeds and forces are limited: leave the area or clear the input that triggers it",
    "PROTECTIVE_STOP": "go to the arm, see what stopped it, clear the cause, then enable the robot on the pendant",
    "RECOVERY": "a limit is exceeded: jog the arm back inside on the pendant",
    "SAFEGUARD_STOP": "close the guard or clear the light curtain, then reset the safeguard",
    "SYSTEM_EMERGENCY_STOP": "an emergency stop of the cell is pressed: find out why, release it, power the arm on",
    "ROBOT_EMERGENCY_STOP": "the pendant's emergency stop is pressed: find out why, release it, power the arm on",
    "VIOLATION": "a safety limit was violated: read the pendant's log, then restart the safety system there",
    "FAULT": "the safety system is at fault: read the pendant's log, then restart it there",
}
_NAMES = {ProtectiveStop: "protective stop", EmergencyStop: "emergency stop"}


def safety_error(mode: str) -> type[ArmError]:
    """Return the exception for a safety mode other than normal."""
    if mode.endswith("EMERGENCY_STOP"):
        return EmergencyStop
    return ProtectiveStop if mode == "PROTECTIVE_STOP" else ArmError


def safety_remedy(mode: str) -> str:
    """Return what a person must do about a safety mode other than normal."""
    return _SAFETY_REMEDY.get(mode, "look at the pendant")


def not_ready(robot_mode: str, safety_mode: str) -> tuple[str, str] | None:
    """Return why an arm in these modes accepts no motion, and the remedy; None if it accepts motions."""
    if safety_mode != "NORMAL":
        return _NAMES.get(safety_error(safety_mode), f"safety mode {safety_mode}"), safety_remedy(safety_mode)
    if robot_mode != "RUNNING":
        return f"robot mode {robot_mode}, needed is RUNNING", mode_remedy(robot_mode)
    return None


_MODE_REMEDY = {
    "CONFIRM_SAFETY": "look at the pendant and confirm its safety configuration",
    "BOOTING": "wait until it has booted",
    "POWER_OFF": "power the arm on and release its brakes on the pendant",
    "POWER_ON": "release its brakes on the pendant, wait until it is ready",
    "IDLE": "release its brakes on the pendant, wait until it is ready",
    "BACKDRIVE": "it is guided by hand: leave the arm alone, and end that mode on the pendant",
    "UPDATING_FIRMWARE": "wait until its firmware is updated",
}


def mode_remedy(mode: str) -> str:
    """Return what a person must do about a robot mode other than RUNNING."""
    return _MODE_REMEDY.get(mode, "look at the pendant")
