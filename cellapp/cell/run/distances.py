"""Known distances between points in sockets: read from a CSV file, checked against the readings, stored in the run."""

from __future__ import annotations

import difflib
import json
import math
import sqlite3
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

from cellapp.cell.run.csv_text import NUMBER, CsvTable, Problems, read_table_of, short
from cellapp.cell.run.rows import select_document
from cellapp.estimation.readings import Distance, Readings
from cellapp.estimation.sockets import in_sockets
from cellapp.estimation.sockets.plausibility import (
    misplaced_readings,
    swapped_between_arms,
    with_ball,
    wrong_between_arms,
    wrong_distances,
)
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.model.nominal import nominal_arm

DISTANCES_RESULT = "distances"
"""Name of the document in which a run keeps known distances; it is part of the file format."""
_COLUMNS = ("point_a", "point_b", "distance_m", "sigma_m")
_LONGEST_M = 20.0
"""Longest distance [m]: no arm reaches farther between two sockets."""
_LARGEST_SIGMA_M = 0.1


def read_distances_csv(path: Path, profile: Profile, readings: Mapping[str, Readings]) -> dict[str, Readings]:
    """Return the readings of each arm with the known distances of a file, both checked against the nominal arms.

    Raises
    ------
    InputError
        Names file, line and column of a value that is missing, not a number, repeated, unknown or contradicts the arm.
    """
    if not any(in_sockets(its) for its in readings.values()):
        raise InputError(f"{path}: known distances are between points; no reading names one: add the column 'point'")
    table = read_table_of(Path(path), "known distances", "distance", "a row per distance", _COLUMNS)
    problems = Problems(table.place)
    rows = _checked_rows(table, problems, readings)
    problems.check()
    lines = {(one.point_a, one.point_b): line for line, one in rows.items()}
    found = {}
    for arm, its in readings.items():
        own = tuple(one for one in rows.values() if one.point_a in (its.point or ()))
        found[arm] = its = replace(its, distances=own)
        if not own:
            continue
        for pair, text in wrong_distances(published_arm(profile, arm, its), its):
            problems.add(lines[pair], "distance_m", text)
    between = [
        one
        for one in rows.values()
        if not any({one.point_a, one.point_b} <= {*(its.point or ())} for its in found.values())
    ]
    for one, text in wrong_between_arms(*_both(profile, found), between) if between else ():
        problems.add(lines[one.point_a, one.point_b], "distance_m", text)
    problems.check()
    return found


def published_arm(profile: Profile, name: str, readings: Readings) -> Geometry:
    """Return the nominal chain of an arm; if the ball's offset is unknown, with the one that most readings agree on."""
    arm = profile.arms[name]
    return with_ball(nominal_arm(arm), readings, unknown=arm.smr.offset == "unknown")


def swapped_points(profile: Profile, name: str, readings: Readings) -> list[tuple[int, str]]:
    """Return the rows of one arm that are at another point by the nominal arm, with a message for each."""
    return list(misplaced_readings(published_arm(profile, name, readings), readings))


def swapped_between(profile: Profile, readings: Mapping[str, Readings]) -> tuple[str, list[tuple[int, str]]]:
    """Return the second of two arms in common sockets, and its rows whose point the first arm has elsewhere."""
    geometries, both = _both(profile, readings)
    return list(readings)[1], list(swapped_between_arms(geometries, both))


def _both(profile: Profile, readings: Mapping[str, Readings]) -> tuple[list[Geometry], list[Readings]]:
    """Return the nominal chains of two arms in sockets, and their readings."""
    return [published_arm(profile, name, its) for name, its in readings.items()], list(readings.values())


def _checked_rows(table: CsvTable, problems: Problems, readings: Mapping[str, Readings]) -> dict[int, Distance]:
    """Parse the distances by line; errors are noted."""
    arms_of = grouped((point or "", arm) for arm, its in readings.items() for point in dict.fromkeys(its.point or ()))
    rows: dict[int, Distance] = {}
    seen: dict[frozenset[str], int] = {}
    cells = zip(table.lines, *(table.cells[name] for name in _COLUMNS), strict=True)
    for line, *texts in cells:
        a, b, distance, sigma = (text.strip() for text in texts)
        before = problems.count
        for column, point in (("point_a", a), ("point_b", b)):
            if point not in arms_of:
                close = difflib.get_close_matches(point, arms_of, n=1, cutoff=0.6)
                hint = f"; is '{close[0]}' meant?" if close else ""
                problems.add(line, column, f"no reading is of a point '{short(point)}'{hint}")
        if problems.count > before:
            continue
        if a == b:
            problems.add(line, "point_b", f"'{short(b)}' is both points; a distance has two")
        elif len(readings) > 2 and set(arms_of[a]).isdisjoint(arms_of[b]):
            text = "points of different arms; with more than two arms, distances are within one arm"
            problems.add(line, "point_b", f"'{a}' and '{b}' are {text}")
        elif (first := seen.setdefault(frozenset((a, b)), line)) != line:
            problems.add(line, "point_a", f"the distance is in line {first} already; give the mean of both")
        values = [
            _number(problems, line, column, text, most)
            for column, text, most in (("distance_m", distance, _LONGEST_M), ("sigma_m", sigma, _LARGEST_SIGMA_M))
        ]
        if problems.count == before:
            rows[line] = Distance(a, b, *values)
    return rows


def _number(problems: Problems, line: int, column: str, text: str, most: float) -> float:
    value = float(text) if NUMBER.fullmatch(text) else math.nan
    if not 0.0 < value <= most:
        problems.add(line, column, f"expected metres above 0 and up to {most:g}, got '{short(text)}'")
    return value


def distances_text(readings: Mapping[str, Readings]) -> str:
    """Compose the document that a run keeps."""
    return json.dumps([asdict(one) for one in dict.fromkeys(d for its in readings.values() for d in its.distances)])


def with_distances(connection: sqlite3.Connection, readings: Readings) -> Readings:
    """Add the stored distances between their points to the readings of one arm."""
    if readings.point is None:
        return readings
    document = select_document(connection, DISTANCES_RESULT)
    if document is None:
        return readings
    stored = (Distance(**its) for its in json.loads(document.text))
    return replace(readings, distances=tuple(one for one in stored if one.point_a in readings.point))
