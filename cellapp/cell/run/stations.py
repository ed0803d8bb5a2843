"""Tracker stations of a run, tied by reference nests from a CSV file; readings are given in the frame of the first."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cellapp.cell.run.csv_text import CsvTable, Problems, read_csv_table
from cellapp.cell.run.sqlite_file import select_document
from cellapp.cell.run.table_spec import ArmCells, TableSpec
from cellapp.estimation.calibration.station_location import NestPoint, StationTie, TooFewNests, tie_stations
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.columns import COLUMNS, Column
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import Array, apply, quaternions_of, rotations_of

STATIONS_RESULT = "stations"
"""Name of the document in which a run keeps the poses of its stations; it is part of the file format."""
_AS_READINGS = [column for column in COLUMNS if column.name in ("p_M", "sigma_m")]
_WORDS = [Column(name, "", (name,), dtype=str, required=True) for name in ("station", "nest")]
_NESTS = TableSpec((*_WORDS, *_AS_READINGS))
_SIGMA_M = 2e-5
"""Standard uncertainty of a nest that states none [m]."""
_OFF = 6.0
"""Residual in standard uncertainties from which a nest has moved or is mistaken for another."""

Poses = dict[str, Array]
"""Station -> T (4, 4) into the frame of the first one, which has the identity."""


def read_reference_nests(path: Path, readings: Mapping[str, Readings]) -> tuple[str, dict[str, StationTie]]:
    """Read the first station of the file, and the ties of the others to it.

    Raises
    ------
    InputError
        Names file, line and column of a value that is missing, not a number, repeated or off; and a station of the
        readings that the file lacks.
    """
    row = "a row per nest and station"
    table = read_csv_table(Path(path), "reference nests", row)
    problems = Problems(table.place)
    *needed, sigma = _NESTS.by_name
    for name, _ in _NESTS.missing(table.names):
        problems.add(1, name, f"the column is missing; expected {', '.join(needed)} and perhaps {sigma}")
    problems.check()
    if not table.lines:
        raise InputError(f"{table.place(1)}: there is a header row but no nest; expected {row}")
    rows = _checked_rows(table, problems)
    problems.check()
    points = list(rows.values())
    first = points[0].station
    try:
        ties = tie_stations(first, points)
    except TooFewNests as error:
        raise InputError(
            f"{path}: station '{error.station}' is not tied to '{first}': measure three nests or more from both that"
            " are not on one line"
        ) from error
    for line, text in _off(rows, first):
        problems.add(line, "nest", text)
    problems.check()
    for arm, its in readings.items():
        unknown = sorted({one for one in its.station or () if one is not None} - {first, *ties})
        if unknown:
            raise InputError(
                f"{path}: station: no nest of station {', '.join(unknown)}, which readings of arm {arm} name"
            )
    return first, ties


def require_ties(path: Path, readings: Mapping[str, Readings]) -> None:
    """Raise ``InputError`` if readings are of several stations that nothing ties."""
    names = sorted({one or "without a name" for its in readings.values() for one in its.station or ()})
    if len(names) > 1:
        raise InputError(
            f"{path}: station: readings of {counted(len(names), 'station')} ({', '.join(names)}) have frames of their"
            " own; give the reference nests that tie them (--reference-nests FILE)"
        )


def twice_at_a_stop(its: Readings) -> Iterator[tuple[int, str]]:
    """Yield the first row of one arm at a stop that another station has too, with a message."""
    if its.station is None:
        return
    seen: dict[int, str | None] = {}
    for row, (stop, station) in enumerate(zip(its.configuration.tolist(), its.station, strict=True)):
        if seen.setdefault(stop, station) != station:
            yield (
                row,
                f"'{station}', but stop {stop} is of station '{seen[stop]}' too; give each station stops of its own",
            )
            return


def stations_text(first: str, ties: Mapping[str, StationTie], sentences: Sequence[str]) -> str:
    """Compose the document that a run keeps: poses, and how well they are known."""
    poses = {first: np.eye(4).tolist(), **{name: tie.T.tolist() for name, tie in ties.items()}}
    return json.dumps({"poses": poses, "sentences": list(sentences)})


def select_stations(connection: sqlite3.Connection) -> Poses:
    """Read the poses of a run's stations; empty if there are none."""
    document = select_document(connection, STATIONS_RESULT)
    return {} if document is None else {name: np.array(T) for name, T in json.loads(document)["poses"].items()}


def stored_tie_sentences(document: str | None) -> tuple[str, ...]:
    """Return how well the stations of a run are tied, from its document; None if there is none."""
    return () if document is None else tuple(json.loads(document)["sentences"])


def in_one_frame(readings: Readings, poses: Poses) -> Readings:
    """Transform readings into the frame of the first station."""
    if readings.station is None or not poses:
        return readings
    T = np.array([poses.get(name, np.eye(4)) for name in map(str, readings.station)])
    rotation, shift = T[:, :3, :3], T[:, :3, 3]
    quaternion = readings.quaternion_M
    if quaternion is not None:
        quaternion = quaternions_of(rotation @ rotations_of(quaternion))
    return replace(
        readings,
        p_M=np.einsum("nab,nb->na", rotation, readings.p_M) + shift,
        covariance_M=_rotated(readings.covariance_M, rotation),
        rotation_covariance_M=_rotated(readings.rotation_covariance_M, rotation),
        quaternion_M=quaternion,
        station=None,
    )


def _rotated(covariance: Array | None, rotation: Array) -> Array | None:
    return None if covariance is None else np.asarray(rotation @ covariance @ rotation.swapaxes(1, 2))


def tie_sentences(first: str, ties: Mapping[str, StationTie], readings: Mapping[str, Readings]) -> list[str]:
    """Say how well each station is tied to the first one, at the points where the arms were measured."""
    sentences = []
    for name, tie in ties.items():
        words = (
            f"station {name} is tied to {first} by {counted(len(tie.nests), 'reference nest')}, which are off by"
            f" {1e3 * float(np.sqrt(np.mean(tie.residual_m**2))):.3f} mm rms"
        )
        for arm, its in readings.items():
            own = [row for row, station in enumerate(its.station or ()) if station == name]
            if own:
                sigma_mm = 1e3 * tie.uncertainty(apply(tie.T, its.p_M[own]))
                words += f"; a coordinate of arm {arm} is known to {sigma_mm.max():.3f} mm from there"
        sentences.append(words)
    return sentences


def _checked_rows(table: CsvTable, problems: Problems) -> dict[int, NestPoint]:
    """Return the nests by line; points and uncertainties are checked as those of readings."""
    cells = ArmCells(table, range(len(table.lines)), problems)
    given = {column: cells.matrix(column, 0) for column in _AS_READINGS}
    for column, values in given.items():
        if values is not None:
            cells.check(column, values, 0, None)
    problems.check()
    p, sigma = given.values()
    assert p is not None
    sigma_m = np.full(len(p), _SIGMA_M) if sigma is None else np.where(np.isnan(sigma), _SIGMA_M, sigma)[:, 0]
    seen: dict[tuple[str, str], int] = {}
    rows: dict[int, NestPoint] = {}
    for row, (line, *words) in enumerate(zip(table.lines, cells.texts("station"), cells.texts("nest"), strict=True)):
        station, nest = map(str.strip, words)
        for name, word in (("station", station), ("nest", nest)):
            if not word:
                problems.add(line, name, "the value is missing")
        if (first := seen.setdefault((station, nest), line)) != line:
            problems.add(
                line, "nest", f"'{nest}' of station '{station}' is in line {first} already; give the mean of both"
            )
        rows[line] = NestPoint(station, nest, p[row], float(sigma_m[row]))
    return rows


def _off(rows: Mapping[int, NestPoint], first: str) -> Iterator[tuple[int, str]]:
    """Yield the line of the nest without which the others fit, if all together do not fit."""
    points = list(rows.values())
    if _worst(first, points)[0] <= _OFF:
        return
    without = list[tuple[float, int, float]]()
    for line, one in rows.items():
        others = [other for other in points if other is not one]
        try:
            worst, ties = _worst(first, others)
        except TooFewNests:
            continue
        known = [apply(_pose(ties, o.station), o.p[None])[0] for o in others if o.nest == one.nest]
        if known and one.station in ties:
            off = float(np.linalg.norm(apply(ties[one.station].T, one.p[None])[0] - np.mean(known, axis=0)))
            without.append((worst, line, off))
    for _, line, off in sorted(without)[:1]:
        yield (
            line,
            f"'{rows[line].nest}' of station '{rows[line].station}' is off by {1e3 * off:.2f} mm from where the other"
            " nests have it; did it move, or are names exchanged?",
        )


def _worst(first: str, points: Sequence[NestPoint]) -> tuple[float, dict[str, StationTie]]:
    """Return the largest residual in standard uncertainties, and the ties."""
    ties = tie_stations(first, points)
    sigma = {(one.station, one.nest): one.sigma_m for one in points}
    largest = max(
        (float(off) / sigma[name, nest] for name, tie in ties.items() for nest, off in zip(tie.nests, tie.residual_m)),
        default=0.0,
    )
    return largest, ties


def _pose(ties: Mapping[str, StationTie], station: str) -> Array:
    return ties[station].T if station in ties else np.eye(4)
