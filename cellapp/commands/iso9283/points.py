"""The file of raw points beside a run, from which other programs can recompute all figures of a test."""

from __future__ import annotations

import hashlib
from pathlib import Path

from cellapp.cell.driving.iso9283.findings import IsoFindings
from cellapp.cell.run.csv_text import table_text
from cellapp.estimation.iso9283.raw_points import HEADER, raw_rows
from cellapp.ground.outputs import NEW_ONLY

_NAME = "iso9283-points"


def write_points(folder: Path, found: IsoFindings) -> tuple[str, str]:
    """Write all measured points into a new file of the folder; return its name and SHA-256, both empty without points.

    Raises ``InputError`` if the file cannot be written.
    """
    tracks = [
        *(runs.tracks for runs in found.paths),
        *(runs.tracks for runs in found.settling),
        *(runs.tracks for runs in found.weaving),
    ]
    if not found.measured.visits and not any(tracks):
        return "", ""
    data = table_text(
        HEADER, raw_rows(found.programmes, found.measured, found.paths, found.settling, found.weaving)
    ).encode()
    path = _unused(folder)
    NEW_ONLY.write(path, data)
    return path.name, hashlib.sha256(data).hexdigest()


def _unused(folder: Path) -> Path:
    """Return an unused file name, as a run keeps the points of each of its tests."""
    path, number = folder / f"{_NAME}.csv", 1
    while path.exists():
        number += 1
        path = folder / f"{_NAME}-{number}.csv"
    return path
