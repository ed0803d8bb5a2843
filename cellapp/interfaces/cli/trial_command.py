"""Conversion of trials to commands: options for computing and storing, tables, JSON, Markdown, exit code."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellapp.ground.errors import CheckFailed
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.job import Job
from cellapp.interfaces.cli.options import Jobs, JsonOption, MarkdownFile, Scheduler, Store, resources_of

if TYPE_CHECKING:
    from cellapp.commands.trials.skeleton import Stated

_SHARED = {"jobs": Jobs, "scheduler": Scheduler, "store": Store, "markdown": MarkdownFile, "json_file": JsonOption}
_LATER = {"Work": object, "Stated": object}
"""Placeholders for types in the signatures of trials that are slow to load."""
TrialFunction = Callable[..., "Stated"]


def trial(app: Commands, name: str, *left_out: str) -> Callable[[TrialFunction], TrialFunction]:
    """Create a command from a function that takes a ``Work`` and options of its own and returns a ``Stated``.

    The command also has the options that trials share, except those ``left_out``.
    """
    shared = {option: kind for option, kind in _SHARED.items() if option not in left_out}

    def register(function: TrialFunction) -> TrialFunction:
        def command(**options: Any) -> None:
            given = {option: options.pop(option) for option in shared}
            with Job(given.pop("json_file")) as job:
                markdown = given.pop("markdown", None)
                state(job, function(_work(job, **given), **options), markdown)

        own = [*inspect.signature(function, eval_str=True, locals=_LATER).parameters.values()][1:]
        parameters = [*own, *_options(shared)]
        command.__name__, command.__doc__, command.__module__ = function.__name__, function.__doc__, function.__module__
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {one.name: one.annotation for one in parameters}
        app.command(name)(command)
        return function

    return register


def state(job: Job, stated: Stated, markdown: Path | None = None) -> None:
    """Print tables and sentences; write JSON and Markdown if requested.

    Raises
    ------
    CheckFailed
        If the trial does not hold; everything has been printed then.
    InputError
        If the Markdown file cannot be written.
    """
    from cellapp.commands.view.table import markdown as as_markdown

    job.show(stated.tables)
    job.say(*stated.sentences)
    job.result(stated.result)
    if markdown is not None:
        job.outputs.write_text(markdown, as_markdown(stated.tables, stated.sentences), "--markdown")
    if stated.refused:
        raise CheckFailed(stated.refused)


def _work(job: Job, jobs: int | None = None, scheduler: str | None = None, store: Path | None = None) -> Any:
    from cellapp.commands.trials.skeleton import Work

    return Work(resources_of(jobs, scheduler, store), job.listen, job.control)


def _options(shared: dict[str, Any]) -> Iterator[inspect.Parameter]:
    for option, kind in shared.items():
        yield inspect.Parameter(option, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=None, annotation=kind)
