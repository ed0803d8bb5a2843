"""Readings as cells of a table in the columns of ``columns.COLUMNS``: export to CSV, and arrays from memory.

See ``csv_import`` for the format. Arrays become the table that a CSV file of the same values gives, so that they are
checked as those of a file.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cellapp.cell.run.columns import Kind
from cellapp.cell.run.csv_text import CsvTable, quoted_text, table_in_memory, whole, write_csv
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.recordings import read_stream, recording_states
from cellapp.cell.run.records import RecordingState
from cellapp.cell.run.table_spec import READINGS
from cellapp.estimation.readings.columns import COLUMNS, CONFIGURATION, Column, Values
from cellapp.estimation.readings.readings import Readings
from cellapp.ground.counting import did_you_mean
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs
from cellapp.ground.profile import Profile
from cellapp.robot.model.arguments import of_arm


def write_readings_csv(run: RunFile, path: Path, outputs: Outputs = NEW_ONLY) -> None:
    """Write all readings of a run, ordered by configuration, numbers in their shortest exact form.

    The file is written completely or not at all; ``outputs`` says whether an existing one is replaced.

    Raises
    ------
    InputError
        If there are no readings, or the file cannot be written.
    """
    path = Path(path)
    arms = {arm: run.rows(arm) for arm in run.arms()}
    if not arms:
        raise InputError(f"{run.path} holds no readings yet; there is nothing to export")
    names = _header(arms, run.columns)
    rows = sorted(
        itertools.chain.from_iterable(
            zip(readings.configuration.tolist(), itertools.repeat(order), _rows(arm, readings, names))
            for order, (arm, readings) in enumerate(arms.items())
        ),
        key=itemgetter(0, 1),
    )
    write_csv(path, names, (row for _, _, row in rows), outputs)


def _header(arms: Mapping[str, Readings], imported: Sequence[str]) -> list[str]:
    """Return the columns that any arm has values for and those of the imported file; unknown ones last."""
    joints = max(readings.joints for readings in arms.values())
    names: list[str] = []
    for column in COLUMNS:
        given = column.required or any(column.is_given(getattr(readings, column.name)) for readings in arms.values())
        names += [name for name in column.csv_names(joints) if given or name in imported]
    names.insert(1, "arm")
    extras = [name for name in imported if not READINGS.find(name)]
    extras += [name for readings in arms.values() for name in readings.extras]
    return [*names, *dict.fromkeys(extras)]


def _rows(arm: str, readings: Readings, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the cells of one arm's readings in the columns ``names``; empty where it has no value."""
    texts: dict[str, Sequence[str]] = {"arm": [arm] * len(readings)}
    texts |= {name: [*map(quoted_text, its)] for name, its in readings.extras.items()}
    for column in COLUMNS:
        values = getattr(readings, column.name)
        if isinstance(values, tuple):
            texts[column.csv[0]] = [quoted_text(word or "") for word in values]
        elif values is not None:
            matrix = column.matrix(values)
            for place, name in enumerate(column.csv_names(readings.joints)):
                texts[name] = ["" if one is None or one != one else str(one) for one in matrix[:, place].tolist()]
    empty = [""] * len(readings)
    return list(zip(*(texts.get(name, empty) for name in names), strict=True))


# -- Arrays of readings as a table -------------------------------------------------------------------------------------


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
    given = {name: _of_arrays(profile, name, quantities) for name, quantities in arms.items()}
    numbered = all(its.get(CONFIGURATION.name) is not None for its in arms.values())
    if len({len(its) for its in given.values()}) > 1 and not numbered:
        words = ", ".join(f"{len(its)} of arm {name}" for name, its in given.items())
        raise InputError(f"readings: {words}; give 'configuration' (n,), which says what was measured at the same stop")
    names = _header(given, ())
    rows = [row for name, its in given.items() for row in _rows(name, its, names)]
    places = [f"arm {name}, row {row}" for name, its in given.items() for row in range(len(its))]
    columns = zip(*rows, strict=True) if rows else [()] * len(names)
    return table_in_memory("readings", dict(zip(names, columns, strict=True)), places)


def _of_arrays(profile: Profile, name: str, quantities: Mapping[str, Any]) -> Readings:
    """Return the quantities of one arm as readings, whose values are not checked yet."""
    joints, known = len(of_arm(profile.arms, name, f"profile {profile.name}").type.joints), [c.name for c in COLUMNS]
    if not isinstance(quantities, Mapping):
        raise InputError(f"arm {name}: expected names with arrays, as {{'q': ..., 'p_M': ...}}, got {quantities!r:.40}")
    for quantity in quantities:
        if quantity not in known:
            hint = did_you_mean(quantity, known, cutoff=0.4, otherwise=f"; known are {', '.join(known)}")
            raise InputError(f"arm {name}: no quantity is called '{quantity}'{hint}")
    for column in COLUMNS:
        if column.required and column is not CONFIGURATION and quantities.get(column.name) is None:
            raise InputError(f"arm {name}: {column.name} is missing; expected an array {_shape_words(column, joints)}")
    n = len(np.atleast_1d(np.asarray(quantities["q"], dtype=object)))
    given = {CONFIGURATION.name: np.arange(n)} | {key: its for key, its in quantities.items() if its is not None}
    values: dict[str, Any] = {
        column.name: _array(f"arm {name}: {column.name}", column, given[column.name], n, joints)
        if column.name in given
        else column.missing(n, joints)
        for column in COLUMNS
    }
    return Readings(**values)


def _array(where: str, column: Column, value: ArrayLike, n: int, joints: int) -> Values:
    """Convert a quantity to an array of its shape, or to n words, with None for NaN."""
    dtype = None if column is CONFIGURATION else object if column.dtype is str else np.float64
    try:
        array = np.asarray(value, dtype=dtype)
    except (TypeError, ValueError):
        raise InputError(f"{where} is no array of numbers; expected shape {_shape_words(column, joints)}") from None
    if array.ndim == 0 and column.shape == "scalar" and column is not CONFIGURATION:
        array = np.full(n, array)
    expected = column.array_shape(n, joints)
    if array.shape != expected:
        single = "; a single row is array[np.newaxis]" if array.shape == expected[1:] else ""
        shape = _shape_words(column, joints)
        raise InputError(f"{where} has shape {array.shape}, expected {shape} with n = {n}, the rows of q{single}")
    if column.dtype is str:
        return tuple(None if one is None or one != one else str(one) for one in array.tolist())
    return np.array(whole(array.tolist()), dtype=object) if column is CONFIGURATION else array


def _shape_words(column: Column, joints: int) -> str:
    """Return the shape of n values, as "(n, 3) [m]"."""
    _, *inner = column.array_shape(0, joints)
    unit = f" [{column.unit}]" if column.unit else ""
    return f"(n,{','.join(f' {size}' for size in inner)}){unit}"


# -- Export of recordings of motion to CSV, as ``recordings_csv`` reads them ------------------------------------------


_KEY = ("arm", "recording")


def write_recordings_csv(run: RunFile, kind: Kind, path: Path, outputs: Outputs = NEW_ONLY) -> None:
    """Write the joints or the points of all recordings to one file, numbers in their shortest exact form.

    Raises
    ------
    InputError
        If there are no recordings, or the file cannot be written.
    """
    states = recording_states(run)
    if not states:
        raise InputError(f"{run.path} holds no recording of motion; there is nothing to export")
    names = dict.fromkeys(name for state in states for name in read_stream(run, state, kind)[0])
    header = [*_KEY, *(name for name in names if name not in _KEY)]
    write_csv(Path(path), header, (row for state in states for row in _stream_rows(run, state, kind, header)), outputs)


def _stream_rows(run: RunFile, state: RecordingState, kind: Kind, header: Sequence[str]) -> Iterator[tuple[str, ...]]:
    columns, words = read_stream(run, state, kind)
    n = state.joints.n if kind == "joints" else state.points.n
    texts = {"arm": [quoted_text(state.arm)] * n, "recording": [quoted_text(state.name)] * n}
    for name, values in columns.items():
        if name in words:
            texts.setdefault(name, [quoted_text(words[name][int(code)]) for code in values.tolist()])
        else:
            texts[name] = ["" if number != number else repr(number) for number in values.tolist()]
    empty = [""] * n
    return zip(*(texts.get(name, empty) for name in header), strict=True)
