"""A section of the page that shows one result: sentences, charts, tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cellapp.commands.view.charts import Chart
from cellapp.commands.view.table import Table
from cellapp.interfaces.page.captioned import CaptionedFigure


@dataclass(frozen=True)
class ResultSection:
    """``message`` is the section in one sentence."""

    message: str
    sentences: tuple[str, ...]
    figures: tuple[CaptionedFigure, ...]
    tables: tuple[Table, ...]


def result_section(
    key: str, sentences: Sequence[str], charts: Sequence[Chart], tables: Sequence[Table]
) -> ResultSection:
    """The section whose first sentence is the message; ids of its figures begin with ``key``. Empty charts are left
    out."""
    from cellapp.interfaces.page.chart_figure import chart_figure

    message, *others = sentences
    drawn = [chart for chart in charts if not chart.is_empty]
    return ResultSection(
        message=message[:1].upper() + message[1:],
        sentences=tuple(others),
        figures=tuple(chart_figure(f"{key}{number}", chart) for number, chart in enumerate(drawn, start=1)),
        tables=tuple(tables),
    )
