"""JSON schemas of the results."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from cellapp.cell.planning.records import PlanDesignResult, PlanForecastResult
from cellapp.commands.collect.result import CollectionResult
from cellapp.commands.job import RequestResult
from cellapp.commands.plan.result import StopsResult
from cellapp.commands.record import Verb
from cellapp.commands.registry import records
from cellapp.commands.show.comparison import RunComparison
from cellapp.commands.show.result import HistoryResult, LogResult, OverviewResult
from cellapp.ground.counting import did_you_mean
from cellapp.ground.errors import InputError
from cellapp.ground.results import ErrorResult, Result

WITHOUT_VERB: tuple[type[Result], ...] = (
    PlanForecastResult,
    PlanDesignResult,
    CollectionResult,
    OverviewResult,
    HistoryResult,
    LogResult,
    RunComparison,
    StopsResult,
    RequestResult,
    ErrorResult,
)
"""Results that no verb declares: parts that ``show`` prints, requests to a running job, failures."""


def written_results(verbs: Iterable[Verb]) -> tuple[type[Result], ...]:
    """Return every result that ``--json`` writes, each once: those of the verbs in their order, then the others."""
    published = (verb for verb in verbs if not verb.name.startswith("trials "))  # those of trials change with them
    own = (one for verb in published for one in verb.results if one.has_own_schema)
    return tuple(dict.fromkeys((*own, *WITHOUT_VERB)))


def results_by_name(results: Iterable[type[Result]]) -> dict[str, type[Result]]:
    """Return results by the name in their JSON objects under ``schema``."""
    return {str(result.model_fields["schema_"].default): result for result in results}


def json_schema(result: type[Result]) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a result. Every number may be null: ``--json`` writes NaN and infinity so."""
    schema: dict[str, Any] = _nullable_numbers(result.model_json_schema())
    return schema


def _nullable_numbers(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_nullable_numbers(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    changed = {key: _nullable_numbers(part) for key, part in schema.items()}
    if changed.get("type") == "number":
        changed["type"] = ["number", "null"]
    return changed


def schemas_text(name: str | None) -> str:
    """Return the schemas of all results as JSON, or that of the one with this name.

    Raises
    ------
    InputError
        If there is no such result.
    """
    results = results_by_name(written_results(records()))
    if name is None:
        return json.dumps({name: json_schema(result) for name, result in results.items()}, indent=1)
    if name not in results:
        own, known = name.removeprefix("cellapp-"), [one.removeprefix("cellapp-") for one in results]
        meant = did_you_mean(own, known, "did you mean 'cellapp-{}'? Results", otherwise="results")
        raise InputError(f"docs: --schema: '{name}' is not a result; {meant} are {', '.join(results)}")
    return json.dumps(json_schema(results[name]), indent=1)
