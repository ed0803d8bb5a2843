"""Tables and sentences of ``runs``: every run below a folder, and the one that can be resumed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from cellapp.reporting.table import Cell, Column, Table, number_column
from cellapp.results import BeforeAfter, CellKind, RunsResult, RunSummary

CELL_WORDS: dict[CellKind, str] = {
    "simulated": "simulated",
    "emulated": "emulated",
    "real": "REAL ARMS",
    "none": "imported",
}
_MM = ".3f"
_KIB = 1024.0


def runs_tables(result: RunsResult) -> list[Table]:
    """State of every run that can be read, and the accuracy of every arm that is calibrated."""
    readable = [run for run in result.runs if not run.problem]
    if not readable:
        return []
    state = Table(
        f"Runs below {result.folder}, newest first",
        tuple(map(Column, ("run", "cell", "began (UTC)", "stops", "collecting", "next", "size"))),
        tuple(
            (
                short_name(run, result.folder),
                f"{run.profile}, {CELL_WORDS[run.cell]}",
                time_words(run.began),
                stops_words(run),
                session_words(run),
                next_words(run),
                size_words(run.size_bytes),
            )
            for run in readable
        ),
    )
    rows = tuple(row for run in readable for row in _accuracy_rows(run, short_name(run, result.folder)))
    if not rows:
        return [state]
    columns = (
        Column("run"),
        Column("arm"),
        number_column("geometry", _MM),
        number_column("best model", _MM),
        Column("effects"),
        number_column("targets", _MM),
        number_column("compensated", _MM),
    )
    title = "Mean errors [mm]: held-out positions, targets without and with compensation"
    return [state, Table(title, columns, rows)]


def runs_sentences(result: RunsResult) -> list[str]:
    """What cannot be read and why, what is in use, what can be resumed, and what comes next in the newest run."""
    if not result.runs:
        return [f"no runs below {result.folder}; 'cellapp run PROFILE' makes one"]
    sentences = [run.problem for run in result.runs if run.problem]
    sentences += [f"{run.run}: in use by {run.in_use}" for run in result.runs if run.in_use]
    sentences += [resume_sentence(run) for run in result.runs if run.resumable]
    newest = next((run for run in result.runs if not run.problem), None)
    if newest is not None and newest.next_step and not newest.resumable:
        sentences.append(f"next in the newest run: {newest.next_step}")
    return sentences


def resume_sentence(run: RunSummary) -> str:
    """Offer to continue an interrupted run."""
    return (
        f"{run.run}: collecting was interrupted ({session_words(run)}) with {run.stops_left} of"
        f" {run.stops_measured + run.stops_left} stops left; 'cellapp collect {run.run} --resume' continues it"
    )


def short_name(run: RunSummary, folder: str) -> str:
    """The run's folder as seen from the listed one."""
    path = Path(run.run)
    return str(path.relative_to(folder)) if path.is_relative_to(folder) and path != Path(folder) else run.run


def time_words(written: str) -> str:
    """A time (ISO 8601) to the minute."""
    return written[:16].replace("T", " ")


def stops_words(run: RunSummary) -> str:
    """``120/400``; the number alone for imported readings."""
    return f"{run.stops_measured}/{run.stops_planned}" if run.stops_planned else str(run.stops_measured)


def session_words(run: RunSummary) -> str:
    """How the last session of collecting ended, or that it still runs."""
    if run.in_use and run.last_session == "no end":
        return "running"
    return run.last_session or ("" if run.stops_measured else "not begun")


def stages_words(run: RunSummary) -> str:
    """``calibrate, discover (out of date)``."""
    return ", ".join(f"{stage.name} (out of date)" if stage.out_of_date else stage.name for stage in run.stages)


def next_words(run: RunSummary) -> str:
    """The verb that comes next, and whether a result is out of date; ``done`` if nothing is left to do."""
    outdated = any(stage.out_of_date for stage in run.stages)
    return f"{run.next_verb or 'done'}{' (out of date)' if outdated else ''}"


def effects_words(effects: Sequence[str]) -> str:
    """Names of effects as words."""
    return ", ".join(slug.replace("_", " ") for slug in effects)


def size_words(size_bytes: int) -> str:
    """A size with its unit, as ``1.2 MiB``."""
    size, unit = float(size_bytes), "B"
    for unit in ("B", "KiB", "MiB", "GiB"):  # noqa: B007 - the last unit is used below
        if size < _KIB:
            break
        size /= _KIB
    return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"


def _accuracy_rows(run: RunSummary, name: str) -> Iterator[tuple[Cell, ...]]:
    for arm, figures in run.figures.items():
        yield (
            name,
            arm,
            *_pair(figures.heldout_mm),
            effects_words(figures.effects) or figures.verdict or "",
            *_pair(figures.verified_mm),
        )


def _pair(values: BeforeAfter | None) -> tuple[float | None, float | None]:
    return (None, None) if values is None else (values.before, values.after)
