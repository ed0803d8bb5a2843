"""Readings recorded by other programs: other names, separators, decimal commas, degrees, millimetres.

``read_recorded`` detects what each column is and in which unit, and says where that is ambiguous; ``converted`` gives
the same rows in the format of ``read_readings_csv``. Nothing is written here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.arm_cells import is_known, not_per_joint
from cellapp.cell.run.columns import (
    EXAMPLES,
    POINT,
    AngleUnit,
    LengthUnit,
    Understood,
    angle_unit,
    length_unit,
    understood,
    with_quaternions,
)
from cellapp.cell.run.csv_text import NUMBER, CsvTable, Problems, read_header, short
from cellapp.ground.errors import InputError

_SEPARATORS: Mapping[str, str] = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", " ": "blanks"}
_ANGLES: Mapping[AngleUnit, float] = {"rad": 1.0, "deg": math.pi / 180.0}
_LENGTHS: Mapping[LengthUnit, float] = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
_Unit = TypeVar("_Unit")
_OWN = {name for column in not_per_joint() for name in column.csv} | {"arm"}
"""Cellapp's own column names keep their meaning; names of joint positions state no unit."""
_LEAST_ROWS = 3


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
        How columns of an orientation were interpreted.
    """

    path: Path
    separator: str
    decimal_comma: bool
    table: CsvTable
    known: Understood
    angles: AngleUnit | None
    lengths: LengthUnit | None
    notes: tuple[str, ...] = ()

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
        """Columns that are not used."""
        return tuple(name for name in self.table.names if not is_known(name))

    def in_si(self, angles: AngleUnit, lengths: LengthUnit) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return joint positions (n, N) [rad] and points (n, 3) [m]."""
        return _values(self.table, self.joints) * _ANGLES[angles], _values(self.table, POINT) * _LENGTHS[lengths]


def read_recorded(path: Path) -> Recorded:
    """Read a file of joint positions and points in any columns, and detect what these are.

    Raises
    ------
    InputError
        If it cannot be read, has no header row, lacks a joint or a coordinate, or a cell that is not a number.
    """
    file = read_header(path, "joint positions and points", EXAMPLES["readings"])
    stripped = ((line, [cell.strip() for cell in row]) for line, row in file.rows())
    rows = [(line, row) for line, row in stripped if any(row)]
    if len(rows) < _LEAST_ROWS:
        raise InputError(f"{path}: expected a row of names and at least {_LEAST_ROWS} rows of readings")
    cells = zip(*(row for _, row in rows), strict=True)
    table = CsvTable(path, file.names, tuple(line for line, _ in rows), dict(zip(file.names, cells, strict=True)))
    table, notes = with_quaternions(table)
    known = understood(table.names, "readings", _OWN)
    _check_columns(f"{path}:{file.head}", file.names, known)
    table = CsvTable(path, known.names, table.lines, dict(zip(known.names, table.cells.values(), strict=True)))
    _check_numbers(table)
    joints = _joints(table.names)
    return Recorded(
        path,
        _SEPARATORS[file.separator],
        file.decimal_comma,
        table,
        known,
        angles=_stated(path, known, joints, _ANGLES) or angle_unit(_values(table, joints)),
        lengths=_stated(path, known, POINT, _LENGTHS) or length_unit(_values(table, POINT)),
        notes=tuple(notes),
    )


def converted(
    recorded: Recorded, angles: AngleUnit, lengths: LengthUnit, arm: str
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return header and rows of the same readings in the format of ``read_readings_csv``.

    Rows get numbers and the name of the ``arm`` if the file has none. Unknown columns are left out.
    """
    table = recorded.table
    columns = {name: table.cells[name] for name in table.names if is_known(name)}
    q, p_M = recorded.in_si(angles, lengths)
    for names, values, factor in ((recorded.joints, q, _ANGLES[angles]), (POINT, p_M, _LENGTHS[lengths])):
        if factor != 1.0:
            columns |= {name: tuple(map(repr, own)) for name, own in zip(names, values.T.tolist(), strict=True)}
    n = len(table.lines)
    given = {"configuration": tuple(map(str, range(n))), "arm": (arm,) * n}
    whole = {name: its for name, its in given.items() if name not in columns} | columns
    return tuple(whole), list(zip(*whole.values(), strict=True))


# -- inside -----------------------------------------------------------------------------------------------------------


def _joints(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(sorted((name for name in names if re.fullmatch(r"q[1-9]\d?", name)), key=lambda name: int(name[1:])))


def _values(table: CsvTable, names: Sequence[str]) -> NDArray[np.float64]:
    return np.array([list(map(float, table.cells[name])) for name in names]).T


def _check_columns(head: str, there: Sequence[str], known: Understood) -> None:
    """Refuse a file that lacks a joint or a coordinate."""
    joints, seen = _joints(known.names), short(", ".join(there), 200)
    problems = Problems(lambda _: head)
    for name, columns in known.doubled.items():
        problems.add(1, name, f"two columns seem to be it ({', '.join(columns)}); rename or remove one")
    if not joints or joints != tuple(f"q{number}" for number in range(1, len(joints) + 1)):
        text = f"expected columns such as q1, q2, ... without a gap; the file has {seen}"
        problems.add(1, "joint positions", text)
    for name in POINT:
        if name not in known.names and name not in known.doubled:
            problems.add(1, name[0], f"expected a column such as {name}m; the file has {seen}")
    problems.check()


def _check_numbers(table: CsvTable) -> None:
    problems = Problems(table.place)
    for name in (*_joints(table.names), *POINT):
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
