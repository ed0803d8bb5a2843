"""Convert a table of D-H rows to the file of an arm type: columns theta, d, a, alpha with units in the headings."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

import yaml

from cellapp.cell.run.csv_text import NUMBER, CsvTable, Problems, check_names, read_csv_table, short
from cellapp.ground.errors import InputError

_ANGLES, _LENGTHS = ("theta", "alpha"), ("d", "a")
_UNITS = {"deg": math.pi / 180.0, "rad": 1.0, "m": 1.0, "mm": 1e-3}
_HEADING = re.compile(r"(theta|d|a|alpha)_(deg|rad|m|mm)")
_FEWEST = 2
_EXAMPLE = "theta_deg,d_mm,a_mm,alpha_deg"


def arm_type_text(path: Path, *, modified: bool = False) -> str:
    """Convert D-H rows, one for each joint, to the YAML of an arm type; its joint limits allow two turns.

    Standard rows are ``rot_z(q + theta) trans(a, 0, d) rot_x(alpha)``. Modified ones (Craig, Introduction to Robotics,
    section 3.4: ``rot_x(alpha) trans(a, 0, 0) rot_z(q + theta) trans(0, 0, d)``, where ``a`` and ``alpha`` of a row lie
    before its joint) are the same chain with ``a`` and ``alpha`` one row later; those of the first belong to the base.

    Raises
    ------
    InputError
        If the file cannot be read, a heading is missing or has no unit, or a cell is no number.
    """
    table = read_csv_table(path, "D-H rows", "a row per joint")
    rows = _rows(table)
    if modified:
        after = [(a, alpha) for _, _, a, alpha in rows[1:]] + [(0.0, 0.0)]
        rows = [(theta, d, *link) for (theta, d, _, _), link in zip(rows, after, strict=True)]
    joints = [dict(zip(("theta", "d", "a", "alpha"), map(float, row), strict=True)) for row in rows]
    content = {"model": path.stem, "source": f"D-H rows of {path.name}", "joints": joints}
    head = (
        "# D-H (standard): A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha); numbers are SI (m, rad).\n"
        "# limit, speed, mass, center_of_mass and capsules may be added; see the arm types that come with cellapp.\n"
    )
    return head + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def _rows(table: CsvTable) -> list[tuple[float, float, float, float]]:
    """Return theta, d, a, alpha of each joint [rad, m]."""
    problems = Problems(table.place)
    check_names(table, problems)
    headings = {match.group(1): name for name in table.names if (match := _HEADING.fullmatch(name.lower()))}
    for quantity in (*_ANGLES, *_LENGTHS):
        if quantity not in headings:
            units = "deg or rad" if quantity in _ANGLES else "mm or m"
            problems.add(1, quantity, f"expected a column {quantity}_UNIT with {units}; write the header as {_EXAMPLE}")
    problems.check()
    columns = {quantity: _numbers(table, name, problems) for quantity, name in headings.items()}
    problems.check()
    if len(table.lines) < _FEWEST:
        raise InputError(f"{table.path}: expected a row for each of at least {_FEWEST} joints")
    return list(zip(*(columns[quantity] for quantity in ("theta", "d", "a", "alpha")), strict=True))


def _numbers(table: CsvTable, name: str, problems: Problems) -> Sequence[float]:
    factor = _UNITS[name.lower().rpartition("_")[2]]
    if (name.lower().partition("_")[0] in _ANGLES) != (name.lower().rpartition("_")[2] in ("deg", "rad")):
        problems.add(1, name, "the unit does not fit the quantity")
    values = []
    for line, cell in zip(table.lines, table.cells[name], strict=True):
        text = cell.strip()
        if not NUMBER.fullmatch(text):
            problems.add(line, name, f"expected a number, got '{short(text)}'")
            return []
        values.append(float(text) * factor)
    return values
