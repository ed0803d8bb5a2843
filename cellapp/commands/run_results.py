"""Results of a whole run: ``run``, ``report`` and ``show``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeVar

from cellapp.cell.driving.records import CollectResult
from cellapp.cell.planning.design_records import PlanDesignResult
from cellapp.cell.run.records import ArmOrder
from cellapp.cell.targets.path_records import PathResult
from cellapp.cell.targets.records import CompensateResult, VerifyResult
from cellapp.commands.certificate.result import CertificateResult
from cellapp.commands.locate.result import LocateResult
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.iso9283.records import Iso9283Result
from cellapp.estimation.monitoring.check.records import CheckResult
from cellapp.ground.results import CHECK, STAGE_NAMES, Record, Result, StageName


class RunResults(Result):
    """The current results of a run, each None where that verb has not run.

    ``calibrate`` has the stage ``effects`` of the discovery as long as that holds. ``out_of_date`` maps the name of a
    result that no longer holds to the reason. Such a result is still there, so that it can be shown with its mark; it
    is None where this version cannot read what is stored.
    """

    schema_: str = "cellapp-results"
    version: int = 1
    run: str
    calibrate: CalibrateResult | None = None
    discover: DiscoverResult | None = None
    locate: LocateResult | None = None
    compensate: CompensateResult | None = None
    push: VerifyResult | None = None
    verify: VerifyResult | None = None
    path: PathResult | None = None
    follow: PathResult | None = None
    iso9283: Iso9283Result | None = None
    check: CheckResult | None = None
    certificate: CertificateResult | None = None
    out_of_date: Mapping[StageName, str] = {}
    omitted_when_none = frozenset(STAGE_NAMES)

    @property
    def held_check(self) -> CheckResult | None:
        """The last check while it holds."""
        return None if CHECK in self.out_of_date else self.check


class WholeRunResult(RunResults):
    """``run``: the folder, the results of every step, and notes for the operator."""

    schema_: Literal["cellapp-run"] = "cellapp-run"
    version: Literal[1] = 1
    collect: CollectResult | None = None
    notes: tuple[str, ...] = ()


class ReportResult(RunResults):
    """``report``: the page, the results that it shows, and its print where one was asked for."""

    schema_: Literal["cellapp-report"] = "cellapp-report"
    version: Literal[1] = 1
    page: str
    pdf: str | None = None
    omitted_when_none = RunResults.omitted_when_none | {"pdf"}


R = TypeVar("R", bound=RunResults)


def shown_by(kind: type[R], stored: RunResults, **more: object) -> R:
    """The stored results as the result of a verb that shows them."""
    return kind.model_validate({**{name: getattr(stored, name) for name in stored.model_fields_set}, **more})


class DocsResult(Result):
    """``docs``: a chapter or section of the handbook as Markdown, or the files that were drawn."""

    schema_: Literal["cellapp-docs"] = "cellapp-docs"
    version: Literal[1] = 1
    topic: str
    text: str | None = None
    files: tuple[str, ...] = ()


class ArmState(Record):
    """How much of one arm's plan is measured, and in which splits."""

    type: str
    planned: int
    measured: int
    splits: Mapping[str, int]


class StageState(Record):
    """One stored stage: when and by which version it was stored, what it rests on, and whether that still holds.

    ``number`` is 0 for results of versions that did not record a basis; ``out_of_date`` is the reason, None where the
    stage holds; ``superseded`` says that a later stage of the same name exists.
    """

    number: int
    name: StageName
    written: str
    program: str
    digest: str
    rests_on: tuple[str, ...]
    superseded: bool = False
    out_of_date: str | None = None


NextVerb = Literal["plan", "collect", "calibrate", "discover", "locate", "compensate", "push", "report", ""]
"""The verb that comes next in a run; ``push`` stands for compensated targets that are verified, ``compensate``
stands in its place where nothing can be driven, ``plan`` for a new run of a cell that has changed, empty for none."""


class UnseenArmState(Record):
    """An arm that was not seen at rest after a stop: since when (UTC) it counts as moving, and why."""

    since: str
    reason: str


class OverviewResult(Result):
    """``show``: the state of a run, and the verb and command that come next (both empty if none).

    ``in_order`` maps arms to what an import derived from their order of measurement. ``complaints`` says what is out of
    date: stages, the page, the certificate. ``stale`` says why the model in force should not be used as it is; empty if
    it may. ``not_seen_at_rest`` has the arms that must be treated as moving.
    """

    schema_: Literal["cellapp-overview"] = "cellapp-overview"
    version: Literal[1] = 1
    run: str
    profile: str
    arms: Mapping[str, ArmState]
    in_order: Mapping[str, ArmOrder] = {}
    stages: tuple[StageState, ...]
    in_force: StageName | None
    stale: str = ""
    next_verb: NextVerb
    next_step: str
    complaints: tuple[str, ...] = ()
    not_seen_at_rest: Mapping[str, UnseenArmState] = {}


class AtRestResult(Result):
    """``at-rest``: the arm that a person has seen at rest, and whether it counted as moving."""

    schema_: Literal["cellapp-at-rest"] = "cellapp-at-rest"
    version: Literal[1] = 1
    run: str
    arm: str
    counted_as_moving: bool


class HistoryResult(Result):
    """``show DIR history``: every stage that was ever stored, oldest first."""

    schema_: Literal["cellapp-history"] = "cellapp-history"
    version: Literal[1] = 1
    run: str
    stages: tuple[StageState, ...]


class LogLine(Record):
    """One line of a run's log; ``written`` is UTC, ``time_s`` seconds since the run began where it was measured."""

    number: int
    written: str
    time_s: float | None
    level: str
    text: str


class LogResult(Result):
    """``show DIR log``: lines of the run's log, oldest first."""

    schema_: Literal["cellapp-log"] = "cellapp-log"
    version: Literal[1] = 1
    run: str
    lines: tuple[LogLine, ...]


class PlannedStop(Record):
    """One planned stop: joint positions of every arm [rad], whether it was measured."""

    configuration: int
    measured: bool
    q: Mapping[str, tuple[float, ...]]


class StopsResult(Result):
    """``show DIR plan``: every planned stop, and what is known of their design if they were designed."""

    schema_: Literal["cellapp-stops"] = "cellapp-stops"
    version: Literal[1] = 1
    run: str
    stops: tuple[PlannedStop, ...]
    design: PlanDesignResult | None = None
    omitted_when_none = frozenset({"design"})
