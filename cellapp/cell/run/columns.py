"""Meaning of columns in readings and recordings of other programs: their names, and units that stand in them.

Examples: ``actual_q_0`` beside ``target_q_0`` is q1, as is ``ROBOT_ACTUAL_JOINT_POSITIONS (J1)``; ``Joint 1 [deg]`` is
q1 in degrees, ``timestamp_ns`` a timestamp in nanoseconds, ``X [mm]`` x_m. Cellapp's own names keep their meaning.

Units of columns in files of other programs: from their names, else from values where only one is possible.

Columns of recordings: their names, checks of plausibility, and their conversion to objects for estimation.

Columns that hold the orientation of a probe in other forms than ``quat_w`` to ``quat_z``, recognised by their names.

Names of other quaternions, rotation vectors, matrices, and of roll, pitch and yaw with a unit are unambiguous. Three
angles by any other names are ambiguous: they are not used, and a note says how to name them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.cell.run.arm_cells import ArmCells
from cellapp.cell.run.csv_text import CsvTable, Problems
from cellapp.cell.run.records import StreamState
from cellapp.cell.run.stream_csv import StreamTable
from cellapp.estimation.motion.streams import JointStream, PointStream
from cellapp.estimation.readings.columns import COLUMNS, Fault, beyond_limits
from cellapp.ground.errors import InputError

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


Array = NDArray[np.float64]
QUATERNION = ("quat_w", "quat_x", "quat_y", "quat_z")
_ORIENTATION_UNITS = {"": 1.0, "rad": 1.0, "deg": float(np.pi / 180.0)}
_MOST_RAD = 4.0 * np.pi
"""Largest plausible angle [rad]: larger ones are refused as probably degrees."""
_OFF = 1e-3
"""Largest deviation of a matrix times its transpose from the identity."""


@dataclass(frozen=True)
class Form:
    """A form of an orientation: its columns, whose ``parts`` and units ``pattern`` finds in a name.

    ``rotations`` converts their values (n, k) [rad], None for a quaternion; ``said`` describes the form.
    ``needs_unit``: the names must say degrees or radians.
    """

    pattern: re.Pattern[str]
    parts: tuple[str, ...]
    said: str
    rotations: Callable[[Array], scipy.spatial.transform.Rotation] | None
    needs_unit: bool = False


_OF = r"(?P<of>(?:.*_)?)"
_NUMBERED = Form(
    re.compile(_OF + r"(?:quaternion|quat|q|orientation|rotation|o)_?(?P<part>[0-3])(?P<unit>)"),
    ("0", "1", "2", "3"),
    "a quaternion",
    None,
)
_FORMS = (
    Form(
        re.compile(_OF + r"(?:quaternion|quat|q|orientation|rotation|o)_?(?P<part>[wxyz])(?P<unit>)"),
        ("w", "x", "y", "z"),
        "a quaternion",
        None,
    ),
    _NUMBERED,
    Form(
        re.compile(_OF + r"(?:rotvec|rot_vec|rotation_vector|rv)_?(?P<part>[xyz])(?:_(?P<unit>rad|deg))?"),
        ("x", "y", "z"),
        "a rotation vector",
        lambda vectors: scipy.spatial.transform.Rotation.from_rotvec(vectors),
    ),
    Form(
        re.compile(_OF + r"(?P<part>roll|pitch|yaw)(?:_(?P<unit>rad|deg))?"),
        ("roll", "pitch", "yaw"),
        "rot_z(yaw) rot_y(pitch) rot_x(roll)",
        lambda rpy: scipy.spatial.transform.Rotation.from_euler("xyz", rpy),
        needs_unit=True,
    ),
    Form(
        re.compile(_OF + r"(?:r|rot|rotation|m)_?(?P<part>[123][123])(?P<unit>)"),
        tuple(f"{row}{column}" for row in "123" for column in "123"),
        "a matrix, its rows one after another",
        lambda entries: scipy.spatial.transform.Rotation.from_matrix(entries.reshape(-1, 3, 3)),
    ),
)
_OF_FIFTH_JOINT = re.compile(r"(?:.*_)?q_?[45]")
"""Beside such a column q0 to q3 are joints, not a quaternion."""
_OTHERS = {"tcp", "robot", "flange", "tool", "target", "commanded", "command", "desired"}
"""Orientations of these belong to the controller, not to the tracker."""
_AMBIGUOUS = tuple(
    re.compile(rf"({'|'.join(names)})(?:_(?:rad|deg))?")
    for names in (("rx", "ry", "rz"), ("a", "b", "c"), ("alpha", "beta", "gamma"), ("phi", "theta", "psi"))
)
_WHAT_TO_DO = (
    "they may be a rotation vector or Euler angles in any order; to use them, name them rotvec_x, rotvec_y, rotvec_z"
    " for a rotation vector [rad], roll_deg, pitch_deg, yaw_deg for rot_z(yaw) rot_y(pitch) rot_x(roll), or give"
    " quat_w, quat_x, quat_y, quat_z"
)


@dataclass(frozen=True)
class Written:
    """The columns of an orientation in a file, in the order of their form, and the factor to radians."""

    form: Form
    columns: tuple[str, ...]
    factor: float

    @property
    def said(self) -> str:
        """Description of how they are interpreted."""
        return f"{', '.join(self.columns)}: taken as {self.form.said} of the probe's orientation in the tracker frame"

    def quaternions(self, values: Array) -> tuple[Array, Fault | None]:
        """Convert values (n, k) of these columns to quaternions (n, 4), scalar first; return also the first fault. Rows
        without values, which are NaN, stay NaN."""
        if self.form.rotations is None:
            return values, None
        found = np.full((len(values), 4), np.nan)
        blank = np.isnan(values).all(axis=1)
        if values.shape[1] == 9:
            blank |= (values == 0.0).all(axis=1)  # programs write zeros where nothing was measured
        given = np.flatnonzero(~blank)
        if (fault := self._fault(values, given)) is None and len(given):
            turns = self.form.rotations(values[given] * self.factor)
            found[given] = turns.as_quat(canonical=True, scalar_first=True)
        return found, fault

    def _fault(self, values: Array, given: NDArray[np.intp]) -> Fault | None:
        """Return the fault of the first of the ``given`` rows that is not a rotation; None if all are."""
        own, columns = values[given], len(self.columns)
        if (part := np.isnan(own)).any():
            row, place = map(int, np.argwhere(part)[0])
            return Fault(int(given[row]), place, f"the value is missing; give all {columns} of the orientation or none")
        if columns < 9:
            largest = np.abs(own).max(axis=1, initial=0.0) * self.factor
            off, text = largest - _MOST_RAD, "{:.4g} rad; are these angles in degrees?"
        else:
            matrices = own.reshape(-1, 3, 3)
            largest = np.abs(matrices @ matrices.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
            off = largest - _OFF
            text = f"rows {self.columns[0]} to {self.columns[-1]} are off unit length and right angles by {{:.2g}}"
            if not (off > 0.0).any() and (mirrored := np.flatnonzero(np.linalg.det(matrices) < 0.0)).size:
                return Fault(int(given[mirrored[0]]), 0, "the matrix is a reflection: a frame is left-handed")
        wrong = np.flatnonzero(off > 0.0)
        return Fault(int(given[wrong[0]]), 0, text.format(largest[wrong[0]])) if len(wrong) else None


def written_orientation(names: Sequence[str]) -> tuple[Written | None, list[str]]:
    """Find the columns of an orientation in a header; return also notes on ambiguous ones.

    None if they are ``QUATERNION`` already, or there are none.
    """
    if any(name in QUATERNION for name in names):
        return None, []
    plain = {_plain(name): name for name in names}
    if any(map(_OF_FIFTH_JOINT.fullmatch, plain)):
        plain = {key: name for key, name in plain.items() if not _NUMBERED.pattern.fullmatch(key)}
    for form in _FORMS:
        sets: dict[str, dict[str, tuple[str, str]]] = {}
        for key, name in plain.items():
            if match := form.pattern.fullmatch(key):
                sets.setdefault(match["of"], {})[match["part"]] = (name, match["unit"] or "")
        sets = {of: own for of, own in sets.items() if not _OTHERS & set(of.split("_"))}
        whole = [own for own in sets.values() if len(own) == len(form.parts)]
        if len(whole) == 1 and len({unit for _, unit in whole[0].values()}) == 1:
            columns, units = zip(*(whole[0][part] for part in form.parts), strict=True)
            if form.needs_unit and not units[0]:
                return None, [f"{', '.join(columns)}: no orientation, as no unit is in the names: write _deg or _rad"]
            return Written(form, columns, _ORIENTATION_UNITS[units[0]]), []
        if not whole and len(own := sets.get("", {})) == len(form.parts) - 1 and form is not _NUMBERED:
            lacking = next(part for part in form.parts if part not in own)
            missing = f"not used as an orientation: a column for {lacking} is missing"
            return None, [f"{', '.join(name for name, _ in own.values())}: {missing}"]
    notes = []
    for pattern in _AMBIGUOUS:
        angles = {match[1]: name for key, name in plain.items() if (match := pattern.fullmatch(key))}
        if len(angles) == 3:
            notes.append(f"{', '.join(angles.values())}: not used as an orientation: {_WHAT_TO_DO}")
    return None, notes


def names_with_quaternion(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the columns that ``with_quaternions`` gives."""
    written, _ = written_orientation(names)
    return tuple(names) if written is None else (*(name for name in names if name not in written.columns), *QUATERNION)


def with_quaternions(table: CsvTable) -> tuple[CsvTable, list[str]]:
    """Convert the orientation of a probe to a quaternion; return also notes. Raise ``InputError`` by row."""
    written, notes = written_orientation(table.names)
    if written is None:
        return table, notes
    own = [table.cells[name] for name in written.columns]
    if written.form.rotations is not None:
        cells = ArmCells(table, range(len(table.lines)), Problems(table.place))
        values = np.column_stack([cells.numbers(name, required=False) for name in written.columns])
        cells.problems.check()
        found, fault = written.quaternions(values)
        if fault is not None:
            where = f"{table.place(table.lines[fault.row])}: {written.columns[fault.place or 0]}"
            raise InputError(f"{where}: {fault.text}")
        own = [tuple("" if math.isnan(value) else repr(value) for value in column) for column in found.T.tolist()]
    columns = {name: its for name, its in table.cells.items() if name not in written.columns}
    columns |= dict(zip(QUATERNION, own, strict=True))
    return replace(table, names=tuple(columns), cells=columns), [written.said]


def _plain(name: str) -> str:
    """Return a column's name in lower case, its unit after an underscore: ``Roll [deg]`` is ``roll_deg``."""
    return re.sub(r"[^0-9a-z]+", "_", name.strip().lower()).strip("_")


Columns = Mapping[str, NDArray[np.float64]]
"""Columns of a stream by their names in a CSV file, each (n,)."""

TEXTS = ("recording", "arm", "split")
POINT = ("x_m", "y_m", "z_m")
OPTIONAL_OF_JOINTS = ("qd", "joint_temperature")
BESIDE = "other_q"
"""Joint positions of the other arm of the cell, if it moved meanwhile."""

_CHECKS = {name: column.check for column in COLUMNS for name in (column.csv[0],) if column.check is not None}
_LEAST_ROWS = 20
_SLOWEST_HZ, _FASTEST_HZ = 2.0, 20_000.0
"""Plausible sampling rates [Hz]; outside these, timestamps are not in seconds."""
UNITS_OF_TIME = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_COLUMNS_OF_TIME = {"milliseconds": "time_ms", "microseconds": "time_us", "nanoseconds": "time_ns"}
_USUAL_STEP_S = (5e-4, 0.05)
"""Plausible steps of recordings [s], a factor of 100 apart: at most one unit puts a step between them."""
_DEGREES = "degrees? Then name the columns q1_deg, q2_deg, ..."
_FASTEST_RAD_S = 12.0
"""Upper limit of joint speeds [rad/s]: no joint of an industrial arm is faster."""
_REST_RAD, _REST_M = 1e-3, 2e-3
"""Ranges of joints and of the point within which an arm does not move."""
_UNIT = 1e-3
"""Largest deviation of a quaternion's length from one."""
_GAP = 2.5
"""Multiple of the median step of the timestamps from which on a step is a gap."""


@dataclass(frozen=True)
class Implausible:
    """What is wrong in a stream: row (None: the whole file), column, and what was expected."""

    row: int | None
    column: str
    text: str


def stems(kind: Kind, joints: int, others: int = 0) -> dict[str, tuple[str, ...]]:
    """Return quantity -> its columns; the first two of a kind are required. ``others``: joints of the other arm."""
    if kind == "points":
        return {"time_s": ("time_s",), "p_M": POINT, "sigma_m": ("sigma_m",), "quaternion": QUATERNION}
    per_joint = {stem: tuple(f"{stem}{j}" for j in range(1, joints + 1)) for stem in ("q", *OPTIONAL_OF_JOINTS)}
    beside = tuple(f"{BESIDE}{j}" for j in range(1, others + 1))
    return {"time_s": ("time_s",), **per_joint, BESIDE: beside}


def state_of(time_s: NDArray[np.float64], lost: int = 0) -> StreamState:
    """Summarise the timestamps of a stream, in the order in which they were recorded."""
    step = np.diff(time_s)
    forward = step[step > 0.0]
    median = float(np.median(forward)) if len(forward) else math.inf
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


def time_unit(stamps: NDArray[np.float64]) -> str | None:
    """Return the unit of timestamps by the median step between them; None if no unit gives a plausible step."""
    step = np.diff(stamps)
    usual = float(np.median(step[step > 0.0])) if (step > 0.0).any() else 0.0
    least, most = _USUAL_STEP_S
    return next((unit for unit, factor in UNITS_OF_TIME.items() if least <= usual * factor <= most), None)


def joint_faults(columns: Columns, limits: NDArray[np.float64], *, dated: bool = False) -> Iterator[Implausible]:
    """Yield what is implausible in samples of an arm whose joints have these ``limits`` (N, 2) [rad].

    ``dated``: the timestamps are dates or times of day in the file, so that their unit is certain.
    """
    names = stems("joints", len(limits))
    q = _matrix(columns, names["q"])
    wrong = [*_stamp_faults(columns["time_s"], dated), *_missing(columns, names["q"]), *_missing(columns, names["qd"])]
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
        text = f"the joint turns at {fast[joint]:.3g} rad/s; expected radians and seconds; {_DEGREES}"
        yield Implausible(None, f"q{joint + 1}", text)
    if float(np.ptp(q, axis=0).max()) < _REST_RAD:
        yield Implausible(None, "q1..", f"no joint moves by {_REST_RAD:g} rad; expected a recording of a motion")
    if names["qd"][0] in columns:
        yield from _speed_unit(columns, names["qd"], q)


def beside_faults(columns: Columns, limits: NDArray[np.float64]) -> Iterator[Implausible]:
    """Yield what is implausible in joint positions of the other arm, whose joints have these ``limits`` (K, 2) [rad];
    rows without any are allowed: it was not recorded then."""
    names = tuple(f"{BESIDE}{joint}" for joint in range(1, len(limits) + 1))
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
    p = _matrix(columns, POINT)
    for stem, matrix in (("x_m", p), ("sigma_m", _matrix(columns, ("sigma_m",)))):
        names: tuple[str, ...] = POINT if stem == "x_m" else ("sigma_m",)
        check = _CHECKS[stem]
        fault: Fault | None = check(matrix) if names[0] in columns else None
        if fault is not None:
            hint = "; if these are millimetres, name the columns x_mm, y_mm, z_mm" if stem == "x_m" else ""
            yield Implausible(fault.row, names[fault.place or 0], fault.text + hint)
    if QUATERNION[0] in columns:
        length = np.linalg.norm(_matrix(columns, QUATERNION), axis=1)
        wrong = np.flatnonzero(np.abs(length - 1.0) > _UNIT)
        if len(wrong):
            text = f"expected a quaternion of length 1, got {length[wrong[0]]:.4g}; correct them, or leave them out"
            yield Implausible(int(wrong[0]), QUATERNION[0], text)
    if len(p) and float(np.ptp(p, axis=0).max()) < _REST_M:
        yield Implausible(None, "x_m", f"the SMR does not move by {_REST_M * 1e3:g} mm; expected points of a motion")


def joint_stream(columns: Columns, joints: int) -> JointStream:
    """Convert the samples of an arm for estimation."""
    names = stems("joints", joints)
    optional = {
        stem: _matrix(columns, names[stem]) for stem in OPTIONAL_OF_JOINTS if names[stem][0] in columns
    }  # each has all joints or none: checked on import
    beside = [name for name in columns if name.startswith(BESIDE)]
    return JointStream(
        time_s=columns["time_s"],
        q=_matrix(columns, names["q"]),
        other_q=_matrix(columns, tuple(beside)) if beside else None,
        **optional,
    )


def point_stream(columns: Columns, splits: tuple[str, ...] | None) -> PointStream:
    """Convert the points for estimation; ``splits`` are the texts to which the codes in column ``split`` refer."""
    held_out = None
    if splits is not None and any(splits):
        held_out = columns["split"] == (splits.index("validate") if "validate" in splits else math.inf)
    return PointStream(
        time_s=columns["time_s"],
        p_M=_matrix(columns, POINT),
        sigma_m=columns.get("sigma_m"),
        quaternion=_matrix(columns, QUATERNION) if QUATERNION[0] in columns else None,
        held_out=held_out,
    )


def _matrix(columns: Columns, names: tuple[str, ...]) -> NDArray[np.float64]:
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
    rate = 1.0 / float(np.median(forward))
    if not _SLOWEST_HZ <= rate <= _FASTEST_HZ:
        text = f"the median step is {1.0 / rate:.3g}; expected seconds, {_SLOWEST_HZ:g} to {_FASTEST_HZ:g} samples each"
        unit = None if dated else time_unit(time_s)
        hint = "" if unit is None else f"; are these {unit}? Then name the column {_COLUMNS_OF_TIME[unit]}"
        yield Implausible(None, "time_s", text + hint)


def _speed_unit(columns: Columns, names: tuple[str, ...], q: NDArray[np.float64]) -> Iterator[Implausible]:
    """Check that speeds agree with the joint positions: in rad/s, not in degrees per second."""
    qd = _matrix(columns, names)
    step = np.diff(columns["time_s"])
    steady = (step > 0.0) & (step < _GAP * np.median(step[step > 0.0]))
    turned = np.diff(q, axis=0)[steady]
    by_speed = 0.5 * (qd[1:] + qd[:-1])[steady] * step[steady, np.newaxis]
    ratio = math.sqrt(float((by_speed**2).sum()) / max(float((turned**2).sum()), 1e-300))
    if not 0.1 < ratio < 10.0 and ratio > 0.0:
        hint = "; are these degrees a second? Then name the columns qd1_deg, ..." if 40.0 < ratio < 80.0 else ""
        yield Implausible(None, "qd1", f"the speeds are {ratio:.3g} times those of q1..; expected rad/s{hint}")


_DEG = math.pi / 180.0
AngleUnit = Literal["rad", "deg"]
LengthUnit = Literal["m", "mm", "um"]
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


def in_si(table: StreamTable, kind: Kind, known: Understood) -> tuple[StreamTable, list[str]]:
    """Convert the table to SI units; return also a sentence about columns with other names."""
    if not known.others:
        return table, []
    columns, factors, guessed = dict(table.columns), dict(known.factors), list[str]()
    if table.dated:
        factors.pop("time_s", None)
    if known.unsaid("time_s"):
        unit = "seconds" if table.dated else time_unit(columns["time_s"])
        factors["time_s"] = 1.0 if unit is None else UNITS_OF_TIME[unit]
        guessed.append("stamps in seconds" if unit is None else f"stamps in {unit}, by the step between them")
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
        if known.unsaid("sigma_m"):
            factors["sigma_m"] = factors.get("x_m", 1.0)
    for name, factor in factors.items():
        columns[name] = columns[name] * factor
    text = f"{table.path}: understood as {', '.join(known.said)}"
    return replace(table, columns=columns), ["; ".join([text, *guessed])]


def without_part_of_orientation(table: StreamTable) -> tuple[StreamTable, list[str]]:
    """Drop orientations if rows lack them, as a fit then uses points only; return also a sentence about it."""
    if any(name not in table.columns for name in QUATERNION):
        return table, []
    turned = np.column_stack([table.columns[name] for name in QUATERNION])
    empty = np.isnan(turned).any(axis=1) | (turned == 0.0).all(axis=1)
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
    step = np.diff(columns["time_s"]) * factors.get("time_s", 1.0)
    steady = step > 0.5 * float(np.median(step[step > 0.0])) if (step > 0.0).any() else step > 0.0
    turned = np.array([np.diff(columns[q])[steady] * factors.get(q, 1.0) / step[steady] for q, _ in names])
    stated = np.array([columns[qd][1:][steady] for _, qd in names])
    known = np.isfinite(turned) & np.isfinite(stated)
    ratio = math.sqrt(float(np.sum(stated[known] ** 2)) / max(float(np.sum(turned[known] ** 2)), 1e-300))
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
