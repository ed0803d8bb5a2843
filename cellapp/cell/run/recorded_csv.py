"""Tables of other programs: other names, separators, decimal commas, degrees, millimetres.

``read_recorded`` detects what each column is and in which unit, and says where that is ambiguous; ``converted`` gives
the same rows in the columns of cellapp. Nothing is written here.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.columns import (
    EXAMPLES,
    FRACTION,
    POINT,
    UNITS_OF_TIME,
    AngleUnit,
    LengthUnit,
    Understood,
    angle_unit,
    length_unit,
    time_unit,
    understood,
    with_sigma,
    without_unit,
)
from cellapp.cell.run.csv_text import NUMBER, CsvTable, Problems, is_number, read_header, short, stamp_seconds
from cellapp.cell.run.orientation_columns import Written, with_quaternions, written_orientation
from cellapp.cell.run.table_spec import READINGS
from cellapp.estimation.readings.columns import OF_SOCKETS
from cellapp.estimation.readings.readings import SAME_STOP_RAD, lost_points
from cellapp.ground.errors import InputError

_SEPARATORS: Mapping[str, str] = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", " ": "blanks"}
_ANGLES: Mapping[AngleUnit, float] = {"rad": 1.0, "deg": math.pi / 180.0}
_LENGTHS: Mapping[LengthUnit, float] = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2, "in": 0.0254}
_Unit = TypeVar("_Unit")
Choose = Callable[[str, tuple[str, ...]], str]
"""(question, possible answers) -> the answer of a person; "" if nobody can be asked."""
_OWN = READINGS.by_name
"""Cellapp's own column names keep their meaning; names of joint positions state no unit."""
_LEAST_ROWS = 3
_RIGID, _APART = 0.05, 0.01
"""Largest scatter of the distance of two SMRs on a flange, as a share of it; least distance, of the points' spread."""
_LIST = re.compile(r"p?[\[(]([^\[\]()]*,[^\[\]()]*)[\])]")
_WITH_UNIT = re.compile(r"([+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?)\s*(°|deg|rad|mm|cm|m|in)")
_Cells = dict[str, tuple[str, ...]]
"""Columns by their names in the file."""
_SPHERICAL: Mapping[str, frozenset[str]] = {
    "range": frozenset({"range", "distance", "dist"}),
    "azimuth": frozenset({"azimuth", "az", "hz"}),
    "zenith": frozenset({"zenith"}),
    "elevation": frozenset({"elevation", "elev", "el"}),
    "vertical": frozenset({"vertical", "v"}),
}
_MOST_NAMED = 5
"""Most rows that a sentence names."""
_UNIT_LENGTH = 0.01
"""Largest deviation of a quaternion's length from one that a program with few digits writes."""
_MADE = {FRACTION, *(f"{kind}_{axis}" for kind in ("sigma", "expanded") for axis in "xyzm")}
"""Parts of ``time_s`` and ``sigma_m`` in files of other programs."""


def nobody(question: str, answers: tuple[str, ...]) -> str:
    """Answer nothing: nobody can be asked."""
    return ""


@dataclass(frozen=True)
class Recorded:
    """A recorded file, interpreted as far as it is unambiguous.

    Attributes
    ----------
    path : Path
    separator : str
        In words.
    decimal_comma : bool
    table : CsvTable
        Columns by cellapp's names, unknown ones by their own; numbers with a decimal point, not yet in SI.
    known : Understood
    angles, lengths : unit or None
        None if neither names nor values decide.
    notes : tuple of str
        How columns of an orientation were interpreted, and several SMRs.
    lost : frozenset of int
        Rows without a point, as the beam was lost.
    taken : tuple of str
        Columns that count where two may be meant.
    stamps : array, shape (n,), or None
        Times of the rows in their unit, which is ``clock`` [s] if it is known.
    """

    path: Path
    separator: str
    decimal_comma: bool
    table: CsvTable
    known: Understood
    angles: AngleUnit | None
    lengths: LengthUnit | None
    notes: tuple[str, ...] = ()
    stamps: NDArray[np.float64] | None = None
    clock: float | None = None
    lost: frozenset[int] = frozenset()
    taken: tuple[str, ...] = ()

    @property
    def points(self) -> bool:
        """Whether the rows have points."""
        return set(POINT) <= {*self.table.names}

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the columns of joint positions."""
        return _joints(self.table.names)

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the arms, in order; empty if the file has no such column."""
        return tuple(dict.fromkeys(map(str.strip, self.table.cells.get("arm", ()))))

    @property
    def unknown(self) -> tuple[str, ...]:
        """Columns that are not used, by their names in the file."""
        others = self.known.others
        return tuple(
            others.get(name, name) for name in self.table.names if name not in _MADE and not READINGS.find(name)
        )

    def in_si(self, angles: AngleUnit, lengths: LengthUnit) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return joint positions (n, N) [rad] and points (n, 3) [m]."""
        return _values(self.table, self.joints) * _ANGLES[angles], _values(self.table, POINT) * _LENGTHS[lengths]

    @property
    def smrs(self) -> tuple[str, ...]:
        """Names of the SMRs on the flange; empty if the file has no such column."""
        return tuple(dict.fromkeys(self.table.cells.get("smr", ())))

    def of_one_point(self, angles: AngleUnit, lengths: LengthUnit) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ``in_si`` of the rows that show one point of the flange: those of the first SMR, none that is lost."""
        smrs, (q, p_M) = self.table.cells.get("smr"), self.in_si(angles, lengths)
        kept = [row for row in range(len(q)) if row not in self.lost and (smrs is None or smrs[row] == smrs[0])]
        return q[kept], p_M[kept]


def read_recorded(path: Path, taken: Sequence[str] = (), choose: Choose = nobody, most: int | None = None) -> Recorded:
    """Read a file of joint positions, points or both in any columns, and detect what these are.

    ``taken`` columns count where two may be meant; else a person is asked with ``choose``. With ``most`` rows, for a
    first look, cells may be empty.

    Raises
    ------
    InputError
        If it cannot be read, has no header row, has a gap in the joints, or a cell that is not a number.
    """
    file = read_header(path, "joint positions and points", EXAMPLES["readings"])
    stripped = ((line, [cell.strip() for cell in row]) for line, row in itertools.islice(file.rows(), most))
    rows = [(line, row) for line, row in stripped if any(row)]
    if len(rows) < _LEAST_ROWS:
        raise InputError(f"{path}: expected a row of names and at least {_LEAST_ROWS} rows of readings")
    cells = _plain_columns(dict(zip(file.names, zip(*(row for _, row in rows), strict=True), strict=True)))
    cells, of_units = _of_one_unit(*_cartesian(path, cells))
    table = CsvTable(path, tuple(line for line, _ in rows), cells)
    written, _ = written_orientation(table.names)
    if written is not None and _are_joints(table, written):
        written, notes = None, list[str]()
    else:
        table, notes = with_quaternions(table)
    where, names, row = f"{path}:{file.head}", table.names, [its[0] for its in table.cells.values()]
    known = understood(names, "readings", _OWN, written, taken, row)
    while (name := next((name for name in known.doubled if name in POINT or name.startswith("q")), None)) is not None:
        meant = known.doubled[name]
        if (answer := choose(f"Which column is {name}?", meant)) not in meant:
            raise InputError(
                f"{where}: {name}: two columns seem to be it ({', '.join(meant)}); give the one that is: --column NAME"
            )
        taken = (*taken, answer)
        known = understood(names, "readings", _OWN, written, taken, row)
    _check_joints(path, file.head, file.names, known)
    table = CsvTable(path, table.lines, dict(zip(known.names, table.cells.values(), strict=True)))
    joints = _joints(table.names)
    points = POINT if set(POINT) <= {*table.names} else ()
    notes += of_units
    if known.smrs:
        table, of_smrs = _row_per_smr(table, known)
        notes.append(of_smrs)
    elif points:
        table, said = _with_points(table)
        notes += said
    if most is None:
        _check_numbers(table, (*joints, *points))
    lost = lost_points(_values(table, joints), _values(table, POINT)) if points else {}
    notes += [f"{table.place(table.lines[row])}: {words}: the beam was lost there" for row, words in lost.items()]
    lengths = _stated(path, known, points, _LENGTHS) or length_unit(_values(table, points)) if points else "m"
    stamps, clock = _clock(table, known)
    return Recorded(
        path,
        _SEPARATORS[file.separator],
        file.decimal_comma,
        table,
        known,
        angles=_stated(path, known, joints, _ANGLES) or angle_unit(_values(table, joints)),
        lengths=lengths,
        notes=(*notes, *(() if not known.ordered else known.said[-1:])),
        stamps=stamps,
        clock=clock,
        lost=frozenset(lost),
        taken=tuple(taken),
    )


def _are_joints(table: CsvTable, written: Written) -> bool:
    """Return whether q0 to q3 are joint positions: there are no others, and their squares do not add up to one."""
    if len(written.columns) != 4 or _joints([*understood(table.names, "readings", _OWN, written).others]):
        return False
    return not np.allclose(np.linalg.norm(_values(table, written.columns), axis=1), 1.0, atol=_UNIT_LENGTH)


def _clock(table: CsvTable, known: Understood) -> tuple[NDArray[np.float64] | None, float | None]:
    """Return the times of the rows, and their unit where names or their size since 1970 decide it."""
    cells = table.cells.get("time_s")
    if cells is None:
        return None, None
    if not all(map(is_number, cells)):
        stamps = np.array([stamp_seconds(cell) for cell in cells])
        return (None, None) if np.isnan(stamps).any() else (stamps, 1.0)
    stamps = _values(table, ["time_s"])[:, 0]
    if FRACTION in table.cells:
        return stamps + known.factors[FRACTION] * _values(table, [FRACTION])[:, 0], 1.0
    found = time_unit(stamps) if len(stamps) > 1 else None
    since_1970 = UNITS_OF_TIME[found[0]] if found is not None and "1970" in found[1] else None
    return stamps, known.factors.get("time_s", since_1970 if "time_s" in known.others else 1.0)


def _plain_columns(columns: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Give each number of a list, as ``[0.1, 0.2]``, a column of its own, and move units from cells to names."""
    found = dict[str, tuple[str, ...]]()
    for name, cells in columns.items():
        lists = [match[1].split(",") for cell in cells if (match := _LIST.fullmatch(cell))]
        units = {match[2] for cell in cells if (match := _WITH_UNIT.fullmatch(cell))}
        if len(lists) == len(cells) and len({*map(len, lists)}) == 1:
            ends = "xyz" if len(lists[0]) == 3 else range(1, len(lists[0]) + 1)
            parts = (tuple(map(str.strip, its)) for its in zip(*lists, strict=True))
            found |= {f"{name} {end}": its for end, its in zip(ends, parts, strict=True)}
        elif len(units) == 1 and all(map(_WITH_UNIT.fullmatch, cells)):
            (unit,) = units
            found[f"{name} [{unit}]"] = tuple(cell.removesuffix(unit).strip() for cell in cells)
        else:
            found[name] = cells
    return found


def _cartesian(path: Path, columns: _Cells) -> tuple[_Cells, list[str]]:
    """Make points of range, azimuth, and zenith angle or elevation, where there are no others; say how."""
    if set(POINT) <= {*understood([*columns], "readings", _OWN).names}:
        return columns, []
    parts = {kind: name for kind, words in _SPHERICAL.items() for name in columns if words & _words(name)}
    height = next((kind for kind in ("zenith", "elevation", "vertical") if kind in parts), "")
    if not height or not {"range", "azimuth"} <= parts.keys():
        return columns, []
    if height == "vertical":
        raise InputError(
            f"{path}: {parts[height]}: from the zenith or from the horizon? Name the column zenith or elevation, with"
            " its unit, as 'zenith [gon]'"
        )
    found = dict[str, NDArray[np.float64]]()
    for kind, quantity, units in (("range", "length", "m"), ("azimuth", "angle", "gon"), (height, "angle", "gon")):
        if (factor := without_unit(parts[kind], quantity)[1]) is None:
            raise InputError(f"{path}: {parts[kind]}: expected its unit in its name, as '{parts[kind]} [{units}]'")
        found[kind] = factor * np.array([*map(_number, columns[parts[kind]])])
    clockwise = bool({"hz", "cw", "clockwise"} & _words(parts["azimuth"]))
    azimuth = -found["azimuth"] if clockwise else found["azimuth"]
    above = found[height] if height == "elevation" else 0.5 * np.pi - found[height]
    level = found["range"] * np.cos(above)
    p_M = (level * np.cos(azimuth), level * np.sin(azimuth), found["range"] * np.sin(above))
    kept = {name: its for name, its in columns.items() if name not in parts.values()}
    points = {f"{axis} [m]": tuple(map(repr, its.tolist())) for axis, its in zip("xyz", p_M, strict=True)}
    how = "clockwise, as Hz of a theodolite" if clockwise else "counter-clockwise, as it is not named Hz or clockwise"
    listed = ", ".join(parts[kind] for kind in found)
    words = f"{listed}: points by range, azimuth and {height} of the tracker, the azimuth seen from above {how}"
    return kept | points, [words]


def _words(name: str) -> set[str]:
    return {*re.findall("[a-z]+", name.lower())}


def _of_one_unit(columns: _Cells, notes: list[str]) -> tuple[_Cells, list[str]]:
    """Give joint positions in radians if their names state several units, or one in which joints are rarely given."""
    known = understood([*columns], "readings", _OWN)
    joints = _joints(known.names)
    stated = {known.others[name]: known.factors[name] for name in joints if name in known.factors}
    units = {*stated.values()}
    if not units or len(stated) < len(joints) or (len(units) == 1 and units <= {*_ANGLES.values()}):
        return columns, notes
    found = dict[str, tuple[str, ...]]()
    for name, cells in columns.items():
        factor, stem = stated.get(name, 0.0), without_unit(name, "angle")[0]
        numbers = (repr(factor * float(cell)) if is_number(cell) else cell for cell in cells)
        found |= {f"{stem.strip()} [rad]": tuple(numbers)} if factor else {name: cells}
    return found, [*notes, f"joint positions in the units that their names state: {', '.join(stated)}"]


def _with_points(table: CsvTable) -> tuple[CsvTable, list[str]]:
    """Leave out rows whose point is no number at all, as programs write NaN or stars for a lost beam; say so."""
    kept, lost = list[int](), list[int]()
    for row, cells in enumerate(zip(*(table.cells[name] for name in POINT), strict=True)):
        (kept if any(map(re.compile(r"\d").search, cells)) else lost).append(row)
    if not lost:
        return table, []
    listed = ", ".join(table.place(table.lines[row]) for row in lost[:_MOST_NAMED])
    what = " ".join(short(table.cells[name][lost[0]] or "nothing", 8) for name in POINT)
    more = f" and {len(lost) - _MOST_NAMED} more" if len(lost) > _MOST_NAMED else ""
    return table.take(kept), [f"{listed}{more}: {what} for a point: left out"]


def _row_per_smr(table: CsvTable, known: Understood) -> tuple[CsvTable, str]:
    """Give each SMR of a row a row of its own. Raise ``InputError`` if their distances say that they are none."""
    own = dict(zip(known.smrs, (POINT, *[*known.smrs.values()][1:])))
    p = {smr: _values(table, its) for smr, its in own.items()}
    (name, first), *rest = p.items()
    apart = {smr: np.linalg.norm(its - first, axis=1) for smr, its in rest}
    for its in apart.values():
        if not np.nanstd(its) <= _RIGID * np.nanmean(its) or np.nanmean(its) <= _APART * np.nanstd(first):
            listed = "; ".join(map(", ".join, known.smrs.values()))
            raise InputError(
                f"{table.path}: points: which columns? {listed}: no SMRs on one flange, as their distance is"
                f" {np.nanmin(its):g} to {np.nanmax(its):g}; give a column of the point with --column NAME"
            )
    kept = [(row, smr) for row in range(len(table.lines)) for smr in own if np.isfinite(p[smr][row]).all()]
    both = table.take([row for row, _ in kept])
    cells = {name: its for name, its in both.cells.items() if not any(name in columns for columns in own.values())}
    cells |= {axis: tuple(table.cells[own[smr][k]][row] for row, smr in kept) for k, axis in enumerate(POINT)}
    cells = {"configuration": tuple(str(row) for row, _ in kept)} | cells | {"smr": tuple(smr for _, smr in kept)}
    words = [f"{smr} is {np.nanmean(its):.6g} from {name}" for smr, its in apart.items()]
    return replace(both, cells=cells), f"SMRs {', '.join(own)} in each row: {', '.join(words)}"


def converted(
    recorded: Recorded, angles: AngleUnit, lengths: LengthUnit, arm: str, clock: float | None = None
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return header and rows of the same readings in the columns of cellapp.

    Rows get numbers and the name of the ``arm`` if the file has none; those of several SMRs share that of their stop.
    Unknown columns keep name and text.
    """
    table, others, n = recorded.table, recorded.known.others, len(recorded.table.lines)
    q, p_M = recorded.in_si(angles, lengths)
    made = {name: its for name, its in zip(recorded.joints, q.T) if _ANGLES[angles] != 1.0}
    made |= {name: its for name, its in zip(POINT, p_M.T) if _LENGTHS[lengths] != 1.0}
    clock = recorded.clock or clock
    if "time_s" in others and recorded.stamps is not None and clock is not None:
        made["time_s"] = (recorded.stamps - recorded.stamps[0]) * clock
    parts = _MADE & others.keys()
    made |= with_sigma(
        {
            name: _values(table, [name])[:, 0] * recorded.known.factors.get(name, _LENGTHS[lengths])
            for name in parts - {FRACTION}
        }
    )
    texts = {name: tuple("" if math.isnan(one) else repr(one) for one in its.tolist()) for name, its in made.items()}
    columns = dict[str, tuple[str, ...]]()
    for name, its in table.cells.items():
        used = name in made or (READINGS.find(name) and name not in ("time_s", OF_SOCKETS)) or name not in others
        if name not in parts:
            columns[f"{name} (not used)" if name == OF_SOCKETS else name if used else others[name]] = its
    given = {"configuration": tuple(map(str, _stops(q, table.cells.get("smr")))), "arm": (arm,) * n}
    whole = {name: its for name, its in given.items() if name not in columns} | columns | texts
    whole = dict(sorted(whole.items(), key=lambda one: not READINGS.find(one[0])))
    return tuple(whole), list(zip(*whole.values(), strict=True))


def _stops(q: NDArray[np.float64], smrs: Sequence[str] | None) -> list[int]:
    """Number the rows by stop: SMRs of one stop stand one after another, at the same joint positions."""
    found, seen = [0], {"" if smrs is None else smrs[0]}
    for row in range(1, len(q)):
        moved = smrs is None or smrs[row] in seen or np.abs(q[row] - q[row - 1]).max() > SAME_STOP_RAD
        seen = {"" if smrs is None else smrs[row]} | (set() if moved else seen)
        found.append(found[-1] + moved)
    return found


# -- inside -----------------------------------------------------------------------------------------------------------


def _joints(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(sorted((name for name in names if re.fullmatch(r"q[1-9]\d?", name)), key=lambda name: int(name[1:])))


def _values(table: CsvTable, names: Sequence[str]) -> NDArray[np.float64]:
    return np.array([[*map(_number, table.cells[name])] for name in names]).T


def _number(cell: str) -> float:
    return float(cell) if cell.strip() and is_number(cell) else math.nan


def _check_joints(path: Path, line: int, there: Sequence[str], known: Understood) -> None:
    """Refuse a file without joints, or with a gap in them or in the coordinates of points."""
    joints, seen = _joints(known.names), short(", ".join(there), 200)
    points, problems = [name for name in POINT if name in known.names], Problems(lambda _: f"{path}:{line}")
    if not joints or joints != tuple(f"q{number}" for number in range(1, len(joints) + 1)):
        text = f"expected columns such as q1, q2, ... without a gap; the file has {seen}"
        if points and not joints:
            text += (
                ". Points of a motion are imported with the file of its joints: give that one to 'cellapp init"
                " NAME --readings FILE'; its next command takes these points, too, where they lie beside it"
            )
        problems.add(1, "joint positions", text)
    for name in POINT:
        if points and name not in points:
            problems.add(1, name[0], f"expected a column such as {name}m; the file has {seen}")
    problems.check()


def _check_numbers(table: CsvTable, names: Sequence[str]) -> None:
    problems = Problems(table.place)
    for name in names:
        for line, cell in zip(table.lines, table.cells[name], strict=True):
            if not (NUMBER.fullmatch(cell.strip()) and math.isfinite(float(cell))):
                problems.add(line, name, f"expected a number, got '{short(cell)}'")
    problems.check()


def _stated(path: Path, known: Understood, names: Sequence[str], units: Mapping[_Unit, float]) -> _Unit | None:
    """Return the unit that the names of columns state; cellapp's own names state SI."""
    factors = {known.factors[name] for name in names if name in known.factors}
    factors |= {1.0 for name in names if name not in known.others}
    if len(factors) > 1:
        columns = ", ".join(known.others.get(name, name) for name in names)
        raise InputError(f"{path}: columns {columns} have different units; give them the same one")
    return next((unit for unit, factor in units.items() if {factor} == factors), None)
