"""A table of texts whose columns are always as wide as their longest text."""

from __future__ import annotations

from rich.text import Text
from textual.widgets import DataTable


class TextTable(DataTable[Text]):
    """A ``DataTable`` that forgets drawn cells when its size changes.

    Textual measures new rows when the table is idle. A busy computer may draw them before that, in columns as narrow as
    their headings, and Textual 8 keeps what it drew then.
    """

    def watch_virtual_size(self) -> None:
        """Draw all cells again with the columns' present widths."""
        self.notify_style_update()
