"""What commands of trials against bars share: tables on the terminal and as Markdown, exit code for missed bars."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.ground.errors import CheckFailed
from cellapp.interfaces.cli.job import Job

if TYPE_CHECKING:
    from cellapp.commands.trials.judge_records import TargetScore
    from cellapp.commands.view.table import Table
    from cellapp.ground.results import Result

_NAMED = 10
"""Failures that are named one by one."""


def state_result(
    job: Job, result: Result, tables: Sequence[Table], sentences: Sequence[str], markdown: Path | None
) -> None:
    """Show the tables and the sentences below them, state the result, and write the Markdown file if asked for.

    Raises
    ------
    InputError
        If the Markdown file cannot be written.
    """
    from cellapp.commands.view.table import markdown as as_markdown

    job.show(tables)
    job.say(*sentences)
    job.result(result)
    if markdown is not None:
        job.outputs.write_text(markdown, as_markdown(tables, sentences), "--markdown")


def check_failed(failed: Sequence[str]) -> None:
    """Raise ``CheckFailed`` that names the first tasks that failed; the result of the others was stated."""
    if failed:
        more = f"; and {len(failed) - _NAMED} more" if len(failed) > _NAMED else ""
        raise CheckFailed(f"{len(failed)} could not be computed: {'; '.join(failed[:_NAMED])}{more}")


def check_bars(failed: Sequence[str], missed: Sequence[TargetScore]) -> None:
    """Raise ``CheckFailed`` if runs could not be judged, or a bar was missed in enough trials to say so."""
    check_failed(failed)
    if missed:
        raise CheckFailed(f"bars missed: {'; '.join(f'{one.kind}: {one.target}' for one in missed)}")
