"""Export of readings to CSV, in the columns of ``columns.COLUMNS``; see ``csv_import`` for the format."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path

from cellapp.cell.run.arm_cells import is_known
from cellapp.cell.run.columns import Kind
from cellapp.cell.run.csv_text import quoted_text, write_csv
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.recordings import read_stream, recording_states
from cellapp.cell.run.records import RecordingState
from cellapp.estimation.readings.columns import COLUMNS
from cellapp.estimation.readings.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs


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
    extras = [name for name in imported if not is_known(name)]
    extras += [name for readings in arms.values() for name in readings.extras]
    return [*names, *dict.fromkeys(extras)]


def _rows(arm: str, readings: Readings, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the cells of one arm's readings in the columns ``names``; empty where it has no value."""
    n = len(readings)
    texts: dict[str, Sequence[str]] = {
        "arm": [arm] * n,
        **{name: [*map(quoted_text, its)] for name, its in readings.extras.items()},
    }
    for column in COLUMNS:
        values = getattr(readings, column.name)
        if isinstance(values, tuple):
            texts[column.csv[0]] = [quoted_text(word or "") for word in values]
        elif values is not None:
            matrix = column.matrix(values)
            for place, name in enumerate(column.csv_names(readings.joints)):
                texts[name] = ["" if number != number else repr(number) for number in matrix[:, place].tolist()]
    empty = [""] * n
    return list(zip(*(texts.get(name, empty) for name in names), strict=True))


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
