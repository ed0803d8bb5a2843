"""Results of ``runs`` and ``compare``: what a folder of runs holds, and where two runs differ."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

from cellapp.commands.next_step import ArmState
from cellapp.commands.stages import NextVerb
from cellapp.estimation.discovery.records import BeforeAfter, Place
from cellapp.ground.profile import CellKind
from cellapp.ground.results import Method, Record, Result, Stage, StageName, Verdict

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
    tracker_due : str
        Until when the tracker's calibration is valid (ISO 8601); empty where the profile does not say.
    """

    run: str
    problem: str = ""
    profile: str = ""
    cell: CellKind = "none"
    began: str = ""
    changed: str = ""
    arms: Mapping[str, ArmState] = {}
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
    tracker_due: str = ""

    @property
    def resumable(self) -> bool:
        """Whether ``collect --resume`` can continue it now."""
        return self.interrupted and not self.in_use


class RunsResult(Result, schema="cellapp-runs"):
    """``runs``: every run below a folder, newest first."""

    folder: str
    runs: tuple[RunSummary, ...]


class ProfileDifference(Record):
    """A key of the profile, as ``arms.left.base.position[0]``, with its values as JSON; None where it is missing."""

    key: str
    a: str | None
    b: str | None


class ValueComparison(Record):
    """A parameter of two runs with standard errors, all in ``unit``; None where a run does not have it.

    ``difference`` is b less a; ``z`` is that over the combined standard uncertainty, the root of the sum of both
    squared standard errors (JCGM 100:2008, 5.1.2, for independent estimates).
    """

    name: str
    unit: str
    a: float | None
    b: float | None
    a_standard_error: float | None
    b_standard_error: float | None
    difference: float | None
    z: float | None

    @property
    def combined_standard_uncertainty(self) -> float | None:
        """Root of the sum of both squared standard errors; None where one is not known."""
        if self.a_standard_error is None or self.b_standard_error is None:
            return None
        return math.hypot(self.a_standard_error, self.b_standard_error)

    @property
    def differs(self) -> bool:
        """Whether the two values differ by more than three combined standard uncertainties."""
        return self.z is not None and abs(self.z) > MOST_Z


MOST_Z = 3.0
"""Difference in combined standard uncertainties from which it counts: 0.3 % of normal differences are larger."""


class ErrorComparison(Record):
    """Mean and rms error of two runs [mm]; None where a run does not have it."""

    a_mean_mm: float | None
    b_mean_mm: float | None
    a_rms_mm: float | None
    b_rms_mm: float | None


class EffectComparison(Record):
    """An effect in one run or in both: where it acts, None in a run without it, and its sizes."""

    effect: str
    title: str
    a_where: Place | None
    b_where: Place | None
    parameters: tuple[ValueComparison, ...]

    @property
    def found_in(self) -> Literal["a", "b", "both"]:
        """Which of the runs has the effect."""
        if self.a_where is not None and self.b_where is not None:
            return "both"
        return "b" if self.a_where is None else "a"


class ArmComparison(Record):
    """One arm of two runs: parameters of the geometry, held-out errors by stage, effects, verification.

    ``verified_mm`` has the distances from the targets with nominal and with compensated commands.
    """

    parameters: tuple[ValueComparison, ...] = ()
    heldout_mm: Mapping[Stage, ErrorComparison] = {}
    effects: tuple[EffectComparison, ...] = ()
    verified_mm: Mapping[Literal["nominal", "compensated"], ErrorComparison] = {}


class PairComparison(Record):
    """The inter-base transform of ``method`` in two runs, and the pair's held-out cooperative errors by method.

    ``distance_mm`` is the distance between the two origins of the second base in the frame of the first.
    """

    method: Method | None
    parameters: tuple[ValueComparison, ...] = ()
    distance_mm: float | None = None
    cooperative_mm: Mapping[Method, ErrorComparison] = {}


class RunComparison(Result, schema="cellapp-comparison"):
    """``compare``: where two runs differ; ``notes`` say what cannot be compared, and what is out of date."""

    a: str
    b: str
    profile: tuple[ProfileDifference, ...]
    arms: Mapping[str, ArmComparison]
    pair: PairComparison | None
    notes: tuple[str, ...]
