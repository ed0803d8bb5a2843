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
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellapp.cell.profile.messages import KeyPath, Spot, YamlDocument
from cellapp.cell.run.csv_text import COMMENTS, CsvTable, Problems, read_csv_table, unquoted_text
from cellapp.ground.counting import did_you_mean


@dataclass(frozen=True)
class _Column:
    """Contents of a column: its name, its key in a target, its unit as written in YAML (empty: none)."""

    name: str
    path: KeyPath
    unit: str = ""

    @property
    def vector(self) -> KeyPath:
        """Key of the vector of which it is a component; empty for other columns."""
        return self.path[:-1] if isinstance(self.path[-1], int) else ()


_WORDS: Mapping[str, KeyPath] = {
    "name": ("name",),
    "arm": ("arm",),
    "frame": ("frame",),
    "partner_arm": ("partner", "arm"),
    "partner_moves": ("partner", "moves"),
}
_UNITS_OF_ONE_ARM: Mapping[str, tuple[KeyPath, tuple[str, ...]]] = {
    **{axis: (("position", place), ("mm", "m")) for place, axis in enumerate("xyz")},
    **{name: (("rpy", place), ("deg", "rad")) for place, name in enumerate(("roll", "pitch", "yaw"))},
    **{f"r{axis}": (("rotation_vector", place), ("deg", "rad")) for place, axis in enumerate("xyz")},
    **{f"q{part}": (("quaternion", place), ("",)) for place, part in enumerate("wxyz")},
    "payload": (("conditions", "payload"), ("kg",)),
    "temperature": (("conditions", "temperature"), ("c",)),
    "time": (("conditions", "time"), ("s",)),
    "dwell": (("conditions", "dwell"), ("s",)),
}
_UNITS: Mapping[str, tuple[KeyPath, tuple[str, ...]]] = {
    **_UNITS_OF_ONE_ARM,
    "tolerance": (("tolerance",), ("mm", "m", "um")),
    "orientation_tolerance": (("orientation_tolerance",), ("mrad", "rad", "deg")),
    **{f"partner_{stem}": (("partner", *path), units) for stem, (path, units) in _UNITS_OF_ONE_ARM.items()},
}
"""Key in a target, and possible units, by the name of a column without its unit."""
_COLUMNS: Mapping[str, _Column] = {
    name: _Column(name, path, "degC" if unit == "c" else unit)
    for stem, (path, units) in _UNITS.items()
    for unit in units
    for name in (f"{stem}_{unit}" if unit else stem,)
}
"""All columns of numbers, without those of each joint."""
_PER_JOINT = re.compile(r"approach([1-9][0-9]*)")
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
    for index in range(len(table.lines)):
        document.data["targets"].append(_row(table, index, columns, joints))
        at: KeyPath = ("targets", index)
        document.places[at] = _spot(table, table.lines[index], *at)
        for column in columns:
            document.places[*at, *column.path] = _spot(table, table.lines[index], *at, column.name)
            for end in range(1, len(column.path)):
                inside: KeyPath = (*at, *column.path[:end])
                document.places[inside] = _spot(table, table.lines[index], *inside)
    return document


def _spot(table: CsvTable, line: int, *inside: str | int) -> Spot:
    return Spot(str(table.path), line, inside) if table.row_places is None else Spot(table.place(line), 0, inside)


# -- the header -------------------------------------------------------------------------------------------------------


def _columns(table: CsvTable, problems: Problems) -> list[_Column]:
    """Return the columns, components of vectors in order; report names that are unknown, duplicate or missing."""
    columns: list[_Column] = []
    for name in table.names:
        if match := _PER_JOINT.fullmatch(name):
            columns.append(_Column(name, ("approach", int(match.group(1)) - 1)))
        elif name in _WORDS:
            columns.append(_Column(name, _WORDS[name]))
        elif name in _COLUMNS:
            columns.append(_COLUMNS[name])
        else:
            problems.add(1, name, _unknown(name))
    first: dict[KeyPath | str, _Column] = {}
    for column in columns:
        if (before := first.setdefault(column.path, column)) is not column:
            problems.add(1, column.name, f"the same value as column {before.name}; keep one")
        what = _MIXED.get(str(column.vector[-1])) if column.vector else None
        if what and (before := first.setdefault(what, column)).unit != column.unit:
            text = f"column {before.name} is in {before.unit}; give all {what} of a file in one unit"
            problems.add(1, column.name, text)
    _check_complete(table, columns, problems)
    return sorted(columns, key=lambda column: column.path[-1] if isinstance(column.path[-1], int) else -1)


def _unknown(name: str) -> str:
    stem = name if name in _UNITS else name.rpartition("_")[0]
    if stem in _UNITS:
        return f"its unit is missing or none of this column; name it {_choices(stem)}"
    known = did_you_mean(name, [*_WORDS, *_COLUMNS, "approach1"], " (is '{}' meant?)")
    return f"unknown column{known}; remove it, or correct its name"


def _choices(stem: str) -> str:
    """Return the allowed names of a column."""
    return " or ".join(f"{stem}_{unit}" if unit else stem for unit in _UNITS[stem][1])


def _check_complete(table: CsvTable, columns: Sequence[_Column], problems: Problems) -> None:
    """Report missing columns: those that every target needs, and the rest of a vector."""
    given = {column.path for column in columns}
    partner = [("partner", "position")] if any(path[0] == "partner" for path in given) else []
    for name in ["name", "arm", *("partner_arm" for _ in partner)]:
        if name not in table.names:
            problems.add(1, name, "the column is missing")
    units = {column.vector: column.unit for column in columns}
    there = {*table.names, *(name.rpartition("_")[0] for name in table.names)}  # a wrong unit was reported already
    for stem, (path, _) in _UNITS.items():
        used = path[:-1] in units or path[:-1] in [("position",), *partner]
        if isinstance(path[-1], int) and used and path not in given and stem not in there:
            unit = units.get(path[:-1])
            problems.add(1, f"{stem}_{unit}" if unit else _choices(stem), "the column is missing")
    joints = sorted(int(column.path[1]) for column in columns if column.path[0] == "approach")
    for joint in set(range(len(joints))).difference(joints):
        problems.add(1, f"approach{joint + 1}", "the column is missing")


# -- the rows ---------------------------------------------------------------------------------------------------------


def _row(table: CsvTable, index: int, columns: Sequence[_Column], joints: Mapping[str, int]) -> dict[str, Any]:
    """Return the keys of one target; an empty cell of a vector that has others is None, a sign among others 0."""
    row: dict[str, Any] = {}
    vectors: dict[KeyPath, list[Any]] = {}
    for column in columns:
        text = table.cells[column.name][index].strip()
        if column.name in _WORDS:
            if text or column.name in ("name", "arm"):
                _enter(row, column.path, unquoted_text(text))
        elif column.vector:
            vectors.setdefault(column.vector, []).append(_value(text, column.unit))
        elif text:
            _enter(row, column.path, _value(text, column.unit))
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
        return f"{text} {unit}" if text else None
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
