"""Data for the screens: the profile, the open run, and the progress of each step of the day."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellapp.commands.docs.keys import Step
from cellapp.ground.errors import CellappError, InputError
from cellapp.ground.job_client import JOB_FILE, who_uses

if TYPE_CHECKING:
    from cellapp.cell.planning.planned_stops import PlannedStops
    from cellapp.cell.run.sqlite_file import Event
    from cellapp.commands.collect.result import CollectionResult
    from cellapp.commands.next_step import Conclusion
    from cellapp.commands.plan.result import StopsResult
    from cellapp.commands.report.data import ReportData
    from cellapp.commands.run_results import RunResults
    from cellapp.commands.run_state import RunState
    from cellapp.commands.show.result import OverviewResult
    from cellapp.commands.view.parts import Parts
    from cellapp.commands.view.words import Verdict
    from cellapp.estimation.uncertainty.records import Conformity
    from cellapp.ground.profile import CellKind, Profile
    from cellapp.ground.results import StageName


@dataclass(frozen=True, eq=False)
class Workspace:
    """A profile and a run of it, read once for the screens.

    Attributes
    ----------
    profile : Profile or None
        That of the run if one is open, else that of ``profile_path``.
    folder : Path or None
        The run; None if none is open.
    overview, results, collection, stops, ways
        Content of the run; None without a run. ``ways`` is how each stop is reached, and its purpose.
    problem : str
        Why profile or run cannot be used, in a sentence; empty if they can.
    edited : bool
        Whether the file of the profile was changed since the run was planned from it.
    in_use : str
        Which job used the run when it was read, as a phrase; empty if none did.
    conclusions : mapping
        Stage -> its conclusion.
    conformity : str or None
        The verdict on the tolerances; None if nothing is judged.
    verdict : tuple or None
        The verdict, its judgements and next steps; None without a run.
    data : ReportData or None
        Readings, models and held-out errors; None if the run is not calibrated.
    log : tuple of Event
        The log that the run stores.
    reported, read_only : bool
        Whether the page of the run is written; whether its folder cannot be written.
    beside_run : Profile or None
        If a run is open, the current content of ``profile_path``, which may be another cell than that of the run.
    """

    profile_path: Path | None = None
    profile: Profile | None = None
    folder: Path | None = None
    overview: OverviewResult | None = None
    results: RunResults | None = None
    collection: CollectionResult | None = None
    stops: StopsResult | None = None
    ways: PlannedStops | None = None
    problem: str = ""
    edited: bool = False
    in_use: str = ""
    beside_run: Profile | None = None
    conclusions: Mapping[StageName, Conclusion] = field(default_factory=dict)
    conformity: Conformity | None = None
    verdict: tuple[Verdict, Parts] | None = None
    data: ReportData | None = None
    log: tuple[Event, ...] = ()
    reported: bool = False
    read_only: bool = False

    def stored(self, stage: StageName | Step) -> Any:
        """Return the result of a stage that the run stores, also one that is out of date; None if there is none."""
        return None if self.results is None else getattr(self.results, stage)

    @property
    def file_profile(self) -> Profile | None:
        """Content of ``profile_path``, from which a new run is planned, whichever run is open."""
        return self.profile if self.folder is None else self.beside_run

    @property
    def kind(self) -> CellKind:
        """Whether this cell's arms are real, emulated or simulated; ``none`` if none can move."""
        return "none" if self.profile is None else self.profile.cell_kind

    @property
    def arms_words(self) -> str:
        """Which arms a job would move."""
        return "REAL ARMS WILL MOVE" if self.kind == "real" else f"the arms are {self.kind}"

    @property
    def outcome(self) -> str:
        """How the last session of collecting ended; empty without one, or if the program died in it."""
        last = None if self.collection is None else self.collection.last
        return "" if last is None else last.outcome or ""

    @property
    def drifts(self) -> bool:
        """Whether the newest reference measurements of the run are beyond the limit."""
        rows = () if (collection := self.collection) is None else collection.references
        newest = (row for row in rows if row.stops_done == rows[-1].stops_done)
        return collection is not None and any(row.drift_mm > collection.drift_limit_mm for row in newest)

    @property
    def unseen(self) -> Mapping[str, str]:
        """Arms that the run counts as moving, arm -> why they were not seen at rest."""
        return {} if self.overview is None else {n: a.reason for n, a in self.overview.not_seen_at_rest.items()}

    @property
    def stale(self) -> str:
        """Why the model in force should not be used; empty if it may be, or there is none."""
        return "" if self.overview is None else self.overview.stale


def holds_run(folder: Path | None) -> bool:
    """Return whether a folder contains a run file."""
    from cellapp.cell.run.sqlite_file import FILE_NAME

    return folder is not None and (folder / FILE_NAME).is_file()


_SQLITE = b"SQLite format 3"


def last_run(logs: Path) -> Path | None:
    """Return the run below a folder that was changed last, before all one with a job; quickly, without reading any."""
    found = []
    for file in logs.glob("*/run.sqlite"):
        with suppress(OSError), file.open("rb") as opened:
            if opened.read(len(_SQLITE)) == _SQLITE:
                found.append(((file.parent / JOB_FILE).exists(), file.stat().st_mtime, file.parent))
    return max(found, default=(False, 0.0, None))[2]


def load_workspace(profile_path: Path | None, folder: Path | None) -> Workspace:
    """Read a profile and a run. A problem is part of the return value; bad files raise nothing."""
    from cellapp.cell.profile import load_profile

    profile, problem = None, ""
    if profile_path is not None:
        try:
            profile = load_profile(profile_path)
        except CellappError as error:
            problem = str(error)
    if folder is None:
        return Workspace(profile_path, profile, problem=problem)
    try:
        return _with_run(profile_path, profile, folder)
    except CellappError as error:
        why = str(error)
    except (OSError, ValueError, TypeError) as error:  # whatever a damaged or foreign file may contain
        why = f"{folder} holds values that this cellapp cannot read ({str(error).partition(chr(10))[0]})"
    return Workspace(profile_path, profile, problem=f"{problem}; {why}" if problem else why)


def _with_run(profile_path: Path | None, profile: Profile | None, folder: Path) -> Workspace:
    from cellapp.cell.planning.planned_stops import read_planned_stops
    from cellapp.cell.run import RunFile
    from cellapp.cell.run.sqlite_file import FILE_NAME, REPORT_FILE
    from cellapp.commands.collect.state import collection_state
    from cellapp.commands.next_step import stage_conclusions
    from cellapp.commands.plan.run import planned_stops
    from cellapp.commands.report.summary import read_verdict
    from cellapp.commands.run_state import RunState
    from cellapp.commands.show.overview import run_log, run_overview

    with RunFile.open(folder) as run:
        state = RunState(run)
        data = _report_data(state)
        return Workspace(
            profile_path,
            run.profile,
            folder,
            run_overview(state),
            state.results,
            collection_state(run, state.results),
            planned_stops(run),
            read_planned_stops(run),
            edited=profile is not None and profile.name == run.profile.name and profile != run.profile,
            in_use=who_uses(folder),
            beside_run=profile,
            conclusions=stage_conclusions(state.results),
            conformity=state.conformity,
            verdict=read_verdict(state, data, datetime.now(UTC).date()),
            data=data,
            log=run_log(run).lines,
            reported=(folder / REPORT_FILE).exists(),
            read_only=not all(os.access(path, os.W_OK) for path in (folder, folder / FILE_NAME)),
        )


def _report_data(state: RunState) -> ReportData | None:
    """Return the data for plots of a run; None if it is not calibrated."""
    from cellapp.commands.report.data import read_report_data

    try:
        data = read_report_data(state)
    except InputError:
        return None  # the screen says what is missing
    for arm in data.held_out.values():
        _ = arm.errors_mm  # computed here, not while drawing
    return data


def new_folder(profile: Profile | None) -> Path:
    """Return the path of a new folder for a run. Raises ``InputError`` without a profile."""
    from cellapp.commands.plan.run import default_folder

    if profile is None:
        raise InputError("no profile is open: choose one on the screen Cell")
    return default_folder(profile.name)
