"""``schema``: print the JSON schemas of the results."""

from __future__ import annotations

from typing import Annotated

import typer

from cellapp.ground.errors import InputError
from cellapp.interfaces.cli.job import Job
from cellapp.interfaces.cli.options import JsonOption


def schema(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="One result, as cellapp-calibrate.")] = None,
    json_file: JsonOption = None,
) -> None:
    """Print the JSON schemas of the results, by the name that their JSON carries under "schema"."""
    import json

    from cellapp.commands.schemas import json_schemas
    from cellapp.commands.trials.results import TRIAL_RESULTS

    schemas = {**json_schemas(), **json_schemas(TRIAL_RESULTS)}
    if name is not None and name not in schemas:
        raise InputError(f"schema: '{name}' is not a result; results are {', '.join(schemas)}")
    text = json.dumps(schemas if name is None else schemas[name], indent=1)
    with Job(json_file) as job:
        if json_file is None:
            job.say(text)
        job.write_json(text)
