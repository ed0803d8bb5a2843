"""Readings that somebody recorded without cellapp: other names, separators, decimal commas, degrees, millimetres.

``read_recorded`` finds out what each column is and in which units, and says where it is not sure; ``converted`` gives
the same rows as ``read_readings_csv`` reads them. Nothing is written here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.csv_text import NUMBER, Problems, short, split_row
from cellapp.cell.run.written_orientation import QUATERNION, written_orientation
from cellapp.estimation.readings.columns import COLUMNS
from cellapp.ground.errors import InputError

AngleUnit = Literal["rad", "deg"]
LengthUnit = Literal["m", "mm"]

_SEPARATORS: Mapping[str, str] = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", " ": "blanks"}
"""In this order: a file with semicolons may have decimal commas, one with tabs blanks in its names."""
COMMENTS = ("#", "%", "//")
_MOST_BYTES = 500_000_000
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")
_UNIT = re.compile(r"[\[(_ ]\s*(deg|degree|degrees|°|grad|rad|mm|m|um|µm)\s*[\])]?$", re.IGNORECASE)
_JOINT = re.compile(
    r"(?:actual_|measured_|act_|target_)?(?:joint|axis|theta|rax|ax|q|j|a|t)(?:_?pos|_?angle)?[_ .]?([1-9])"
)
_POINT = re.compile(r"(?:smr|tracker|point|pos|position|meas|measured|target|tcp|p|at960|leica)?[_ .]?([xyz])")
_UNITS_OF_NAMES: Mapping[str, str] = {
    "deg": "deg",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "grad": "deg",
    "rad": "rad",
    "mm": "mm",
    "m": "m",
    "um": "um",
    "µm": "um",
}
"""Those that are no ``AngleUnit`` or ``LengthUnit`` are refused."""
_TO_SI: Mapping[str, float] = {"rad": 1.0, "deg": math.pi / 180.0, "m": 1.0, "mm": 1e-3}
_SURELY_RAD, SURELY_DEG = 2.0 * math.pi + 0.05, 4.0 * math.pi + 0.05
"""Joint positions [rad] within the first and over more than ``_WIDE`` are radians; beyond the second are degrees."""
_WIDE = 0.3
_SURELY_M, SURELY_MM = 20.0, 100.0
"""No cell is wider than the first [m]; no tracker measures beyond the second [m]."""
_LEAST_M = 0.05
"""Points that lie closer together [m] may be in another unit."""
_LEAST_ROWS = 3


@dataclass(frozen=True)
class RecordedColumn:
    """One column: its name in the file, what it is in cellapp's names ("" for unknown), its unit by its name or ""."""

    name: str
    quantity: str
    unit: str = ""


@dataclass(frozen=True)
class Recorded:
    """A recorded file, understood as far as it says.

    Attributes
    ----------
    path : Path
    separator : str
        In words.
    decimal_comma : bool
    columns : tuple of RecordedColumn
    lines : tuple of int
        Line of each row in the file.
    rows : tuple of tuple of str
        Cells, numbers with a decimal point.
    angles, lengths : unit or ""
        Empty where neither names nor values decide.
    """

    path: Path
    separator: str
    decimal_comma: bool
    columns: tuple[RecordedColumn, ...]
    lines: tuple[int, ...]
    rows: tuple[tuple[str, ...], ...]
    angles: AngleUnit | Literal[""]
    lengths: LengthUnit | Literal[""]

    @property
    def joints(self) -> int:
        """Number of joints that have a column."""
        return sum(_is_joint(column.quantity) for column in self.columns)

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the arms, in order; empty if the file has no such column."""
        index = next((i for i, column in enumerate(self.columns) if column.quantity == "arm"), None)
        return () if index is None else tuple(dict.fromkeys(row[index].strip() for row in self.rows))

    def values(self, quantities: Sequence[str]) -> NDArray[np.float64]:
        """Columns as they stand in the file, (n, m)."""
        at = [next(i for i, one in enumerate(self.columns) if one.quantity == name) for name in quantities]
        return np.array([[float(row[i]) for i in at] for row in self.rows])


def read_recorded(path: Path) -> Recorded:
    """Read a file of joint positions and points in whatever columns, and find out what they are.

    Raises
    ------
    InputError
        If it cannot be read, has no header row, lacks a joint or a coordinate, has the same quantity twice, or a cell
        that is not a number.
    """
    lines = _text_lines(path)
    separator = next((sign for sign in _SEPARATORS if sign in lines[0][1]), " ")
    cells = [(number, split_row(line, separator)) for number, line in lines]
    (_, names), body = cells[0], cells[1:]
    if sum(_is_number(name) for name in names) > len(names) // 2:
        raise InputError(
            f"{path}:{lines[0][0]}: the first row has numbers; write a row with the names of the columns above it, such"
            " as q1,q2,q3,q4,q5,q6,x,y,z"
        )
    comma = separator != "," and any(DECIMAL_COMMA.fullmatch(cell) for _, row in body for cell in row)
    body = [(n, [_point(cell) if comma else cell for cell in row]) for n, row in body]
    names, body = _with_quaternions(path, names, body)
    columns = _columns(path, lines[0][0], names)
    rows = _rows(path, columns, body)
    found = Recorded(
        path, _SEPARATORS[separator], comma, columns, tuple(n for n, _ in body), tuple(rows), angles="", lengths=""
    )
    return _with_units(found)


def converted(
    recorded: Recorded, angles: AngleUnit, lengths: LengthUnit, arm: str
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows of the same readings, as ``read_readings_csv`` reads them.

    Rows get numbers and the name of the ``arm`` where the file has none. Columns that nobody knows are left out.
    """
    known = [(i, column) for i, column in enumerate(recorded.columns) if column.quantity]
    present = {column.quantity for _, column in known}
    head = [name for name in ("configuration", "arm") if name not in present]
    factors = [_TO_SI[_unit(column, angles, lengths)] if _is_scaled(column.quantity) else None for _, column in known]
    rows = []
    for number, row in enumerate(recorded.rows):
        given = {"configuration": str(number), "arm": arm}
        cells = [_scaled(row[i], factor) for (i, _), factor in zip(known, factors, strict=True)]
        rows.append((*(given[name] for name in head), *cells))
    return (*head, *(_si_name(column.quantity) for _, column in known)), rows


# -- the text ---------------------------------------------------------------------------------------------------------


def _text_lines(path: Path) -> list[tuple[int, str]]:
    """Lines with their numbers, without comments and blank ones."""
    try:
        if not path.is_file():
            raise InputError(f"{path}: file not found; give a text file of joint positions and points")
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")  # what spreadsheets of western systems write
    if "\x00" in text:
        raise InputError(f"{path}: not a text file; export the table as CSV")
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    kept = [(number, line) for number, line in lines if line.strip(" ;,\t|") and not line.startswith(COMMENTS)]
    if len(kept) < 1 + _LEAST_ROWS:
        raise InputError(f"{path}: expected a row of names and at least {_LEAST_ROWS} rows of readings")
    return kept


def _is_number(cell: str) -> bool:
    return bool(NUMBER.fullmatch(cell) or DECIMAL_COMMA.fullmatch(cell))


def _point(cell: str) -> str:
    return cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell


def _with_quaternions(
    path: Path, names: list[str], body: list[tuple[int, list[str]]]
) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Names and rows with the orientation of a probe as a quaternion, where the names say how it is written."""
    written, _ = written_orientation(names)
    if written is None or any(len(row) != len(names) for _, row in body):
        return names, body
    at = {name: place for place, name in enumerate(names)}
    own_cells = {name: [row[at[name]] for _, row in body] for name in written.columns}
    found = written.quaternions(own_cells, lambda row: f"{path}:{body[row][0]}")
    kept = [place for place, name in enumerate(names) if name not in written.columns]
    rows = [(n, [*(row[place] for place in kept), *own]) for (n, row), own in zip(body, found, strict=True)]
    return [*(names[place] for place in kept), *QUATERNION], rows


# -- the columns ------------------------------------------------------------------------------------------------------


def _columns(path: Path, line: int, names: Sequence[str]) -> tuple[RecordedColumn, ...]:
    columns = tuple(_column(name) for name in names)
    joints = sorted(int(column.quantity[1:]) for column in columns if _is_joint(column.quantity))
    found = [column.quantity for column in columns if column.quantity]
    seen = ", ".join(names)
    problems = Problems(lambda row: f"{path}:{row}")
    for quantity in dict.fromkeys(one for one in found if found.count(one) > 1):
        problems.add(line, quantity, f"two columns seem to be it ({seen}); rename or remove one")
    if not joints or joints != list(range(1, len(joints) + 1)):
        problems.add(
            line, "joint positions", f"expected columns such as q1, q2, ... without a gap; the file has {seen}"
        )
    for quantity in ("x", "y", "z"):
        if quantity not in found:
            problems.add(line, quantity, f"expected a column such as {quantity}_mm; the file has {seen}")
    problems.check()
    return columns


def _column(name: str) -> RecordedColumn:
    own = _OWN_NAMES.get(name)
    if own is not None:
        return own
    match = _UNIT.search(name)
    unit = "" if match is None else _UNITS_OF_NAMES.get(match.group(1).lower(), "")
    stem = (name if match is None else name[: match.start()]).strip().lower()
    for pattern, letter in ((_JOINT, "q"), (_POINT, "")):
        if found := pattern.fullmatch(stem):
            return RecordedColumn(name, letter + found.group(1), unit)
    return RecordedColumn(name, _OTHER_NAMES.get(stem, ""), unit)


def _own_names() -> dict[str, RecordedColumn]:
    """Cellapp's own names mean what they mean there."""
    own = {f"{axis}_m": RecordedColumn(f"{axis}_m", axis, "m") for axis in "xyz"}
    for column in COLUMNS:
        if column.shape != "joints":
            for name in column.csv:
                own.setdefault(name, RecordedColumn(name, name))
    return own


_OWN_NAMES = _own_names()
_OTHER_NAMES: Mapping[str, str] = {
    "arm": "arm",
    "robot": "arm",
    "configuration": "configuration",
    "temperature": "temperature_c",
    "temp": "temperature_c",
    "payload": "payload_kg",
}


def _is_joint(quantity: str) -> bool:
    return re.fullmatch(r"q[1-9]", quantity) is not None


def _is_scaled(quantity: str) -> bool:
    return _is_joint(quantity) or quantity in ("x", "y", "z")


def _si_name(quantity: str) -> str:
    return f"{quantity}_m" if quantity in ("x", "y", "z") else quantity


def _unit(column: RecordedColumn, angles: AngleUnit, lengths: LengthUnit) -> str:
    return column.unit or (angles if _is_joint(column.quantity) else lengths)


def _scaled(cell: str, factor: float | None) -> str:
    return cell if factor is None or factor == 1.0 else repr(float(cell) * factor)


# -- the rows ---------------------------------------------------------------------------------------------------------


def _rows(
    path: Path, columns: Sequence[RecordedColumn], body: Sequence[tuple[int, Sequence[str]]]
) -> list[tuple[str, ...]]:
    """All rows, each as long as the header, with numbers where numbers must be."""
    problems = Problems(lambda row: f"{path}:{row}")
    for line, row in body:
        if len(row) != len(columns):
            problems.add(line, "row", f"it has {len(row)} cells, the header has {len(columns)}")
            continue
        for cell, column in zip(row, columns, strict=True):
            if _is_scaled(column.quantity) and not (NUMBER.fullmatch(cell) and math.isfinite(float(cell))):
                problems.add(line, column.name, f"expected a number, got '{short(cell)}'")
    problems.check()
    return [tuple(row) for _, row in body]


def _with_units(found: Recorded) -> Recorded:
    """Units by the names of the columns, else by the size of the values where that decides."""
    joints = [column for column in found.columns if _is_joint(column.quantity)]
    points = [column for column in found.columns if column.quantity in ("x", "y", "z")]
    angles, lengths = _stated(found.path, joints, ("rad", "deg")), _stated(found.path, points, ("m", "mm"))
    q = found.values([column.quantity for column in joints])
    p = found.values(["x", "y", "z"])
    return replace(
        found,
        angles=cast(AngleUnit, angles) if angles else _angles_by_size(q),
        lengths=cast(LengthUnit, lengths) if lengths else _lengths_by_size(p),
    )


def _stated(path: Path, columns: Sequence[RecordedColumn], possible: Sequence[str]) -> str:
    units = {column.unit for column in columns} - {""}
    if len(units) > 1:
        names = ", ".join(column.name for column in columns)
        raise InputError(f"{path}: columns {names} have different units; give them the same one")
    for unit in units - set(possible):
        raise InputError(f"{path}: column {columns[0].name}: '{unit}' does not fit; expected {' or '.join(possible)}")
    return next(iter(units), "")


def _angles_by_size(q: NDArray[np.float64]) -> AngleUnit | Literal[""]:
    largest, widest = float(np.abs(q).max()), float(np.ptp(q, axis=0).max())
    if largest > SURELY_DEG:
        return "deg"
    return "rad" if largest <= _SURELY_RAD and widest > _WIDE else ""


def _lengths_by_size(p: NDArray[np.float64]) -> LengthUnit | Literal[""]:
    largest, widest = float(np.abs(p).max()), float(np.ptp(p, axis=0).max())
    if largest > SURELY_MM:
        return "mm"
    return "m" if largest <= _SURELY_M and widest > _LEAST_M else ""
