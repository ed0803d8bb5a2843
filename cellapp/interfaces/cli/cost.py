"""``cellapp trials cost``: what trials cost, from the results that a store holds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.interfaces.cli.job import Job
from cellapp.interfaces.cli.options import JsonOption


def cost(
    store: Annotated[Path, typer.Argument(metavar="FILE", help="A store that trials wrote with --store.")],
    tasks: Annotated[int, typer.Option("--tasks", min=1, help="Number of tasks to estimate.")] = 1_000_000,
    json_file: JsonOption = None,
) -> None:
    """Processor time and memory of the tasks in a store, and what as many as asked for would need."""
    from cellapp.commands.trials.cost import cost_of, cost_table

    with Job(json_file) as job:
        result = cost_of(store, tasks)
        job.show([cost_table(result)])
        job.result(result)
