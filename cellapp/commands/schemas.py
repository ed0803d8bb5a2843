"""JSON schemas of the results."""

from __future__ import annotations

from typing import Any

from cellapp.cell.driving.records import (
    CollectionResult,
    CollectResult,
    ImportResult,
    PlanResult,
    ReplayResult,
    RequestResult,
)
from cellapp.cell.exports.records import ExportResult
from cellapp.cell.planning.design_records import PlanDesignResult, ViewResult
from cellapp.cell.planning.records import PlanCheckResult, PlanForecastResult
from cellapp.cell.programs.records import CorrectResult
from cellapp.cell.targets.path_records import PathResult
from cellapp.cell.targets.records import CompensateResult, VerifyResult
from cellapp.commands.at_rest.result import AtRestResult
from cellapp.commands.certificate.result import CertificateResult
from cellapp.commands.check_certificate.result import CertificateCheckResult
from cellapp.commands.docs.result import DocsResult
from cellapp.commands.doctor.result import DoctorResult
from cellapp.commands.emulate.result import EmulateResult
from cellapp.commands.init.result import InitResult
from cellapp.commands.locate.result import LocateResult
from cellapp.commands.plan.result import StopsResult
from cellapp.commands.recalibrate.result import RecalibrateResult
from cellapp.commands.report.result import ReportResult
from cellapp.commands.run.result import WholeRunResult
from cellapp.commands.runs.result import RunComparison, RunsResult
from cellapp.commands.show.result import HistoryResult, LogResult, OverviewResult
from cellapp.commands.sign_key.result import SignKeyResult
from cellapp.commands.tracker_bridge.result import TrackerBridgeResult
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.iso9283.records import Iso9283Result
from cellapp.estimation.monitoring.check.records import CheckResult
from cellapp.estimation.monitoring.fleet.records import FleetResult
from cellapp.ground.results import ErrorResult, Result

VERB_RESULTS: tuple[type[Result], ...] = (
    PlanResult,
    PlanCheckResult,
    PlanForecastResult,
    PlanDesignResult,
    ViewResult,
    CollectResult,
    CollectionResult,
    ReplayResult,
    RequestResult,
    AtRestResult,
    ImportResult,
    ExportResult,
    InitResult,
    DoctorResult,
    CalibrateResult,
    DiscoverResult,
    LocateResult,
    CompensateResult,
    VerifyResult,
    PathResult,
    CorrectResult,
    Iso9283Result,
    CheckResult,
    CertificateResult,
    CertificateCheckResult,
    SignKeyResult,
    FleetResult,
    RecalibrateResult,
    ReportResult,
    WholeRunResult,
    EmulateResult,
    TrackerBridgeResult,
    OverviewResult,
    HistoryResult,
    LogResult,
    StopsResult,
    RunsResult,
    RunComparison,
    DocsResult,
    ErrorResult,
)
"""Every result of a verb, for the exported JSON schemas."""


def json_schemas(results: tuple[type[Result], ...] = VERB_RESULTS) -> dict[str, dict[str, Any]]:
    """JSON Schema (2020-12) of each result, by the name that its JSON objects carry under ``schema``.

    As ``--json`` writes NaN and infinity as null, every number may be null.
    """
    return {_schema_name(result): _nullable_numbers(result.model_json_schema()) for result in results}


def _schema_name(result: type[Result]) -> str:
    return str(result.model_fields["schema_"].default)


def _nullable_numbers(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_nullable_numbers(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    changed = {key: _nullable_numbers(part) for key, part in schema.items()}
    if changed.get("type") == "number":
        changed["type"] = ["number", "null"]
    return changed
