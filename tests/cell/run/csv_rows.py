"""Rows of a CSV file by the names of its columns, for tests that change some of them."""

from __future__ import annotations

import csv
from pathlib import Path

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
