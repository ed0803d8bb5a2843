"""Scrollable sentences, tables and charts below one another, more than a small terminal can show at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from textual.containers import ItemGrid, VerticalScroll
from textual.geometry import Size
from textual.widget import Widget
from textual.widgets import Static

from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Facts, Parts, Section, printed
from cellapp.commands.view.table import Table
from cellapp.interfaces.render.terminal import rich_table
from cellapp.interfaces.tui.keys import table_with_keys, with_keys
from cellapp.interfaces.tui.plots import ChartPlot
from cellapp.interfaces.tui.widgets.tables import TablesView

LEAST_COLUMNS = 56
"""Width of a chart: two fit side by side into a terminal of 120 columns."""
_ROWS = 16
"""Lines of a chart with axes: half of a typical terminal."""
_WORDS = 5
"""Lines of title and message around bars."""


class ScrolledPlot(ChartPlot):
    """A chart as high as it needs to be."""

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        """Return the number of lines of the drawing."""
        bars = 0 if self.chart is None else len(self.chart.categories)
        return bars + _WORDS if bars else _ROWS


class ChartsView(VerticalScroll):
    """Scrollable view of sentences, charts and tables.

    Parameters
    ----------
    empty : str
        Text while there is nothing to show.
    """

    DEFAULT_CSS = """
    ChartsView { height: 1fr; }
    ChartsView ItemGrid { height: auto; grid-rows: auto; grid-gutter: 0 2; }
    ChartsView ChartPlot { height: auto; }
    ChartsView .table { height: auto; padding-top: 1; }
    """

    def __init__(self, empty: str, *, id: str) -> None:
        super().__init__(Static(empty, classes="muted", markup=False), id=id)
        self._shown: tuple[object, ...] = ()
        self.tooltip = "up, down, Page Up, Page Down scroll"

    async def show(self, charts: Sequence[Chart], tables: Sequence[Table] = (), sentences: Sequence[str] = ()) -> None:
        """Replace the content by these sentences, charts and tables."""
        await self.remove_children()
        grid = [ItemGrid(*map(ScrolledPlot, charts), min_column_width=LEAST_COLUMNS)] if charts else []
        await self.mount(
            *(Static(text, markup=False) for text in sentences),
            *grid,
            *(Static(rich_table(table), classes="table") for table in tables),
        )
        self.scroll_home(animate=False)

    async def say(self, sentence: str) -> None:
        """Show only a sentence."""
        await self.show((), (), (sentence,))


# -- The view of a result on a screen: its sentences, charts, tables and sections, as data from the verb's record -----


class PartsView(TablesView):
    """Parts of a view below one another: in each section sentences, charts, tables, then its subsections."""

    DEFAULT_CSS = """
    PartsView ItemGrid { height: auto; grid-rows: auto; grid-gutter: 0 2; }
    PartsView ChartPlot { height: auto; }
    """

    def show_parts(self, parts: Parts, before: Sequence[str] = ()) -> None:
        """Replace the content by the parts of a view; ``before`` are marks above them."""
        shown = (*before, *parts)
        lines = list(printed(shown))
        drawn = (
            tuple(one for one in lines if isinstance(one, Table)),
            tuple(one for one in lines if isinstance(one, str)),
        )
        if drawn == (self._tables, self._sentences):
            return
        self._tables, self._sentences = drawn
        self.put(lambda: widgets_of(shown))


def widgets_of(parts: Parts) -> Iterator[Widget]:
    """Yield the widgets of parts in reading order on a screen."""
    for part in parts:
        if isinstance(part, str):
            yield Static(with_keys(part), markup=False)
        elif isinstance(part, Facts):
            yield Static("\n".join(map(str, printed((part,)))), markup=False)
    if charts := [part for part in parts if isinstance(part, Chart)]:
        yield ItemGrid(*map(ScrolledPlot, charts), min_column_width=LEAST_COLUMNS)
    yield from (Static(rich_table(table_with_keys(part)), classes="table") for part in parts if isinstance(part, Table))
    for part in parts:
        if isinstance(part, Section):
            yield Static(part.title, classes="title table", markup=False)
            yield from widgets_of((*filter(None, (part.outdated, part.message, part.about)), *part.parts))
