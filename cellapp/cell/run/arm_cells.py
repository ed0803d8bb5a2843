"""The rows of one arm in a table of readings, column by column: numbers and words are parsed, errors noted by line."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.csv_text import NUMBER, WHOLE, CsvTable, Problems, short, unquoted_text
from cellapp.estimation.readings.columns import COLUMNS, CONFIGURATION, Column, beyond_limits
from cellapp.estimation.readings.readings import Readings


def is_known(name: str) -> bool:
    """Return whether a CSV column is one of ``COLUMNS`` or the arm."""
    return name == "arm" or stem_and_joint(name) is not None or any(name in column.csv for column in not_per_joint())


def not_per_joint() -> list[Column]:
    """Return the columns of ``COLUMNS`` that a reading has once."""
    return [column for column in COLUMNS if column.shape != "joints"]


def stem_and_joint(name: str) -> tuple[str, int] | None:
    """Split the name of a column that belongs to one joint into stem and number; None for other columns."""
    match = re.fullmatch(r"(\w*?)([1-9][0-9]*)", name)
    if match and any(column.shape == "joints" and column.csv == (match.group(1),) for column in COLUMNS):
        return match.group(1), int(match.group(2))
    return None


@dataclass(frozen=True)
class ArmCells:
    """The rows of one arm, column by column; errors are noted in ``problems``."""

    table: CsvTable
    rows: Sequence[int]
    problems: Problems

    def texts(self, name: str) -> list[str]:
        cells = self.table.cells[name]
        return [cells[row] for row in self.rows]

    def line(self, index: int) -> int:
        return self.table.lines[self.rows[index]]

    def refuse(self, index: int, name: str, text: str) -> None:
        self.problems.add(self.line(index), name, text)

    def numbers(self, name: str, *, required: bool) -> NDArray[np.float64]:
        """Parse a column to (n,), NaN for an empty cell that is not required; note its first wrong cell.

        ``float`` alone accepts more than decimal numbers: nan, 1_000, digits of other scripts.
        """
        texts = [text.strip() for text in self.texts(name)]
        values = np.array([float(text) if NUMBER.fullmatch(text) else math.nan for text in texts])
        wrong = (index for index in np.flatnonzero(~np.isfinite(values)).tolist() if texts[index] or required)
        if (index := next(wrong, None)) is not None:
            text = f"expected a finite number such as 0.25, got '{short(texts[index])}'"
            self.refuse(index, name, text if texts[index] else "the value is missing")
        return values

    def whole_numbers(self, name: str) -> NDArray[np.int64]:
        """Parse a column of integers to (n,), not via floats, which would round large ones."""
        texts = [text.strip() for text in self.texts(name)]
        for index, text in enumerate(texts):
            if not WHOLE.fullmatch(text):
                what = f"expected a whole number, got '{short(text)}'" if text else "the value is missing"
                self.refuse(index, name, what)
                return np.zeros(len(texts), dtype=np.int64)
        return np.array([int(text) for text in texts], dtype=np.int64)

    def words(self, column: Column) -> tuple[str | None, ...] | None:
        """Return a column of words, None for an empty cell; None if all are empty or the file lacks the column."""
        (name,) = column.csv
        if name not in self.table.cells:
            return None
        words = [unquoted_text(text.strip()) for text in self.texts(name)]
        for index, word in enumerate(words):
            if word and column.allowed and word not in column.allowed:
                self.refuse(index, name, f"expected {column.expected}, got '{short(word)}'")
                break
        return tuple(word or None for word in words) if any(words) else None

    def matrix(self, column: Column, joints: int) -> NDArray[Any] | None:
        """Parse a quantity to (n, w), NaN where a value is missing; None if the file has none of it."""
        names = column.csv_names(joints)
        if names[0] not in self.table.cells:
            return None
        if column.dtype is np.int64:
            return np.column_stack([self.whole_numbers(name) for name in names])
        matrix = np.column_stack([self.numbers(name, required=column.required) for name in names])
        if column.allowed:
            for row, place in np.argwhere(~np.isnan(matrix) & ~np.isin(matrix, column.allowed))[:1].tolist():
                self.refuse(row, names[place], f"expected {column.expected}, got {matrix[row, place]:g}")
        return None if np.all(np.isnan(matrix)) else matrix

    def check(self, column: Column, matrix: NDArray[Any], joints: int, limits: NDArray[np.float64] | None) -> None:
        """Note the first implausible value; for joint positions, the first of each joint."""
        fault = None if column.check is None else column.check(matrix)
        faults = [] if fault is None else [fault]
        if column.name == "q" and limits is not None and fault is None:
            faults = beyond_limits(matrix, limits)
        for fault in faults:
            names = column.csv_names(joints)
            name = f"{names[0]}..{names[-1]}" if fault.place is None else names[fault.place]
            self.refuse(fault.row, name, fault.text)


def read_arm(cells: ArmCells, arm: str, joints: int, limits: NDArray[np.float64] | None) -> Readings | None:
    """Parse the readings of one arm in the order of the rows; None if a problem was found."""
    problems, before = cells.problems, cells.problems.count
    _check_joint_columns(cells, arm, joints)
    if problems.count > before:
        return None
    matrices = {column.name: (column, cells.matrix(column, joints)) for column in COLUMNS if column.dtype is not str}
    words = {column.name: cells.words(column) for column in COLUMNS if column.dtype is str}
    if problems.count > before:
        return None
    values: dict[str, Any] = {**words}
    for name, (column, matrix) in matrices.items():
        if matrix is not None:
            cells.check(column, matrix, joints, limits)
        values[name] = column.missing(len(cells.rows), joints) if matrix is None else column.from_matrix(matrix)
    configuration = cells.whole_numbers(CONFIGURATION.name)
    _check_once(cells, configuration, arm, words)
    if problems.count > before:
        return None
    extras = {name: tuple(map(unquoted_text, cells.texts(name))) for name in cells.table.names if not is_known(name)}
    return Readings(**values, extras=extras)


def _check_joint_columns(cells: ArmCells, arm: str, joints: int) -> None:
    """Check that a quantity per joint has a column for each joint of the arm and no value for any other."""
    for column in (column for column in COLUMNS if column.shape == "joints"):
        own = column.csv_names(joints)
        there = [name for name in cells.table.names if (stem_and_joint(name) or ("",))[0] == column.csv[0]]
        for name in own if there else ():
            if name not in there:
                cells.problems.add(1, name, f"the column is missing; arm {arm} has {joints} joints")
        for name in there:
            filled = next((index for index, text in enumerate(cells.texts(name)) if text.strip()), None)
            if name not in own and filled is not None:
                cells.refuse(filled, name, f"there is a value, but arm {arm} has {joints} joints in the profile")


def _check_once(
    cells: ArmCells, configuration: NDArray[np.int64], arm: str, words: Mapping[str, tuple[str | None, ...] | None]
) -> None:
    """Check that an arm has one row per stop, or one per SMR and station where these are named."""
    named = [its for name in ("smr", "station") if (its := words[name]) is not None]
    once = "give one row per stop" + (", SMR and station" if named else "")
    first: dict[tuple[int | str | None, ...], int] = {}
    for index, key in enumerate(zip(configuration.tolist(), *named, strict=True)):
        if key in first:
            before = cells.table.row_words(cells.line(first[key]))
            text = f"{key[0]} of arm {arm} was given in {before} already; {once}"
            cells.refuse(index, "configuration", text)
            return
        first[key] = index
