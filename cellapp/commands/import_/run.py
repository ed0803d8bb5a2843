"""The verb ``import``: a new run of readings from a CSV file."""

from __future__ import annotations

from pathlib import Path

from cellapp.cell.driving.records import ImportResult
from cellapp.cell.profile import load_profile
from cellapp.cell.run import import_csv
from cellapp.cell.run.in_order import read_in_order
from cellapp.commands.import_.request import ImportRequest
from cellapp.commands.record import Work
from cellapp.ground.profile import Profile


def run(request: ImportRequest, work: Work) -> ImportResult:
    """Make the run."""
    return import_new_run(
        load_profile(request.profile),
        request.csv,
        request.folder,
        in_order=request.in_order,
        distances=request.distances,
    )


def import_new_run(
    profile: Profile, csv: Path, folder: Path, *, in_order: bool = False, distances: Path | None = None
) -> ImportResult:
    """Make a new run from readings in a CSV file; ``in_order``, ``distances`` and errors are as in ``import_csv``."""
    with import_csv(profile, csv, folder, in_order=in_order, distances=distances) as run:
        return ImportResult(
            run=str(folder),
            readings={name: len(run.readings(name)) for name in run.arms()},
            in_order=read_in_order(run),
            notes=tuple(event.text for event in run.events() if event.level == "note"),
        )
