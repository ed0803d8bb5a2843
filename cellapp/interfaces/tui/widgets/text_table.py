"""A table of texts whose rows are always measured and whose columns are as wide as their longest text."""

from __future__ import annotations

from rich.text import Text
from textual.widgets import DataTable


class TextTable(DataTable[Text]):
    """A ``DataTable`` that measures its rows when it is mounted and clears its cell cache when its size changes.

    Textual measures new rows when the table has handled a message and is idle. On a busy computer two things go wrong
    in Textual 8. If the position of a table is queried before the screen is laid out, Textual takes the table for shown
    already: it gets no message and stays empty. A table drawn before it is measured keeps columns as narrow as their
    headings.
    """

    def on_mount(self) -> None:
        """Measure rows that were added before, without waiting for a message of the layout."""
        self.check_idle()

    def watch_virtual_size(self) -> None:
        """Redraw all cells with the columns' current widths."""
        self.notify_style_update()
