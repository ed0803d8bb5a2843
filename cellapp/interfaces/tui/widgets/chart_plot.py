"""The widget that draws a chart. Drawing code is loaded with the first chart: a blank widget needs no numerics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.segment import Segment
from rich.style import Style
from textual.reactive import reactive
from textual.strip import Strip
from textual.widget import Widget

if TYPE_CHECKING:
    from cellapp.commands.view.charts import Chart

ON_DARK = ("#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442", "#d55e00")
ON_LIGHT = ("#0072b2", "#b64f00", "#00795a", "#a8447c", "#000000", "#7a6a00")
"""Colours of the styles on dark and on light backgrounds: those of Okabe and Ito (2008), distinguishable with colour
blindness; on light backgrounds darkened to a contrast of 3 to 1."""


class ChartPlot(Widget):
    """A chart with its title, key and message. Set ``chart`` to draw another one; None is blank."""

    chart: reactive[Chart | None] = reactive(None)

    def __init__(self, chart: Chart | None = None, *, id: str | None = None, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes)
        self._strips: list[Strip] = []
        self._drawn_as: tuple[object, ...] = ()
        self.set_reactive(ChartPlot.chart, chart)

    def render_line(self, y: int) -> Strip:
        """Return one line of the drawing, which is cached for a chart, a size and a background."""
        width, height = self.content_size
        drawn_as = (self.chart, width, height, self.rich_style, self.app.current_theme.dark)
        if drawn_as != self._drawn_as:
            self._strips = [] if self.chart is None else self._drawing(self.chart, width, height)
            self._drawn_as = drawn_as
        return self._strips[y] if y < len(self._strips) else Strip.blank(width, self.rich_style)

    def _drawing(self, chart: Chart, width: int, height: int) -> list[Strip]:
        """Return the lines of a chart."""
        from cellapp.interfaces.tui.plots import draw

        lines = draw(chart, width, height)
        styles = {ink: self._style(ink) for ink in {ink for line in lines for _, ink in line}}
        return [
            Strip([Segment(text, styles[ink]) for text, ink in line]).adjust_cell_length(width, self.rich_style)
            for line in lines
        ]

    def _style(self, ink: int) -> Style:
        """Return the style of an ink on the current background."""
        from cellapp.interfaces.tui.plots import HEADING, SOFT, TEXT

        own = self.rich_style
        if ink == TEXT:
            return own
        if ink == HEADING:
            return own + Style(bold=True)
        if ink == SOFT:
            return own + Style(italic=True)
        colours = ON_DARK if self.app.current_theme.dark else ON_LIGHT
        return own + Style(color=colours[ink % len(colours)])
