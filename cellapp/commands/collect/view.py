"""Tables and sentences on collecting: what a session stored and what is missing.

Recordings of motion as a table: counts, rates, gaps, unsteady clocks.
"""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.cell.driving.records import CollectResult
from cellapp.cell.run import Outcome
from cellapp.cell.run.records import RecordingState
from cellapp.cell.run.sqlite_file import Session
from cellapp.commands.collect.charts import drift_by_reference, drift_chart
from cellapp.commands.collect.result import CollectedStop, CollectionResult
from cellapp.commands.record import Request, View
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Section, section_of
from cellapp.commands.view.table import Table, part_title, table_of, table_of_cells, with_rows
from cellapp.commands.view.words import ranges
from cellapp.ground.counting import counted, mm
from cellapp.ground.grouping import grouped
from cellapp.ground.results import second_of

_MOST_LISTED = 10
"""Most missing readings that are printed one by one; ``show DIR collection`` has all."""


def view(result: CollectResult, request: Request | None = None) -> View:
    """Show what is stored, what is missing, and notes."""
    return View((*collect_lines(result), *other_notes(result, result.notes)), result.complaints())


def stored_view(state: CollectionResult) -> View:
    """Show the run's collection so far, and the drift of its references."""
    ranges = residual_range_words(state)
    return View((*([ranges] if ranges else []), *collection_tables(state), *_drift_charts(state)))


def collection_section(state: CollectionResult) -> Section:
    """Show the run's collection, with sessions, missing readings and drift in one sentence."""
    count, missing = len(state.sessions), len(state.missing)
    words = [counted(count, "session"), f"{counted(missing, 'planned reading')} missing"]
    drifts = [reference.drift_mm for reference in state.references]
    if drifts:
        words.append(f"references moved by at most {mm(max(drifts))}, limit {mm(state.drift_limit_mm)}")
    return section_of(
        stored_view(state).parts,
        message="; ".join(words),
        about="How the readings were collected: sessions, what persons asked and what interrupted them, planned"
        " readings that are missing, and how far the repeated reference measurements moved. The standard error is that"
        " of a predicted SMR position from the identified parameters alone.",
    )


def _drift_charts(state: CollectionResult) -> list[Chart]:
    """Show the drift of the references over the run with its limit; empty if none was measured twice."""
    twice = any(len(rows) > 1 for rows in drift_by_reference(state.references).values())
    return [drift_chart(state.references, state.drift_limit_mm)] if twice else []


def collect_lines(result: CollectResult) -> list[str]:
    """Say how many stops are stored, how the session ended, which readings are missing."""
    lines = [f"{counted(result.stops, 'stop')} stored: {result.outcome}"]
    if result.replaced is not None:
        counts = counted(result.replaced, "reading was", "readings were")
        lines = [f"{counts} measured again, and the earlier ones are kept; {lines[0]}"]
    if result.missing:
        share = f"{result.missing_share:.1%}, tolerated {result.tolerated_share:.1%}"
        lines.append(f"{counted(len(result.missing), 'planned reading is', 'planned readings are')} missing ({share}):")
        groups = _grouped(result.missing)
        lines += [f"  stop {stops}, arm {arm}: {kind}: {reason}" for stops, arm, kind, reason in groups[:_MOST_LISTED]]
        if len(groups) > _MOST_LISTED:
            lines.append(f"  and {len(groups) - _MOST_LISTED} more: 'cellapp show DIR collection' lists all")
    errors = ", ".join(f"{name} {error:.4f} mm" for name, error in result.standard_error_mm.items())
    return [*lines, f"standard error of a predicted position: {errors}"] if errors else lines


def other_notes(result: CollectResult | None, notes: Sequence[str]) -> list[str]:
    """Return the notes other than reasons of missing readings."""
    reasons = {f": {one.reason}" for one in result.missing} if result is not None else set()
    return [note for note in notes if not any(note.endswith(reason) for reason in reasons)]


def collection_tables(state: CollectionResult) -> list[Table]:
    """Show sessions, their events, missing and replaced readings, drift, standard errors, the most doubtful stops.

    Tables without rows are left out.
    """
    tables = [
        _sessions(state),
        _requests(state),
        _missing(state),
        _replaced(state),
        _drift(state),
        _standard_errors(state),
    ]
    measured = [one for one in state.stops if one.residual_mm is not None]
    worst = sorted(measured, key=_suspicion, reverse=True)[:_MOST_LISTED]
    return with_rows(*tables, stops_table(worst, part_title("Stops to look at first", len(worst), len(measured))))


def stops_table(stops: Sequence[CollectedStop], title: str = "Stops one by one") -> Table:
    """Show residual, its sigma, their ratio and the suspicion of stops."""
    return table_of(
        title,
        stops,
        ("stop", lambda one: one.stop + 1, "d"),
        ("arm", "arm"),
        ("residual", "residual_mm", ".4f", "mm"),
        ("sigma", "sigma_mm", ".4f", "mm"),
        ("ratio", residual_ratio, ".1f"),
        ("retried", _retried),
        ("suspicion", "suspicion"),
    )


def _retried(one: CollectedStop) -> str:
    """Say whether a later visit gave the reading, or how many readings it replaced."""
    times = "" if one.again < 2 else f" x{one.again}"
    return f"again{times}" if one.again else "yes" if one.retried else ""


def residual_ratio(one: CollectedStop) -> float | None:
    """Return the residual in units of sigma; None without a reading or a model."""
    return one.residual_mm / one.sigma_mm if one.residual_mm is not None and one.sigma_mm else None


def residual_range_words(state: CollectionResult) -> str:
    """State the normal residuals of each arm before and after calibration; empty without a model."""
    words = []
    for arm, its in state.residual_ranges.items():
        before = "" if its.before_mm is None else f"up to {mm(its.before_mm)} before calibration (running model)"
        after = "" if its.after_mm is None else f"up to {mm(its.after_mm)} after it (held-out stops)"
        if before or after:
            words.append(f"{arm} {', '.join(filter(None, (before, after)))}")
    return f"Normal range of a residual (95 %): {'; '.join(words)}." if words else ""


def _suspicion(one: CollectedStop) -> tuple[bool, float]:
    """Return a sort key: suspicion first, then the ratio of residual and sigma."""
    return bool(one.suspicion), residual_ratio(one) or 0.0


def _grouped(missing: Sequence[Outcome]) -> list[tuple[str, str, str, str]]:
    """Return the stops, as people count them, arm, kind and reason of missing readings, a row for each reason."""
    groups = grouped(((one.arm, one.kind, one.reason), one.stop + 1) for one in missing)
    return [(ranges(stops), *group) for group, stops in groups.items()]


def _sessions(state: CollectionResult) -> Table:
    return table_of(
        "Sessions of collecting",
        state.sessions,
        ("session", lambda one: str(one.number)),
        ("began (UTC)", lambda one: _time(one.began)),
        ("ended (UTC)", lambda one: _time(one.ended)),
        ("outcome", _outcome_words),
        ("reason", lambda one: one.reason or ""),
    )


def _outcome_words(session: Session) -> str:
    again = f", stops {session.again} again" if session.again else ""
    return f"{session.outcome or 'the program died'}{again}"


def _requests(state: CollectionResult) -> Table:
    return table_of(
        "Requests of persons and interruptions",
        [(session, request) for session in state.sessions for request in session.requests],
        ("session", lambda row: str(row[0].number)),
        ("when (UTC)", lambda row: _time(row[1].written)),
        ("what", lambda row: row[1].kind),
        ("reason", lambda row: row[1].reason),
    )


def _missing(state: CollectionResult) -> Table:
    share = f"{state.missing_share:.1%} of the planned ones, tolerated {state.tolerated_share:.1%}"
    title = f"Missing readings: {len(state.missing)} ({share})"
    return table_of_cells(title, _grouped(state.missing), "stop", "arm", "what", "reason")


def _replaced(state: CollectionResult) -> Table:
    """Show readings replaced by later ones: residuals before and now."""
    now = {(one.stop, one.arm): one.residual_mm for one in state.stops}
    return table_of(
        "Stops measured again: the readings before, which are kept and not used",
        state.replaced,
        ("stop", lambda one: one.stop + 1, "d"),
        ("arm", "arm"),
        ("replaced (UTC)", lambda one: _time(one.replaced)),
        ("residual before", "residual_mm", ".4f", "mm"),
        ("residual now", lambda one: now.get((one.stop, one.arm)), ".4f", "mm"),
    )


def _drift(state: CollectionResult) -> Table:
    names = tuple(dict.fromkeys(row.name for row in state.references))
    by_stop: dict[int, dict[str, float]] = {}
    for row in state.references:
        by_stop.setdefault(row.stops_done, {})[row.name] = row.drift_mm
    rows = ((stops, *map(drift.get, names)) for stops, drift in sorted(by_stop.items()))
    title = f"Reference measurements: distance from the first one [mm], limit {state.drift_limit_mm:.3f} mm"
    return table_of_cells(title, rows, ("stops done", "d"), *((name, ".4f") for name in names))


def _standard_errors(state: CollectionResult) -> Table:
    title, errors_mm = "Standard error of a predicted SMR position", state.standard_error_mm.items()
    return table_of_cells(title, errors_mm, "arm", ("standard error", ".4f", "mm"))


def _time(written: str | None) -> str:
    return "" if written is None else second_of(written)


_OF_POINTS = ("sigma_m", "quat_w", "split")


def recording_tables(states: Sequence[RecordingState]) -> list[Table]:
    """Build a table with two rows for each recording; no table without recordings."""
    table = table_of(
        "Recordings of motion",
        [(one, kind, its) for one in states for kind, its in (("joints", one.joints), ("points", one.points))],
        ("arm", lambda row: row[0].arm),
        ("recording", lambda row: row[0].name),
        ("of", lambda row: row[1]),
        ("n", lambda row: row[2].n, "d"),
        ("s", lambda row: row[2].seconds, ".1f"),
        ("Hz", lambda row: row[2].rate_hz, ".1f"),
        ("gaps", lambda row: row[2].gaps, "d"),
        ("longest [s]", lambda row: row[2].longest_gap_s, ".3f"),
        ("repeats", lambda row: row[2].repeats, "d"),
        ("clock steps back", lambda row: row[2].backward, "d"),
        ("beam lost", lambda row: row[2].lost, "d"),
        ("with", lambda row: ", ".join(one for one in row[0].optional if (one in _OF_POINTS) == (row[1] == "points"))),
    )
    return with_rows(table)
