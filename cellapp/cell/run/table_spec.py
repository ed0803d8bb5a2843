"""What a table of a kind may hold, and its rows column by column: numbers and words are parsed, errors noted by line.

A header is read by its ``TableSpec``: which quantity a name is, what is missing, which joints no arm has.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.csv_text import NUMBER, WHOLE, CsvTable, Problems, short, unquoted_text
from cellapp.estimation.readings.columns import COLUMNS, CONFIGURATION, Column, beyond_limits
from cellapp.estimation.readings.readings import Readings

_NO_NUMBER = -(10**18)
"""Stands for a cell that is no whole number; it is less than all that ``WHOLE`` describes."""


class Named(NamedTuple):
    """What the name of a column says: a quantity, the place in its ``csv_names``, the unit that follows the stem."""

    column: Column
    place: int
    unit: str = ""


@dataclass(frozen=True)
class TableSpec:
    """The quantities that a kind of table holds; their columns are found by name."""

    columns: tuple[Column, ...]

    @cached_property
    def by_name(self) -> Mapping[str, Named]:
        """All columns by name, one for each unit, without those of each joint."""
        return {
            f"{stem}_{unit}" if unit else stem: Named(column, place, unit)
            for column in self.columns
            if column.shape != "joints"
            for place, stem in enumerate(column.csv)
            for unit in column.units
        }

    def find(self, name: str) -> Named | None:
        """Return what a column holds; None if it is unknown."""
        if match := re.fullmatch(r"(\w*?)([1-9][0-9]*)", name):
            for column in self.columns:
                if column.shape == "joints" and column.csv == (match[1],):
                    return Named(column, int(match[2]) - 1)
        return self.by_name.get(name)

    def names(self, joints: int) -> list[str]:
        """Return all columns of an arm with this number of joints, without units."""
        return [name for column in self.columns for name in column.csv_names(joints)]

    def missing(self, names: Collection[str], joints: int = 1) -> list[tuple[str, Column]]:
        """Return what a header lacks, without units: of required quantities, and of those that it has in part."""
        there = {(its.column.name, its.place) for its in map(self.find, names) if its is not None}
        given = {quantity for quantity, _ in there}
        return [
            (name, column)
            for column in self.columns
            if column.required or column.name in given
            for place, name in enumerate(column.csv_names(joints))
            if (column.name, place) not in there
        ]

    def beyond(self, names: Collection[str], joints: int) -> list[str]:
        """Return the columns of joints that an arm does not have, by quantity."""
        found = [(name, its) for name in names if (its := self.find(name)) is not None]
        found = [(name, its) for name, its in found if its.column.shape == "joints" and its.place >= joints]
        return [name for name, its in sorted(found, key=lambda one: self.columns.index(one[1].column))]


READINGS = TableSpec((Column("arm", "", ("arm",), dtype=str, required=True), *COLUMNS))
"""Readings at rest: a row per arm per stop."""


@dataclass(frozen=True)
class ArmCells:
    """The rows of one arm, column by column; in ``problems`` is noted the first error of a column, or ``every`` one."""

    table: CsvTable
    rows: Sequence[int]
    problems: Problems
    every: bool = False

    def texts(self, name: str) -> list[str]:
        cells = self.table.cells[name]
        return [cells[row] for row in self.rows]

    def line(self, index: int) -> int:
        return self.table.lines[self.rows[index]]

    def refuse(self, index: int, name: str, text: str) -> None:
        self.problems.add(self.line(index), name, text)

    def expect(
        self, name: str, texts: Sequence[str], right: NDArray[np.bool_], what: str, required: bool = True
    ) -> None:
        """Note the cells of a column that are not right; empty ones if they are required."""
        wrong = (index for index in np.flatnonzero(~right).tolist() if texts[index] or required)
        for index in itertools.islice(wrong, None if self.every else 1):
            text = f"expected {what}, got '{short(texts[index])}'" if texts[index] else "the value is missing"
            self.refuse(index, name, text)

    def numbers(self, name: str, *, required: bool) -> NDArray[np.float64]:
        """Parse a column to (n,), NaN for a wrong cell, and for an empty one that is not required.

        ``float`` alone accepts more than decimal numbers: nan, 1_000, digits of other scripts.
        """
        texts = [text.strip() for text in self.texts(name)]
        values = np.array([float(text) if NUMBER.fullmatch(text) else math.nan for text in texts])
        self.expect(name, texts, np.isfinite(values), "a finite number such as 0.25", required)
        return values

    def whole_numbers(self, name: str, least: int = _NO_NUMBER + 1) -> NDArray[np.int64]:
        """Parse a column of integers to (n,), not via floats, which would round large ones."""
        texts = [text.strip() for text in self.texts(name)]
        values = np.array([int(text) if WHOLE.fullmatch(text) else _NO_NUMBER for text in texts], dtype=np.int64)
        self.expect(name, texts, values >= least, "a whole number from 0" if least == 0 else "a whole number")
        return values

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
    extras = {
        name: tuple(map(unquoted_text, cells.texts(name))) for name in cells.table.names if not READINGS.find(name)
    }
    return Readings(**values, extras=extras)


def _check_joint_columns(cells: ArmCells, arm: str, joints: int) -> None:
    """Check that a quantity per joint has a column for each joint of the arm and no value for any other."""
    for name, _ in READINGS.missing(cells.table.names, joints):  # of joints: the header was checked for all others
        cells.problems.add(1, name, f"the column is missing; arm {arm} has {joints} joints")
    for name in READINGS.beyond(cells.table.names, joints):
        filled = next((index for index, text in enumerate(cells.texts(name)) if text.strip()), None)
        if filled is not None:
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
