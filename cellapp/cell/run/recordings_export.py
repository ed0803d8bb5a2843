"""Export of recordings of motion to CSV, as ``recordings_csv`` reads them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from cellapp.cell.run.column_names import Kind
from cellapp.cell.run.csv_text import quoted_text, write_csv
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.recordings import read_stream, recording_states
from cellapp.cell.run.records import RecordingState
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs

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
    write_csv(Path(path), header, (row for state in states for row in _rows(run, state, kind, header)), outputs)


def _rows(run: RunFile, state: RecordingState, kind: Kind, header: Sequence[str]) -> Iterator[tuple[str, ...]]:
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
