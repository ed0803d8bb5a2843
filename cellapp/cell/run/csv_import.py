"""Readings from CSV: header row, SI units, one row per arm per stop. All readings measured elsewhere are checked here.

Columns are those of ``columns.COLUMNS``. ``configuration``, ``arm``, ``q1`` ... ``qN`` and ``x_m, y_m, z_m`` have a
value in every row. The others are optional, and an empty cell is a missing value; a covariance has all six numbers or
none. Without times the time is NaN: the order of rows is not a clock. The caller says whether it is the order of
measurement, which gives each joint's last motion (``in_order``). Unknown columns are kept as text.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.arm_cells import ArmCells, is_known, not_per_joint, read_arm, stem_and_joint
from cellapp.cell.run.columns import names_with_quaternion, with_quaternions
from cellapp.cell.run.csv_text import (
    CsvTable,
    Problems,
    check_names,
    read_csv_table,
)
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.measurement_order import in_measured_order, order_fault, order_sentences, write_in_order
from cellapp.cell.run.records import ArmOrder
from cellapp.cell.run.stations import (
    STATIONS_RESULT,
    read_reference_nests,
    require_ties,
    stations_text,
    tie_sentences,
    twice_at_a_stop,
)
from cellapp.estimation.calibration.quantities import repeats_words
from cellapp.estimation.calibration.registration import factory_doubt
from cellapp.estimation.readings.columns import COLUMNS, CONFIGURATION, OF_SOCKETS
from cellapp.estimation.readings.readings import Readings, one_pose_a_stop, smr_names
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.removed import removed_readings


class WhichSmr(InputError):
    """Readings of two SMRs, which give no rotation: one of ``names`` is to be taken."""

    def __init__(self, text: str, names: tuple[str, ...]) -> None:
        super().__init__(text)
        self.names = names


def read_readings_csv(
    path: Path,
    joint_counts: Mapping[str, int],
    *,
    in_order: bool = False,
    limits: Mapping[str, NDArray[np.float64]] | None = None,
) -> tuple[dict[str, Readings], list[str]]:
    """Read and check a file of readings.

    Parameters
    ----------
    path : Path
        UTF-8, comma-separated.
    joint_counts : mapping
        Number of joints of each arm that may occur, by name.
    in_order : bool
        The rows of an arm stand in the order in which they were measured (with ``time_s``, the order is by time):
        approach and step that the file does not give follow from the row before, see ``in_measured_order``.
    limits : mapping, optional
        Joint limits (N, 2) [rad] of each arm. Joint positions further beyond them than a revolution are refused.

    Returns
    -------
    readings : dict
        Readings of each arm that occurs, ordered by configuration. Unknown columns are in ``extras``.
    notes : list of str
        Unknown columns and arms that do not occur.

    Raises
    ------
    InputError
        Names file, line and column of values that are missing, not numbers, repeated or implausible.
    """
    readings, _, notes = _read(read_csv_table(Path(path)), joint_counts, in_order, limits or {})
    return readings, notes


def import_csv(profile: Profile, csv: Path, folder: Path, *, in_order: bool = False) -> RunFile:
    """Make a run from a file of readings, after the whole file was read and checked.

    Notes (unknown columns) are logged in the run with level ``note``. ``in_order`` is as in ``read_readings_csv``; the
    run then stores what was derived.

    Raises
    ------
    InputError
        As ``read_readings_csv`` and ``RunFile.create`` do, and if an arm of the profile has no readings. No run is
        made then.
    """
    return RunFile.create(folder, profile, readings_from_csv(profile, csv, in_order=in_order))


def readings_from_csv(
    profile: Profile,
    csv: Path,
    *,
    in_order: bool = False,
    recorded: Collection[str] = (),
    reference_nests: Path | None = None,
    smr: str | None = None,
) -> Callable[[RunFile], None]:
    """Read and check a whole file of readings; return a function that stores them in a new run.

    Notes (unknown columns) are logged in the run with level ``note``. ``in_order`` is as in ``read_readings_csv``; the
    run then stores what was derived. ``reference_nests`` is a file of nests that tie tracker stations. Arms that are
    ``recorded`` in motion need no readings. ``smr`` is as in ``readings_of_table``.

    Raises as ``import_csv``.
    """
    table = read_csv_table(Path(csv))
    readings, orders, notes = readings_of_table(profile, table, in_order=in_order, recorded=recorded, smr=smr)
    tied = ""
    if reference_nests is None:
        require_ties(csv, readings)
    else:
        first, ties = read_reference_nests(reference_nests, readings)
        sentences = tie_sentences(first, ties, readings)
        tied, notes = stations_text(first, ties, sentences), [*notes, *sentences]

    def fill(run: RunFile) -> None:
        run.keep_columns(names_with_quaternion(table.names))
        for arm, rows in readings.items():
            run.add_readings(arm, rows)
        count = ", ".join(f"{len(rows)} of arm {arm}" for arm, rows in readings.items())
        run.log("info", f"imported {csv}: {count}")
        if orders:
            write_in_order(run, orders)
        if tied:
            run.write_result(STATIONS_RESULT, tied)
        for note in notes:
            run.log("note", note)

    return fill


def readings_of_table(
    profile: Profile,
    table: CsvTable,
    *,
    in_order: bool = False,
    recorded: Collection[str] = (),
    smr: str | None = None,
) -> tuple[dict[str, Readings], dict[str, ArmOrder], list[str]]:
    """Check the readings of a cell, from a file or from ``table_in_memory``; all readings pass here.

    Three SMRs or more on a flange give one position and one rotation a stop; ``smr`` takes only the SMR of that name.

    Returns
    -------
    readings : dict
        Of every arm of the profile, ordered by configuration; unknown columns are in ``extras``.
    orders : dict
        What ``in_order`` derived, by arm; empty without it.
    notes : list of str
        As those of ``read_readings_csv``.

    Raises
    ------
    InputError
        As ``read_readings_csv`` does, and if an arm of the profile has no readings.
    WhichSmr
        If an arm has readings of two SMRs, and ``smr`` does not say which one counts.
    """
    joint_counts = {name: len(arm.type.joints) for name, arm in profile.arms.items()}
    readings, orders, notes = _read(table, joint_counts, in_order, joint_limits(profile))
    readings, made = _one_a_stop(table, readings, smr)
    notes += made
    said = {arm: repeats_words(its.q, its.p_M) for arm, its in readings.items() if its.station is None}
    doubts = {arm: factory_doubt(profile.arms[arm], its) for arm, its in readings.items()}
    notes += [f"{table.path}: arm '{arm}': {words}" for its in (said, doubts) for arm, words in its.items() if words]
    missing = [name for name in profile.arms if name not in readings and name not in recorded]
    if missing:
        raise InputError(
            f"{table.path}: arm: no reading of arm {', '.join(missing)} of the profile; add its readings, or remove the"
            " arm from the profile"
        )
    return readings, orders, notes


def _one_a_stop(
    table: CsvTable, readings: Mapping[str, Readings], smr: str | None
) -> tuple[dict[str, Readings], list[str]]:
    """Make one reading a stop of each arm; return them, and sentences on what was made of several SMRs."""
    problems, found, notes = Problems(table.place), dict(readings), list[str]()
    if smr is not None and not any(smr in smr_names(its) for its in readings.values()):
        known = dict.fromkeys(name for its in readings.values() for name in smr_names(its))
        raise InputError(f"--smr: no reading is of an SMR '{smr}'; there are {', '.join(known) or 'no names of SMRs'}")
    for arm, its in readings.items():
        lines, names, faults = _lines_of(table, arm), smr_names(its), list[tuple[int, str, str]]()
        faults += [(row, "station", text) for row, text in twice_at_a_stop(its)]
        if len(names) > 1 and smr is not None:
            found[arm] = its.take([row for row, word in enumerate(its.smr or ()) if word == smr])
        elif len(names) == 2:
            raise WhichSmr(
                f"{table.path}: smr: arm '{arm}' was measured at two SMRs, {' and '.join(names)}; two give no rotation:"
                " take one of them (--smr NAME)",
                names,
            )
        elif len(names) > 2 and not faults:
            found[arm], made, faults = one_pose_a_stop(its)
            notes.append(f"{table.path}: arm '{arm}': {made}; smr.offset of the profile is that of {names[0]}")
        for row, column, text in faults:
            problems.add(lines[row], column, text)
        if not len(found[arm]):
            raise InputError(f"{table.path}: smr: no reading of arm '{arm}' is of SMR '{smr}'")
    problems.check()
    return found, notes


def _lines_of(table: CsvTable, arm: str) -> list[int]:
    """Return the lines of an arm's rows, in the order of its readings: by configuration."""
    numbers = table.cells[CONFIGURATION.csv[0]]
    own = zip(table.cells["arm"], numbers, table.lines, strict=True)
    return [line for _, line in sorted((int(n), line) for name, n, line in own if name.strip() == arm)]


def joint_limits(profile: Profile) -> dict[str, NDArray[np.float64]]:
    """Return the joint limits (N, 2) [rad] of each arm's type, which no cell widens."""
    return {name: np.array([joint.limit for joint in arm.type.joints]) for name, arm in profile.arms.items()}


def _read(
    table: CsvTable,
    joint_counts: Mapping[str, int],
    in_order: bool,
    limits: Mapping[str, NDArray[np.float64]],
) -> tuple[dict[str, Readings], dict[str, ArmOrder], list[str]]:
    """Read the readings; return also what their order of measurement gave, and notes."""
    problems = Problems(table.place)
    check_names(table, problems)  # of all columns, before those of an orientation are replaced
    table, unsaid = with_quaternions(table)
    _check_header(table, problems)
    names = [name.strip() for name in table.cells["arm"]]
    for line, name in zip(table.lines, names, strict=True):
        if not name:
            problems.add(line, "arm", f"the value is missing; arms are {', '.join(joint_counts)}")
        elif name not in joint_counts:
            problems.add(line, "arm", f"arm '{name}' is not in the profile; arms are {', '.join(joint_counts)}")
    problems.check()
    readings: dict[str, Readings] = {}
    orders: dict[str, ArmOrder] = {}
    for arm in joint_counts:
        rows = [index for index, name in enumerate(names) if name == arm]
        cells = ArmCells(table, rows, problems)
        result = read_arm(cells, arm, joint_counts[arm], limits.get(arm)) if rows else None
        if result is None:
            continue
        fault = order_fault(result) if in_order else None
        if fault is not None:
            cells.refuse(*fault)
        elif in_order:
            result, orders[arm] = in_measured_order(result)
        readings[arm] = result.take(np.argsort(result.configuration, kind="stable"))
    problems.check()
    return readings, orders, [*_notes(table, joint_counts, readings), *unsaid, *order_sentences(orders)]


def _check_header(table: CsvTable, problems: Problems) -> None:
    names = table.names
    unknown = [name for name in names if not is_known(name)]
    if OF_SOCKETS in names:
        problems.add(1, OF_SOCKETS, f"{removed_readings(OF_SOCKETS)}; rename the column if it is something else")
        problems.check()
    for name in ("arm", *(name for column in COLUMNS if column.required for name in column.csv_names(1))):
        if name not in names:
            close = difflib.get_close_matches(name, unknown, n=1, cutoff=0.6)
            hint = f"; is '{close[0]}' meant? Its name and unit must be as written here" if close else ""
            problems.add(1, name, f"the column is missing{hint}")
    for column in not_per_joint():
        if not column.required and any(name in names for name in column.csv):
            for name in column.csv:
                if name not in names:
                    problems.add(1, name, f"the column is missing; give all of {', '.join(column.csv)} or none")
    problems.check()
    if not table.lines:
        raise InputError(f"{table.place(1)}: there is a header row but no reading; expected a row per arm per stop")


def _notes(table: CsvTable, joint_counts: Mapping[str, int], readings: Mapping[str, Readings]) -> list[str]:
    notes = []
    known = sorted({"arm", *(name for column in not_per_joint() for name in column.csv)})
    most = max(joint_counts.values())
    for name in table.names:
        found = stem_and_joint(name)
        if found is not None and found[1] > most:
            notes.append(f"{table.path}: column '{name}' is empty and no arm has that joint; it is not imported")
        if not is_known(name):
            close = difflib.get_close_matches(name, known, n=1, cutoff=0.75)
            hint = f" (is '{close[0]}' meant?)" if close else ""
            notes.append(f"{table.path}: column '{name}' is unknown{hint}; it is kept and not used")
    for arm in joint_counts:
        if arm not in readings:
            notes.append(f"{table.path}: arm '{arm}' of the profile has no readings in this file")
    return notes
