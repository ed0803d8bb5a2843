"""Encoding of the tracker bridge protocol, version 1, for both ends. BRIDGE.md describes it.

A line is ``NUMBER WORD key=value ...*CRC`` and a line feed: printable ASCII, at most ``LONGEST_LINE`` bytes. CRC is the
CRC-32 of all bytes before the star as eight hexadecimal digits.
"""

from __future__ import annotations

import hashlib
import hmac
import math
import re
import secrets
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.trackers.protocol import (
    ACCURACIES,
    Halted,
    NotReady,
    Point,
    Preparation,
    StreamLimits,
    TargetLost,
    Track,
    TrackerError,
    TrackerIdentity,
    TrackerLinkLost,
    TrackerRefused,
    TrackerTimeout,
    Unstable,
    WrongTarget,
)

VERSION = 1
LONGEST_LINE = 2048
LONGEST_TEXT = 300
LAST_SEQUENCE = 999_999
DEFAULT_PORT = 50960
"""Default TCP port of the bridge."""

Fields = Mapping[str, str]

_LINE = re.compile(rb"(0|[1-9][0-9]{0,5}) ([a-z][a-z-]{0,19})((?: [a-z][a-z0-9._]{0,19}=[!-)+-~]*)*)")
_CRC = re.compile(rb"[0-9A-Fa-f]{8}")
_ESCAPE = re.compile(r"%([0-9A-F]{2})")
_TO_ESCAPE = re.compile(r"[^!-$&-)+-~]")  # not printable ASCII, a percent sign or a star
_NUMBER = re.compile(r"[-+]?(?:[0-9]{1,20}\.?[0-9]{0,30}|\.[0-9]{1,30})(?:[eE][-+]?[0-9]{1,3})?")
_IDENTIFIER = re.compile(r"[0-9A-Za-z_-]{8,64}")
_AXES = ("x", "y", "z")
_QUATERNION = ("quat_w", "quat_x", "quat_y", "quat_z")
_UNIT_LENGTH, _ROUNDED = 1e-3, 1e-12
"""Tolerances of a quaternion's length: beyond the first it is invalid; beyond the second it is normalised."""
_AIR = {"temperature": "temperature_c", "pressure": "pressure_hpa", "humidity": "humidity_percent"}
"""Fields of the air, and their names in ``Preparation`` and ``Point``."""
_UPPER_TRIANGLE = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))

ERRORS: Mapping[str, type[TrackerError]] = {
    "not-ready": NotReady,
    "target-lost": TargetLost,
    "wrong-target": WrongTarget,
    "unstable": Unstable,
    "halted": Halted,
    "timeout": TrackerTimeout,
    "link-lost": TrackerLinkLost,
    "failed": TrackerError,
    "refused": TrackerRefused,
    "held": TrackerRefused,
    "version": TrackerRefused,
}
"""Exception for each ``kind`` of an ``error`` line; ``failed`` covers every class without its own kind."""


class Garbled(ValueError):
    """Input that is not a line of the protocol: damaged, too long, or of another protocol."""


class BadField(ValueError):
    """An undamaged line with a missing or invalid field."""


@dataclass(frozen=True)
class WireLine:
    """One line: its number, its word (a command, ``ok``, ``wait`` or ``error``) and its fields."""

    sequence: int
    word: str
    fields: Fields


def encode(sequence: int, word: str, fields: Fields | None = None) -> bytes:
    """Return a line with its line feed. Raises ``ValueError`` if it would be too long or malformed."""
    parts = [str(sequence), word, *(f"{key}={_escaped(value)}" for key, value in (fields or {}).items())]
    body = " ".join(parts).encode("ascii")
    line = b"%s*%08X\n" % (body, zlib.crc32(body))
    if len(line) > LONGEST_LINE or not _LINE.fullmatch(body):
        raise ValueError(f"not a line of the bridge protocol: {len(line)} bytes, '{word}'")
    return line


def decode(raw: bytes) -> WireLine:
    """Decode a line, with or without its line end. Raises ``Garbled``."""
    raw = raw.rstrip(b"\r\n")
    if len(raw) + 1 > LONGEST_LINE:
        raise Garbled(f"the line is longer than {LONGEST_LINE} bytes")
    body, star, check = raw.rpartition(b"*")
    if not star or not _CRC.fullmatch(check):
        raise Garbled("the line does not end in its checksum")
    if int(check, 16) != zlib.crc32(body):
        raise Garbled("the checksum is wrong")
    match = _LINE.fullmatch(body)
    if match is None:
        raise Garbled("the line is not of the form 'NUMBER WORD key=value ...'")
    fields: dict[str, str] = {}
    for part in match.group(3).decode("ascii").split(" ")[1:]:
        key, _, value = part.partition("=")
        if key in fields:
            raise Garbled(f"the key '{key}' occurs twice")
        fields[key] = _unescaped(value)
    return WireLine(int(match.group(1)), match.group(2).decode("ascii"), fields)


def _escaped(value: str) -> str:
    return _TO_ESCAPE.sub(
        lambda found: "".join(f"%{byte:02X}" for byte in found.group().encode("utf-8", "replace")), value
    )


def _unescaped(value: str) -> str:
    raw = _ESCAPE.sub(lambda found: chr(int(found.group(1), 16)), value)
    return raw.encode("latin-1").decode("utf-8", "replace")


def text(message: str, max_bytes: int = LONGEST_TEXT) -> str:
    """Return a message for a person, shortened to at most ``max_bytes`` of a line."""
    if len(_escaped(message)) <= max_bytes:
        return message
    cut = message[:max_bytes]
    while len(_escaped(cut)) > max_bytes - 3:
        cut = cut[: len(cut) * (max_bytes - 3) // len(_escaped(cut))]
    return cut + "..."


def number(value: float) -> str:
    """Format a finite number so that reading returns the identical value. Raises ``BadField`` if it is not finite."""
    value = float(value)
    if not math.isfinite(value):
        raise BadField(f"{value!r} is not a finite number")
    return repr(value)


def read_number(fields: Fields, key: str, low: float = -1e12, high: float = 1e12) -> float:
    """Read a number between ``low`` and ``high``. Raises ``BadField``."""
    if key not in fields:
        raise BadField(f"the field '{key}' is missing")
    found = fields[key]
    value = float(found) if _NUMBER.fullmatch(found) else math.nan
    if not low <= value <= high:
        raise BadField(f"{key} is '{text(found)}'; expected a number between {low:g} and {high:g}")
    return value


def read_optional(fields: Fields, key: str, low: float = -1e12, high: float = 1e12) -> float | None:
    """Read a number, or None if the field is missing or empty. Raises ``BadField``."""
    return read_number(fields, key, low, high) if fields.get(key) else None


def read_id(fields: Fields, key: str = "id") -> str:
    """Read an identifier of 8 to 64 letters, digits, ``-`` or ``_``. Raises ``BadField``."""
    value = fields.get(key, "")
    if not _IDENTIFIER.fullmatch(value):
        raise BadField(f"{key} is '{text(value)}'; expected 8 to 64 letters and digits that were never used before")
    return value


def new_id() -> str:
    """Return a new random identifier."""
    return secrets.token_hex(8)


def proof(token: str, side: str, client: str, server_nonce: str, client_nonce: str) -> str:
    """Return the HMAC-SHA256, in hexadecimal digits, that proves that ``side`` (client or server) knows the token."""
    message = "|".join((f"tracker-bridge-{VERSION}", side, client, server_nonce, client_nonce))
    return hmac.new(token.encode("utf-8"), message.encode("ascii"), hashlib.sha256).hexdigest()


def proofs_equal(one: str, other: str) -> bool:
    """Compare two proofs in constant time."""
    return hmac.compare_digest(one.lower().encode("utf-8"), other.lower().encode("utf-8"))


def error_fields(error: BaseException) -> dict[str, str]:
    """Return the fields of an ``error`` line for an exception; its kind is that of the nearest known base class."""
    if isinstance(error, ValueError):
        return {"kind": "bad-field", "text": text(str(error))}
    kinds = {known: kind for kind, known in reversed(list(ERRORS.items()))}  # if a class has several kinds, the first
    kind = next((kinds[known] for known in type(error).__mro__ if known in kinds), "failed")
    return {"kind": kind, "text": text(str(error))}


# -- fields of each command and its answer ----------------------------------------------------------------------------


def identity_fields(identity: TrackerIdentity) -> dict[str, str]:
    """Return the answer to ``identify``."""
    return {key: text(getattr(identity, key)) for key in ("model", "serial", "software")}


def read_identity(fields: Fields) -> TrackerIdentity:
    """Read the answer to ``identify``. Raises ``BadField``."""
    missing = [key for key in ("model", "serial", "software") if key not in fields]
    if missing:
        raise BadField(f"the field '{missing[0]}' is missing")
    return TrackerIdentity(fields["model"], fields["serial"], fields["software"])


def preparation_fields(settings: Preparation) -> dict[str, str]:
    """Return the fields of ``prepare``."""
    air = {key: getattr(settings, name) for key, name in _AIR.items()}
    given = {key: number(value) for key, value in air.items() if value is not None}
    return {"reflector": settings.reflector, "accuracy": settings.accuracy, **given}


def read_preparation(fields: Fields) -> Preparation:
    """Read the fields of ``prepare``. Raises ``ValueError``."""
    name = fields.get("accuracy", "standard")
    accuracy = next((known for known in ACCURACIES if known == name), None)
    if accuracy is None:
        raise BadField(f"accuracy is '{text(name)}'; expected one of {', '.join(ACCURACIES)}")
    return Preparation(
        reflector=fields.get("reflector", ""),
        accuracy=accuracy,
        **{name: read_optional(fields, key) for key, name in _AIR.items()},
    )


def point_fields(point: Point) -> dict[str, str]:
    """Return the fields of a measured point. Raises ``BadField`` if it holds a value that is not finite."""
    values: dict[str, float | None] = {
        **dict(zip(_AXES, point.p_M, strict=True)),
        **{f"c{_AXES[i]}{_AXES[j]}": point.covariance_M[i, j] for i, j in _UPPER_TRIANGLE},
        "time": point.time_s,
        "averaging": point.averaging_s,
        **{key: getattr(point, name) for key, name in _AIR.items()},
    }
    if point.quaternion_M is not None:
        values |= dict(zip(_QUATERNION, point.quaternion_M, strict=True)) | {"sigma_rad": point.sigma_rad}
    fields = {key: number(value) for key, value in values.items() if value is not None}
    if point.reflector:
        fields["reflector"] = text(point.reflector, 60)
    if point.quality:
        fields["quality"] = text("; ".join(point.quality), 120)
    return fields


def read_point(own: Fields) -> Point:
    """Read a measured point. Raises ``BadField``."""
    covariance = np.zeros((3, 3))
    for i, j in _UPPER_TRIANGLE:
        low = 0.0 if i == j else -1.0
        covariance[i, j] = covariance[j, i] = read_number(own, f"c{_AXES[i]}{_AXES[j]}", low, 1.0)
    has_rotation = _QUATERNION[0] in own
    return Point(
        p_M=np.array([read_number(own, axis, -1e3, 1e3) for axis in _AXES]),
        covariance_M=covariance,
        time_s=read_number(own, "time"),
        averaging_s=read_number(own, "averaging", 0.0, 3600.0),
        temperature_c=read_optional(own, "temperature", -100.0, 200.0),
        pressure_hpa=read_optional(own, "pressure", 0.0, 2000.0),
        humidity_percent=read_optional(own, "humidity", 0.0, 100.0),
        reflector=own.get("reflector", ""),
        quality=tuple(own["quality"].split("; ")) if own.get("quality") else (),
        quaternion_M=_read_quaternion(own) if has_rotation else None,
        sigma_rad=read_optional(own, "sigma_rad", 0.0, 0.1) if has_rotation else None,
    )


def _read_quaternion(fields: Fields) -> NDArray[np.float64]:
    """Read a unit quaternion (4,), scalar first. Raises ``BadField``."""
    values = np.array([read_number(fields, name, -1.001, 1.001) for name in _QUATERNION])
    length = float(np.linalg.norm(values))
    if abs(length - 1.0) > _UNIT_LENGTH:
        raise BadField(f"{', '.join(_QUATERNION)} has the length {length:.4g}; expected a unit quaternion")
    return values / length if abs(length - 1.0) > _ROUNDED else values


def unmet_fields(unmet: list[str]) -> dict[str, str]:
    """Return the answer to ``unmet``: the number of preconditions and the texts of the first five."""
    return {"count": str(len(unmet))} | {f"u{k}": text(item) for k, item in enumerate(unmet[:5], start=1)}


def read_unmet(fields: Fields) -> list[str]:
    """Read the answer to ``unmet``. Raises ``BadField``."""
    count = int(read_number(fields, "count", 0, 10_000))
    unmet = [fields[f"u{k}"] for k in range(1, count + 1) if f"u{k}" in fields]
    if len(unmet) < count:
        unmet.append(f"and {count - len(unmet)} more")
    return unmet


# -- Points of a moving SMR ------------------------------------------------------------------------------------------
#
# A packet is a list of points, ``stamp,x,y,z,sigma;...``: the tracker's own timestamp [s], coordinates and their
# standard uncertainty [m] (empty if not known).


MOST_WAITING = 200_000
"""Largest number of points buffered for a client; a slower client loses points."""
_LONGEST_POINTS = 1500
"""Longest text of the points in one line, whose length is limited [characters]."""
_POINT = re.compile(r"(-?[0-9.]+),(-?[0-9.]+),(-?[0-9.]+),(-?[0-9.]+),([0-9.e-]*)")


def limits_fields(limits: StreamLimits | None) -> dict[str, str]:
    """Return the answer to ``stream-limits``."""
    shortest, longest = (0.0, 0.0) if limits is None else (limits.shortest_s, limits.longest_s)
    return {"shortest": number(shortest), "longest": number(longest)}


def read_limits(fields: Fields) -> StreamLimits | None:
    """Read the answer to ``stream-limits``. Raises ``BadField``."""
    longest_s = read_number(fields, "longest", 0.0, 3600.0)
    shortest_s = read_number(fields, "shortest", 0.0, 3600.0)
    return None if longest_s == 0.0 else StreamLimits(shortest_s, longest_s)


def packet_lines(packet: Track) -> list[tuple[str, ...]]:
    """Return the points of a packet as texts, in groups that fit into one line each."""
    lines: list[tuple[str, ...]] = []
    some: list[str] = []
    length = 0
    for stamp_s, (x, y, z), sigma_m in zip(packet.device_time_s, packet.p_M, packet.sigma_m, strict=True):
        sigma = f"{sigma_m:.2e}" if math.isfinite(sigma_m) else ""
        point = f"{stamp_s:.7f},{x:.8f},{y:.8f},{z:.8f},{sigma}"
        if some and length + len(point) > _LONGEST_POINTS:
            lines.append(tuple(some))
            some, length = [], 0
        some.append(point)
        length += len(point) + 1
    return [*lines, tuple(some)] if some else lines


def read_packet(fields: Fields, now_s: float) -> tuple[Track, int]:
    """Read an answer to ``points`` that came at ``now_s``: a packet, and how many points wait. Raises ``BadField``."""
    listed = fields.get("points", "")
    found = [_POINT.fullmatch(part) for part in listed.split(";")] if listed else []
    if any(match is None for match in found):
        raise BadField(f"points: '{text(listed, 40)}' is not a list of 'stamp,x,y,z,sigma'")
    try:
        rows = np.array([[float(value or "nan") for value in match.groups()] for match in found if match is not None])
    except ValueError as error:
        raise BadField(f"points: {error}") from error
    rows = rows.reshape(-1, 5)
    age_s = read_number(fields, "age", 0.0, 1e6) if len(rows) else 0.0
    waiting = int(read_number(fields, "waiting", 0, 10 * MOST_WAITING))
    return Track(rows[:, 0], rows[:, 1:4], rows[:, 4], np.full(len(rows), now_s - age_s)), waiting
