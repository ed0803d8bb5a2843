"""Charts of a collection: residuals and standard errors as readings arrive, and drift of the references."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from cellapp.cell.run.records import ReferenceDrift
from cellapp.commands.collect.result import CollectedStop
from cellapp.commands.view.charts import Axis, Chart, Kind, Limit, Series, enumerated, series
from cellapp.ground.counting import counted, mm
from cellapp.ground.grouping import grouped
from cellapp.ground.progress import ReferenceReport, StopReport
from cellapp.robot.kinematics.transforms import Array

NO_READINGS = "No stop was reported."
NO_REFERENCES = "No reference was measured yet."
_STOP = Axis("stop")


def residual_chart(
    stops: Sequence[StopReport | CollectedStop],
    arms: Sequence[str] = (),
    nothing: str = NO_READINGS,
    chosen: CollectedStop | None = None,
) -> Chart:
    """Show the residual of each stop by arm: from the model refitted with it, of stored stops from that of all of them.

    ``arms`` fixes the order of the arms, and with it their colours and marks, before all have reported. ``nothing`` is
    the message without a residual. The ``chosen`` stop is marked.
    """
    known = grouped((one.arm, (one.stop + 1, one.residual_mm)) for one in stops if one.residual_mm is not None)
    by_arm: dict[str, list[tuple[int, float]]] = {name: [] for name in arms} | known
    drawn = [*_named(by_arm, "points")]
    medians = [f"{name} {mm(statistics.median(length for _, length in rows))}" for name, rows in known.items()]
    message = f"Median: {enumerated(medians)}." if known else nothing
    if chosen is not None and chosen.residual_mm is not None:
        name = f"stop {chosen.stop + 1}, arm {chosen.arm}"
        style = [*by_arm].index(chosen.arm)
        drawn.append(series(name, [chosen.stop + 1], [chosen.residual_mm], "points", style=style, mark="◉"))
        message = f"Chosen: {name}, {mm(chosen.residual_mm)}. {message}"
    return Chart("Residual of each stop", _STOP, Axis("residual", "mm"), tuple(drawn), message)


def standard_error_chart(reports: Sequence[StopReport], arms: Sequence[str] = (), nothing: str = NO_READINGS) -> Chart:
    """Show the standard error of a predicted SMR position over the stops, by arm; ``arms`` and ``nothing`` as above."""
    by_arm = {name: list[StopReport]() for name in arms} | grouped((report.arm, report) for report in reports)
    message = nothing
    if reports:
        changes = [
            f"{name} {mm(rows[-1].standard_error_mm)} (at stop {rows[0].stop + 1}: {mm(rows[0].standard_error_mm)})"
            for name, rows in by_arm.items()
            if rows
        ]
        message = f"Standard error of a predicted position: {enumerated(changes)}."
    axis = Axis("standard error", "mm", logarithmic=True)
    drawn = _named({name: [(row.stop + 1, row.standard_error_mm) for row in rows] for name, rows in by_arm.items()})
    return Chart("Standard error of a prediction", _STOP, axis, drawn, message)


def _named(rows: Mapping[str, Sequence[tuple[float, float]]], kind: Kind = "line") -> tuple[Series, ...]:
    """Return a series of x and y for each name that has any; its style is its place."""
    return tuple(
        series(name, [x for x, _ in its], [y for _, y in its], kind, style=style)
        for style, (name, its) in enumerate(rows.items())
        if its
    )


def drift_by_reference(references: Iterable[ReferenceDrift]) -> dict[str, list[tuple[int, float]]]:
    """Return the stops done and drift [mm] of each reference, in the order of measurement."""
    return grouped((row.name, (row.stops_done, row.drift_mm)) for row in references)


def drift_chart(references: Iterable[ReferenceDrift], limit_mm: float) -> Chart:
    """Show the distance of every reference from its first measurement over the stops of a run, with the limit [mm]."""
    return _drift_chart(drift_by_reference(references), limit_mm, Axis("stops done"))


def live_drift_chart(reports: Sequence[ReferenceReport]) -> Chart:
    """Show the same drift from the events of a running collection, which count reference measurements from 1."""
    drift_mm = grouped(
        (name, (number, drift))
        for number, report in enumerate(reports, start=1)
        for name, drift in report.drift_mm.items()
    )
    limit_mm = reports[-1].limit_mm if reports else None
    return _drift_chart(drift_mm, limit_mm, Axis("reference measurement"))


def _drift_chart(drift_mm: Mapping[str, Sequence[tuple[int, float]]], limit_mm: float | None, x: Axis) -> Chart:
    drawn = _named(drift_mm)
    limits = () if limit_mm is None or not drawn else (Limit("limit", limit_mm),)
    message = _drift_message(drift_mm, limit_mm) if drawn else NO_REFERENCES
    return Chart("Drift of the references", x, Axis("distance from the first", "mm"), drawn, message, limits)


def _drift_message(drift_mm: Mapping[str, Sequence[tuple[int, float]]], limit_mm: float | None) -> str:
    farthest, name = max((drift, name) for name, rows in drift_mm.items() for _, drift in rows)
    words = f"{name} moved farthest, {mm(farthest)} from its first measurement"
    if limit_mm is None:
        return f"{words}."
    if farthest > limit_mm:
        return f"{words}: beyond the limit of {mm(limit_mm)}. Check its nest and the tracker's stand."
    return f"{words}; the limit is {mm(limit_mm)}."


# -- Drift over a run: mean residuals of successive blocks of stops, with bands ---------------------------------------


_BLOCK, _MOST_BLOCKS, _FEWEST = 20, 24, 3
"""Least stops of a block: enough for its scatter; most blocks; least blocks for a drift to show."""
_TWO_SIDED = 2.09
"""Half width of the 95 % band of a mean of 20 in standard errors: Student's t with 19 degrees of freedom."""
_EXPECTED = 0.05
"""Share of 95 % bands that exclude zero by chance."""
_RARE = 0.01
"""More bands than chance that exclude zero are a drift if their probability is below this."""
_HOUR = 3600.0


def residual_drift_chart(name: str, time_s: Array, residuals_M: Array) -> Chart:
    """Show the mean residuals (n, 3) [m] along x, y, z of blocks of stops over the time (n,) [s] of a run.

    Without times they are shown over the order of the readings.
    """
    title, y = f"Arm {name}: residuals over the run", Axis("mean residual", "mm")
    known = np.isfinite(residuals_M).all(axis=1)  # NaN if an effect needs a value not recorded at the stop
    time_s, residuals_M = time_s[known], residuals_M[known]
    timed = bool(np.isfinite(time_s).all()) and float(np.ptp(time_s)) > 0.0
    x = Axis("time since the run began", "h") if timed else Axis("reading")
    at = time_s / _HOUR if timed else np.arange(1.0, len(time_s) + 1.0)
    count = min(len(at) // _BLOCK, _MOST_BLOCKS)
    if count < _FEWEST:
        return Chart(title, x, y, (), f"Arm {name} has too few readings ({len(at)}) to tell a drift from noise.")
    blocks = np.array_split(np.argsort(at, kind="stable"), count)
    middle = np.array([at[rows].mean() for rows in blocks])
    mean = np.array([residuals_M[rows].mean(axis=0) for rows in blocks]) * 1e3
    sizes = np.array([len(rows) for rows in blocks])
    scatter = np.array([residuals_M[rows].std(axis=0, ddof=1) for rows in blocks]) * 1e3
    band = _TWO_SIDED * scatter / np.sqrt(sizes)[:, None]
    drawn = tuple(series(f"along {axis}", middle, mean[:, k], band=band[:, k], style=k) for k, axis in enumerate("xyz"))
    return Chart(title, x, y, drawn, _message(name, mean, band), (Limit("no residual", 0.0),))


def _message(name: str, mean: Array, band: Array) -> str:
    """Say whether more bands exclude zero than by chance."""
    outside, total = int(np.count_nonzero(np.abs(mean) > band)), mean.size
    drifts = _chance_of_at_least(outside, total) < _RARE
    verdict = "more than by chance: they drift" if drifts else "no more than by chance"
    return (
        f"Residuals of arm {name}: means of {len(mean)} successive blocks of stops stay within"
        f" {mm(float(np.abs(mean).max()))}; {outside} of {counted(total, 'band')} (95 %) leave zero out, {verdict}"
        f" ({_EXPECTED * total:.1f})."
    )


def _chance_of_at_least(outside: int, total: int) -> float:
    """Return the probability that chance alone excludes that many zeros (binomial distribution)."""
    p = _EXPECTED
    return 1.0 - sum(math.comb(total, k) * p**k * (1.0 - p) ** (total - k) for k in range(outside))
