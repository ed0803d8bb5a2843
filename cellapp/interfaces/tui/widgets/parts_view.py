"""Sentences, tables and charts of a view below one another: to read and to scroll."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from textual.containers import ItemGrid, VerticalScroll
from textual.geometry import Size
from textual.widget import Widget
from textual.widgets import Static

from cellapp.commands.view.parts import Facts, Part, Parts, Section, printed
from cellapp.commands.view.table import Table
from cellapp.interfaces.tui.keys import with_keys
from cellapp.interfaces.tui.widgets.chart_plot import ChartPlot

LEAST_COLUMNS = 56
"""Width of a chart: two fit side by side into a terminal of 120 columns."""
_ROWS = 16
"""Lines of a chart with axes: half of a typical terminal."""


class ScrolledPlot(ChartPlot):
    """A chart as high as it needs to be."""

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        """Return the number of lines of the drawing."""
        return _ROWS


class PartsView(VerticalScroll):
    """Parts of a view in reading order, charts side by side where there is room.

    Parameters
    ----------
    empty : str
        Text while there is nothing to show.
    """

    def __init__(self, empty: str = "", *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._empty = empty
        self._late: Callable[[], Iterable[Widget]] | None = tuple
        self._lines: tuple[Part, ...] = ()
        self.tooltip = "up, down, Page Up, Page Down scroll"

    def show(self, parts: Parts, before: Iterable[str] = ()) -> None:
        """Replace the content by the parts of a view; ``before`` are marks above them."""
        from cellapp.commands.view.charts import Chart  # late: numerics, which the start must not wait for

        shown = (*before, *parts)
        lines = tuple(printed(shown))
        if lines == self._lines and not any(isinstance(one, Chart) for one in shown):
            return  # charts are drawn anew: they cannot be compared
        self._lines = lines
        self._put(lambda: widgets_of(shown))

    def say_empty(self, sentence: str) -> None:
        """Set the text while there is nothing to show."""
        if sentence != self._empty:
            self._empty = sentence
            if not self._lines:
                self._put(tuple)

    def _put(self, make: Callable[[], Iterable[Widget]]) -> None:
        """Replace the content by the widgets of ``make``, or by the empty text if it gives none.

        A screen may be drawn before it is mounted: what is not attached yet is drawn when it is mounted.
        """
        self._late = None if self.is_attached else make
        if self.is_attached:
            self.remove_children()
            self.mount(*(tuple(make()) or (Static(self._empty, classes="muted", markup=False),)))
            self.scroll_home(animate=False)

    def on_mount(self) -> None:
        """Draw the content that was given before the widget was attached."""
        if self._late is not None:
            self._put(self._late)


def words_first(parts: Parts) -> list[Part]:
    """Return parts with the sentences first: on a small screen a table would hide them."""
    return sorted(parts, key=lambda part: not isinstance(part, str | Facts))


def widgets_of(parts: Parts) -> Iterator[Widget]:
    """Yield the widgets of parts in reading order on a screen; all charts of a section where its first one is."""
    from cellapp.commands.view.charts import Chart  # late: tables and charts are shown after the start
    from cellapp.interfaces.render.terminal import TerminalTable

    charts = [part for part in parts if isinstance(part, Chart)]
    for part in parts:
        if isinstance(part, Chart):
            if part is charts[0]:
                yield ItemGrid(*map(ScrolledPlot, charts), min_column_width=LEAST_COLUMNS)
        elif isinstance(part, Table):
            yield Static(TerminalTable(part.with_texts(with_keys)), classes="table")
        elif isinstance(part, Facts):
            yield Static("\n".join(map(str, printed((part,)))), markup=False)
        elif isinstance(part, Section):
            yield Static(part.title, classes="title table", markup=False)
            yield from widgets_of((*filter(None, (part.outdated, part.message, part.about)), *words_first(part.parts)))
        else:
            yield Static(with_keys(part), markup=False)
