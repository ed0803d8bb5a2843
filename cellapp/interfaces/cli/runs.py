"""``runs`` and ``compare``: what a folder of runs holds, and where runs differ. They only read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from cellapp.interfaces.cli.job import Job, open_run
from cellapp.interfaces.cli.options import JsonOption


def runs(
    folder: Annotated[
        Path | None, typer.Argument(metavar="FOLDER", help="A folder that holds runs; logs if not given.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """List every run below a folder, newest first: state, accuracy, what comes next, what can be resumed."""
    from cellapp.commands.runs.history import list_runs
    from cellapp.commands.runs.view import runs_sentences, runs_tables

    with Job(json_file) as job:
        result = list_runs(folder)
        job.show(runs_tables(result))
        job.say(*runs_sentences(result))
        job.result(result)


def compare(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR DIR...", help="Folders of two runs or more; the first is compared with."),
    ],
    json_file: JsonOption = None,
) -> None:
    """Compare two runs: profile, parameters, held-out errors, effects, inter-base transform, verification.

    More than two are compared as by 'fleet', in the order in which they are given.
    """
    if len(folders) == 2:
        _compare_two(folders[0], folders[1], json_file)
    else:
        _compare_many(folders, json_file)


def _compare_two(first: Path, second: Path, json_file: str | None) -> None:
    from cellapp.commands.compare.run import compare_runs
    from cellapp.commands.compare.view import comparison_sentences, comparison_tables

    with Job(json_file) as job, open_run(first) as a, open_run(second) as b:
        result = compare_runs(a, b)
        job.show(comparison_tables(result))
        job.say(*comparison_sentences(result))
        job.result(result)


def _compare_many(folders: Sequence[Path], json_file: str | None) -> None:
    from cellapp.commands.fleet.run import compare_many
    from cellapp.commands.fleet.view import fleet_sentences, fleet_tables

    with Job(json_file) as job:
        result = compare_many(folders)
        job.show(fleet_tables(result))
        job.say(*fleet_sentences(result))
        job.result(result)
