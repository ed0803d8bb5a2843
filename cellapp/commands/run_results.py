"""The current results of a run: what its verbs measured and computed, read from its stages.

Results of ``report`` and ``run``, which give all current results of a run with their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, get_args

import numpy as np

from cellapp.cell.driving.records import CollectResult
from cellapp.cell.run.file import RunFile
from cellapp.cell.targets.path import PathResult
from cellapp.cell.targets.records import CompensateResult, TargetCommand, VerifyResult
from cellapp.commands.certificate_result import CertificateResult
from cellapp.commands.stages import RunStages, read_stages
from cellapp.estimation.calibration.records import CalibrateResult, PairMethodResult
from cellapp.estimation.discovery.records import DiscoverResult, with_effects
from cellapp.estimation.iso9283.records import Iso9283Result
from cellapp.estimation.monitoring.records import CheckResult, LocateResult
from cellapp.estimation.uncertainty.budget import BudgetEvidence, MeasuredConditions
from cellapp.ground.errors import InputError
from cellapp.ground.results import CALIBRATE, DISCOVER, STAGE_NAMES, Method, Result, StageName


def evidence_of(results: RunResults, arm: str, measured: MeasuredConditions | None = None) -> BudgetEvidence:
    """Return the evidence on one arm; ``measured`` are the conditions of its readings."""
    held = results.held
    points = [one.measured_M for one in results.verified.of_arm(arm) if one.measured_M is not None]
    return BudgetEvidence(
        calibrated=None if results.calibrate is None else results.calibrate.arms.get(arm),
        discovered=None if held.discover is None else held.discover.arms.get(arm),
        commands=tuple(one.parts for one in results.commands if one.arm == arm and one.parts is not None),
        verified_m=float(np.linalg.norm(np.array(points), axis=1).max()) if points else None,
        station_mm=None if held.locate is None or not held.locate.moved else held.locate.uncertainty_mm,
        measured=measured,
    )


UNREADABLE = "another version of cellapp stored it and this one cannot read it"


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
    iso9283: Iso9283Result | None = None
    check: CheckResult | None = None
    out_of_date: Mapping[StageName, str] = {}
    certificate: CertificateResult | None = None
    omitted_when_none = frozenset(STAGE_NAMES)

    @property
    def held(self) -> RunResults:
        """The results that still hold."""
        return self.model_copy(update=dict.fromkeys(self.out_of_date))

    @property
    def verified(self) -> VerifyResult:
        """The verification that still holds and measured a target; without targets if there is none."""
        verify = self.held.verify
        return VerifyResult(arms={}, targets=()) if verify is None or not verify.arms else verify

    @property
    def commands(self) -> tuple[TargetCommand, ...]:
        """The compensated targets that still hold."""
        return () if (held := self.held.compensate) is None else held.targets

    @property
    def pair(self) -> Mapping[Method, PairMethodResult]:
        """What a calibration that still holds says of the pair, by method."""
        return {} if (held := self.held.calibrate) is None else held.pair


def read_results(run: RunFile, stages: RunStages | None = None) -> RunResults:
    """Read the current results of a run; ``out_of_date`` lists those that no longer hold."""
    stages = stages or read_stages(run)
    types = {
        name: get_args(field.annotation)[0] for name, field in RunResults.model_fields.items() if name in STAGE_NAMES
    }
    out_of_date = dict(stages.out_of_date)
    found: dict[str, Any] = {}
    for name, stage in stages.current.items():
        try:
            found[name] = types[name].from_json(stage.text, f"{run.path}: {name}")
        except InputError:
            out_of_date[name] = UNREADABLE
    if CALIBRATE in found:
        discover, calibrate = None if DISCOVER in stages.out_of_date else found.get(DISCOVER), found[CALIBRATE]
        found[CALIBRATE] = calibrate.without_effects() if discover is None else with_effects(calibrate, discover)
    return RunResults(run=str(run.folder), out_of_date=out_of_date, **found)


class ReportResult(RunResults, schema="cellapp-report"):
    """``report``: the page, and the results that it shows."""

    page: str


class WholeRunResult(RunResults, schema="cellapp-run"):
    """``run``: the folder, the results of every step, and notes for the operator."""

    collect: CollectResult | None = None
    notes: tuple[str, ...] = ()


R = TypeVar("R", bound=RunResults)


def shown_by(kind: type[R], stored: RunResults, **more: object) -> R:
    """Return the stored results as the result of a verb that shows them."""
    return kind.model_validate({**{name: getattr(stored, name) for name in stored.model_fields_set}, **more})
