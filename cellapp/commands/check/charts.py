"""Charts of a check: the evidence stop by stop, and the errors behind it."""

from __future__ import annotations

import numpy as np

from cellapp.commands.view.charts import Axis, Chart, Limit, mm, series
from cellapp.estimation.monitoring.check.records import CheckResult
from cellapp.ground.counting import counted

_STOP = Axis("stop")
_CHANGE, _NONE = 3, 1
"""Styles of the curves for a change and for none: those of effects and of the geometry."""


def check_charts(result: CheckResult) -> tuple[Chart, ...]:
    """Show the evidence and the errors over the stops."""
    return evidence_chart(result), error_chart(result)


def evidence_chart(result: CheckResult) -> Chart:
    """Show the log likelihood ratios of a change and of none, with the limits at which the test decides."""
    stops = np.arange(1.0, len(result.stops) + 1.0)
    drawn = (
        series("a change", stops, [stop.log_evidence for stop in result.stops], style=_CHANGE),
        series("no visible change", stops, [stop.log_valid for stop in result.stops], style=_NONE),
    )
    named = (("a change is sure", result.sure_change), ("no visible change is sure", result.sure_valid))
    limits = tuple(Limit(name, value) for name, value in named if value is not None)
    return Chart(
        "Check: evidence over the stops",
        _STOP,
        Axis("log of the likelihood ratio"),
        drawn if result.stops else (),
        _evidence_message(result),
        limits,
        by_stage=True,
    )


def error_chart(result: CheckResult) -> Chart:
    """Show the distance of each measured SMR from its prediction, by arm."""
    drawn, words = [], []
    for style, (name, arm) in enumerate(result.arms.items()):
        measured = [
            (number, stop.points[name].error_mm)
            for number, stop in enumerate(result.stops, start=1)
            if name in stop.points
        ]
        drawn.append(series(f"arm {name}", [at for at, _ in measured], [error for _, error in measured], style=style))
        words.append(f"arm {name} {mm(arm.rms_mm)} rms, {mm(arm.expected_mm)} expected")
    message = f"Errors with the stored model: {'; '.join(words)}." if result.stops else "No stop was measured."
    return Chart("Check: errors over the stops", _STOP, Axis("error", "mm"), tuple(drawn), message)


def _evidence_message(result: CheckResult) -> str:
    if not result.stops:
        return "No stop was measured."
    last = result.stops[-1]
    words = [
        f"{what} {value:.1f}" + ("" if sure is None else f" (sure at {sure:.1f})")
        for what, value, sure in (
            ("of a change", last.log_evidence, result.sure_change),
            ("of no visible change", last.log_valid, result.sure_valid),
        )
    ]
    return (
        f"Evidence after {counted(len(result.stops), 'stop')}: {', '.join(words)}; the verdict is '{result.verdict}'."
    )
