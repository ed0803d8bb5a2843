"""Tables with a cursor, and the map of the cell."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from typing import TYPE_CHECKING, Literal

from rich.text import Text
from textual import work
from textual.widgets import DataTable
from textual.worker import get_current_worker

from cellapp.commands.view.table import Table
from cellapp.interfaces.tui.widgets.chart_plot import ChartPlot

if TYPE_CHECKING:
    from cellapp.commands.plan.result import PlannedStop
    from cellapp.ground.profile import Profile


_AT_ONCE, _SOON_S = 80, 0.02
"""Rows that are drawn together, and the interval [s] to the next ones."""


class TextTable(DataTable[Text]):
    """A ``DataTable`` that measures its rows when it is mounted and clears its cell cache when its size changes.

    Textual measures new rows when the table has handled a message and is idle. On a busy computer two things go wrong
    in Textual 8. If the position of a table is queried before the screen is laid out, Textual takes the table for shown
    already: it gets no message and stays empty. A table drawn before it is measured keeps columns as narrow as their
    headings.
    """

    _texts: Sequence[Sequence[str]] = ()

    def show(self, table: Table, row: int = 0, marked: Collection[int] = ()) -> None:
        """Draw a table with the cursor in a ``row``; the rows ``marked`` begin with a star.

        Keys are handled between its rows: hundreds would hold them up.
        """
        self._texts = texts = table.text_rows()
        sides: list[Literal["left", "right"]] = ["right" if column.is_number else "left" for column in table.columns]
        self.clear(columns=True)
        for heading, side in zip(table.headings, sides, strict=True):
            self.add_column(Text(heading, justify=side))

        def add(begin: int, end: int) -> None:
            if texts is not self._texts:
                return  # drawn anew meanwhile
            for number, cells in enumerate(texts[begin:end], begin):
                star, style = ("* ", "reverse") if number in marked else ("", "")
                words = (star + cells[0], *cells[1:])
                self.add_row(*(Text(word, style, justify=side) for word, side in zip(words, sides, strict=True)))
            if end < len(texts):
                self.set_timer(_SOON_S, partial(add, end, end + _AT_ONCE))

        add(0, row + _AT_ONCE)
        self.move_cursor(row=row)

    def on_mount(self) -> None:
        """Measure rows that were added before, without waiting for a message of the layout."""
        self.check_idle()

    def watch_virtual_size(self) -> None:
        """Redraw all cells with the columns' current widths."""
        self.notify_style_update()


class CellMap(ChartPlot):
    """Bases, tracker and stops from above."""

    def show_cell(self, profile: Profile | None, stops: Sequence[PlannedStop] = ()) -> None:
        """Draw the cell of a profile with its planned stops; blank without a profile."""
        if profile is None:
            self.workers.cancel_node(self)
            self.chart = None
        else:
            self._make(profile, stops)

    @work(thread=True, exclusive=True, description="charts")  # by default the repr of all arguments: 40 ms
    def _make(self, profile: Profile, stops: Sequence[PlannedStop]) -> None:
        from cellapp.commands.plan.charts import cell_map_chart

        made = cell_map_chart(profile, stops)
        if not get_current_worker().is_cancelled:  # else another one is being made
            self.call_later(setattr, self, "chart", made)
