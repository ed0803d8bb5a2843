"""A chart as a figure of the page, with the same content as in the terminal."""

from __future__ import annotations

from dataclasses import dataclass

from cellapp.commands.view.charts import Chart
from cellapp.interfaces.page.chart_svg import chart_svg
from cellapp.interfaces.render.chart_data import chart_data
from cellapp.interfaces.render.chart_style import LegendEntry, legend_of


@dataclass(frozen=True)
class Figure:
    """A figure: static picture, caption, message, legend, and its values for the page's script.

    ``note`` is its message: one or two sentences that say what the reader should see. ``data`` (JSON) lets the script
    redraw the figure with values under the pointer. ``key`` is its anchor on the page. ``css_class`` is ``wide`` for a
    figure over the whole width.
    """

    svg: str
    caption: str
    legend: tuple[LegendEntry, ...]
    css_class: str = ""
    note: str = ""
    data: str = ""
    key: str = ""


def chart_figure(key: str, chart: Chart) -> Figure:
    """Return a chart's figure: message, legend, and values for the script; ``key`` is its anchor on the page.

    An empty chart has only its message; bars show their values and need no script.
    """
    if chart.is_empty:
        return Figure("", chart.title, (), note=chart.message, key=key)
    drawn, data = chart_svg(chart), "" if chart.categories else chart_data(chart)
    return Figure(drawn, chart.title, legend_of(chart), note=chart.message, data=data, key=key)
