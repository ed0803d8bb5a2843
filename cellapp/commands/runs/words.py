"""A run of a list in words: name, stops, next step. Lists, tables and screens share them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellapp.commands.runs.result import ArmRun, RunSummary
from cellapp.ground.profile import CellKind

CELL_WORDS: dict[CellKind, str] = {
    "simulated": "simulated",
    "emulated": "emulated",
    "real": "REAL ARMS",
    "none": "no arms",
}


def short_name(run: RunSummary | ArmRun, folder: str) -> str:
    """Return the run's folder relative to the listed one."""
    path = Path(run.run)
    return str(path.relative_to(folder)) if path.is_relative_to(folder) and path != Path(folder) else run.run


def stops_words(run: RunSummary) -> str:
    """State the measured stops as ``120/400 stopped``; only their number for imported readings."""
    if not run.stops_planned:
        return str(run.stops_measured)
    words = session_words(run)
    return f"{run.stops_measured}/{run.stops_planned} {'' if words == 'complete' else words}".rstrip()


def session_words(run: RunSummary) -> str:
    """Say how the last session of collecting ended, or that it is still running."""
    if run.in_use and run.last_session == "no end":
        return "running"
    return run.last_session or ("" if run.stops_measured else "not begun")


def next_words(run: RunSummary) -> str:
    """Return the next verb, and whether a result is out of date; ``done`` if nothing is left to do."""
    outdated = any(stage.out_of_date for stage in run.stages)
    return f"{run.next_verb or 'done'}{' (out of date)' if outdated else ''}"


def effects_words(effects: Sequence[str]) -> str:
    """Return the names of effects in words."""
    return ", ".join(slug.replace("_", " ") for slug in effects)
