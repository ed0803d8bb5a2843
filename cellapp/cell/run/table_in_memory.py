"""Readings in memory: data frames and arrays as the table of cells that a CSV file of the same values gives.

Numbers become their shortest exact texts, so that they are checked as those of a file.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellapp.cell.run.csv_text import CsvTable
from cellapp.estimation.readings.columns import COLUMNS, CONFIGURATION, Column
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.model.arguments import of_arm

if TYPE_CHECKING:
    import pandas as pd

_BY_NAME = {column.name: column for column in COLUMNS}
_SHAPES = {
    "scalar": "(n,)",
    "joints": "(n, {joints})",
    "point": "(n, 3)",
    "quaternion": "(n, 4)",
    "symmetric": "(n, 3, 3)",
}


def is_frame(value: object) -> TypeGuard[pd.DataFrame]:
    """Return whether a value is a data frame of pandas, which need not be installed."""
    return type(value).__name__ == "DataFrame" and hasattr(value, "columns")


def table_of_frame(frame: pd.DataFrame) -> CsvTable:
    """Convert a data frame with the column names of a CSV file; missing values (None, NaN, NA) become empty cells.

    Messages name rows by the index of the frame.
    """
    names = tuple(str(name) for name in frame.columns)
    texts = [
        _texts(column.astype(object).where(column.notna(), None).tolist(), whole=name == CONFIGURATION.name)
        for name, (_, column) in zip(names, frame.items(), strict=True)
    ]
    places = tuple(f"data frame, row {label}" for label in frame.index.tolist())
    return CsvTable(Path("data frame"), names, _lines(len(frame)), dict(zip(names, texts, strict=True)), places)


def table_of_arrays(profile: Profile, arms: Mapping[str, Mapping[str, Any]]) -> CsvTable:
    """Convert arrays to cells.

    Parameters
    ----------
    profile : Profile
    arms : mapping
        Arm -> quantity -> array, with the names, shapes and units of ``Readings``: ``q`` (n, N) [rad] and ``p_M``
        (n, 3) [m] at least. One number stands for n equal ones. Without ``configuration`` (n,) row k is stop k, and all
        arms must have as many rows.

    Raises
    ------
    InputError
        If an arm is not in the profile, a quantity is unknown or missing, or an array has another shape.
    """
    if not arms:
        raise InputError(f"readings: no arm is given; expected arrays of {', '.join(profile.arms)}")
    given = {name: _arm_arrays(profile, name, quantities) for name, quantities in arms.items()}
    counts = {name: len(arrays["q"]) for name, arrays in given.items()}
    if len(set(counts.values())) > 1 and any(CONFIGURATION.name not in arrays for arrays in given.values()):
        words = ", ".join(f"{n} of arm {name}" for name, n in counts.items())
        raise InputError(f"readings: {words}; give 'configuration' (n,), which says what was measured at the same stop")
    joints = max(len(profile.arms[name].type.joints) for name in given)
    used = [column for column in COLUMNS if column.required or any(column.name in one for one in given.values())]
    cells: dict[str, list[str]] = {"arm": [name for name, n in counts.items() for _ in range(n)]}
    for column in used:
        parts = [_column_texts(column, given[name], joints, n) for name, n in counts.items()]
        for place, csv_name in enumerate(column.csv_names(joints)):
            cells[csv_name] = [text for part in parts for text in part[place]]
    places = tuple(f"arm {name}, row {row}" for name, n in counts.items() for row in range(n))
    table = {name: tuple(texts) for name, texts in cells.items()}
    return CsvTable(Path("readings"), tuple(table), _lines(len(places)), table, places)


# -- inside -----------------------------------------------------------------------------------------------------------


def _lines(rows: int) -> tuple[int, ...]:
    """Return line numbers of the rows; line 1 is the header, as in a file."""
    return tuple(range(2, rows + 2))


def _texts(values: list[Any], *, whole: bool = False) -> tuple[str, ...]:
    """Convert each value to its shortest exact text; whole numbers that are stored as floats get no point."""
    if whole:
        values = [int(one) if isinstance(one, float) and one.is_integer() else one for one in values]
    return tuple("" if one is None or one != one else str(one) for one in values)


def _arm_arrays(profile: Profile, name: str, quantities: Mapping[str, Any]) -> dict[str, Any]:
    """Check the quantities of one arm; return each as an array of its shape, or as n words."""
    joints = len(of_arm(profile.arms, name, f"profile {profile.name}").type.joints)
    if not isinstance(quantities, Mapping):
        raise InputError(f"arm {name}: expected names with arrays, as {{'q': ..., 'p_M': ...}}, got {quantities!r:.40}")
    for quantity in quantities:
        if quantity not in _BY_NAME:
            close = difflib.get_close_matches(quantity, _BY_NAME, n=1, cutoff=0.4)
            hint = f"; did you mean '{close[0]}'?" if close else f"; known are {', '.join(_BY_NAME)}"
            raise InputError(f"arm {name}: no quantity is called '{quantity}'{hint}")
    for column in COLUMNS:
        if column.required and column is not CONFIGURATION and quantities.get(column.name) is None:
            shape = _SHAPES[column.shape].format(joints=joints)
            raise InputError(f"arm {name}: {column.name} is missing; expected an array {shape} [{column.unit}]")
    n = len(np.atleast_1d(np.asarray(quantities["q"], dtype=object)))
    return {
        column.name: _array(f"arm {name}: {column.name}", column, quantities[column.name], n, joints)
        for column in COLUMNS
        if quantities.get(column.name) is not None
    }


def _array(where: str, column: Column, value: ArrayLike, n: int, joints: int) -> NDArray[Any]:
    """Convert a quantity to an array of its shape."""
    dtype = None if column is CONFIGURATION else object if column.dtype is str else np.float64
    try:
        array = np.asarray(value, dtype=dtype)
    except (TypeError, ValueError):
        raise InputError(f"{where} is no array of numbers; expected shape {_shape_words(column, joints)}") from None
    if array.ndim == 0 and column.shape == "scalar" and column is not CONFIGURATION:
        array = np.full(n, array, dtype=dtype)
    expected = column.array_shape(n, joints)
    if array.shape != expected:
        single = "; a single row is array[np.newaxis]" if array.shape == expected[1:] else ""
        shape = _shape_words(column, joints)
        raise InputError(f"{where} has shape {array.shape}, expected {shape} with n = {n}, the rows of q{single}")
    return array


def _shape_words(column: Column, joints: int) -> str:
    unit = f" [{column.unit}]" if column.unit else ""
    return f"{_SHAPES[column.shape].format(joints=joints)}{unit}"


def _column_texts(column: Column, arrays: Mapping[str, Any], joints: int, n: int) -> list[tuple[str, ...]]:
    """Return the texts of one arm's rows for each CSV column of a quantity; empty where it has no value."""
    width = len(column.csv_names(joints))
    values = arrays.get(column.name)
    if values is None:
        return [_texts(list(range(n))) if column is CONFIGURATION else ("",) * n] * width
    own = column.matrix(values).T.tolist()
    given = [_texts(numbers, whole=column is CONFIGURATION) for numbers in own]
    return [*given, *[("",) * n] * (width - len(own))]
