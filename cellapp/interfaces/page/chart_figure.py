"""A chart of ``cellapp.commands.view.charts`` as a figure of the page: the page draws what the terminal draws."""

from __future__ import annotations

from cellapp.commands.view.charts import Chart
from cellapp.interfaces.page.captioned import CaptionedFigure
from cellapp.interfaces.page.chart_svg import chart_svg
from cellapp.interfaces.render.chart_data import chart_data
from cellapp.interfaces.render.chart_style import legend_of


def chart_figure(key: str, chart: Chart) -> CaptionedFigure:
    """The chart with its message, its legend, and its values for the script; ``key`` is its anchor on the page.

    An empty chart has its message alone; bars have their values beside them and need no script.
    """
    if chart.is_empty:
        return CaptionedFigure("", chart.title, (), note=chart.message, key=key)
    drawn, data = chart_svg(chart), "" if chart.categories else chart_data(chart)
    return CaptionedFigure(drawn, chart.title, legend_of(chart), note=chart.message, data=data, key=key)
