"""The figure of collecting on the page of a run."""

from __future__ import annotations

from cellapp.cell.driving.records import CollectionResult
from cellapp.commands.collect.charts import drift_by_reference, drift_chart
from cellapp.interfaces.page.captioned import CaptionedFigure
from cellapp.interfaces.page.chart_figure import chart_figure


def drift_figures(state: CollectionResult | None) -> list[CaptionedFigure]:
    """Reference drift over the run with its limit; empty if nothing was measured twice."""
    drift_mm = drift_by_reference(() if state is None else state.references)
    if state is None or all(len(rows) < 2 for rows in drift_mm.values()):
        return []
    return [chart_figure("drift", drift_chart(state.references, state.drift_limit_mm))]
