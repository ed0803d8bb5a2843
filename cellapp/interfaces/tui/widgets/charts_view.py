"""Scrollable sentences, tables and charts below one another, more than a small terminal can show at once.

Overview of the judgements: each error with its expanded uncertainty against its tolerance, as a bar with a mark.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from textual.containers import ItemGrid, VerticalScroll
from textual.content import Content
from textual.geometry import Size
from textual.reactive import reactive
from textual.widget import Widget
from textual.widgets import Static

from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Facts, Parts, Section, printed
from cellapp.commands.view.table import Table
from cellapp.estimation.uncertainty.records import Conformity, Judgement
from cellapp.interfaces.render.terminal import rich_table
from cellapp.interfaces.tui.keys import table_with_keys, with_keys
from cellapp.interfaces.tui.plots import ChartPlot
from cellapp.interfaces.tui.run_state import SIGNS
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
        if drawn == (self._tables, self._sentences) and not any(isinstance(one, Chart) for one in shown):
            return  # charts are drawn anew: they cannot be compared
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


_STYLES: Mapping[Conformity, str] = {
    "conforms": "$text-success",
    "does not conform": "bold $text-error",
    "cannot say": "$text-warning",
}
_NUMBERS = 26
"""Columns of "0.049 ± 0.051 / 0.100 mm"."""
_LEAST_BAR, _MOST_BAR = 10, 60
_SCALE = 1.5
"""Length of a bar in tolerances: a larger error is drawn up to the end."""


class VerdictBars(Widget):
    """One line for each judgement: mark, name, bar, numbers. The tolerance is at two thirds of the bar."""

    DEFAULT_CSS = """
    VerdictBars { height: auto; padding: 1 0 0 0; }
    """

    judgements: reactive[tuple[Judgement, ...]] = reactive((), layout=True)

    def __init__(self, *, id: str) -> None:
        super().__init__(id=id)
        self.tooltip = "━ the error, ─ its expanded uncertainty, │ the tolerance"

    def get_content_height(self, container: object, viewport: object, width: int) -> int:
        """Return one line for each judgement."""
        return len(self.judgements)

    def render(self) -> Content:
        """Return the bars."""
        return Content("\n").join(verdict_lines(self.judgements, self.content_size.width))


def verdict_lines(judgements: Sequence[Judgement], width: int) -> list[Content]:
    """Return a line for each judgement, at most ``width`` cells wide."""
    names = [f"{one.characteristic.replace('_', ' ')}, {one.where}" for one in judgements]
    longest = min(max(map(len, names), default=0), max(width - _NUMBERS - _LEAST_BAR - 6, 8))
    cells = max(min(width - longest - _NUMBERS - 6, _MOST_BAR), _LEAST_BAR)
    return [
        Content.assemble(
            (f"{SIGNS[one.conformity]} ", _STYLES[one.conformity]),
            f"{name[:longest]:<{longest}}  ",
            (error_bar(one, cells), _STYLES[one.conformity]),
            f"  {_numbers(one)}",
        )
        for one, name in zip(judgements, names, strict=True)
    ]


def error_bar(one: Judgement, cells: int) -> str:
    """Return ``━`` up to the error, ``─`` as far as its uncertainty extends it, ``│`` at the tolerance."""
    value, more = one.value, one.expanded or 0.0

    def place(amount: float) -> int:
        return min(max(round(amount / (_SCALE * one.tolerance) * cells), 0), cells)

    bar = [" "] * cells
    if value is not None:
        low, high = place(value - more), place(value + more)
        bar[: place(value)] = "━" * place(value)
        bar[low:high] = "─" * (high - low) if more else bar[low:high]
        bar[max(place(value) - 1, 0)] = "╋" if more else "━"
    bar[min(place(one.tolerance), cells - 1)] = "│"
    return "".join(bar)


def _numbers(one: Judgement) -> str:
    limit = f"{one.tolerance:.3f} {one.unit}"
    if one.value is None:
        return f"not measured / {limit}"
    sure = "" if one.expanded is None else f" ± {one.expanded:.3f}"
    return f"{one.value:.3f}{sure} / {limit}"
