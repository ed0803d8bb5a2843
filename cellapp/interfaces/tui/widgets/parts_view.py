"""The view of a result on a screen: its sentences, charts, tables and sections, as data from the verb's record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from textual.containers import ItemGrid
from textual.widget import Widget
from textual.widgets import Static

from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Facts, Parts, Section, printed
from cellapp.commands.view.table import Table
from cellapp.interfaces.render.terminal import rich_table
from cellapp.interfaces.tui.keys import table_with_keys, with_keys
from cellapp.interfaces.tui.widgets.charts_view import LEAST_COLUMNS, ScrolledPlot
from cellapp.interfaces.tui.widgets.tables import TablesView


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
