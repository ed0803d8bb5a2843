"""The verb ``import``: a new run of readings or recordings of motion from CSV files."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from cellapp.cell.driving.records import ImportResult
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.csv_import import WhichSmr, readings_from_csv
from cellapp.cell.run.measurement_order import read_in_order
from cellapp.cell.run.recordings import recording_states, recordings_from_csv
from cellapp.commands.import_.request import ImportRequest
from cellapp.commands.record import Work
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile


def run(request: ImportRequest, work: Work) -> ImportResult:
    """Make the run; ask which SMR counts where two of a stop give no rotation."""
    make = partial(
        import_new_run,
        load_profile(request.profile),
        request.csv,
        request.folder,
        in_order=request.in_order,
        recordings=(request.joints, request.points),
        arm=request.arm,
        reference_nests=request.reference_nests,
    )
    try:
        return make(smr=request.smr)
    except WhichSmr as error:
        if not (smr := work.choose(str(error), error.names)):
            raise
        return make(smr=smr)


def import_new_run(
    profile: Profile,
    csv: Path | None,
    folder: Path,
    *,
    in_order: bool = False,
    recordings: tuple[Sequence[Path], Sequence[Path]] = ((), ()),
    arm: str | None = None,
    reference_nests: Path | None = None,
    smr: str | None = None,
) -> ImportResult:
    """Make a new run from readings in a CSV file, recordings of motion, or both.

    ``recordings`` are files of joints and of points, pair by pair, and ``arm`` their arm if they do not state one.
    ``reference_nests`` is a file of nests that tie tracker stations together; ``smr`` is as in ``readings_of_table``.

    Raises
    ------
    InputError
        As ``readings_from_csv`` and ``recordings_from_csv``, and if an arm of the profile has no data; no run is made.
    """
    recorded, fills = frozenset[str](), []
    if any(recordings):
        recorded, fill = recordings_from_csv(profile, *recordings, arm)
        fills.append(fill)
    if csv is not None:
        fills.append(
            readings_from_csv(
                profile, csv, in_order=in_order, recorded=recorded, reference_nests=reference_nests, smr=smr
            )
        )
    elif missing := [name for name in profile.arms if name not in recorded]:
        raise InputError(
            f"import: no recording of arm {', '.join(missing)} of the profile; add its recordings or readings, or"
            " remove the arm from the profile"
        )

    def fill_all(run: RunFile) -> None:
        for fill in fills:
            fill(run)

    with RunFile.create(folder, profile, fill_all) as run:
        return ImportResult(
            run=str(folder),
            readings={name: len(run.readings(name)) for name in run.arms()},
            recordings=recording_states(run),
            in_order=read_in_order(run),
            notes=tuple(event.text for event in run.events() if event.level == "note"),
        )
