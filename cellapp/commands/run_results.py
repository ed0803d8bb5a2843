"""The current results of a run: what its verbs measured and computed, read from its stages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar, cast

import numpy as np

from cellapp.cell.run.file import RunFile
from cellapp.cell.targets.path import PathResult
from cellapp.cell.targets.records import CompensateResult, VerifyResult
from cellapp.commands.locate.result import LocateResult
from cellapp.commands.stages import RunStages, read_stages
from cellapp.commands.stored_model import joined_calibration
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.iso9283.records import Iso9283Result
from cellapp.estimation.monitoring.check.records import CheckResult
from cellapp.estimation.uncertainty.budget import Evidence, MeasuredConditions
from cellapp.ground.errors import InputError
from cellapp.ground.results import (
    CALIBRATE,
    CHECK,
    COMPENSATE,
    DISCOVER,
    ISO9283,
    LOCATE,
    PATH,
    PUSH,
    STAGE_NAMES,
    VERIFY,
    Result,
    StageName,
)


def evidence_of(results: StageResults, arm: str, measured: MeasuredConditions | None = None) -> Evidence:
    """Return the evidence on one arm; ``measured`` are the conditions of its readings."""
    outdated = results.out_of_date
    discovered = None if DISCOVER in outdated else results.discover
    compensated = None if COMPENSATE in outdated else results.compensate
    verified = None if VERIFY in outdated else results.verify
    located = None if LOCATE in outdated else results.locate
    commands = () if compensated is None else compensated.targets
    targets = () if verified is None else verified.targets
    points = [one.measured_M for one in targets if one.arm == arm and one.measured_M is not None]
    return Evidence(
        calibrated=None if results.calibrate is None else results.calibrate.arms.get(arm),
        discovered=None if discovered is None else discovered.arms.get(arm),
        commands=tuple(one.parts for one in commands if one.arm == arm and one.parts is not None),
        verified_m=float(np.linalg.norm(np.array(points), axis=1).max()) if points else None,
        station_mm=None if located is None or not located.moved else located.uncertainty_mm,
        measured=measured,
    )


UNREADABLE = "another version of cellapp stored it and this one cannot read it"
RESULTS: Mapping[StageName, type[Result]] = {
    CALIBRATE: CalibrateResult,
    DISCOVER: DiscoverResult,
    LOCATE: LocateResult,
    COMPENSATE: CompensateResult,
    PUSH: VerifyResult,
    VERIFY: VerifyResult,
    PATH: PathResult,
    ISO9283: Iso9283Result,
    CHECK: CheckResult,
}
"""Name of each stage of ``StageResults`` -> type of its result."""


class StageResults(Result):
    """The current results of a run without its certificate, each None where that verb has not run.

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
    omitted_when_none = frozenset(STAGE_NAMES)

    @property
    def held_check(self) -> CheckResult | None:
        """The last check while it holds."""
        return None if CHECK in self.out_of_date else self.check


R = TypeVar("R", bound=StageResults)


def read_stage_results(run: RunFile, stages: RunStages | None = None) -> StageResults:
    """Read the current results of a run; ``out_of_date`` lists those that no longer hold."""
    return results_as(StageResults, run, stages or read_stages(run), RESULTS)


def results_as(kind: type[R], run: RunFile, stages: RunStages, types: Mapping[StageName, type[Result]]) -> R:
    """Read the current results of a run into an object of ``kind``, which has a field for each stage of ``types``."""
    out_of_date = dict(stages.out_of_date)
    found: dict[str, Result] = {}
    for name, stage in stages.current.items():
        if name in types:
            try:
                found[name] = types[name].from_json(stage.text, f"{run.path}: {name}")
            except InputError:
                out_of_date[name] = UNREADABLE
    calibrate, discover = found.get(CALIBRATE), found.get(DISCOVER)
    if isinstance(calibrate, CalibrateResult):
        holds = isinstance(discover, DiscoverResult) and DISCOVER not in stages.out_of_date
        found[CALIBRATE] = joined_calibration(calibrate, cast(DiscoverResult, discover) if holds else None)
    return kind.model_validate({"run": str(run.folder), "out_of_date": out_of_date, **found})
