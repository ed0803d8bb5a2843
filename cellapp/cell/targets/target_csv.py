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
have the same unit, and so have all angles. A number gets the unit of its column, and is then checked as one in YAML.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from cellapp.cell.profile.messages import KeyPath, Spot, YamlDocument
from cellapp.cell.run.csv_text import COMMENTS, CsvTable, Problems, read_csv_table, unquoted_text
from cellapp.cell.run.table_spec import Named, TableSpec
from cellapp.estimation.readings.columns import Column
from cellapp.ground.counting import did_you_mean

_OF_AN_ARM = (
    Column("position", "m", ("x", "y", "z"), "point", required=True, units=("mm", "m")),
    Column("rpy", "rad", ("roll", "pitch", "yaw"), "point", units=("deg", "rad")),
    Column("rotation_vector", "rad", ("rx", "ry", "rz"), "point", units=("deg", "rad")),
    Column("quaternion", "", ("qw", "qx", "qy", "qz"), "quaternion"),
    Column("conditions.payload", "kg", ("payload",), units=("kg",)),
    Column("conditions.temperature", "degC", ("temperature",), units=("c",)),
    Column("conditions.time", "s", ("time",), units=("s",)),
    Column("conditions.dwell", "s", ("dwell",), units=("s",)),
)
_TARGETS = TableSpec(
    (
        Column("name", "", ("name",), dtype=str, required=True),
        Column("arm", "", ("arm",), dtype=str, required=True),
        Column("partner.arm", "", ("partner_arm",), dtype=str, required=True),
        Column("partner.moves", "", ("partner_moves",), dtype=str),
        Column("frame", "", ("frame",), dtype=str),
        *_OF_AN_ARM,
        Column("tolerance", "m", ("tolerance",), units=("mm", "m", "um")),
        Column("orientation_tolerance", "rad", ("orientation_tolerance",), units=("mrad", "rad", "deg")),
        *(
            replace(one, name=f"partner.{one.name}", csv=tuple(f"partner_{stem}" for stem in one.csv))
            for one in _OF_AN_ARM
        ),
        Column("approach", "", ("approach",), "joints"),
    )
)
"""Columns of targets; the name of a quantity is its key in YAML."""
_OF_STEM = {one.column.csv[one.place]: one.column for one in _TARGETS.by_name.values() if one.column.dtype is not str}
_IN_YAML = {"c": "degC"}
_MIXED = {"position": "coordinates", "rpy": "angles", "rotation_vector": "angles"}
"""Quantities that must have the same unit throughout a file."""


def is_csv(path: Path) -> bool:
    """Return whether a file is CSV: by its first line, a header row with ``arm`` or a key of YAML, else by its name."""
    with suppress(OSError), path.open(encoding="utf-8-sig", errors="replace") as file:
        first = next((line for line in map(str.strip, file) if line and not line.startswith(COMMENTS)), "")
        if ":" in first or re.search(r"\barm\b", first):
            return ":" not in first
    return path.suffix.lower() == ".csv"


def read_csv(path: Path, joints: Mapping[str, int]) -> YamlDocument:
    """Read a file; ``joints`` maps arms to their numbers of joints.

    Raises
    ------
    InputError
        With file, line and column of what is missing, unknown or not a number.
    """
    return document_of_table(read_csv_table(path, "targets", "a row per target"), joints)


def document_of_table(table: CsvTable, joints: Mapping[str, int]) -> YamlDocument:
    """Convert a table, from a file or from memory, into what YAML would say; else as ``read_csv``."""
    problems = Problems(table.place)
    columns = _columns(table, problems)
    problems.check()
    if not table.lines:
        problems.add(1, "targets", "there is a header row but no target; expected a row for each")
        problems.check()
    document = YamlDocument({"schema": "cellapp-targets", "version": 1, "targets": []})
    document.places |= {("targets",): _spot(table, 1), (): _spot(table, 1)}
    paths: dict[str, KeyPath] = {
        name: (*its.column.name.split("."), *([] if its.column.shape == "scalar" else [its.place]))
        for name, its in columns.items()
    }
    for index in range(len(table.lines)):
        document.data["targets"].append(_row(table, index, columns, paths, joints))
        at: KeyPath = ("targets", index)
        document.places[at] = _spot(table, table.lines[index], *at)
        for name, path in paths.items():
            document.places[*at, *path] = _spot(table, table.lines[index], *at, name)
            for end in range(1, len(path)):
                inside: KeyPath = (*at, *path[:end])
                document.places[inside] = _spot(table, table.lines[index], *inside)
    return document


def _spot(table: CsvTable, line: int, *inside: str | int) -> Spot:
    return Spot(str(table.path), line, inside) if table.row_places is None else Spot(table.place(line), 0, inside)


# -- the header -------------------------------------------------------------------------------------------------------


def _columns(table: CsvTable, problems: Problems) -> dict[str, Named]:
    """Return the columns, components of vectors in order; report names that are unknown, duplicate or missing."""
    columns = {name: its for name in table.names if (its := _TARGETS.find(name)) is not None}
    for name in table.names:
        if name not in columns:
            problems.add(1, name, _unknown(name))
    first: dict[str | tuple[str, int], str] = {}
    for name, (column, place, unit) in columns.items():
        if (before := first.setdefault((column.name, place), name)) != name:
            problems.add(1, name, f"the same value as column {before}; keep one")
        what = _MIXED.get(column.name.removeprefix("partner."))
        if what and (other := columns[before := first.setdefault(what, name)].unit) != unit:
            problems.add(1, name, f"column {before} is in {other}; give all {what} of a file in one unit")
    _check_complete(table, columns, problems)
    return dict(sorted(columns.items(), key=lambda one: one[1].place))


def _unknown(name: str) -> str:
    column = _OF_STEM.get(stem := name) or _OF_STEM.get(stem := name.rpartition("_")[0])
    if column is not None:
        return f"its unit is missing or none of this column; name it {_choices(stem, column)}"
    known = did_you_mean(name, [*_TARGETS.by_name, "approach1"], " (is '{}' meant?)")
    return f"unknown column{known}; remove it, or correct its name"


def _choices(stem: str, column: Column, unit: str | None = None) -> str:
    """Return the allowed names of a column; the one in this unit if it is given."""
    return " or ".join(f"{stem}_{one}" if one else stem for one in (column.units if unit is None else (unit,)))


def _check_complete(table: CsvTable, columns: Mapping[str, Named], problems: Problems) -> None:
    """Report missing columns: those that every target needs, and the rest of a vector."""
    units = {its.column.name: its.unit for its in columns.values()}
    partner = any(name.startswith("partner.") for name in units)
    there = {*table.names, *(name.rpartition("_")[0] for name in table.names)}  # a wrong unit was reported already
    for stem, column in _TARGETS.missing(columns, sum(its.column.shape == "joints" for its in columns.values())):
        wanted = stem not in there or column.shape in ("scalar", "joints")
        if wanted and (partner or not column.name.startswith("partner.")):
            problems.add(1, _choices(stem, column, units.get(column.name)), "the column is missing")


# -- the rows ---------------------------------------------------------------------------------------------------------


def _row(
    table: CsvTable, index: int, columns: Mapping[str, Named], paths: Mapping[str, KeyPath], joints: Mapping[str, int]
) -> dict[str, Any]:
    """Return the keys of one target; an empty cell of a vector that has others is None, a sign among others 0."""
    row: dict[str, Any] = {}
    vectors: dict[KeyPath, list[Any]] = {}
    for name, (column, _, unit) in columns.items():
        text = table.cells[name][index].strip()
        if column.dtype is str:
            if text or name in ("name", "arm"):
                _enter(row, paths[name], unquoted_text(text))
        elif column.shape != "scalar":
            vectors.setdefault(paths[name][:-1], []).append(_value(text, unit))
        elif text:
            _enter(row, paths[name], _value(text, unit))
    for path, vector in vectors.items():
        filled = max((place for place, value in enumerate(vector, start=1) if value is not None), default=0)
        if path == ("approach",):  # columns of joints that the arm does not have may be empty
            vector = [sign or 0 for sign in vector[: max(joints.get(str(row.get("arm")), len(vector)), filled)]]
        if filled:
            _enter(row, path, vector)
    return row


def _value(text: str, unit: str) -> str | float | int | None:
    """Return a cell as it would be in YAML, a whole number as such; None if it is empty."""
    if unit or not text:
        return f"{text} {_IN_YAML.get(unit, unit)}" if text else None
    try:
        value = float(text)
    except ValueError:
        return text
    return int(value) if value.is_integer() else value


def _enter(row: dict[str, Any], path: KeyPath, value: object) -> None:
    """Store a value under its key, which may be in a section."""
    for key in path[:-1]:
        row = row.setdefault(str(key), {})
    row[str(path[-1])] = value
