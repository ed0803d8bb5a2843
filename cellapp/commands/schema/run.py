"""The verb ``schema``: the JSON schemas of the results."""

from __future__ import annotations

import json

from cellapp.commands.record import Work
from cellapp.commands.schema.request import SchemaRequest
from cellapp.commands.schema.result import SchemaResult
from cellapp.commands.schema.results import json_schemas, written_results
from cellapp.commands.trials.results import TRIAL_RESULTS
from cellapp.ground.errors import InputError


def run(request: SchemaRequest, work: Work) -> SchemaResult:
    """All of them, or that of one result."""
    schemas = json_schemas((*written_results(work.verbs), *TRIAL_RESULTS))
    if request.name is not None and request.name not in schemas:
        raise InputError(f"schema: '{request.name}' is not a result; results are {', '.join(schemas)}")
    return SchemaResult(text=json.dumps(schemas if request.name is None else schemas[request.name], indent=1))
