"""A table of texts, and functions for screens with tabs."""

from __future__ import annotations

from collections.abc import Sequence

from rich.text import Text
from textual.widgets import DataTable, TabbedContent, TabPane, Tabs

from cellapp.commands.docs.keys import SHOWN


class TextTable(DataTable[Text]):
    """A ``DataTable`` that measures its rows when it is mounted and clears its cell cache when its size changes.

    Textual measures new rows when the table has handled a message and is idle. On a busy computer two things go wrong
    in Textual 8. If the position of a table is queried before the screen is laid out, Textual takes the table for shown
    already: it gets no message and stays empty. A table drawn before it is measured keeps columns as narrow as their
    headings.
    """

    texts: Sequence[str] = ()
    """A sentence for each row; empty where none is said."""

    @property
    def selected_text(self) -> str:
        """The sentence of the row under the cursor."""
        return self.texts[self.cursor_row] if self.cursor_row < len(self.texts) else ""

    def on_mount(self) -> None:
        """Measure rows that were added before, without waiting for a message of the layout."""
        self.check_idle()

    def watch_virtual_size(self) -> None:
        """Redraw all cells with the columns' current widths."""
        self.notify_style_update()


# -- Functions for screens with tabs ----------------------------------------------------------------------------------


def show_next_tab(tabs: TabbedContent) -> None:
    """Show the tab after the current one; after the last, the first."""
    names = [pane.id or "" for pane in tabs.query(TabPane)]
    tabs.active = names[(names.index(tabs.active) + 1) % len(names)]


def show_next_of(tabs: TabbedContent, some: Sequence[str]) -> None:
    """Show the next one of some tabs; if another tab is shown, the first of them."""
    tabs.active = some[(some.index(tabs.active) + 1) % len(some)] if tabs.active in some else some[0]


def explain_tabs(tabs: TabbedContent) -> None:
    """Set a tooltip that explains the tabs."""
    tabs.query_one(Tabs).tooltip = f"Left and right choose a tab; {SHOWN['tab']} shows the next one"
