"""Columns of a list of runs that can be sorted and filtered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cellapp.commands.runs.result import RunSummary
from cellapp.commands.runs.words import CELL_WORDS, effects_words, next_words, short_name, stops_words
from cellapp.ground.times import minute_of


@dataclass(frozen=True)
class RunColumn:
    """A column: its text for a readable run, and its sort key."""

    title: str
    words: Callable[[RunSummary], str]
    order: Callable[[RunSummary], str | float]
    newest_first: bool = False


def run_columns(folder: str) -> tuple[RunColumn, ...]:
    """Return the columns of a list of the runs below ``folder``, the name first."""
    return (
        RunColumn("run", lambda run: short_name(run, folder), lambda run: run.run),
        RunColumn("began (UTC)", lambda run: minute_of(run.began), lambda run: run.began or run.changed, True),
        RunColumn("cell", lambda run: CELL_WORDS[run.cell], lambda run: run.cell),
        RunColumn("stops", stops_words, lambda run: run.stops_measured),
        RunColumn("next", next_words, next_words),
        RunColumn("best mean [mm]", _errors_words, _largest_error_mm),
        RunColumn("effects", _effects, _effects),
        RunColumn("profile", lambda run: run.profile, lambda run: run.profile),
    )


def run_cells(run: RunSummary, columns: tuple[RunColumn, ...]) -> tuple[str, ...]:
    """Return the texts of one row; for a run that cannot be read, its name and the reason."""
    if run.problem:
        return (columns[0].words(run), "", "unreadable", *("" for _ in columns[3:]))
    return tuple(column.words(run) for column in columns)


def contains(run: RunSummary, columns: tuple[RunColumn, ...], text: str) -> bool:
    """Return whether every word of ``text`` occurs in the row or in the run's problem, ignoring case."""
    row = " ".join([*run_cells(run, columns), run.problem]).lower()
    return all(word in row for word in text.lower().split())


def _errors_words(run: RunSummary) -> str:
    """State the mean held-out error of each arm with its best model."""
    return ", ".join(f"{arm.heldout_mm.after:.3f}" for arm in run.figures.values() if arm.heldout_mm)


def _largest_error_mm(run: RunSummary) -> float:
    return max((arm.heldout_mm.after for arm in run.figures.values() if arm.heldout_mm), default=0.0)


def _effects(run: RunSummary) -> str:
    return effects_words(tuple(dict.fromkeys(slug for arm in run.figures.values() for slug in arm.effects)))
