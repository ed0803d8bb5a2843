"""Readings of a CSV file, and its rows by the names of its columns, for tests that change some of them."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from cellapp.cell.run import RunFile
from cellapp.cell.run.csv_import import arms_of_table, readings_from_csv
from cellapp.cell.run.csv_text import read_csv_table
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from tests.arms import Array

Rows = list[dict[str, str]]


def rows_of(path: Path) -> Rows:
    """The rows of a file."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def written(path: Path, rows: Rows) -> Path:
    """The file of these rows."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def read_readings_csv(
    path: Path, joints: Mapping[str, int], *, in_order: bool = False, limits: Mapping[str, Array] | None = None
) -> tuple[dict[str, Readings], list[str]]:
    """The readings of each arm in a file, and notes."""
    readings, _, _, notes = arms_of_table(read_csv_table(path), joints, in_order, limits or {})
    return readings, notes


def import_csv(profile: Profile, csv: Path, folder: Path, *, in_order: bool = False) -> RunFile:
    """A new run of the readings in a file."""
    return RunFile.create(folder, profile, readings_from_csv(profile, csv, in_order=in_order))
