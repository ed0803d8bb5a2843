"""Readings from CSV: header row, SI units, one row per arm per stop. All readings measured elsewhere are checked here.

Columns are those of ``columns.COLUMNS``. ``configuration``, ``arm``, ``q1`` ... ``qN`` and ``x_m, y_m, z_m`` have a
value in every row. The others are optional, and an empty cell is a missing value; a covariance has all six numbers or
none. Without times the time is NaN: the order of rows is not a clock. The caller says whether it is the order of
measurement, which gives each joint's last motion (``in_order``). Unknown columns are kept as text.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.csv_text import CsvTable, Problems, read_csv_table
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.measurement_order import in_measured_order, order_fault, order_sentences, write_in_order
from cellapp.cell.run.orientation_columns import names_with_quaternion, with_quaternions
from cellapp.cell.run.records import ArmOrder
from cellapp.cell.run.stations import (
    STATIONS_RESULT,
    read_reference_nests,
    require_ties,
    stations_text,
    tie_sentences,
    twice_at_a_stop,
)
from cellapp.cell.run.table_spec import READINGS, ArmCells, read_arm
from cellapp.estimation.calibration.quantities import repeats_words
from cellapp.estimation.calibration.station_location import COMPUTED, explained, wrong_factory
from cellapp.estimation.readings.columns import OF_SOCKETS
from cellapp.estimation.readings.readings import Readings, lost_points, one_pose_a_stop, smr_names
from cellapp.ground.counting import did_you_mean
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Arm, Profile
from cellapp.ground.removed import removed_readings
from cellapp.robot.kinematics.chain import nominal_geometry
from cellapp.robot.model.arguments import too_heavy
from cellapp.robot.model.nominal import published_rows

_FEWEST_JUDGED = 10
"""Least number of rows that show whether points are computed."""


_Lines = Mapping[str, Sequence[int]]
"""Arm -> the line of each of its readings, in their order."""


class WhichSmr(InputError):
    """Readings of two SMRs, which give no rotation: one of ``names`` is to be taken."""

    def __init__(self, text: str, names: tuple[str, ...]) -> None:
        super().__init__(text)
        self.names = names


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

    Notes (unknown columns) are logged in the run with level ``note``. ``in_order`` is as in ``readings_of_table``; the
    run then stores what was derived. ``reference_nests`` is a file of nests that tie tracker stations. Arms that are
    ``recorded`` in motion need no readings. ``smr`` is as in ``readings_of_table``.

    Raises as ``readings_of_table``.
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
            run.write_document(STATIONS_RESULT, tied)
        for note in notes:
            run.log("note", note)

    return fill


def readings_of_table(
    profile: Profile, table: CsvTable, *, in_order: bool = False, recorded: Collection[str] = (), smr: str | None = None
) -> tuple[dict[str, Readings], dict[str, ArmOrder], list[str]]:
    """Check the readings of a cell, from a file or from a caller in Python; all readings pass here.

    Three SMRs or more on a flange give one position and one rotation a stop; ``smr`` takes only the SMR of that name.
    ``in_order``: the rows of an arm stand in the order in which they were measured (with ``time_s``, the order is by
    time); approach and step that the file does not give follow from the row before, see ``in_measured_order``.

    Returns
    -------
    readings : dict
        Of every arm of the profile, ordered by configuration; unknown columns are in ``extras``.
    orders : dict
        What ``in_order`` derived, by arm; empty without it.
    notes : list of str
        Unknown columns, lost beams, and arms that do not occur.

    Raises
    ------
    InputError
        Names file, line and column of values that are missing, not numbers, repeated or implausible; and an arm of the
        profile that has no readings.
    WhichSmr
        If an arm has readings of two SMRs, and ``smr`` does not say which one counts.
    """
    joint_counts = {name: len(arm.type.joints) for name, arm in profile.arms.items()}
    readings, orders, lines, notes = arms_of_table(table, joint_counts, in_order, joint_limits(profile))
    _check_payloads(profile, table, readings, lines)
    readings, made = _one_a_stop(table, readings, lines, smr)
    said = {arm: repeats_words(its.q, its.p_M) for arm, its in readings.items() if its.station is None}
    misfits = {
        arm: _computed(profile.arms[arm], its) or wrong_factory(profile.arms[arm], its) for arm, its in readings.items()
    }
    notes += made
    notes += [f"{table.path}: arm '{arm}': {words}" for its in (said, misfits) for arm, words in its.items() if words]
    missing = [name for name in profile.arms if name not in readings and name not in recorded]
    if missing:
        raise InputError(
            f"{table.path}: arm: no reading of arm {', '.join(missing)} of the profile; add its readings, or remove the"
            " arm from the profile"
        )
    return readings, orders, notes


def _seen(cells: ArmCells, its: Readings) -> tuple[list[int], list[str]]:
    """Return the rows that have a point, and sentences on the others, where the beam was lost."""
    lost = lost_points(its.q, its.p_M)
    notes = [
        f"{cells.table.place(cells.line(row))}: x_m, y_m, z_m: {words}: the beam was lost; left out"
        for row, words in lost.items()
    ]
    return [row for row in range(len(its)) if row not in lost], notes


def _check_payloads(profile: Profile, table: CsvTable, readings: Mapping[str, Readings], lines: _Lines) -> None:
    problems = Problems(table.place)
    for name, its in readings.items():
        masses = np.array([joint.mass for joint in profile.arms[name].type.joints])
        if its.payload_kg is not None and (row := too_heavy(its.payload_kg, masses)) is not None:
            text = f"expected at most the arm's own mass, {masses.sum():.3g} kg, got {its.payload_kg[row]:g}"
            problems.add(lines[name][row], "payload_kg", text)
    problems.check()


def _computed(arm: Arm, its: Readings) -> str:
    """Say that the published geometry explains the points exactly; else empty."""
    if len(np.unique(its.q, axis=0)) < _FEWEST_JUDGED:
        return ""
    geometry = nominal_geometry(published_rows(arm), np.zeros(3))
    exact = explained(geometry, its.q, its.p_M).computed
    return f"the published geometry leaves 0.000 mm of the points: {COMPUTED}" if exact else ""


def _one_a_stop(
    table: CsvTable, readings: Mapping[str, Readings], lines: _Lines, smr: str | None
) -> tuple[dict[str, Readings], list[str]]:
    """Make one reading a stop of each arm; return them, and sentences on what was made of several SMRs."""
    problems, found, notes = Problems(table.place), dict(readings), list[str]()
    if smr is not None and not any(smr in smr_names(its) for its in readings.values()):
        known = dict.fromkeys(name for its in readings.values() for name in smr_names(its))
        raise InputError(f"--smr: no reading is of an SMR '{smr}'; there are {', '.join(known) or 'no names of SMRs'}")
    for arm, its in readings.items():
        names, faults = smr_names(its), [(row, "station", text) for row, text in twice_at_a_stop(its)]
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
            problems.add(lines[arm][row], column, text)
        if not len(found[arm]):
            raise InputError(f"{table.path}: smr: no reading of arm '{arm}' is of SMR '{smr}'")
    problems.check()
    return found, notes


def joint_limits(profile: Profile) -> dict[str, NDArray[np.float64]]:
    """Return the joint limits (N, 2) [rad] of each arm's type, which no cell widens."""
    return {name: np.array([joint.limit for joint in arm.type.joints]) for name, arm in profile.arms.items()}


def arms_of_table(
    table: CsvTable, joint_counts: Mapping[str, int], in_order: bool, limits: Mapping[str, NDArray[np.float64]]
) -> tuple[dict[str, Readings], dict[str, ArmOrder], _Lines, list[str]]:
    """Read the readings of each arm that occurs, ordered by configuration; unknown columns are in ``extras``.

    Return also what their order of measurement gave, the lines of the readings, and notes. Joint positions further
    beyond the ``limits`` (N, 2) [rad] of an arm than a revolution are refused.
    """
    problems = Problems(table.place)
    table, unsaid = with_quaternions(table)
    _check_header(table, problems)
    names = [name.strip() for name in table.cells["arm"]]
    for line, name in zip(table.lines, names, strict=True):
        if not name:
            problems.add(line, "arm", f"the value is missing; arms are {', '.join(joint_counts)}")
        elif name not in joint_counts:
            problems.add(line, "arm", f"arm '{name}' is not in the profile; arms are {', '.join(joint_counts)}")
    problems.check()
    readings, orders, lines, seen = dict[str, Readings](), dict[str, ArmOrder](), dict[str, list[int]](), list[str]()
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
        kept, said = _seen(cells, result)
        seen += said
        if kept:
            kept.sort(key=result.configuration.tolist().__getitem__)
            readings[arm], lines[arm] = result.take(kept), [cells.line(row) for row in kept]
    problems.check()
    notes = [*seen, *_notes(table, joint_counts, readings), *unsaid, *order_sentences(orders)]
    return readings, orders, lines, notes


def _check_header(table: CsvTable, problems: Problems) -> None:
    names = table.names
    unknown = [name for name in names if not READINGS.find(name)]
    if OF_SOCKETS in names:
        problems.add(1, OF_SOCKETS, f"{removed_readings(OF_SOCKETS)}; rename the column if it is something else")
        problems.check()
    for name, column in sorted(READINGS.missing(names), key=lambda one: not one[1].required):
        if column.required:
            hint = did_you_mean(name, unknown, "; is '{}' meant? Its name and unit must be as written here")
            problems.add(1, name, f"the column is missing{hint}")
        elif column.shape != "joints":
            problems.add(1, name, f"the column is missing; give all of {', '.join(column.csv)} or none")
    problems.check()
    if not table.lines:
        raise InputError(f"{table.place(1)}: there is a header row but no reading; expected a row per arm per stop")


def _notes(table: CsvTable, joint_counts: Mapping[str, int], readings: Mapping[str, Readings]) -> list[str]:
    notes = []
    known, beyond = sorted(READINGS.by_name), READINGS.beyond(table.names, max(joint_counts.values()))
    unknown = {name: did_you_mean(name, known, "{}", cutoff=0.75) for name in table.names if not READINGS.find(name)}
    for name in table.names:
        if name in beyond:
            notes.append(f"{table.path}: column '{name}' is empty and no arm has that joint; it is not imported")
        if close := unknown.get(name):
            notes.append(f"{table.path}: column '{name}' is unknown (is '{close}' meant?); it is kept and not used")
    if others := [f"'{name}'" for name, close in unknown.items() if not close]:
        words = "column {} is unknown; it is" if len(others) == 1 else "columns {} are unknown; they are"
        notes.append(f"{table.path}: {words.format(', '.join(others))} kept and not used")
    for arm in joint_counts:
        if arm not in readings:
            notes.append(f"{table.path}: arm '{arm}' of the profile has no readings in this file")
    return notes
