"""Readings as CSV: header row, SI units, one row per arm per stop. The one door for readings that others measured.

Columns (``N`` joints)::

    configuration, arm, q1..qN, x_m, y_m, z_m                          required, in every row
    time_s, approach1..approachN, payload_kg, temperature_c,           optional; an empty cell is a missing value
    joint_temperature1..joint_temperatureN, step1..stepN, dwell_s,
    sigma_m, split
    sxx, sxy, sxz, syy, syz, szz                                       optional, all six or none

A file without times gives NaN as time, not the row's number: order is no clock. All other columns are kept as text.
"""

from __future__ import annotations

import csv
import difflib
import itertools
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cellapp.errors import InputError
from cellapp.profile import Profile
from cellapp.run.file import RunFile
from cellapp.run.readings import SPLITS, Readings

_LEADING = ("configuration", "arm", "time_s")
_POINT = ("x_m", "y_m", "z_m")
_COVARIANCE = ("sxx", "sxy", "sxz", "syy", "syz", "szz")
_SCALARS = ("payload_kg", "temperature_c", "dwell_s", "sigma_m")
_REQUIRED = ("configuration", "arm", *_POINT)
_KNOWN = frozenset((*_LEADING, *_POINT, *_COVARIANCE, *_SCALARS, "split"))
_PER_JOINT = re.compile(r"(q|approach|joint_temperature|step)([1-9][0-9]*)")
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_NOT_NUMBERS = re.compile(r"[^0-9.eE+\- ]")
_UPPER = np.triu_indices(3)
_FURTHEST_M = 100.0
_WIDEST_RAD = 4.0 * math.pi
_SHOWN = 5


@dataclass(frozen=True)
class _Table:
    """The file as text: cells by column, and where each row ends in the file."""

    path: Path
    names: tuple[str, ...]
    lines: tuple[int, ...]
    cells: dict[str, tuple[str, ...]]


@dataclass
class _Problems:
    """What is wrong with a file; told together, first lines first, because a person mends a file in one go."""

    path: Path
    found: dict[tuple[int, str], str] = field(default_factory=dict)
    count: int = 0

    def add(self, line: int, column: str, text: str) -> None:
        """Note a problem; of several with one cell (both arms lack the column) the first."""
        self.count += 1
        self.found.setdefault((line, column), f"{self.path}:{line}: {column}: {text}")

    def check(self) -> None:
        if self.found:
            texts = [self.found[where] for where in sorted(self.found, key=lambda where: where[0])]
            more = [f"and {len(texts) - _SHOWN} more"] if len(texts) > _SHOWN else []
            raise InputError("\n".join(texts[:_SHOWN] + more))


def read_readings_csv(path: Path, joint_counts: Mapping[str, int]) -> tuple[dict[str, Readings], list[str]]:
    """Read and check a file of readings.

    Parameters
    ----------
    path : Path
        The file: UTF-8, comma-separated.
    joint_counts : mapping
        arm -> number of joints; these arms may occur.

    Returns
    -------
    readings : dict
        arm -> its readings, ordered by configuration; only the arms that occur. Unknown columns are in ``extras``.
    notes : list of str
        What a person should know: unknown columns, arms that do not occur.

    Raises
    ------
    InputError
        Names file, line and column of what is missing, no number, twice there or not possible.
    """
    table = _read_table(Path(path))
    return _read(table, joint_counts)


def import_csv(profile: Profile, csv: Path, folder: Path) -> RunFile:
    """Make a run of a file of readings. The run is made only after the whole file was read and found good.

    What is noteworthy (unknown columns) is in the run's events with level ``note``.

    Raises
    ------
    InputError
        As ``read_readings_csv`` and ``RunFile.create`` do, and if an arm of the profile has no readings; nothing is
        left behind then.
    """
    table = _read_table(Path(csv))
    readings, notes = _read(table, {name: len(arm.type.joints) for name, arm in profile.arms.items()})
    missing = [name for name in profile.arms if name not in readings]
    if missing:
        raise InputError(
            f"{csv}: arm: there is no reading of arm {', '.join(missing)}, which the profile has; add its readings, or"
            " take the arm out of the profile"
        )

    def fill(run: RunFile) -> None:
        run.keep_columns(table.names)
        for arm, rows in readings.items():
            run.add_readings(arm, rows)
        count = ", ".join(f"{len(rows)} of arm {arm}" for arm, rows in readings.items())
        run.log("info", f"imported {csv}: {count}")
        for note in notes:
            run.log("note", note)

    return RunFile.create(folder, profile, fill)


def write_readings_csv(run: RunFile, path: Path) -> None:
    """Write all readings of a run, ordered by configuration; numbers in the shortest form that gives them back exactly.

    The file is there as a whole or not at all; one of that name is replaced.

    Raises
    ------
    InputError
        If there are no readings, or the file cannot be written.
    """
    path = Path(path)
    arms = {arm: run.readings(arm) for arm in run.arms()}
    if not arms:
        raise InputError(f"{run.path} holds no readings yet; there is nothing to export")
    names = _columns(arms, run.columns)
    rows = sorted(
        itertools.chain.from_iterable(
            zip(readings.configuration.tolist(), itertools.repeat(order), _text_rows(arm, readings, names))
            for order, (arm, readings) in enumerate(arms.items())
        )
    )
    unfinished = path.with_name(path.name + ".new")
    try:
        try:
            with unfinished.open("w", encoding="utf-8", newline="") as file:
                # Carriage returns inside texts are quoted only if the line ends hold one.
                writer = csv.writer(file, lineterminator="\r\n")
                writer.writerow(names)
                writer.writerows(row for _, _, row in rows)
            os.replace(unfinished, path)
        finally:
            unfinished.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}; check the folder and its rights") from error


# -- reading ----------------------------------------------------------------------------------------------------------


def _read_table(path: Path) -> _Table:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return _parse(path, file)
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; give a CSV file of readings") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}; give a CSV file of readings") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text ({error.reason}); save the file as CSV in UTF-8") from None


def _parse(path: Path, file: Iterable[str]) -> _Table:
    reader = csv.reader(file, strict=True)
    rows: list[list[str]] = []
    lines: list[int] = []
    names: tuple[str, ...] | None = None
    line = 0
    try:
        for row in reader:
            line = reader.line_num
            if not any(row):
                continue
            if names is None:
                names = tuple(name.strip() for name in row)
                continue
            if len(row) != len(names):
                column = names[len(row)] if len(row) < len(names) else f"column {len(names) + 1}"
                raise InputError(f"{path}:{line}: {column}: the row has {len(row)} cells, the header has {len(names)}")
            rows.append(row)
            lines.append(line)
    except csv.Error as error:
        raise InputError(f"{path}:{line + 1}: not CSV: {error}; mend the line") from None
    if names is None:
        raise InputError(f"{path} is empty; expected a header row and a row per arm per stop")
    _check_header(path, names)
    if not rows:
        raise InputError(f"{path}:1: there is a header row but no reading; expected a row per arm per stop")
    return _Table(path, names, tuple(lines), dict(zip(names, zip(*rows, strict=True), strict=True)))


def _check_header(path: Path, names: Sequence[str]) -> None:
    problems = _Problems(path)
    if len(names) == 1 and re.search(r"[;\t|]", names[0]):
        raise InputError(f"{path}:1: the header is one column; separate columns by commas, and write 0.5, not 0,5")
    for number, name in enumerate(names, start=1):
        if not name:
            problems.add(1, f"column {number}", "has no name; name it or remove it")
    for name in dict.fromkeys(name for name in names if name and names.count(name) > 1):
        problems.add(1, name, "the column is there twice; keep one")
    unknown = [name for name in names if not _is_known(name)]
    for name in (*_REQUIRED, "q1"):
        if name not in names:
            close = difflib.get_close_matches(name, unknown, n=1, cutoff=0.6)
            hint = f"; is '{close[0]}' meant? Its name and unit must be as written here" if close else ""
            problems.add(1, name, f"the column is missing{hint}")
    given = [name for name in _COVARIANCE if name in names]
    if given:
        for name in _COVARIANCE:
            if name not in names:
                problems.add(1, name, f"the column is missing; give all six ({', '.join(_COVARIANCE)}) or none")
    problems.check()


def _is_known(name: str) -> bool:
    return name in _KNOWN or _PER_JOINT.fullmatch(name) is not None


def _read(table: _Table, joint_counts: Mapping[str, int]) -> tuple[dict[str, Readings], list[str]]:
    problems = _Problems(table.path)
    names = [cell.strip() for cell in table.cells["arm"]]
    for line, name in zip(table.lines, names, strict=True):
        if not name:
            problems.add(line, "arm", f"the value is missing; arms are {', '.join(joint_counts)}")
        elif name not in joint_counts:
            problems.add(line, "arm", f"there is no arm '{name}' in the profile; arms are {', '.join(joint_counts)}")
    problems.check()
    readings = {}
    for arm in joint_counts:
        rows = [index for index, name in enumerate(names) if name == arm]
        if rows:
            result = _read_arm(table, arm, joint_counts[arm], rows, problems)
            if result is not None:
                readings[arm] = result
    problems.check()
    return readings, _notes(table, joint_counts, readings)


def _read_arm(table: _Table, arm: str, joints: int, rows: Sequence[int], problems: _Problems) -> Readings | None:
    """The readings of one arm; None if a problem was found."""
    before = problems.count
    columns = _Columns(table, rows, problems)
    _check_joint_columns(columns, arm, joints)
    if problems.count > before:
        return None
    configuration = columns.whole("configuration")
    q = columns.numbers_of([f"q{joint}" for joint in range(1, joints + 1)])
    p_M = columns.numbers_of(_POINT)
    optional = {name: columns.optional(name) for name in ("time_s", *_SCALARS)}
    joint_temperature = columns.optional_of([f"joint_temperature{joint}" for joint in range(1, joints + 1)])
    step = columns.optional_of([f"step{joint}" for joint in range(1, joints + 1)])
    approach = columns.approach([f"approach{joint}" for joint in range(1, joints + 1)])
    triangle = columns.optional_of(_COVARIANCE)
    split = columns.split()
    if problems.count > before:
        return None
    _check_once(columns, configuration, arm)
    _check_plausible(columns, q, p_M, optional["sigma_m"])
    covariance = None if triangle is None else _covariance(columns, triangle)
    if problems.count > before:
        return None
    n = len(rows)
    extras = {name: tuple(columns.texts(name)) for name in table.names if not _is_known(name)}
    time_s = optional.pop("time_s")
    readings = Readings(
        configuration=configuration,
        time_s=np.full(n, np.nan) if time_s is None else time_s,
        q=q,
        approach=approach,
        p_M=p_M,
        joint_temperature_c=joint_temperature,
        step=step,
        covariance_M=covariance,
        split=split,
        extras=extras,
        **optional,
    )
    return readings.take(np.argsort(configuration, kind="stable"))


@dataclass(frozen=True)
class _Columns:
    """The rows of one arm, column by column, as numbers; notes what is wrong in ``problems``."""

    table: _Table
    rows: Sequence[int]
    problems: _Problems

    def texts(self, name: str) -> list[str]:
        cells = self.table.cells[name]
        return [cells[row] for row in self.rows]

    def there(self, name: str) -> bool:
        return name in self.table.cells

    def line(self, index: int) -> int:
        return self.table.lines[self.rows[index]]

    def refuse(self, index: int, name: str, text: str) -> None:
        self.problems.add(self.line(index), name, text)

    def numbers(self, name: str, *, required: bool = True) -> NDArray[np.float64]:
        """A column; NaN for an empty cell that is not required. The first bad cell is noted."""
        texts = [text.strip() for text in self.texts(name)]
        # float() takes more than numbers (nan, 1_000, other scripts' digits): one look at the column, not at each cell.
        if all(texts) and not _NOT_NUMBERS.search(" ".join(texts)):
            try:
                values = np.array([float(text) for text in texts])
            except ValueError:
                pass
            else:
                if np.all(np.isfinite(values)):
                    return values
        result = np.full(len(texts), np.nan)
        for index, text in enumerate(texts):
            if not text:
                if not required:
                    continue
                self.refuse(index, name, "the value is missing")
                break
            value = float(text) if _NUMBER.fullmatch(text) else math.nan
            if not math.isfinite(value):
                self.refuse(index, name, f"expected a finite number such as 0.25, got '{_short(text)}'")
                break
            result[index] = value
        return result

    def numbers_of(self, names: Sequence[str]) -> NDArray[np.float64]:
        return np.column_stack([self.numbers(name) for name in names])

    def optional(self, name: str) -> NDArray[np.float64] | None:
        if not self.there(name):
            return None
        values = self.numbers(name, required=False)
        return None if np.all(np.isnan(values)) else values

    def optional_of(self, names: Sequence[str]) -> NDArray[np.float64] | None:
        if not self.there(names[0]):
            return None
        values = np.column_stack([self.numbers(name, required=False) for name in names])
        return None if np.all(np.isnan(values)) else values

    def whole(self, name: str) -> NDArray[np.int64]:
        texts = [text.strip() for text in self.texts(name)]
        for index, text in enumerate(texts):
            if not _WHOLE.fullmatch(text):
                what = f"expected a whole number, got '{_short(text)}'" if text else "the value is missing"
                self.refuse(index, name, what)
                return np.zeros(len(texts), dtype=np.int64)
        return np.array([int(text) for text in texts], dtype=np.int64)

    def approach(self, names: Sequence[str]) -> NDArray[np.int8]:
        result = np.zeros((len(self.rows), len(names)), dtype=np.int8)
        for joint, name in enumerate(names):
            if not self.there(name):
                continue
            values = np.nan_to_num(self.numbers(name, required=False))
            wrong = np.flatnonzero(~np.isin(values, (-1.0, 0.0, 1.0)))
            if len(wrong):
                self.refuse(int(wrong[0]), name, f"expected -1, 0 (unknown) or 1, got {values[wrong[0]]:g}")
            else:
                result[:, joint] = values
        return result

    def split(self) -> tuple[str | None, ...] | None:
        if not self.there("split"):
            return None
        words = [text.strip() for text in self.texts("split")]
        for index, word in enumerate(words):
            if word and word not in SPLITS:
                self.refuse(index, "split", f"expected {', '.join(SPLITS)} or nothing, got '{_short(word)}'")
                break
        return tuple(word or None for word in words) if any(words) else None


def _check_joint_columns(columns: _Columns, arm: str, joints: int) -> None:
    problems = columns.problems
    numbered: dict[str, set[int]] = {"q": set(), "approach": set(), "joint_temperature": set(), "step": set()}
    for name in columns.table.names:
        match = _PER_JOINT.fullmatch(name)
        if match:
            numbered[match.group(1)].add(int(match.group(2)))
    wanted = set(range(1, joints + 1))
    for kind, numbers in numbered.items():
        if numbers or kind == "q":
            for number in sorted(wanted - numbers):
                problems.add(1, f"{kind}{number}", f"the column is missing; arm {arm} has {joints} joints")
        for number in sorted(numbers - wanted):
            name = f"{kind}{number}"
            filled = [index for index, text in enumerate(columns.texts(name)) if text.strip()]
            if filled:
                columns.refuse(filled[0], name, f"there is a value, but arm {arm} has {joints} joints in the profile")


def _check_once(columns: _Columns, configuration: NDArray[np.int64], arm: str) -> None:
    first: dict[int, int] = {}
    for index, number in enumerate(configuration.tolist()):
        if number in first:
            columns.refuse(
                index,
                "configuration",
                f"{number} of arm {arm} was given in line {columns.line(first[number])} already; one row a stop",
            )
            return
        first[number] = index


def _check_plausible(
    columns: _Columns, q: NDArray[np.float64], p_M: NDArray[np.float64], sigma: NDArray[np.float64] | None
) -> None:
    far = np.argwhere(np.abs(p_M) > _FURTHEST_M)
    if len(far):
        row, axis = far[0]
        columns.refuse(
            int(row), _POINT[axis], f"expected metres, got {p_M[row, axis]:g}; no tracker reaches {_FURTHEST_M:g} m"
        )
    wide = np.abs(q) > _WIDEST_RAD
    if 2 * np.count_nonzero(wide.any(axis=1)) > len(q):
        row, joint = np.argwhere(wide)[0]
        columns.refuse(
            int(row),
            f"q{joint + 1}",
            f"expected radians, got {q[row, joint]:g}, and most rows are beyond two turns; are these degrees?",
        )
    if sigma is not None:
        wrong = np.flatnonzero(sigma <= 0.0)
        if len(wrong):
            columns.refuse(int(wrong[0]), "sigma_m", f"expected an uncertainty above 0 m, got {sigma[wrong[0]]:g}")


def _covariance(columns: _Columns, triangle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrices (n, 3, 3) from upper triangles (n, 6); NaN where a row has none."""
    missing = np.isnan(triangle)
    for row in np.flatnonzero(missing.any(axis=1) & ~missing.all(axis=1))[:1]:
        name = _COVARIANCE[int(np.argmax(missing[row]))]
        columns.refuse(int(row), name, "the value is missing; give all six of the covariance or none")
    result = np.empty((len(triangle), 3, 3))
    result[:, _UPPER[0], _UPPER[1]] = triangle
    result[:, _UPPER[1], _UPPER[0]] = triangle
    given = np.flatnonzero(~missing.any(axis=1))
    if len(given):
        variance = np.einsum("nii->ni", result[given])
        positive = np.all(variance > 0.0, axis=1)
        scale = np.sqrt(np.where(positive[:, np.newaxis], variance, 1.0))
        # Correlations instead of covariances: 1e-12 m^2 is an ordinary size here, and no sign of singularity.
        with np.errstate(over="ignore"):
            correlation = result[given] / scale[:, :, np.newaxis] / scale[:, np.newaxis, :]
        usable = positive & np.all(np.abs(correlation) < 2.0, axis=(1, 2))
        smallest = np.linalg.eigvalsh(np.where(usable[:, np.newaxis, np.newaxis], correlation, -np.eye(3)))[:, 0]
        for row in given[smallest <= 1e-14][:1]:
            columns.refuse(int(row), "sxx..szz", "expected a positive definite covariance in m^2")
    return result


def _notes(table: _Table, joint_counts: Mapping[str, int], readings: Mapping[str, Readings]) -> list[str]:
    notes = []
    known = sorted(_KNOWN)
    most = max(joint_counts.values())
    for name in table.names:
        numbered = _PER_JOINT.fullmatch(name)
        if numbered and int(numbered.group(2)) > most:
            notes.append(f"{table.path}: column '{name}' is empty and no arm has that joint; it is left out")
        if not _is_known(name):
            close = difflib.get_close_matches(name, known, n=1, cutoff=0.75)
            hint = f" (is '{close[0]}' meant?)" if close else ""
            notes.append(f"{table.path}: column '{name}' is unknown{hint}; it is kept and not used")
    for arm in joint_counts:
        if arm not in readings:
            notes.append(f"{table.path}: arm '{arm}' of the profile has no readings in this file")
    return notes


def _short(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."


# -- writing ----------------------------------------------------------------------------------------------------------


def _columns(arms: Mapping[str, Readings], imported: Sequence[str]) -> list[str]:
    """The columns of an export: what any arm has, and what the imported file had."""
    joints = range(1, max(readings.joints for readings in arms.values()) + 1)

    def per_joint(kind: str, there: bool) -> list[str]:
        return [f"{kind}{joint}" for joint in joints if there or f"{kind}{joint}" in imported]

    def single(names: Sequence[str], there: bool) -> list[str]:
        return [name for name in names if there or name in imported]

    rows = arms.values()
    extras = [name for name in imported if not _is_known(name)]
    extras += [name for readings in rows for name in readings.extras]
    return [
        "configuration",
        "arm",
        *single(["time_s"], any(np.any(np.isfinite(readings.time_s)) for readings in rows)),
        *per_joint("q", True),
        *per_joint("approach", any(np.any(readings.approach) for readings in rows)),
        *single(["payload_kg"], any(readings.payload_kg is not None for readings in rows)),
        *single(["temperature_c"], any(readings.temperature_c is not None for readings in rows)),
        *per_joint("joint_temperature", any(readings.joint_temperature_c is not None for readings in rows)),
        *per_joint("step", any(readings.step is not None for readings in rows)),
        *single(["dwell_s"], any(readings.dwell_s is not None for readings in rows)),
        *_POINT,
        *single(["sigma_m"], any(readings.sigma_m is not None for readings in rows)),
        *single(_COVARIANCE, any(readings.covariance_M is not None for readings in rows)),
        *single(["split"], any(readings.split is not None for readings in rows)),
        *dict.fromkeys(extras),
    ]


def _text_rows(arm: str, readings: Readings, names: Sequence[str]) -> list[tuple[str, ...]]:
    n = len(readings)
    texts: dict[str, Sequence[str]] = {
        "configuration": [str(number) for number in readings.configuration.tolist()],
        "arm": [arm] * n,
        "time_s": _numbers(readings.time_s),
        "split": [word or "" for word in readings.split or [None] * n],
        **readings.extras,
    }
    for name in _SCALARS:
        values = getattr(readings, name)
        if values is not None:
            texts[name] = _numbers(values)
    for axis, name in enumerate(_POINT):
        texts[name] = _numbers(readings.p_M[:, axis])
    for joint in range(readings.joints):
        texts[f"q{joint + 1}"] = _numbers(readings.q[:, joint])
        texts[f"approach{joint + 1}"] = [str(sign) for sign in readings.approach[:, joint].tolist()]
        if readings.joint_temperature_c is not None:
            texts[f"joint_temperature{joint + 1}"] = _numbers(readings.joint_temperature_c[:, joint])
        if readings.step is not None:
            texts[f"step{joint + 1}"] = _numbers(readings.step[:, joint])
    if readings.covariance_M is not None:
        for name, row, column in zip(_COVARIANCE, *_UPPER, strict=True):
            texts[name] = _numbers(readings.covariance_M[:, row, column])
    nothing = [""] * n
    return list(zip(*(texts.get(name, nothing) for name in names), strict=True))


def _numbers(values: NDArray[np.float64]) -> list[str]:
    """Shortest texts that give the same float64 back; empty for NaN."""
    return ["" if math.isnan(value) else repr(value) for value in values.tolist()]
