"""Meaning of columns in readings and recordings of other programs: their names, and units that stand in them.

Examples: ``actual_q_0`` beside ``target_q_0`` is q1, as is ``ROBOT_ACTUAL_JOINT_POSITIONS (J1)``; ``Joint 1 [deg]`` is
q1 in degrees, ``timestamp_ns`` a timestamp in nanoseconds, ``X [mm]`` x_m. Cellapp's own names keep their meaning.

Units of columns in files of other programs: from their names, else from values where only one is possible.

Columns of recordings: their names, checks of plausibility, and their conversion to objects for estimation.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.csv_text import is_number
from cellapp.cell.run.orientation_columns import QUATERNION, Written
from cellapp.cell.run.records import StreamState
from cellapp.cell.run.stream_csv import StreamTable
from cellapp.cell.run.table_spec import TableSpec
from cellapp.estimation.motion.streams import JointStream, PointStream
from cellapp.estimation.readings.columns import COLUMNS, Column, beyond_limits
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped

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
        **dict.fromkeys(("ms", "msec", "msecs", "millis", "milliseconds"), 1e-3),
        **dict.fromkeys(("us", "µs", "μs", "usec", "usecs", "micros", "microseconds"), 1e-6),
        **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanos", "nanoseconds"), 1e-9),
    },
    "angle": {
        **dict.fromkeys(("deg", "degree", "degrees", "°", "grad"), math.pi / 180.0),
        "rad": 1.0,
        "radians": 1.0,
        "mrad": 1e-3,
        "gon": math.pi / 200.0,
    },
    "length": {
        **dict.fromkeys(("m", "metre", "meter", "metres", "meters"), 1.0),
        **dict.fromkeys(("mm", "millimetre", "millimeter", "millimetres", "millimeters"), 1e-3),
        **dict.fromkeys(("um", "µm", "μm"), 1e-6),
        **dict.fromkeys(("in", "inch", "inches"), 0.0254),
        "cm": 1e-2,
    },
}
_SPEED_UNIT = re.compile(r"(deg|°|rad)\s*(?:/\s*s|s-1|s\^-1|_?per_?s|_s)")
_OF_UNIT = re.compile(r"\s*(?:\[\s*([^\]]+?)\s*\]|\(\s*([^)]+?)\s*\)|(?:^|[ _.])([a-zA-Zµμ°]+(?:/s|_per_s)?))\s*$")
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
_MEASURED = {"actual", "act", "measured", "meas", "feedback", "fb", "ist", "current", "msr"}
_TRACKER = {"tracker", "lasertracker", "laser", "leica", "lt"}
"""Points of these are measured, as the first ones are."""
_COMMANDED = {"target", "desired", "commanded", "command", "cmd", "ref", "reference", "setpoint", "soll", "planned"}
_COMPUTED = _COMMANDED | {"nominal", "nom", "theoretical", "theo", "design", "model", "cad", "calculated", "calc"}
_COMPUTED |= {"computed", "predicted", "ideal", "fit", "fitted", "sim", "simulated"}
_COMMAND = 2
"""Rank of commanded values, and of points that nothing measured."""
_BESIDE = {"robot", "arm", "state", "states", "msg", "field", "data", "value", "encoder", "motor", "controller"}
_NO_CLOCK = {"dwell", "integration", "duration", "settle", "settling", "wait", "exposure", "cycle", "measurement"}
_OF_READINGS = {"robot": "arm", "temperature": "temperature_c", "temp": "temperature_c", "payload": "payload_kg"}
"""Columns of readings at rest besides joint positions and points."""
_GLUED = re.compile(r"([xyz])(meas|act|ist|nom|soll|ref|cmd|theo|calc)")
_POINT = re.compile(r"((?:.*[^a-z])?(?:p|pos|position|point|smr|t)?)([xyz])([ _.\d]*|[ _]?[abcn])")
_NO_POINT = re.compile(r"(?:^|[^a-z])(?:v|vel|velocity|r|rot|rotation|q|quat|quaternion|n|w|acc|normal|o)[ _.]?[xyz]$")
_NO_COORDINATE = {
    "dev",
    "deviation",
    "err",
    "error",
    "errors",
    "delta",
    "diff",
    "difference",
    "residual",
    "rms",
    "d",
    "offset",
}
_SIGMA = re.compile(r"(u\s*\(?\s*(?:95\s*%?|k\s*=\s*2)\s*\)?)|sigma|uncertainty|std(?:ev)?")
"""Standard uncertainties of points, and expanded ones (the first group: coverage factor k = 2, GUM)."""
FRACTION = "time_s fraction"
"""Second column of a time in two, as seconds and microseconds."""
_UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
_LEAST_FAMILY = 4
"""Least number of columns that differ only in their last number to be taken as joint positions, if no others can be."""
_LAST_NUMBER = re.compile(r"(.*?)(\d+)([^\d]*)")
_NAME_OF_JOINT = re.compile(r"(?:.*[^a-z])?names?\W*(\d+)\W*")
_PENDANT = ("base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Joints of a UR arm in its controller's order, as on the pendant; messages of ROS name them in another order."""
_MOTOMAN = "slurbt"
"""Axes of Yaskawa's six-axis arms, in order: swivel, lower, upper, rotate, bend, twist."""
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
    commanded : tuple of str
        What is commanded or computed ("q", "p"), as there is nothing measured.
    smrs : mapping
        Name of each SMR of a row -> its columns x, y, z in the file, where there are several.
    ordered : mapping
        Column of a joint's name -> that name, in the order of ``q1`` ..., where the file names them.
    """

    names: tuple[str, ...]
    factors: Mapping[str, float]
    others: Mapping[str, str]
    doubled: Mapping[str, tuple[str, ...]]
    commanded: tuple[str, ...] = ()
    smrs: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    ordered: Mapping[str, str] = field(default_factory=dict)

    @property
    def said(self) -> tuple[str, ...]:
        """Description of each column under another name, as "q1 = actual_q_0"."""
        lag = "positions that were commanded, as there are no measured ones: their lag is part of the delay"
        own = "points of the controller or a model, as there are no others: computed, not measured?"
        return (
            *(f"{name} = {other}" for name, other in self.others.items() if name != other),
            *((lag,) if "q" in self.commanded else ()),
            *((own,) if "p" in self.commanded else ()),
            *((f"joints in the order of their names: {', '.join(self.ordered.values())}",) if self.ordered else ()),
        )

    def unsaid(self, name: str) -> bool:
        """Return whether the file has this column under another name that states no unit."""
        return name in self.others and name not in self.factors


@dataclass(frozen=True)
class _Read:
    """A column: its quantity, the number of its joint as it stands there or of its axis, and words of its family."""

    quantity: str
    number: int = 0
    family: str = ""
    factor: float | None = None
    rank: int = 1
    """Smaller ranks are preferred: cellapp's own, measured, unmarked, commanded or computed."""
    column: str = ""


def understood(
    names: Sequence[str],
    kind: Kind | Literal["readings"],
    own: Collection[str],
    written: Written | None = None,
    taken: Collection[str] = (),
    row: Sequence[str] = (),
) -> Understood:
    """Interpret the names of a file of this ``kind``; ``own`` are cellapp's, ``written`` is an orientation.

    The columns of a quantity are taken as a family: measured before commanded ones, all counted from the same number.
    One that counts from 0 is shifted as a whole, whatever stands beside it. A quantity with two candidate families is
    left out, unless a column of one of them is among ``taken``. ``row`` are the cells of the first row: messages of ROS
    name their joints there.
    """
    read, order, called = _interpreted(names, kind, own, written), _named_order(names, row), dict[str, str]()
    doubled, commanded, smrs = dict[str, tuple[str, ...]](), list[str](), dict[str, tuple[str, ...]]()
    for quantity, columns in grouped((one.quantity, one) for one in read).items():
        best = _best(quantity, columns, taken)
        rank, families = min(one.rank for one in best), grouped((one.family, one) for one in best)
        commanded += [quantity] * (rank >= _COMMAND)
        if quantity == "p" and len(families) > 1 and (several := _several_smrs(families)):
            smrs = {
                smr: tuple(next(one.column for one in its if one.number == axis) for axis in range(3))
                for smr, its in several.items()
            }
            best = next(iter(families.values()))
        base = min({one.number for one in best} & {0, 1}, default=1)
        for number, its in sorted(grouped((one.number, one) for one in best).items()):
            name = _called(quantity, number, base, order if rank >= 0 else {})
            units = [one.factor for one in its]
            if quantity == "time_s" and (len(families), len(its), units.count(1.0), units.count(None)) == (1, 2, 1, 0):
                called |= {one.column: "time_s" if one.factor == 1.0 else FRACTION for one in its}
            elif name and len(its) == 1:
                called[its[0].column] = name
            elif name:
                doubled[name] = tuple(one.column for one in its)
    foreign = {one.column: one for one in read if one.column in called and one.rank >= 0}
    others = {called[column]: column for column in foreign}
    free = (f"{name} (not used)" if name in others else name for name in names)  # q1 beside actual_q_0
    return Understood(
        tuple(called.get(name, other) for name, other in zip(names, free, strict=True)),
        {called[column]: one.factor for column, one in foreign.items() if one.factor is not None},
        others,
        doubled,
        tuple(commanded),
        smrs,
        {column: name for _, column, name in sorted(order.values())} if "q1" in others else {},
    )


def _interpreted(
    names: Sequence[str], kind: Kind | Literal["readings"], own: Collection[str], written: Written | None
) -> list[_Read]:
    """Interpret each column by itself; those without a meaning are left out."""
    again = {name: name[-4:] for name in names if re.search(r" \(\d\)$", name) and name[:-4] in names}
    plain = {name: name.removesuffix(again.get(name, "")) for name in names}
    if {*_MOTOMAN} <= {re.split(r"\W", its.lower())[0] for its in plain.values()}:
        plain = {name: re.sub(rf"^[{_MOTOMAN}]\b", _of_motoman, its.lower()) for name, its in plain.items()}
    if any(re.fullmatch(r"(?:q|qd)0", name.lower()) for name in names):
        own = [name for name in own if name.rstrip("0123456789") == name]  # names of joints from 0 are not cellapp's
    elsewhere, last = ((), ()) if written is None else (written.columns, written.position)
    read = {name: _own(its) if its in own else _read(its, kind) for name, its in plain.items()}
    read |= dict.fromkeys(elsewhere) | {name: _Read("p", axis, "matrix") for axis, name in enumerate(last)}
    if kind != "points" and not any(one is not None and one.quantity == "q" for one in read.values()):
        read |= {name: _read(its, kind) for name, its in _family([n for n in names if n not in elsewhere]).items()}
    return [
        replace(one, column=name, family=one.family + again.get(name, ""))
        for name, one in read.items()
        if one is not None
    ]


def _of_motoman(letter: re.Match[str]) -> str:
    return f"joint {_MOTOMAN.index(letter[0]) + 1}"


def _own(name: str) -> _Read:
    """Interpret one of cellapp's own names."""
    if name in POINT:
        return _Read("p", POINT.index(name), rank=-1)
    joint = re.fullmatch(r"(q|qd|joint_temperature)([1-9]\d*)", name)
    return _Read(name, rank=-1) if joint is None else _Read(joint[1], int(joint[2]), rank=-1)


def _best(quantity: str, columns: Sequence[_Read], taken: Collection[str]) -> list[_Read]:
    """Return the columns of the families that may be a quantity; of the one alone that has a ``taken`` column."""
    families = grouped(((one.rank, one.family), one) for one in columns).values()
    for its in families:
        if chosen := {one.number: one for one in its if one.column in taken}:
            return [one for one in its if chosen.get(one.number, one) is one]
    whole = [its for its in families if quantity != "p" or len({one.number for one in its}) == 3]
    rank = min((its[0].rank for its in whole), default=None)
    return [one for its in whole if its[0].rank == rank for one in its] or [replace(one, rank=1) for one in columns]


def _called(quantity: str, number: int, base: int, order: Mapping[int, tuple[int, str, str]]) -> str:
    """Return cellapp's name of a column; empty for a joint that the file names and the arm does not have."""
    if quantity == "p":
        return POINT[number]
    if quantity in ("sigma", "expanded"):
        return f"{quantity}_{'xyzm'[number]}"
    if quantity not in ("q", *_OF_JOINTS):
        return quantity
    if order and number not in order:
        return ""
    return f"{quantity}{order[number][0] if order else number + 1 - base}"


def _several_smrs(families: Mapping[str, Sequence[_Read]]) -> dict[str, Sequence[_Read]]:
    """Return the families of points by the number or letter that tells them apart; empty if something else does."""
    found = {re.fullmatch(r"(.*?)(\d+|[a-h]|)", words): its for words, its in families.items()}
    whole = all(len({one.number for one in its}) == 3 for its in families.values())
    if None in found or len({match[1] for match in found if match}) > 1 or not whole:
        return {}
    return {(match[2] or "1").upper(): its for match, its in found.items() if match}


def _named_order(names: Sequence[str], row: Sequence[str]) -> dict[int, tuple[int, str, str]]:
    """Return number in the file -> joint of the arm, column and text of its name, where the first ``row`` names them.

    Known are the names of UR's joints, and names that differ in a number; else they stand in the order of the file.
    """
    texts = dict[int, tuple[str, str]]()
    for name, cell in zip(names, row):
        if (match := _NAME_OF_JOINT.fullmatch(name.lower())) and cell.strip() and not is_number(cell):
            texts[int(match[1])] = (name, cell.strip())
    joints = {n: _UR_JOINTS.index(ur) + 1 for n, (_, text) in texts.items() for ur in _UR_JOINTS if ur in text}
    if len(joints) < len(_UR_JOINTS):
        found = {n: match for n, (_, text) in texts.items() if (match := re.fullmatch(r"(.*?)(\d+)\D*", text))}
        heads = [match[1] for match in found.values()]
        joints = {n: int(match[2]) for n, match in found.items() if match[1] == max(heads, key=heads.count)}
        least = min(joints.values(), default=1)
        joints = {n: joint + 1 - least for n, joint in joints.items()}
    if not joints or sorted(joints.values()) != [*range(1, len(joints) + 1)]:
        joints = {n: place for place, n in enumerate(sorted(texts), start=1)}
    return {n: (joint, *texts[n]) for n, joint in joints.items()}


def _read(name: str, kind: str) -> _Read | None:
    """Interpret one name; joint indices are left as they stand in it."""
    for quantity in ("time", "angle", "length", None):
        stem, factor = without_unit(name, quantity)
        if quantity is not None and factor is None:
            continue
        words = _words(stem)
        if quantity in ("time", None) and ((words[-1:] and words[-1] in _TIME) or (not stem and len(name.strip()) > 1)):
            if _NO_CLOCK & set(words):
                return None
            rank = 0 if "header" in words else 2 if set(words) & _DATE else 1
            return _Read("time_s", 0, stem, factor, rank)
        if kind != "joints" and quantity in ("length", None) and (point := _point(stem, factor)):
            return point
        if kind != "points" and quantity in ("angle", None) and (joint := _joint(stem, factor)):
            return joint
    if kind != "readings":
        return None
    other = _OF_READINGS.get(
        re.sub(r"\s*[\[(]\s*(?:°|deg ?)?c\s*[\])]$|\s*[\[(]\s*kg\s*[\])]$", "", name.strip().lower())
    )
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


def without_unit(name: str, quantity: str | None) -> tuple[str, float | None]:
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
    """Interpret a coordinate of a point, or its uncertainty, measured before nominal in any order of words."""
    if sigma := _SIGMA.search(stem):
        axis = (stem[: sigma.start()] + stem[sigma.end() :]).strip(" _.()")
        place = "xyz".find(axis) if len(axis) == 1 else 3 * (axis in ("", "point", "position"))
        return _Read("expanded" if sigma[1] else "sigma", place, "", factor) if axis in (*"xyz", "", "point") else None
    stem = _GLUED.sub(r"\1 \2", stem).replace("坐标", "")  # coordinate
    words = set(_words(stem))
    marks = words & (_MEASURED | _TRACKER | _COMPUTED | _OF_ROBOT)
    bare = re.sub(rf"[ _.(\[]*\b({'|'.join(marks)})\b[ _.)\]]*", " ", stem.replace("_", " ")).strip() if marks else stem
    if "±" in stem or words & _NO_COORDINATE or _NO_POINT.search(bare) or (match := _POINT.fullmatch(bare)) is None:
        return None
    rank = _COMMAND if words & (_COMPUTED | _OF_ROBOT) else 0 if marks else 1
    family = re.sub(r"[^a-z0-9]+", "", match[1] + match[3]) + " ".join(sorted(marks))
    return _Read("p", "xyz".index(match[2]), family, factor, rank)


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
    return _Read(kinds[0] if kinds else "q", int(numbers[0] if named is None else named), " ".join(words), factor, rank)


Columns = Mapping[str, NDArray[np.float64]]
"""Columns of a stream by their names in a CSV file, each (n,)."""

TEXTS = ("recording", "arm", "split")
POINT = ("x_m", "y_m", "z_m")
BESIDE = "other_q"
"""Joint positions of the other arm of the cell, if it moved meanwhile."""

_STAMPS = Column("time_s", "s", ("time_s",), required=True)
POSITIONS, _TEMPERATURES = (column for column in COLUMNS if column.name in ("q", "joint_temperature_c"))
_SPEEDS = Column("qd", "rad/s", ("qd",), "joints")
STREAMS: Mapping[Kind, TableSpec] = {
    "joints": TableSpec((_STAMPS, POSITIONS, _SPEEDS, _TEMPERATURES)),
    "points": TableSpec((_STAMPS, *(its for its in COLUMNS if its.csv in (POINT, ("sigma_m",), QUATERNION)))),
}
"""Numbers of a stream; its second quantity is the one that is recorded."""
OF_OTHER_ARM = TableSpec((Column(BESIDE, "rad", (BESIDE,), "joints"),))
_LEAST_ROWS = 20
_SLOWEST_HZ, _FASTEST_HZ = 2.0, 20_000.0
"""Plausible sampling rates [Hz]; outside these, timestamps are not in seconds."""
UNITS_OF_TIME = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_COLUMNS_OF_TIME = {"milliseconds": "time_ms", "microseconds": "time_us", "nanoseconds": "time_ns"}
_BLOCK = 64
"""Number of rows over which a usual step is taken."""
_EPOCH_S, _STEPS_S = (9.5e8, 4.2e9), (5e-5, 0.5)
"""Seconds since 1970 of the years 2000 to 2100, and steps that recordings with such stamps have [s]."""
_LEAST_BURSTS, _OF_A_BURST = 4, 0.2
"""Least number of bursts; share of a step or of a burst's time that is small."""
_USUAL_STEP_S = (5e-4, 0.05)
"""Plausible steps of recordings [s], a factor of 100 apart: at most one unit puts a step between them."""
_DEGREES = "degrees? Then name the columns q1_deg, q2_deg, ..."
_FASTEST_RAD_S = 12.0
"""Upper limit of joint speeds [rad/s]: no joint of an industrial arm is faster."""
_REST_RAD, _REST_M = 1e-3, 2e-3
"""Ranges of joints and of the point within which an arm does not move."""
_REST_RAD_S = 0.01
"""Joint speeds [rad/s] up to which controllers report an arm at rest."""
_GAP = 2.5
"""Multiple of the median step of the timestamps from which on a step is a gap."""


@dataclass(frozen=True)
class Implausible:
    """What is wrong in a stream: row (None: the whole file), column, and what was expected."""

    row: int | None
    column: str
    text: str


def state_of(time_s: NDArray[np.float64], lost: int = 0) -> StreamState:
    """Summarise the timestamps of a stream, in the order in which they were recorded."""
    step = np.diff(time_s)
    forward = step[step > 0.0]
    median = (usual_step(time_s) if len(forward) else 0.0) or math.inf
    gaps = step[step > _GAP * median]
    return StreamState(
        n=len(time_s),
        seconds=float(np.ptp(time_s)),
        rate_hz=1.0 / median,
        gaps=len(gaps),
        longest_gap_s=float(gaps.max(initial=0.0)),
        repeats=int(np.count_nonzero(step == 0.0)),
        backward=int(np.count_nonzero(step < 0.0)),
        lost=lost,
    )


def usual_step(stamps: NDArray[np.float64]) -> float:
    """Return the median time from row to row, over blocks of rows: neither gaps nor bursts of stamps change it."""
    rows = max(1, min(_BLOCK, (len(stamps) - 1) // 4))
    step = (stamps[rows:] - stamps[:-rows]) / rows
    return float(np.median(step[step > 0.0])) if (step > 0.0).any() else 0.0


def time_unit(stamps: NDArray[np.float64]) -> tuple[str, str] | None:
    """Return the unit of the timestamps of a recording and its ground: seconds since 1970, or the step from row to row;
    None if no unit gives a plausible step."""
    step = usual_step(stamps)
    for ground, size, (least, most) in (
        ("by their size since 1970", float(np.nanmax(stamps, initial=0.0)), _STEPS_S),
        ("by the step between them", _EPOCH_S[0], _USUAL_STEP_S),
    ):
        for unit, factor in UNITS_OF_TIME.items():
            since_1970 = size if size == _EPOCH_S[0] else size * factor
            if least <= step * factor <= most and _EPOCH_S[0] <= since_1970 <= _EPOCH_S[1]:
                return unit, ground
    return None


def evenly_stamped(time_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
    """Replace timestamps of packets by even ones, if samples came in bursts; return also a sentence, else "".

    A packet's stamps say when it arrived. The last samples of the packets lie on a line over their number, which is the
    clock: its slope is the step from sample to sample.
    """
    step, usual = np.diff(time_s), usual_step(time_s)
    ends = np.flatnonzero(step > 2.0 * usual)
    if len(ends) < _LEAST_BURSTS or not 0.0 < float(np.median(step)) < _OF_A_BURST * usual:
        return time_s, ""
    slope, begin = np.polyfit(ends, time_s[ends], 1)
    off = float(np.abs(time_s[ends] - begin - slope * ends).max())
    apart = float(np.median(np.diff(time_s[ends])))
    words = (
        f"{len(time_s)} samples came in {len(ends) + 1} bursts, {apart:.3g} s apart: their stamps are of arrival, not"
        " of measurement"
    )
    if off > _OF_A_BURST * apart:
        return time_s, f"{words}, and no even clock explains them; record the device's own stamps"
    even = begin + slope * np.arange(len(time_s))
    return even, f"{words}; taken as measured evenly, {1.0 / slope:.5g} a second (the bursts fit to {1e3 * off:.2g} ms)"


def joint_faults(columns: Columns, limits: NDArray[np.float64], *, dated: bool = False) -> Iterator[Implausible]:
    """Yield what is implausible in samples of an arm whose joints have these ``limits`` (N, 2) [rad].

    ``dated``: the timestamps are dates or times of day in the file, so that their unit is certain.
    """
    positions, speeds = POSITIONS.csv_names(len(limits)), _SPEEDS.csv_names(len(limits))
    q = _matrix(columns, positions)
    wrong = [*_stamp_faults(columns["time_s"], dated), *_missing(columns, positions), *_missing(columns, speeds)]
    beyond = beyond_limits(q, limits, _DEGREES)
    wrong += [Implausible(one.row, f"q{(one.place or 0) + 1}", one.text) for one in beyond]
    yield from wrong
    if wrong:
        return
    step = np.diff(columns["time_s"])
    moving = step > 0.5 * np.median(step[step > 0.0])
    speed = np.abs(np.diff(q, axis=0)[moving] / step[moving, np.newaxis])
    fast = np.quantile(speed, 0.95, axis=0)
    joint = int(np.argmax(fast))
    if fast[joint] > _FASTEST_RAD_S:
        text = f"the joint rotates at {fast[joint]:.3g} rad/s; expected radians and seconds; {_DEGREES}"
        yield Implausible(None, f"q{joint + 1}", text)
    fastest = float(np.abs(_matrix(columns, speeds)).max(initial=0.0))
    if float(np.ptp(q, axis=0).max()) < _REST_RAD:
        text = f"no joint moves by {_REST_RAD:g} rad; expected a recording of a motion"
        if fastest > _REST_RAD_S:
            text = f"{text}, as qd1.. reach {fastest:.3g} rad/s: give the joint positions of that motion"
        yield Implausible(None, "q1..", text)
    elif speeds[0] in columns:
        yield from _speed_unit(columns, speeds, q)


def beside_faults(columns: Columns, limits: NDArray[np.float64]) -> Iterator[Implausible]:
    """Yield what is implausible in joint positions of the other arm, whose joints have these ``limits`` (K, 2) [rad];
    rows without any are allowed: it was not recorded then."""
    names = OF_OTHER_ARM.names(len(limits))
    if not names or not all(name in columns for name in names):
        return
    q = _matrix(columns, names)
    unknown = np.isnan(q)
    partly = np.flatnonzero(unknown.any(axis=1) & ~unknown.all(axis=1))
    if len(partly):
        text = "the value is missing; give all joints of the other arm in a row, or none"
        yield Implausible(int(partly[0]), names[int(np.argmax(unknown[partly[0]]))], text)
    for one in beyond_limits(q, limits):
        yield Implausible(one.row, names[one.place or 0], one.text)


def point_faults(columns: Columns, *, dated: bool = False) -> Iterator[Implausible]:
    """Yield what is implausible in points; ``dated`` as in ``joint_faults``."""
    yield from _stamp_faults(columns["time_s"], dated)
    yield from _missing(columns, ("sigma_m", *QUATERNION))
    for column in STREAMS["points"].columns:
        values = _matrix(columns, column.csv)
        if values.size and column.check is not None and (fault := column.check(values)) is not None:
            hint = "; if these are millimetres, name the columns x_mm, y_mm, z_mm" if column.csv == POINT else ""
            yield Implausible(fault.row, column.csv[fault.place or 0], fault.text + hint)
    p = _matrix(columns, POINT)
    if len(p) and float(np.ptp(p, axis=0).max()) < _REST_M:
        yield Implausible(None, "x_m", f"the SMR does not move by {_REST_M * 1e3:g} mm; expected points of a motion")


def joint_stream(columns: Columns, joints: int) -> JointStream:
    """Convert the samples of an arm for estimation."""
    beside = [name for name in columns if name.startswith(BESIDE)]
    return JointStream(
        time_s=columns["time_s"],
        q=_matrix(columns, POSITIONS.csv_names(joints)),
        qd=_matrix(columns, _SPEEDS.csv_names(joints)) if "qd1" in columns else None,  # of all joints, or of none
        other_q=_matrix(columns, beside) if beside else None,
    )


def point_stream(columns: Columns, splits: tuple[str, ...] | None) -> PointStream:
    """Convert the points for estimation; ``splits`` are the texts to which the codes in column ``split`` refer."""
    held_out = None
    if splits is not None and any(splits):
        held_out = columns["split"] == (splits.index("validate") if "validate" in splits else math.inf)
    return PointStream(
        time_s=columns["time_s"], p_M=_matrix(columns, POINT), sigma_m=columns.get("sigma_m"), held_out=held_out
    )


def _matrix(columns: Columns, names: Sequence[str]) -> NDArray[np.float64]:
    return np.column_stack([columns[name] for name in names if name in columns] or [np.empty((0, 0))])


def _missing(columns: Columns, names: tuple[str, ...]) -> Iterator[Implausible]:
    """Yield the first empty cell of each of these columns, which every row must have."""
    for name in names:
        rows = np.flatnonzero(np.isnan(columns[name])) if name in columns else np.empty(0, np.intp)
        if len(rows):
            yield Implausible(int(rows[0]), name, "the value is missing; give it in every row, or leave the column out")


def _stamp_faults(time_s: NDArray[np.float64], dated: bool) -> Iterator[Implausible]:
    if len(time_s) < _LEAST_ROWS:
        yield Implausible(None, "time_s", f"{len(time_s)} rows are no recording of a motion; expected {_LEAST_ROWS}")
        return
    step = np.diff(time_s)
    forward = step[step > 0.0]
    if len(forward) < len(step) // 2:
        yield Implausible(None, "time_s", "most stamps do not increase; expected the times at which samples were taken")
        return
    rate = 1.0 / usual_step(time_s)
    if not _SLOWEST_HZ <= rate <= _FASTEST_HZ:
        text = f"the median step is {1.0 / rate:.3g}; expected seconds, {_SLOWEST_HZ:g} to {_FASTEST_HZ:g} samples each"
        unit = None if dated else time_unit(time_s)
        hint = "" if unit is None else f"; are these {unit[0]}? Then name the column {_COLUMNS_OF_TIME[unit[0]]}"
        yield Implausible(None, "time_s", text + hint)


def _speed_unit(columns: Columns, names: tuple[str, ...], q: NDArray[np.float64]) -> Iterator[Implausible]:
    """Check that speeds agree with the joint positions: in rad/s, not in degrees per second."""
    ratio = _speed_ratio(columns["time_s"], q, _matrix(columns, names))
    if not 0.1 < ratio < 10.0 and ratio > 0.0:
        hint = "; are these degrees a second? Then name the columns qd1_deg, ..." if 40.0 < ratio < 80.0 else ""
        yield Implausible(None, "qd1", f"the speeds are {ratio:.3g} times those of q1..; expected rad/s{hint}")


def _speed_ratio(time_s: NDArray[np.float64], q: NDArray[np.float64], qd: NDArray[np.float64]) -> float:
    """Return the rms of stated speeds (n, N) over that of the motion of joint positions (n, N); NaN if these rest."""
    step = np.diff(time_s)
    usual = float(np.median(step[step > 0.0])) if (step > 0.0).any() else math.inf
    steady = (step > 0.5 * usual) & (step < _GAP * usual)
    moved = np.diff(q, axis=0)[steady]
    by_speed = 0.5 * (qd[1:] + qd[:-1])[steady] * step[steady, np.newaxis]
    known = np.isfinite(moved) & np.isfinite(by_speed)
    motion = float((moved[known] ** 2).sum())
    return math.sqrt(float((by_speed[known] ** 2).sum()) / motion) if motion else math.nan


_DEG = math.pi / 180.0
AngleUnit = Literal["rad", "deg"]
LengthUnit = Literal["m", "mm", "um", "cm", "in"]
_SURELY_RAD, _SURELY_DEG = 2.0 * math.pi + 0.05, 4.0 * math.pi + 0.05
"""Joint positions within the first limit [rad] and over more than ``_WIDE`` are radians, beyond the second degrees."""
_WIDE = 0.3
_SURELY_M, _SURELY_MM = 20.0, 100.0
"""No cell is wider than the first limit [m]; beyond the second, which no tracker reaches, values are millimetres."""
_LEAST_M = 0.05
"""Range of coordinates [m] up to which these may be in a unit other than metres."""


def angle_unit(q: NDArray[np.float64]) -> AngleUnit | None:
    """Return the unit of joint positions (n, N) by their size; None if it is ambiguous."""
    largest, widest = _largest_and_widest(q)
    if largest > _SURELY_DEG:
        return "deg"
    return "rad" if largest <= _SURELY_RAD and widest > _WIDE else None


def length_unit(p: NDArray[np.float64]) -> LengthUnit | None:
    """Return the unit of points (n, 3) by their size; None if it is ambiguous."""
    largest, widest = _largest_and_widest(p)
    if largest > _SURELY_MM:
        return "mm"
    return "m" if largest <= _SURELY_M and widest > _LEAST_M else None


def in_si(table: StreamTable, kind: Kind, known: Understood) -> tuple[StreamTable, tuple[str, float], list[str]]:
    """Convert the table to SI units; return also the clock and its unit, where the file does not say it, and a sentence
    about columns with other names."""
    if not known.others:
        return table, (kind, 1.0), []
    columns, factors, guessed = dict(table.columns), dict(known.factors), list[str]()
    if table.dated:
        factors.pop("time_s", None)
    clock: tuple[str, float] = (kind, 1.0)
    if known.unsaid("time_s"):
        unit, ground = ("seconds", "as dates") if table.dated else time_unit(columns["time_s"]) or ("seconds", "unsaid")
        factors["time_s"] = UNITS_OF_TIME[unit]
        clock = (known.others["time_s"], factors["time_s"])
        guessed.append(f"stamps in {unit}, {ground}")
    if kind == "joints":
        positions = [name for name in columns if _is_joint(name, "q")]
        unsaid = [name for name in positions if known.unsaid(name)]
        if unsaid and angle_unit(np.column_stack([columns[name] for name in unsaid])) == "deg":
            factors |= dict.fromkeys(unsaid, _DEG)
            guessed.append("joint positions in degrees, by their size")
        speeds = [name for name in columns if _is_joint(name, "qd") and known.unsaid(name)]
        guessed += _speeds(columns, factors, positions, speeds)
    else:
        points = [name for name in POINT if name in columns and known.unsaid(name)]
        if points and length_unit(np.column_stack([columns[name] for name in points])) == "mm":
            factors |= dict.fromkeys(points, 1e-3)
            guessed.append("points in millimetres, by their size")
        for name in known.others:
            if name.startswith(("sigma_", "expanded_")) and known.unsaid(name):
                factors[name] = factors.get("x_m", 1.0)
    for name, factor in factors.items():
        columns[name] = columns[name] * factor
    if FRACTION in columns:
        part = columns.pop(FRACTION)
        if part.min() < 0.0 or part.max() >= 1.0:
            names = f"{known.others['time_s']}, {known.others[FRACTION]}"
            raise InputError(f"{table.path}: {names}: two times; expected whole seconds and their part; remove one")
        columns["time_s"] = columns["time_s"] + part
    columns = with_sigma(columns)
    text = f"{table.path}: understood as {', '.join(known.said)}"
    return replace(table, columns=columns), clock, ["; ".join([text, *guessed])]


def with_sigma(columns: Columns) -> dict[str, NDArray[np.float64]]:
    """Make ``sigma_m`` of a stated uncertainty in another form [m]: of each coordinate, or expanded with k = 2.

    An expanded one without a coordinate is that of the point: the root of the sum of the squares of its coordinates'.
    A zero is a rounded one: the least other takes its place.
    """
    found = dict(columns)
    for kind, coverage, axes in (("sigma", 1.0, "xyz"), ("expanded", 2.0, "xyzm")):
        parts = {axis: found.pop(f"{kind}_{axis}") for axis in axes if f"{kind}_{axis}" in found}
        own = [parts[axis] for axis in ("xyz" if {*"xyz"} <= parts.keys() else "m") if axis in parts]
        if own and "sigma_m" not in found:
            sigma = np.sqrt(np.sum(np.square(own), axis=0) / 3.0) / coverage
            least = sigma[sigma > 0.0].min(initial=math.inf)
            found["sigma_m"] = np.where(sigma == 0.0, least, sigma)
    return found


def without_part_of_orientation(table: StreamTable) -> tuple[StreamTable, list[str]]:
    """Drop orientations if rows lack them, as a fit then uses points only; return also a sentence about it."""
    if any(name not in table.columns for name in QUATERNION):
        return table, []
    rotation = np.column_stack([table.columns[name] for name in QUATERNION])
    empty = np.isnan(rotation).any(axis=1) | (rotation == 0.0).all(axis=1)
    if not empty.any():
        return table, []
    kept = {name: values for name, values in table.columns.items() if name not in QUATERNION}
    words = f"{table.path}: {int(empty.sum())} of {len(empty)} rows have no orientation: the quaternions are left out"
    return replace(table, columns=kept), [words]


def _speeds(
    columns: dict[str, NDArray[np.float64]], factors: dict[str, float], positions: list[str], speeds: list[str]
) -> list[str]:
    """Convert speeds from degrees per second if that agrees better with the motion of the positions."""
    names = [(f"q{speed[2:]}", speed) for speed in speeds if f"q{speed[2:]}" in positions]
    if not names:
        return []
    q, qd = (np.column_stack([columns[one] * factors.get(one, 1.0) for one in its]) for its in zip(*names))
    ratio = _speed_ratio(columns["time_s"] * factors.get("time_s", 1.0), q, qd)
    if not 40.0 < ratio < 80.0:
        return []
    factors |= dict.fromkeys(speeds, _DEG)
    return ["speeds in degrees a second, by the motion of the positions"]


def _largest_and_widest(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the largest absolute value in (n, k), and the widest range of a column, ignoring NaN."""
    values = values[:, np.isfinite(values).any(axis=0)]
    if not values.size:
        return 0.0, 0.0
    least, most = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    return float(max(-least.min(), most.max())), float((most - least).max())


def _is_joint(name: str, stem: str) -> bool:
    return name.startswith(stem) and name[len(stem) :].isdigit()
