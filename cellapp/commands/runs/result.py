"""Results of ``runs``: what a folder of runs holds, one arm over its runs; a run of a list in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from cellapp.cell.run.run_arms import IdentityBasis
from cellapp.commands.next_step import ArmProgress
from cellapp.commands.stages import NextVerb
from cellapp.estimation.discovery.records import BeforeAfter
from cellapp.ground.profile import CellKind
from cellapp.ground.results import Record, Result, Stage, StageName, Verdict

LastSession = Literal["complete", "accurate enough", "stopped", "aborted", "failed", "no end"]
"""End of the last session of collecting; "no end": the program died during it, or it is still running."""


class ArmFigures(Record):
    """The figures of one arm of a run that a list shows; None where the stage that has them was not stored.

    ``heldout_mm`` are mean held-out position errors [mm] with the identified geometry and with ``best_stage``, the last
    stage that was computed and still holds. ``verified_mm`` are mean distances from the targets [mm] without and with
    compensation.
    """

    heldout_mm: BeforeAfter | None = None
    best_stage: Stage | None = None
    verdict: Verdict | None = None
    effects: tuple[str, ...] = ()
    verified_mm: BeforeAfter | None = None


class StageSummary(Record):
    """A stored stage; ``out_of_date`` is the reason, None where it holds."""

    name: StageName
    written: str
    out_of_date: str | None = None


class RunSummary(Record):
    """One run in a list.

    Attributes
    ----------
    run : str
        Its folder.
    problem : str
        Why it cannot be read, a sentence; only ``changed``, ``size_bytes`` and ``in_use`` are known then.
    began, changed : str
        When it was made, and when its file last changed (ISO 8601, UTC).
    stops_planned, stops_measured, stops_left : int
        Planned stops without reserves, stops with readings, and planned stops without.
    sessions : int
        Sessions of collecting; 0 for a plan alone or an import.
    stages : tuple
        The newest stage of each name. Whether it holds is judged by the number of readings; opening the run compares
        the readings themselves.
    interrupted : bool
        Whether the last session of collecting ended early and stops are left.
    in_use : str
        The job that uses it now, a phrase; empty if none does.
    size_bytes : int
        Size of all files in its folder.
    """

    run: str
    problem: str = ""
    profile: str = ""
    cell: CellKind = "none"
    began: str = ""
    changed: str = ""
    arms: Mapping[str, ArmProgress] = {}
    stops_planned: int = 0
    stops_measured: int = 0
    stops_left: int = 0
    sessions: int = 0
    last_session: LastSession | None = None
    stages: tuple[StageSummary, ...] = ()
    figures: Mapping[str, ArmFigures] = {}
    next_verb: NextVerb = ""
    next_step: str = ""
    interrupted: bool = False
    in_use: str = ""
    size_bytes: int = 0

    @property
    def resumable(self) -> bool:
        """Whether ``collect --resume`` can continue it now."""
        return self.interrupted and not self.in_use


class RunsResult(Result, schema="cellapp-runs"):
    """``runs``: every run below a folder, newest first."""

    folder: str
    runs: tuple[RunSummary, ...]


class MovedParameter(Record):
    """A parameter of the geometry that moved beyond its uncertainty since the first calibration [m, rad].

    ``moved_mm`` is the rms displacement of the SMR by ``difference`` over evenly drawn configurations; ``chance`` that
    of such a difference without a change, times the number of ``comparisons`` of the whole history.
    """

    name: str
    unit: str
    difference: float
    standard_uncertainty: float
    moved_mm: float
    chance: float


class ArmRun(Record):
    """One run of an arm, which its profile calls ``name``.

    ``compared``: it was compared with the first calibration, ``moved`` is what moved since. Otherwise ``remark`` says
    why it was not.
    """

    run: str
    began: str
    name: str
    figures: ArmFigures
    compared: bool = False
    remark: str = ""
    moved: tuple[MovedParameter, ...] = ()


class ArmHistory(Result, schema="cellapp-arm-history"):
    """``runs --history``: one arm over its runs, the oldest first.

    ``arm`` is its serial number or, where none is known, the names of profile and arm with its type. ``false_alarm`` is
    the largest chance that anything at all is said to have moved where nothing has; ``comparisons`` share it.
    ``problems`` are sentences on runs that cannot be read.
    """

    folder: str
    arm: str
    known_by: IdentityBasis
    runs: tuple[ArmRun, ...]
    false_alarm: float
    comparisons: int
    problems: tuple[str, ...] = ()


CELL_WORDS: dict[CellKind, str] = {
    "simulated": "simulated",
    "emulated": "emulated",
    "real": "REAL ARMS",
    "none": "no arms",
}


def short_name(run: RunSummary | ArmRun, folder: str) -> str:
    """Return the run's folder relative to the listed one."""
    path = Path(run.run)
    return str(path.relative_to(folder)) if path.is_relative_to(folder) and path != Path(folder) else run.run


def stops_words(run: RunSummary) -> str:
    """State the measured stops as ``120/400 stopped``; only their number for imported readings."""
    if not run.stops_planned:
        return str(run.stops_measured)
    words = session_words(run)
    return f"{run.stops_measured}/{run.stops_planned} {'' if words == 'complete' else words}".rstrip()


def session_words(run: RunSummary) -> str:
    """Say how the last session of collecting ended, or that it is still running."""
    if run.in_use and run.last_session == "no end":
        return "running"
    return run.last_session or ("" if run.stops_measured else "not begun")


def next_words(run: RunSummary) -> str:
    """Return the next verb, and whether a result is out of date; ``done`` if nothing is left to do."""
    outdated = any(stage.out_of_date for stage in run.stages)
    return f"{run.next_verb or ('decide' if run.next_step else 'done')}{' (out of date)' if outdated else ''}"


def effects_words(effects: Sequence[str]) -> str:
    """Return the names of effects in words."""
    return ", ".join(slug.replace("_", " ") for slug in effects)
