"""Read a CSV file of targets as plain data: a header row, then a row per target. Units are in the columns' names.

    name, arm                                   as in YAML
    frame                                       base (or empty), tracker, an arm, or a work frame of the YAML file that
                                                names this file
    x_mm, y_mm, z_mm                            SMR position; or x_m, y_m, z_m
    roll_deg, pitch_deg, yaw_deg                flange rotation; or _rad; or qw, qx, qy, qz; or the rotation vector
                                                rx_deg, ry_deg, rz_deg (_rad)
    tolerance_mm                                or _m, _um
    orientation_tolerance_mrad                  or _rad, _deg
    approach1 .. approachN                      preferred sign of each joint's last motion: -1, 0, 1
    payload_kg, temperature_c, time_s, dwell_s  working conditions
    partner_arm, partner_x_mm, ...              other arm of a cooperative target: arm, position, rotation, conditions

Only name, arm and the position are required. An empty cell means that the value is not given. All coordinates of a file
have the same unit, and so have all angles.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cellapp.cell.profile.messages import KeyPath
from cellapp.cell.run.csv_text import (
    COMMENTS,
    NUMBER,
    CsvTable,
    Problems,
    check_names,
    read_csv_table,
    short,
    unquoted_text,
)
from cellapp.cell.targets.target_source import TargetSource
from cellapp.ground.counting import did_you_mean
from drivers.quantities import parse_quantity

_WORDS: Mapping[str, KeyPath] = {
    "name": ("name",),
    "arm": ("arm",),
    "frame": ("frame",),
    "partner_arm": ("partner", "arm"),
    "partner_moves": ("partner", "moves"),
}


@dataclass(frozen=True)
class _CsvQuantity:
    """Contents of a column of numbers: its key in a target, its kind for ``parse_quantity``, and allowed units."""

    path: KeyPath
    kind: str
    units: tuple[str, ...]


def _vector(key: str, kind: str, units: tuple[str, ...], *names: str) -> dict[str, _CsvQuantity]:
    return {name: _CsvQuantity((key, place), kind, units) for place, name in enumerate(names)}


_OF_ONE_ARM: Mapping[str, _CsvQuantity] = {
    **_vector("position", "length", ("mm", "m"), "x", "y", "z"),
    **_vector("rpy", "angle", ("deg", "rad"), "roll", "pitch", "yaw"),
    **_vector("rotation_vector", "angle", ("deg", "rad"), "rx", "ry", "rz"),
    **_vector("quaternion", "", (), "qw", "qx", "qy", "qz"),
    "payload": _CsvQuantity(("conditions", "payload"), "mass", ("kg",)),
    "temperature": _CsvQuantity(("conditions", "temperature"), "temperature", ("c",)),
    "time": _CsvQuantity(("conditions", "time"), "time", ("s",)),
    "dwell": _CsvQuantity(("conditions", "dwell"), "time", ("s",)),
}
_QUANTITIES: Mapping[str, _CsvQuantity] = {
    **_OF_ONE_ARM,
    "tolerance": _CsvQuantity(("tolerance",), "length", ("mm", "m", "um")),
    "orientation_tolerance": _CsvQuantity(("orientation_tolerance",), "angle", ("mrad", "rad", "deg")),
    **{f"partner_{name}": replace(of, path=("partner", *of.path)) for name, of in _OF_ONE_ARM.items()},
}
"""Quantities by the name of their column without its unit."""
_UNITS = {"c": "degC"}
"""Units that are written differently in columns than in ``parse_quantity``."""
_PER_JOINT = re.compile(r"approach([1-9][0-9]*)")
_MIXED = {"position": "coordinates", "rpy": "angles", "rotation_vector": "angles"}
"""Quantities that must have the same unit throughout a file."""


@dataclass(frozen=True)
class _Column:
    """Column of numbers: its name, its key in a target, its unit as written, and that unit in SI."""

    name: str
    path: KeyPath
    unit: str
    factor: float


def is_csv(path: Path) -> bool:
    """Return whether a file is CSV: by its first line, a header row with ``arm`` or a key of YAML, else by its name."""
    with suppress(OSError), path.open(encoding="utf-8-sig", errors="replace") as file:
        first = next((line for line in map(str.strip, file) if line and not line.startswith(COMMENTS)), "")
        if ":" in first or re.search(r"\barm\b", first):
            return ":" not in first
    return path.suffix.lower() == ".csv"


def read_csv(path: Path, joints: Mapping[str, int]) -> TargetSource:
    """Read a file; ``joints`` maps arms to their numbers of joints.

    Raises
    ------
    InputError
        With file, line and column of what is missing, unknown or not a number.
    """
    return source_of_table(read_csv_table(path, "targets", "a row per target"), joints)


def source_of_table(table: CsvTable, joints: Mapping[str, int]) -> TargetSource:
    """Convert a table, from a file or from memory, into a source; ``joints`` and errors are as in ``read_csv``."""
    problems = Problems(table.place)
    columns = _columns(table, problems)
    problems.check()
    if not table.lines:
        problems.add(1, "targets", "there is a header row but no target; expected a row for each")
    rows: list[dict[str, Any]] = [{} for _ in table.lines]
    _fill(rows, table, columns, joints, problems)
    problems.check()
    names = {column.path: column.name for column in columns} | {path: name for name, path in _WORDS.items()}

    def place(location: KeyPath) -> str:
        row = location[1] if len(location) > 1 else None
        return table.place(table.lines[row] if isinstance(row, int) and row < len(table.lines) else 1)

    def key(inside: KeyPath) -> str:
        return names.get(inside) or next((names[at] for at in names if at[: len(inside)] == inside), "")

    content = {"schema": "cellapp-targets", "version": 1, "targets": rows}
    return TargetSource(content, place, key, _words)


def _words(text: str) -> str:
    """Return a message without the advice to write a unit after a number."""
    problem, found, _ = text.partition("; a plain number is")
    return f"{problem}; is the unit in the column's name the right one?" if found else text


# -- the header -------------------------------------------------------------------------------------------------------


def _columns(table: CsvTable, problems: Problems) -> list[_Column]:
    """Return the columns of numbers; report names that are unknown, without a unit, duplicate or missing."""
    check_names(table, problems)
    columns: list[_Column] = []
    for name in filter(None, dict.fromkeys(table.names)):
        if name in _WORDS:
            continue
        column = _column(name)
        if isinstance(column, str):
            problems.add(1, name, column)
            continue
        twice = next((other.name for other in columns if other.path == column.path), None)
        if twice is not None:
            problems.add(1, name, f"the same value as column {twice}; keep one")
        columns.append(column)
    _check_complete(table, columns, problems)
    _check_units(columns, problems)
    return columns


def _column(name: str) -> _Column | str:
    """Return the column of numbers of that name, or why it is none."""
    if match := _PER_JOINT.fullmatch(name):
        return _Column(name, ("approach", int(match.group(1)) - 1), "", 1.0)
    stem, _, unit = name.rpartition("_")
    if name in _QUANTITIES:
        found = _QUANTITIES[name]
        return f"has no unit; name it {_choices(name)}" if found.units else _Column(name, found.path, "", 1.0)
    if stem not in _QUANTITIES:
        return f"unknown column{_similar(name)}; remove it, or correct its name"
    found = _QUANTITIES[stem]
    if unit not in found.units:
        return f"'{unit}' is no unit of this column; name it {_choices(stem)}"
    return _Column(name, found.path, unit, parse_quantity(found.kind, f"1 {_UNITS.get(unit, unit)}"))


def _choices(stem: str) -> str:
    """Return the allowed names of a column."""
    return " or ".join(f"{stem}_{unit}" for unit in _QUANTITIES[stem].units) or stem


def _similar(name: str) -> str:
    known = [*_WORDS, *(f"{stem}_{unit}" for stem, of in _QUANTITIES.items() for unit in of.units), "approach1"]
    return did_you_mean(name, known, " (is '{}' meant?)")


def _check_complete(table: CsvTable, columns: Sequence[_Column], problems: Problems) -> None:
    """Report missing columns: those that every target needs, and the rest of a vector."""
    for name in ("name", "arm"):
        if name not in table.names:
            problems.add(1, name, "the column is missing")
    given = {column.path: column for column in columns}
    in_use = {path[:-1] for path in given} | {("position",)}
    if any(path[0] == "partner" for path in given) or "partner_arm" in table.names:
        in_use.add(("partner", "position"))
        if "partner_arm" not in table.names:
            problems.add(1, "partner_arm", "the column is missing")
    there = {*table.names, *(name.rpartition("_")[0] for name in table.names)}  # a wrong unit was reported already
    for stem, of in _QUANTITIES.items():
        *vector, place = of.path
        if isinstance(place, int) and tuple(vector) in in_use and of.path not in given and stem not in there:
            units = [column.unit for column in columns if column.path[:-1] == tuple(vector) and column.unit]
            problems.add(1, f"{stem}_{units[0]}" if units else _choices(stem), "the column is missing")
    joints = sorted(int(column.path[1]) for column in columns if column.path[0] == "approach")
    for joint in range(len(joints)):
        if joint not in joints:
            problems.add(1, f"approach{joint + 1}", "the column is missing")


def _check_units(columns: Sequence[_Column], problems: Problems) -> None:
    """Report mixed units."""
    first: dict[str, _Column] = {}
    for column in columns:
        what = _MIXED.get(str(column.path[-2])) if len(column.path) > 1 else None
        if what is None:
            continue
        before = first.setdefault(what, column)
        if column.unit != before.unit:
            problems.add(
                1, column.name, f"column {before.name} is in {before.unit}; give all {what} of a file in one unit"
            )


# -- the rows ---------------------------------------------------------------------------------------------------------


def _fill(
    rows: list[dict[str, Any]],
    table: CsvTable,
    columns: Sequence[_Column],
    joints: Mapping[str, int],
    problems: Problems,
) -> None:
    """Store texts and numbers under their keys; report cells that are not numbers, and incomplete vectors."""
    for name, path in _WORDS.items():
        for row, text in zip(rows, table.cells.get(name, ())):
            if text.strip() or name in ("name", "arm"):
                _enter(row, path, unquoted_text(text.strip()))
    vectors: dict[KeyPath, list[_Column]] = {}
    for column in sorted(columns, key=lambda column: column.path[-1] if isinstance(column.path[-1], int) else -1):
        if isinstance(column.path[-1], int):
            vectors.setdefault(column.path[:-1], []).append(column)
            continue
        for row, value in zip(rows, _values(table, column, problems)):
            if value is not None:
                _enter(row, column.path, value)
    for path, members in vectors.items():
        values = list(zip(*(_values(table, column, problems) for column in members)))
        if path == ("approach",):
            _fill_approach(rows, values, joints)
            continue
        for index, vector in enumerate(values):  # each row must have it completely or not at all
            if None not in vector:
                _enter(rows[index], path, vector)
            elif any(value is not None for value in vector):
                where = _cell(table, index, members[vector.index(None)].name)
                problems.add(*where, "the value is missing; the row has others of the same vector")


def _fill_approach(
    rows: list[dict[str, Any]], values: Sequence[tuple[float | None, ...]], joints: Mapping[str, int]
) -> None:
    """Store signs: an empty cell beside others is 0; columns of joints that the arm does not have may be empty."""
    for row, signs in zip(rows, values):
        if any(sign is not None for sign in signs):
            count = joints.get(str(row.get("arm")), len(signs))
            filled = max(place for place, sign in enumerate(signs, start=1) if sign is not None)
            _enter(row, ("approach",), [_whole(sign or 0.0) for sign in signs[: max(count, filled)]])


def _whole(value: float) -> float | int:
    return int(value) if value.is_integer() else value


def _values(table: CsvTable, column: _Column, problems: Problems) -> list[float | None]:
    """Return a column in SI units, None for an empty cell; report cells that are not numbers."""
    values: list[float | None] = []
    for index, cell in enumerate(table.cells[column.name]):
        text = cell.strip()
        value = float(text) if NUMBER.fullmatch(text) else math.nan
        if text and not math.isfinite(value):
            problems.add(*_cell(table, index, column.name), _no_number(text, column))
        values.append(value * column.factor if text else None)
    return values


def _no_number(text: str, column: _Column) -> str:
    got = f"got '{short(text)}'"
    if "," in text and NUMBER.fullmatch(text.replace(",", ".", 1)):
        return f"expected a number with a decimal point, {got}; write {text.replace(',', '.', 1)}"
    unit = f"; it is in {column.unit}, as the column's name says" if column.unit else ""
    return f"expected a finite number such as 0.25, {got}{unit}"


def _cell(table: CsvTable, index: int, column: str) -> tuple[int, str]:
    """Return the line of a row, and the names of its target and of a column."""
    return table.lines[index], f"target '{short(table.cells['name'][index].strip())}': {column}"


def _enter(row: dict[str, Any], path: KeyPath, value: object) -> None:
    """Store a value under its key, which may be in a section."""
    for key in path[:-1]:
        row = row.setdefault(str(key), {})
    row[str(path[-1])] = value
