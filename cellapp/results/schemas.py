"""JSON schemas of the results."""

from __future__ import annotations

from typing import Any

from cellapp.results.base import ErrorResult, Result
from cellapp.results.calibration import CalibrateResult
from cellapp.results.certificate import CertificateCheckResult, CertificateResult, SignKeyResult
from cellapp.results.check import CheckResult
from cellapp.results.collection import (
    CollectionResult,
    CollectResult,
    ImportResult,
    PlanResult,
    ReplayResult,
    RequestResult,
)
from cellapp.results.commissioning import DoctorResult, EmulateResult, InitResult, TrackerBridgeResult
from cellapp.results.discovery import DiscoverResult
from cellapp.results.exports import ExportResult
from cellapp.results.fleet import FleetResult
from cellapp.results.iso9283 import Iso9283Result
from cellapp.results.locate import LocateResult
from cellapp.results.paths import PathResult
from cellapp.results.plan_design import PlanDesignResult, ViewResult
from cellapp.results.planning import PlanCheckResult, PlanForecastResult
from cellapp.results.programs import CorrectResult
from cellapp.results.recalibration import RecalibrateResult
from cellapp.results.run import (
    AtRestResult,
    DocsResult,
    HistoryResult,
    LogResult,
    OverviewResult,
    ReportResult,
    StopsResult,
    WholeRunResult,
)
from cellapp.results.runs import RunComparison, RunsResult
from cellapp.results.targets import CompensateResult, VerifyResult

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
