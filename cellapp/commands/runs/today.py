"""What is due today in a folder of runs: open runs, and the age of each arm's calibration and check."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, date, datetime

from cellapp.commands.runs.result import CELL_WORDS, RunsResult, RunSummary, next_words, short_name, stops_words
from cellapp.commands.view.table import Cell, Column, Table, number_column, table_of, with_rows
from cellapp.ground.grouping import grouped
from cellapp.ground.results import CALIBRATE, CHECK, StageName
from cellapp.ground.times import day_of

_MOST_OPEN = 12
"""Most open runs that are listed; for more there is the list of all."""


def today_tables(result: RunsResult, now: datetime) -> list[Table]:
    """Show open runs with what each waits for; each arm with the ages of its calibration and check, and what is due."""
    return with_rows(_open_runs(result), _arms(result, now))


def today_sentences(result: RunsResult, now: datetime) -> list[str]:
    """State what is urgent: overdue instruments, runs in use by another job, what cannot be read."""
    overdue = {run.profile: run.tracker_due for run in reversed(result.runs) if run.tracker_due}
    late = [
        f"the tracker of {profile} was due for calibration on {due}"
        for profile, due in overdue.items()
        if date.fromisoformat(due) < now.date()
    ]
    used = [f"{run.run}: in use by {run.in_use}" for run in result.runs if run.in_use]
    found = [*late, *used, *(run.problem for run in result.runs if run.problem)]
    return found or ([] if result.runs else [f"No run is below {result.folder} yet."])


def _open_runs(result: RunsResult) -> Table:
    waiting = [run for run in result.runs if run.next_verb and not run.problem]
    return table_of(
        "Open runs, newest first",
        waiting[:_MOST_OPEN],
        ("run", lambda run: short_name(run, result.folder)),
        ("cell", lambda run: CELL_WORDS[run.cell]),
        ("began", lambda run: day_of(run.began)),
        ("stops", stops_words),
        ("waits for", lambda run: "the rest of its stops" if run.resumable else next_words(run)),
    )


def _arms(result: RunsResult, now: datetime) -> Table:
    """Build a row for each arm of each cell."""
    columns = (
        Column("cell"),
        Column("arm"),
        number_column("calibrated", "d", "days ago"),
        number_column("checked", "d", "days ago"),
        number_column("error", ".3f", "mm"),
        number_column("change", "+.3f", "mm"),
        Column("tracker due"),
    )
    return Table("Each arm", columns, tuple(_arm_rows(result, now)))


def _arm_rows(result: RunsResult, now: datetime) -> Iterator[tuple[Cell, ...]]:
    for profile, runs in grouped((run.profile, run) for run in result.runs if not run.problem).items():
        due = next((run.tracker_due for run in runs if run.tracker_due), "")
        for arm in dict.fromkeys(name for run in runs for name in run.arms):
            own = [run for run in runs if arm in run.arms]
            errors = [error for run in own if (error := _error_mm(run, arm)) is not None]
            change = errors[0] - errors[1] if len(errors) > 1 else None
            ages = (_days_since(own, stage, now) for stage in (CALIBRATE, CHECK))
            yield profile, arm, *ages, errors[0] if errors else None, change, due


def _error_mm(run: RunSummary, arm: str) -> float | None:
    """Return the mean held-out error [mm] of an arm with the run's best model; None if unknown."""
    figures = run.figures.get(arm)
    return None if figures is None or figures.heldout_mm is None else figures.heldout_mm.after


def _days_since(runs: list[RunSummary], name: StageName, now: datetime) -> int | None:
    """Return the days since the newest stage of a name that holds; None without one."""
    written = [stage.written for run in runs for stage in run.stages if stage.name == name and not stage.out_of_date]
    if not written:
        return None
    newest = datetime.fromisoformat(max(written))
    return (now - (newest if newest.tzinfo else newest.replace(tzinfo=UTC))).days
