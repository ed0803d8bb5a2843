"""The verb ``import``: a new run of readings or recordings of motion from CSV files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.csv_import import WhichSmr, readings_from_csv
from cellapp.cell.run.file import note_profile
from cellapp.cell.run.measurement_order import read_in_order
from cellapp.cell.run.recordings import recording_states, recordings_from_csv
from cellapp.cell.run.records import ArmOrder, RecordingState
from cellapp.commands.collect.view import recording_tables
from cellapp.commands.record import Asked, NewRun, ProfilePath, Request, Verb, View, Work
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import Result
from cellapp.ground.shell import shell_word


class ImportRequest(Request):
    """Make a run from readings, or from recordings of motion, that were measured elsewhere.

    A recording is a file of joint positions and one of points, each with the clock of its device; several are given by
    repeating both options, in the same order.
    """

    profile: ProfilePath
    csv: Annotated[Path | None, Asked("Readings; 'cellapp docs files' has the columns.", "CSV", argument=True)] = None
    folder: NewRun
    in_order: Annotated[
        bool, Asked("rows stand in the order of measurement, or by time_s; derive missing approach and step.", of="csv")
    ] = False
    reference_nests: Annotated[
        Path | None, Asked("nests on the floor that tie stations: station, nest, x_m, y_m, z_m.", "FILE", of="csv")
    ] = None
    smr: Annotated[
        str | None,
        Asked("take only this SMR, where several were measured at a stop; three give a rotation.", "NAME", of="csv"),
    ] = None
    joints: Annotated[tuple[Path, ...], Asked("Joint positions of a motion: time_s, q1, q2, ...", "FILE")] = ()
    points: Annotated[tuple[Path, ...], Asked("Points of the same motion: time_s, x_m, y_m, z_m.", "FILE")] = ()
    column: Annotated[
        tuple[str, ...], Asked("The column of recordings that counts, where two may be meant.", "NAME")
    ] = ()
    arm: Annotated[str | None, Asked("the arm of recordings that do not say it.", "NAME", of="joints")] = None

    @model_validator(mode="after")
    def _something(self) -> Self:
        """Return readings, recordings or both."""
        if len(self.joints) != len(self.points):
            raise ValueError("give a file of --joints and one of --points for each recording")
        if self.csv is None and not self.joints:
            raise ValueError("give the CSV of readings, or --joints and --points of a recording")
        return self


VERB = Verb("import", ImportRequest, chapter="readings")


class ImportResult(Result, schema="cellapp-import"):
    """``import``: number of readings of each arm; ``in_order`` maps arms to what their order of measurement gave."""

    run: str
    readings: Mapping[str, int]
    recordings: tuple[RecordingState, ...] = ()
    in_order: Mapping[str, ArmOrder] = Field(default_factory=dict)
    notes: tuple[str, ...]


def run(request: ImportRequest, work: Work) -> ImportResult:
    """Make the run; ask which SMR counts where two of a stop give no rotation."""
    profile = load_profile(request.profile)
    try:
        result = import_new_run(profile, request)
    except WhichSmr as error:
        if not (smr := work.choose(str(error), error.names)):
            raise
        result = import_new_run(profile, request.model_copy(update={"smr": smr}))
    with RunFile.open(request.folder, write=True) as made:
        note_profile(made, request.profile)
    return result


def import_new_run(profile: Profile, request: ImportRequest) -> ImportResult:
    """Make a new run from readings in a CSV file, recordings of motion, or both; nothing is left of a bad one.

    Raises
    ------
    InputError
        If files, profile and options do not go together, or the folder holds a run.
    """
    recorded, fills = frozenset[str](), []
    if request.joints:
        recorded, fill = recordings_from_csv(profile, request.joints, request.points, request.arm, request.column)
        fills.append(fill)
    if request.csv is not None:
        fills.append(
            readings_from_csv(
                profile,
                request.csv,
                in_order=request.in_order,
                recorded=recorded,
                reference_nests=request.reference_nests,
                smr=request.smr,
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

    with RunFile.create(request.folder, profile, fill_all) as run:
        return ImportResult(
            run=str(request.folder),
            readings={name: len(run.readings(name)) for name in run.arms()},
            recordings=recording_states(run),
            in_order=read_in_order(run),
            notes=tuple(event.text for event in run.events() if event.level == "note"),
        )


def view(result: ImportResult, request: Request | None = None) -> View:
    """Show the number of readings and the recordings of each arm, and notes."""
    counts = (f"arm {name}: {counted(count, 'reading')}" for name, count in result.readings.items())
    onward = f"next: cellapp calibrate {shell_word(result.run)}"
    return View((*counts, *recording_tables(result.recordings), *result.notes, onward), held="; ".join(result.notes))
