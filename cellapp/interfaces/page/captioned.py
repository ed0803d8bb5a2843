"""A figure of the page with its caption."""

from __future__ import annotations

from dataclasses import dataclass

from cellapp.interfaces.render.chart_style import LegendEntry


@dataclass(frozen=True)
class CaptionedFigure:
    """A figure: static picture, caption, message, legend, and its values for the page's script.

    ``note`` is its message: one or two sentences that say what the reader should see. ``data`` (JSON) lets the script
    draw the figure anew with values under the pointer. ``key`` is its anchor on the page. ``css_class`` is ``wide`` for
    a figure over the whole width.
    """

    svg: str
    caption: str
    legend: tuple[LegendEntry, ...]
    css_class: str = ""
    note: str = ""
    data: str = ""
    key: str = ""
