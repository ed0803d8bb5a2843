"""Tables and sentences of ``runs``: runs below a folder, the one that can be resumed, and one arm over its runs."""

from __future__ import annotations

from rich import filesize

from cellapp.commands.record import Request, View
from cellapp.commands.runs.result import (
    CELL_WORDS,
    ArmFigures,
    ArmHistory,
    ArmRun,
    MovedParameter,
    RunsResult,
    RunSummary,
    effects_words,
    next_words,
    session_words,
    short_name,
    stops_words,
)
from cellapp.commands.view.table import Table, table_of, with_rows
from cellapp.commands.view.words import display_unit
from cellapp.estimation.discovery.records import BeforeAfter
from cellapp.ground.counting import counted
from cellapp.ground.grouping import grouped
from cellapp.ground.results import day_of, minute_of
from cellapp.ground.shell import shell_word

_MM = ".3f"


def view(result: RunsResult | ArmHistory, request: Request | None = None) -> View:
    """Show every run below the folder, or one arm over its runs."""
    if isinstance(result, ArmHistory):
        return View((history_table(result), *history_sentences(result)))
    return View((*runs_tables(result), *runs_sentences(result)))


def runs_tables(result: RunsResult) -> list[Table]:
    """Show the state of every run, and the errors of every calibrated arm."""
    errors = table_of(
        "Mean errors [mm]: held-out positions, targets without and with compensation",
        [(run, arm, figures) for run in result.runs for arm, figures in run.figures.items()],
        ("run", lambda row: short_name(row[0], result.folder)),
        ("arm", lambda row: row[1]),
        ("geometry", lambda row: _pair(row[2].heldout_mm)[0], _MM),
        ("in force", lambda row: _pair(row[2].heldout_mm)[1], _MM),
        ("targets", lambda row: _pair(row[2].verified_mm)[0], _MM),
        ("compensated", lambda row: _pair(row[2].verified_mm)[1], _MM),
    )
    return with_rows(runs_table(result), errors)


def runs_table(result: RunsResult) -> Table:
    """Show the state of every run; of one that cannot be read, its name."""
    return table_of(
        f"Runs below {result.folder}, newest first",
        result.runs,
        ("run", lambda run: short_name(run, result.folder)),
        ("cell", lambda run: "unreadable" if run.problem else CELL_WORDS[run.cell]),
        ("began", lambda run: day_of(run.began)),
        ("stops", lambda run: "" if run.problem else stops_words(run)),
        ("next", lambda run: "" if run.problem else next_words(run)),
    )


def runs_sentences(result: RunsResult) -> list[str]:
    """State what cannot be read and why, what is in use, what can be resumed, and the next step of the newest run."""
    if not result.runs:
        return [f"no runs below {result.folder}; 'cellapp run PROFILE' makes one"]
    sentences = [run.problem for run in result.runs if run.problem]
    sentences += [f"{run.run}: in use by {run.in_use}" for run in result.runs if run.in_use]
    sentences += [resume_sentence(run) for run in result.runs if run.resumable]
    newest = next((run for run in result.runs if not run.problem), None)
    if newest is not None and newest.next_step and not (newest.resumable or newest.in_use):
        sentences.append(f"next in the newest run: {newest.next_step}")
    return sentences


def history_table(result: ArmHistory) -> Table:
    """Show every run of the arm, the oldest first, and what moved since its first calibration."""
    return table_of(
        f"{result.arm}: mean errors [mm], and what moved since the first calibration",
        result.runs,
        ("run", lambda one: short_name(one, result.folder)),
        ("began", lambda one: day_of(one.began)),
        ("geometry", lambda one: _pair(one.figures.heldout_mm)[0], _MM),
        ("in force", lambda one: _pair(one.figures.heldout_mm)[1], _MM),
        ("compensated", lambda one: _pair(one.figures.verified_mm)[1], _MM),
        ("effects", lambda one: effects_words(one.figures.effects)),
        ("moved", _moved_words),
    )


def history_sentences(result: ArmHistory) -> list[str]:
    """State what cannot be read, what moved in the newest run, and how sure that is."""
    compared = [run for run in result.runs if run.compared]
    sentences = list(result.problems)
    if not compared:
        return [*sentences, f"{result.arm}: fewer than two of its runs are calibrated; nothing is compared"]
    newest = compared[-1]
    moved = [f"{one.name} moves the SMR by {one.moved_mm:.3f} mm (rms)" for one in newest.moved]
    words = "; ".join(moved) or "no parameter moved beyond its uncertainty"
    sure = (
        f"a chance below {result.false_alarm:.0%} that anything is said to have moved where nothing has, shared by"
        f" {counted(result.comparisons, 'comparison')}; base and tool are not judged"
    )
    return [*sentences, f"{newest.run}: {words}", sure]


def _moved_words(run: ArmRun) -> str:
    return ", ".join(map(_parameter_words, run.moved)) or ("nothing" if run.compared else run.remark)


def _parameter_words(one: MovedParameter) -> str:
    factor, unit = display_unit(one.unit)
    return f"{one.name} {factor * one.difference:+.1f} {unit} (u {factor * one.standard_uncertainty:.1f})"


def run_lines(run: RunSummary) -> list[str]:
    """Describe one run in a few lines: state, results, figures of each arm, next step."""
    used = [f"in use by {run.in_use}"] if run.in_use else []
    if run.problem:
        return [run.problem, *used]
    size = filesize.decimal(run.size_bytes)
    lines = [
        f"profile {run.profile}, {CELL_WORDS[run.cell]}; began {minute_of(run.began)},"
        f" changed {minute_of(run.changed)} (UTC); {size}",
        f"stops {stops_words(run)}; {stages_words(run)}",
        *used,
        *(f"{name}: {figures_words(figures)}" for name, figures in run.figures.items()),
    ]
    if run.in_use:
        return lines
    if run.resumable:
        return [*lines, f"interrupted, {counted(run.stops_left, 'stop')} left: {run.next_step}"]
    return [*lines, f"next: {run.next_step or 'nothing is left to do'}"]


def figures_words(figures: ArmFigures) -> str:
    """State errors, effects and verification of one arm in one line."""
    parts = []
    if figures.heldout_mm is not None:
        best = f"{figures.heldout_mm.after:{_MM}} mm with {figures.best_stage}"
        parts.append(f"held-out mean {figures.heldout_mm.before:{_MM}} mm with geometry, {best}")
    if figures.verdict is not None:
        parts.append(effects_words(figures.effects) or figures.verdict)
    if figures.verified_mm is not None:
        parts.append(f"targets {figures.verified_mm.before:{_MM}} -> {figures.verified_mm.after:{_MM}} mm")
    return "; ".join(parts)


def resume_sentence(run: RunSummary) -> str:
    """Offer to continue an interrupted run."""
    return (
        f"{run.run}: collecting was interrupted ({session_words(run)}) with {run.stops_left} of"
        f" {counted(run.stops_measured + run.stops_left, 'stop')} left; 'cellapp collect {shell_word(run.run)}"
        " --resume'"
        " continues it"
    )


def stages_words(run: RunSummary) -> str:
    """State which results hold, and which are out of date and why."""
    held = [stage.name for stage in run.stages if not stage.out_of_date]
    reasons = grouped((stage.out_of_date, stage.name) for stage in run.stages if stage.out_of_date)
    parts = [f"results: {', '.join(held)}"] if held else []
    parts += [f"out of date: {', '.join(names)} ({reason})" for reason, names in reasons.items()]
    return "; ".join(parts) or "no results"


def _pair(values: BeforeAfter | None) -> tuple[float | None, float | None]:
    return (None, None) if values is None else (values.before, values.after)
