"""Units of columns in files of other programs: from their names, else from values where only one is possible."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.column_names import Kind, Understood
from cellapp.cell.run.stream_columns import POINT, UNITS_OF_TIME, time_unit
from cellapp.cell.run.stream_csv import StreamTable
from cellapp.cell.run.written_orientation import QUATERNION

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
