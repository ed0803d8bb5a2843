"""Recordings of motion from CSV: files of joints and of points, each with its own clock. All imports pass here.

Columns are ``time_s, q1..qN``, with ``qd`` and ``joint_temperature`` of each joint where known, and ``time_s, x_m, y_m,
z_m`` with ``sigma_m``, ``quat_w..z`` and ``split``; both may have ``arm`` and ``recording``. Rows keep their order:
timestamps that repeat or go back are counted, not sorted. Points without coordinates are left out and counted: the beam
was lost. Unknown columns are kept.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellapp.cell.run.columns import (
    BESIDE,
    EXAMPLES,
    KINDS,
    OF_OTHER_ARM,
    POINT,
    POSITIONS,
    STREAMS,
    TEXTS,
    UNITS_OF_TIME,
    Implausible,
    Kind,
    Understood,
    beside_faults,
    evenly_stamped,
    in_si,
    joint_faults,
    point_faults,
    state_of,
    understood,
    without_part_of_orientation,
)
from cellapp.cell.run.csv_import import joint_limits
from cellapp.cell.run.csv_text import CsvFile, Problems, read_header, short
from cellapp.cell.run.orientation_columns import QUATERNION, Written, written_orientation
from cellapp.cell.run.records import RecordingState
from cellapp.cell.run.stream_csv import StreamTable, read_stream_table
from cellapp.cell.run.table_spec import TableSpec
from cellapp.estimation.readings.columns import SPLITS
from cellapp.ground.counting import did_you_mean
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile

_LONGEST_HEADER = 200
"""Number of characters of a header that a message shows."""

_TAKE = "give the one that is with --column NAME, or rename the other"

Key = tuple[str, str]
"""Arm and name of a recording."""


@dataclass(frozen=True, eq=False)
class RecordedStreams:
    """The columns of one recording of an arm, and their description."""

    state: RecordingState
    joints: StreamTable
    points: StreamTable


def read_recordings(
    profile: Profile,
    joints: Sequence[Path],
    points: Sequence[Path],
    arm: str | None = None,
    taken: Collection[str] = (),
) -> tuple[list[RecordedStreams], list[str]]:
    """Read and check pairs of files; the k-th file of joints belongs to the k-th of points.

    ``arm`` is that of files without such a column; it may be left out if the profile has one arm. ``taken`` columns
    count where two may be meant. Returns notes too: unknown columns, irregular timestamps, clocks that share no time.

    Raises
    ------
    InputError
        Names file, line and column of a value that is missing, not a number or implausible; if files do not belong
        together.
    """
    if len(joints) != len(points) or not joints:
        raise InputError(
            f"import: {len(joints)} files of --joints, {len(points)} of --points; give one of each for each recording"
        )
    if arm is not None and arm not in profile.arms:
        raise InputError(f"import: --arm: '{arm}' is not in the profile; arms are {', '.join(profile.arms)}")
    found, notes = dict[Key, RecordedStreams](), list[str]()
    for number, pair in enumerate(zip(map(Path, joints), map(Path, points), strict=True), start=1):
        recorded, said = _read_pair(profile, *pair, arm, number, taken)
        notes += said
        for one in recorded:
            key = (one.state.arm, one.state.name)
            if key in found:
                raise InputError(
                    f"{pair[0]}: recording '{key[1]}' of arm {key[0]} is there already (from {found[key].joints.path});"
                    " give each a name of its own in a column 'recording'"
                )
            found[key] = one
    return [*found.values()], notes + [note for one in found.values() for note in _notes(one)]


def _read_pair(
    profile: Profile, joints: Path, points: Path, arm: str | None, number: int, taken: Collection[str]
) -> tuple[list[RecordedStreams], list[str]]:
    """Read the recordings in one pair of files; return also how these were interpreted."""
    counts = [len(its.type.joints) for its in profile.arms.values()]
    tables, clocks, said = dict[Kind, StreamTable](), dict[Kind, tuple[str, float]](), list[str]()
    paths: dict[Kind, Path] = {"joints": joints, "points": points}
    for kind, path in paths.items():
        tables[kind], clocks[kind], notes = _read_file(path, kind, counts, taken)
        said += notes
    if clocks["joints"][0] == clocks["points"][0] and len({factor for _, factor in clocks.values()}) > 1:
        units = [next(unit for unit, its in UNITS_OF_TIME.items() if its == factor) for _, factor in clocks.values()]
        raise InputError(
            f"{points}: {clocks['points'][0]}: the steps are those of {units[1]}, and in {joints} those of {units[0]}:"
            " one of the two has another unit; write it into the name, as time_ns"
        )
    for table in tables.values():
        _check_words(table, "arm", tuple(profile.arms), "is not in the profile; arms are")
        _check_words(table, "split", ("", *SPLITS), "is no split; expected nothing or")
        _check_words(table, "recording", (), "")
    arms = _sole(tables, "arm", arm or (next(iter(profile.arms)) if len(profile.arms) == 1 else None))
    if arms is None and any("arm" not in table.words for table in tables.values()):
        raise InputError(
            f"{joints}: the file does not say which arm it is of; give --arm or a column 'arm'; arms are"
            f" {', '.join(profile.arms)}"
        )
    names = _sole(tables, "recording", _name_of_files(joints, points, number))
    groups = {kind: _by_recording(table, arms or "", names or "") for kind, table in tables.items()}
    for kind, other in itertools.permutations(KINDS):
        for its_arm, name in groups[kind].keys() - groups[other].keys():
            raise InputError(
                f"{tables[kind].path}: recording '{name}' of arm {its_arm} has no {other} in {tables[other].path}"
            )
    found = [checked_recording(profile, key, its, groups["points"][key]) for key, its in groups["joints"].items()]
    return found, said


def _sole(tables: Mapping[Kind, StreamTable], column: str, otherwise: str | None) -> str | None:
    """Return the arm or name of a file without such a column: the only one in the other file, else ``otherwise``."""
    words = [table.words[column] for table in tables.values() if column in table.words]
    return words[0][0] if len(words) == 1 and len(words[0]) == 1 else otherwise


def _name_of_files(joints: Path, points: Path, number: int) -> str:
    """Return the common beginning of both file names, else their number."""
    pairs = itertools.takewhile(lambda two: two[0] == two[1], zip(joints.stem, points.stem, strict=False))
    return "".join(first for first, _ in pairs).strip("_-. ") or str(number)


def _read_file(
    path: Path, kind: Kind, joints: Sequence[int], taken: Collection[str]
) -> tuple[StreamTable, tuple[str, float], list[str]]:
    """Read the columns of a file in SI units; return also the name and the unit of a clock whose unit it does not say,
    and how foreign names and units were interpreted."""
    what = "joint positions" if kind == "joints" else "points"
    file, most = read_header(path, what, EXAMPLES[kind]), max(joints)
    numbers = {*STREAMS[kind].names(most), *(OF_OTHER_ARM.names(most) if kind == "joints" else ())}
    written, notes = written_orientation(file.names) if kind == "points" else (None, [])
    rotated = () if written is None else written.columns
    row = next((cells for _, cells in file.rows()), [])
    known = understood(file.names, kind, (*numbers, *TEXTS), written, taken, row)
    _check_columns(file, kind, known, most)
    numbers |= {*rotated, *known.others}
    required = {"time_s", *POSITIONS.csv_names(min(joints))} & {*known.names}
    table = read_stream_table(file, known.names, numbers=numbers, required=required, texts=TEXTS)
    if written is not None:
        table, notes = _with_quaternions(table, written), [f"{path}: {written.said}"]
    for column, name in known.ordered.items():
        if (words := table.words[column]) != (name,):
            raise InputError(
                f"{path}: the joint '{name}' is '{words[-1]}' in other rows; give each order a file of its own"
            )
    in_units, clock, said = in_si(table, kind, known)
    stamps, burst = evenly_stamped(in_units.columns["time_s"])
    if burst:
        in_units = replace(in_units, columns={**in_units.columns, "time_s": stamps})
        said = [*said, f"{path}: {burst}"]
    whole, left_out = without_part_of_orientation(in_units)
    return whole, clock, said + left_out + notes


def _with_quaternions(table: StreamTable, written: Written) -> StreamTable:
    """Replace the orientation of a probe by a quaternion. Raise ``InputError`` by row."""
    found, fault = written.quaternions(np.column_stack([table.columns[name] for name in written.columns]))
    if fault is not None:
        _refuse(table, [Implausible(fault.row, written.columns[fault.place or 0], fault.text)])
    columns = {name: its for name, its in table.columns.items() if name not in written.columns}
    return replace(table, columns=columns | dict(zip(QUATERNION, found.T, strict=True)))


def _check_columns(file: CsvFile, kind: Kind, known: Understood, joints: int) -> None:
    """Refuse a file that lacks a required column, or has only some columns of a quantity."""
    path, names, main = file.path, known.names, STREAMS[kind].columns[1].csv_names(joints)
    other: Kind = "points" if kind == "joints" else "joints"
    there = understood(file.names, other, ()).names
    if not set(main) & set(names) and set(there) & {"q1", *POINT}:
        raise InputError(
            f"{path}:{file.head}: {main[0]}: the column is missing; this file has"
            f" {'points' if kind == 'joints' else 'joint positions'}: are --joints and --points swapped?"
        )
    problems = Problems(lambda line: f"{path}:{line}")
    for name, column in STREAMS[kind].missing(names):
        if column.required and name in known.doubled:
            problems.add(file.head, name, f"two columns may be it ({', '.join(known.doubled[name])}); {_TAKE}")
        elif column.shape == "quaternion":
            problems.add(file.head, name, f"the column is missing; give all of {', '.join(column.csv)} or none")
            break  # the last quantity: one of its columns says it
        elif column.required:
            meant = did_you_mean(name, file.names, " is '{}' meant?", cutoff=0.5)
            there_are = short(", ".join(file.names), _LONGEST_HEADER)
            problems.add(
                file.head, name, f"the column is missing;{meant} rename the one that is it; the file has {there_are}"
            )
    problems.check()


def _check_words(table: StreamTable, column: str, allowed: Sequence[str], text: str) -> None:
    """Refuse a text that is not ``allowed``; if none is listed, an empty one."""
    for code, word in enumerate(table.words.get(column, ())):
        if (word not in allowed) if allowed else not word:
            row = int(np.flatnonzero(table.columns[column] == code)[0])
            listed = ", ".join(one for one in allowed if one)
            what = f"'{short(word)}' {text} {listed}" if word else "the value is missing"
            raise InputError(f"{table.path}:{table.lines([row])[row]}: {column}: {what}")


def _by_recording(table: StreamTable, arm: str, name: str) -> dict[Key, StreamTable]:
    """Split the rows by arm and name, in the order of the file; ``arm`` and ``name`` if the file has none."""
    given = [column for column in ("arm", "recording") if column in table.words]
    if not given:
        return {(arm, name): table}
    codes = np.column_stack([table.columns[column] for column in given])
    places, first = np.unique(codes, axis=0, return_index=True)
    found = {}
    for place in places[np.argsort(first)]:
        words = {column: table.words[column][int(code)] for column, code in zip(given, place, strict=True)}
        rows = np.flatnonzero((codes == place).all(axis=1))
        found[words.get("arm", arm), words.get("recording", name)] = table.take(rows)
    return found


def checked_recording(
    profile: Profile, key: Key, joints: StreamTable, points: StreamTable, session: str = ""
) -> RecordedStreams:
    """Check that the values of one recording are plausible, and drop the points at which the beam was lost.

    Raises ``InputError`` with what is not plausible.
    """
    known_limits = joint_limits(profile)
    limits, others = known_limits[key[0]], [name for name in known_limits if name != key[0]]
    beside = known_limits[others[0]] if len(others) == 1 else limits[:0]
    _check_joints(joints, ((STREAMS["joints"], key[0], len(limits)), (OF_OTHER_ARM, "".join(others), len(beside))))
    _refuse(joints, joint_faults(joints.columns, limits, dated=joints.dated))
    _refuse(joints, beside_faults(joints.columns, beside))
    p_M = np.column_stack([points.columns[name] for name in POINT])
    blank = np.isnan(p_M)
    lost = blank.all(axis=1) | (p_M == 0.0).all(axis=1)  # programs write zeros, too
    if (part := np.flatnonzero(blank.any(axis=1) & ~lost)).size:
        where = Implausible(
            int(part[0]), POINT[int(np.argmax(blank[part[0]]))], "the value is missing; give all of the point"
        )
        _refuse(points, [where])
    seen = points.take(np.flatnonzero(~lost)) if lost.any() else points
    _refuse(seen, point_faults(seen.columns, dated=seen.dated))
    known = {
        *TEXTS,
        *STREAMS["joints"].names(len(limits)),
        *OF_OTHER_ARM.names(len(beside)),
        *STREAMS["points"].names(0),
    }
    columns = dict.fromkeys([*joints.columns, *seen.columns])
    state = RecordingState(
        name=key[1],
        arm=key[0],
        session=session,
        joints=state_of(joints.columns["time_s"]),
        points=state_of(seen.columns["time_s"], int(lost.sum())),
        optional=tuple(stem for stem in ("qd", "joint_temperature", BESIDE) if f"{stem}1" in joints.columns)
        + tuple(name for name in ("sigma_m", "quat_w", "split") if name in seen.columns),
        unknown=tuple(name for name in columns if name not in known),
    )
    return RecordedStreams(state, joints, seen)


def _check_joints(table: StreamTable, arms: Sequence[tuple[TableSpec, str, int]]) -> None:
    """Check that a quantity has a column for each joint of its arm, or none."""
    line, problems = 1 if table.file is None else table.file.head, Problems(lambda line: f"{table.path}:{line}")
    for spec, arm, joints in arms:
        for name, _ in spec.missing({*table.columns} - {*spec.beyond(table.columns, joints)}, joints):
            problems.add(line, name, f"the column is missing; arm {arm} has {joints} joints")
    for stem, (_, arm, joints) in zip(("q", BESIDE), arms, strict=True):
        if (more := f"{stem}{joints + 1}") in table.columns and joints and np.isfinite(table.columns[more]).any():
            problems.add(line, more, f"there are values, but arm {arm} has {joints} joints in the profile")
    problems.check()


def _refuse(table: StreamTable, faults: Iterable[Implausible]) -> None:
    """Raise ``InputError`` with the lines of implausible values, if there are any."""
    found = [*faults]
    lines = table.lines([fault.row for fault in found if fault.row is not None])
    problems = Problems(lambda line: f"{table.path}:{line}" if line else f"{table.path}")
    for fault in found:
        problems.add(0 if fault.row is None else lines[fault.row], fault.column, fault.text)
    problems.check()


def _notes(recorded: RecordedStreams) -> list[str]:
    """Return what a person should know of a recording that was accepted."""
    state = recorded.state
    where = f"recording '{state.name}' of arm {state.arm}"
    notes = [f"{where}: {sentence}" for kind in KINDS for sentence in stamp_words(state, kind)]
    if state.unknown:
        words = " is unknown; it is" if len(state.unknown) == 1 else " are unknown; they are"
        listed = ", ".join(f"'{name}'" for name in state.unknown)
        notes.append(f"{where}: column{'s' * (len(state.unknown) > 1)} {listed}{words} kept and not used")
    first, second = recorded.joints.columns["time_s"], recorded.points.columns["time_s"]
    if first.max() < second.min() or second.max() < first.min():
        notes.append(
            f"{where}: the stamps of joints and points share no time (joints {first.min():.2f} to {first.max():.2f} s,"
            f" points {second.min():.2f} to {second.max():.2f} s); the clocks are aligned by the motion alone"
        )
    return notes


def stamp_words(state: RecordingState, kind: Kind) -> list[str]:
    """Describe irregular timestamps of a stream, in sentences."""
    its = state.joints if kind == "joints" else state.points
    found = (
        (its.gaps, f"{kind} have {its.gaps} gaps, the longest of {its.longest_gap_s:.3g} s"),
        (its.repeats, f"{its.repeats} stamps of {kind} repeat the one before"),
        (its.backward, f"{its.backward} stamps of {kind} are before the one before; rows keep their order"),
        (its.lost, f"{its.lost} rows of {kind} have no coordinates (beam lost); they are left out"),
    )
    return [sentence for count, sentence in found if count]
