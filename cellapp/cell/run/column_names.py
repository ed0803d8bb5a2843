"""Meaning of columns in readings and recordings of other programs: their names, and units that stand in them.

Examples: ``actual_q_0`` beside ``target_q_0`` is q1, as is ``ROBOT_ACTUAL_JOINT_POSITIONS (J1)``; ``Joint 1 [deg]`` is
q1 in degrees, ``timestamp_ns`` a timestamp in nanoseconds, ``X [mm]`` x_m. Cellapp's own names keep their meaning.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

Kind = Literal["joints", "points"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""Streams of a recording of motion."""
EXAMPLES: Mapping[Kind | Literal["readings"], str] = {
    "joints": "time_s,q1,q2,q3",
    "points": "time_s,x_m,y_m,z_m",
    "readings": "q1,q2,q3,q4,q5,q6,x,y,z",
}
"""Example header rows for messages."""

_UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {
        **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
        **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), 1e-3),
        **dict.fromkeys(("us", "µs", "μs", "usec", "micros", "microseconds"), 1e-6),
        **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), 1e-9),
    },
    "angle": {**dict.fromkeys(("deg", "degree", "degrees", "°", "grad"), math.pi / 180.0), "rad": 1.0, "radians": 1.0},
    "length": {"m": 1.0, "metre": 1.0, "meter": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6},
}
_SPEED_UNIT = re.compile(r"(deg|°|rad)\s*(?:/\s*s|s-1|s\^-1|_?per_?s|_s)")
_OF_UNIT = re.compile(r"\s*(?:\[\s*([^\]]+?)\s*\]|\(\s*([^)]+?)\s*\)|[ _.]([a-zA-Zµμ°]+(?:/s|_per_s)?))\s*$")
_DATE = {"datetime", "date", "datum"}
_TIME = _DATE | {"time", "timestamp", "timestamps", "stamp", "stamps", "t", "zeit", "clock", "epoch"}
_OF_JOINTS: Mapping[str, frozenset[str]] = {
    "qd": frozenset({"qd", "dq", "qdot", "vel", "velocity", "velocities", "speed", "speeds", "omega"}),
    "joint_temperature": frozenset({"temperature", "temperatures", "temp", "temps"}),
}
_TORQUES = {"tau", "torque", "torques", "effort", "efforts", "moment", "moments", "current", "currents"}
"""Columns of joints that are kept and not read."""
_POSITION = {"q", "joint", "joints", "axis", "axes", "theta", "rax", "ax", "j", "a", "position", "positions", "pos"}
_POSITION |= {"angle", "angles", "achse", "gelenk"}
_MEASURED = {"actual", "act", "measured", "meas", "feedback", "fb", "ist", "current"}
_COMMANDED = {"target", "desired", "commanded", "command", "cmd", "ref", "reference", "setpoint", "soll", "planned"}
_COMMAND = 2
"""Rank of commanded values."""
_BESIDE = {"robot", "arm", "state", "states", "msg", "field", "data", "value", "encoder", "motor", "controller"}
_OF_READINGS = {"robot": "arm", "temperature": "temperature_c", "temp": "temperature_c", "payload": "payload_kg"}
"""Columns of readings at rest besides joint positions and points."""
_POINT = re.compile(r"(?:.*[^a-z])?(?:p|pos|position|point|smr|t)?([xyz])")
_NO_POINT = re.compile(r"(?:^|[^a-z])(?:v|vel|velocity|r|rot|rotation|q|quat|quaternion|n|w|acc|normal|o)[ _.]?[xyz]$")
_UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
_LEAST_FAMILY = 4
"""Least number of columns that differ only in their last number to be taken as joint positions, if no others can be."""
_LAST_NUMBER = re.compile(r"(.*?)(\d+)([^\d]*)")
_PENDANT = ("base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Joints of a UR arm in its controller's order, as on the pendant; messages of ROS name them in another order."""
_OF_ROBOT = {"tcp", "robot", "flange", "tool"}
"""Points of these belong to the controller, not to the tracker."""


@dataclass(frozen=True)
class Understood:
    """The columns of a file.

    Attributes
    ----------
    names : tuple of str
        Cellapp's names, each once; unknown columns keep their name in the file.
    factors : mapping
        Factor to SI of each column whose name states a unit.
    others : mapping
        Cellapp's name -> name in the file, where they differ.
    doubled : mapping
        Quantity that is left out -> the columns in the file that may be it.
    commanded : bool
        Whether positions are the commanded ones, as there are no measured ones.
    """

    names: tuple[str, ...]
    factors: Mapping[str, float]
    others: Mapping[str, str]
    doubled: Mapping[str, tuple[str, ...]]
    commanded: bool = False

    @property
    def said(self) -> tuple[str, ...]:
        """Description of each column under another name, as "q1 = actual_q_0"."""
        lag = ("positions that were commanded, as there are no measured ones: their lag is part of the delay",)
        return (*(f"{name} = {other}" for name, other in self.others.items()), *(lag if self.commanded else ()))

    def unsaid(self, name: str) -> bool:
        """Return whether the file has this column under another name that states no unit."""
        return name in self.others and name not in self.factors


@dataclass(frozen=True)
class _Read:
    name: str
    factor: float | None = None
    rank: int = 0
    """Smaller ranks are preferred: measured to commanded."""


def understood(
    names: Sequence[str], kind: Kind | Literal["readings"], own: Collection[str], orientation: Collection[str] = ()
) -> Understood:
    """Interpret the names of a file of this ``kind``; ``own`` are cellapp's, ``orientation`` are read elsewhere.

    A quantity with two candidate columns is left out, unless one of them is the measured one.
    """
    nothing = _Read("")
    if kind == "joints" and any(re.fullmatch(r"(?:q|qd)0", name.lower()) for name in names):
        own = [name for name in own if name.rstrip("0123456789") == name]  # names of joints from 0 are not cellapp's
    read = [
        _Read(name, None, -1) if name in own else nothing if name in orientation else _read(name, kind) or nothing
        for name in names
    ]
    if kind == "joints" and not any(re.fullmatch(r"q\d+", one.name) for one in read):
        numbered = _family(names)
        read = [_read(numbered[name], kind) or nothing if name in numbered else one for name, one in zip(names, read)]
    places: dict[str, list[int]] = {}
    for place, one in enumerate(read):
        if one is not nothing:
            places.setdefault(one.name, []).append(place)
    chosen, doubled = {}, {}
    for name, its in places.items():
        ranks = [read[place].rank for place in its]
        if ranks.count(min(ranks)) == 1:
            chosen[its[ranks.index(min(ranks))]] = name
        else:
            doubled[name] = tuple(names[place] for place in its)
    shift = 0 if kind == "points" or "q0" not in chosen.values() else 1
    owned = {name for place, name in chosen.items() if read[place].rank < 0}
    called, factors = dict[int, str](), {}
    for place, name in chosen.items():
        one = read[place]
        stem = name.rstrip("0123456789")
        new = f"{stem}{int(name[len(stem) :]) + shift}" if stem != name else name
        if one.rank < 0 or new in owned:
            continue
        called[place] = new
        if one.factor is not None:
            factors[new] = one.factor
    commanded = any(read[place].rank == _COMMAND and name.startswith("q") for place, name in chosen.items())
    others = {new: names[place] for place, new in called.items()}
    free = (f"{name} (not used)" if name in others else name for name in names)  # q1 beside actual_q_0
    all_names = tuple(called.get(place, name) for place, name in enumerate(free))
    return Understood(all_names, factors, others, doubled, commanded)


def _read(name: str, kind: str) -> _Read | None:
    """Interpret one name; joint indices are left as they stand in it."""
    for quantity in ("time", "angle", "length", None):
        stem, factor = _without_unit(name, quantity)
        if quantity is not None and factor is None:
            continue
        if kind != "readings" and quantity in ("time", None) and _words(stem)[-1:] and _words(stem)[-1] in _TIME:
            words = set(_words(stem))
            return _Read("time_s", factor, 0 if "header" in words else 2 if words & _DATE else 1)
        if kind != "joints" and quantity in ("length", None) and (point := _point(stem, factor)):
            return point
        if kind != "points" and quantity in ("angle", None) and (joint := _joint(stem, factor)):
            return joint
    other = _OF_READINGS.get(name.strip().lower()) if kind == "readings" else None
    return None if other is None else _Read(other)


def _family(names: Sequence[str]) -> Mapping[str, str]:
    """Map columns that differ only in their last number to joints, if only one family of them can be positions."""
    families: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        if match := _LAST_NUMBER.fullmatch(name.strip().lower()):
            families.setdefault((match[1], match[3]), {})[int(match[2])] = name
    no_positions = _COMMANDED.union(_TORQUES, *_OF_JOINTS.values())
    found = [
        {name: f"joint_{number}{suffix.lstrip('])} _')}" for number, name in its.items()}
        for (prefix, suffix), its in families.items()
        if len(its) >= _LEAST_FAMILY
        and sorted(its) in (list(range(len(its))), list(range(1, len(its) + 1)))
        and not no_positions & set(_words(prefix + suffix))
    ]
    return found[0] if len(found) == 1 else {}


def _without_unit(name: str, quantity: str | None) -> tuple[str, float | None]:
    """Remove the unit of this quantity from the end of a name, in lower case; return also its factor or None."""
    low = name.strip().lower()
    if quantity is None or (match := _OF_UNIT.search(low)) is None:
        return low, None
    unit = next(one for one in match.groups() if one)
    if quantity == "angle" and (speed := _SPEED_UNIT.fullmatch(unit)):
        unit = speed.group(1)
    factor = _UNITS[quantity].get(unit)
    return (low, None) if factor is None else (low[: match.start()], factor)


def _words(stem: str) -> list[str]:
    return re.findall(r"[a-zµ]+", stem)


def _point(stem: str, factor: float | None) -> _Read | None:
    rank = 1 if set(_words(stem)) & (_COMMANDED | _OF_ROBOT) else 0
    if _NO_POINT.search(stem) is None and (match := _POINT.fullmatch(stem)) is not None:
        return _Read(f"{match.group(1)}_m", factor, rank)
    if {"sigma", "uncertainty", "std"} & set(_words(stem)) and len(_words(stem)) == 1:
        return _Read("sigma_m", factor, rank)
    return None


def _joint(stem: str, factor: float | None) -> _Read | None:
    joined = stem.replace(" ", "_")
    named = next((k for k, joint in enumerate(_UR_JOINTS, 1) if joint in joined), None)
    if named is not None:
        stem = joined.replace(_UR_JOINTS[named - 1], "joint")
    elif joined in _PENDANT:
        named, stem = _PENDANT.index(joined) + 1, "joint"
    numbers, words = re.findall(r"\d+", stem), _words(stem)
    if len(numbers) != (named is None):
        return None
    kinds = [quantity for quantity, its in _OF_JOINTS.items() if its & set(words)]
    if "current" in words and not kinds and not set(words) & (_POSITION - {"joint", "joints", "j", "axis", "a"}):
        return None  # a motor's; the current position is a position
    known = _POSITION | _MEASURED | _COMMANDED | _BESIDE | {word for its in _OF_JOINTS.values() for word in its}
    if len(kinds) > 1 or not set(words) <= known or not (kinds or set(words) & _POSITION):
        return None
    rank = _COMMAND if set(words) & _COMMANDED else 0 if set(words) & _MEASURED else 1
    if rank == _COMMAND and kinds:
        return None  # speeds are only useful as measured
    return _Read(f"{kinds[0] if kinds else 'q'}{numbers[0] if named is None else named}", factor, rank)
