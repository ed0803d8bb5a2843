"""The verb ``schema``: the JSON schemas of the results."""

from __future__ import annotations

import json

from cellapp.commands.record import Work
from cellapp.commands.registry import records
from cellapp.commands.schema.request import SchemaRequest
from cellapp.commands.schema.result import SchemaResult
from cellapp.commands.schema.results import json_schema, results_by_name, written_results
from cellapp.ground.errors import InputError


def run(request: SchemaRequest, work: Work) -> SchemaResult:
    """Return the schemas of all results, or of one."""
    results = results_by_name(written_results(records()))
    if request.name is None:
        return SchemaResult(text=json.dumps({name: json_schema(result) for name, result in results.items()}, indent=1))
    if request.name not in results:
        raise InputError(f"schema: '{request.name}' is not a result; results are {', '.join(results)}")
    return SchemaResult(text=json.dumps(json_schema(results[request.name]), indent=1))
