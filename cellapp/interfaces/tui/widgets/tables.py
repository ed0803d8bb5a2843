"""Tables of the report in the terminal: to read, to scroll, to copy, to save."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import ClassVar, Literal

from rich.text import Text
from textual.binding import BindingType
from textual.containers import Vertical, VerticalScroll
from textual.widget import Widget
from textual.widgets import DataTable, Static, TabbedContent, TabPane, Tabs

from cellapp.commands.view.table import Table, markdown
from cellapp.ground.counting import counted
from cellapp.interfaces.tui.dialogs.file_picker import SaveAs
from cellapp.interfaces.tui.keys import SHOWN, bind, table_with_keys, with_keys


class TablesView(VerticalScroll):
    """Tables below one another, with sentences before and after them.

    Parameters
    ----------
    empty : str
        Text while there is nothing to show.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        bind("copy", "copy", "Copy tables", "copy the tables as Markdown"),
        bind("save", "save", "Save tables", "save the tables as a Markdown file"),
    ]
    DEFAULT_CSS = """
    TablesView { height: 1fr; }
    TablesView .table { height: auto; padding-top: 1; }
    TablesView .table DataTable { height: auto; }
    """

    def __init__(self, empty: str = "", *, id: str | None = None, classes: str | None = None) -> None:
        super().__init__(Static(empty, classes="muted", markup=False), id=id, classes=classes)
        self._empty = empty
        self._late: Callable[[], Iterable[Widget]] | None = None
        self._tables: tuple[Table, ...] = ()
        self._sentences: tuple[str, ...] = ()
        self.tooltip = f"up, down, Page Up, Page Down scroll; {SHOWN['copy']} copies, {SHOWN['save']} saves"

    def show(self, tables: Sequence[Table], before: Sequence[str] = (), after: Sequence[str] = ()) -> None:
        """Replace the content by these tables and sentences."""
        before, after = tuple(map(with_keys, before)), tuple(map(with_keys, after))
        drawn = (tuple(tables), (*before, *after))
        if drawn == (self._tables, self._sentences):
            return
        self._tables, self._sentences = drawn
        self.put(
            lambda: (
                *(Static(text, classes="before", markup=False) for text in before),
                *map(self.draw, tables),
                *(Static(text, classes="after", markup=False) for text in after),
            )
        )

    def say_empty(self, sentence: str) -> None:
        """Set the text while there is nothing to show."""
        if sentence != self._empty:
            self._empty = sentence
            if not self._tables and not self._sentences:
                self.put(tuple)

    def put(self, make: Callable[[], Iterable[Widget]]) -> None:
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
            self.put(self._late)

    def draw(self, table: Table) -> Widget:
        """Return a widget for one table."""
        return draw_table(table)

    def action_copy(self) -> None:
        """Copy all tables to the clipboard."""
        self.app.copy_to_clipboard(markdown(self._tables, self._sentences))
        self.notify(f"{counted(len(self._tables), 'table')} copied")

    def action_save(self) -> None:
        """Save all tables in a file."""
        text = markdown(self._tables, self._sentences)
        self.app.push_screen(SaveAs("tables", text, Path("tables.md")), self._say_saved)

    def _say_saved(self, path: Path | None) -> None:
        if path is not None:
            self.notify(f"saved as {path}")


class WrappedTables(TablesView):
    """Tables whose cells contain sentences: these are wrapped, and no column is cut off."""

    def draw(self, table: Table) -> Widget:
        """Return a table as the command line prints it."""
        from cellapp.interfaces.render.terminal import rich_table  # late: tables are shown after the start

        return Static(rich_table(table_with_keys(table)), classes="table")


def draw_table(table: Table) -> Vertical:
    """Return a table with its title. Cells are plain text: Textual would interpret a unit in brackets as markup."""
    grid = TextTable(cursor_type="none", zebra_stripes=True)
    grid.can_focus = False  # the pane scrolls all tables together
    sides: list[Literal["left", "right"]] = ["right" if column.is_number else "left" for column in table.columns]
    for heading, side in zip(table.headings, sides, strict=True):
        grid.add_column(Text(heading, justify=side))
    for row in table.text_rows():
        grid.add_row(*(Text(cell, justify=side) for cell, side in zip(row, sides, strict=True)))
    return Vertical(Static(table.title, markup=False, classes="title"), grid, classes="table")


# -- A table of texts whose rows are always measured and whose columns are as wide as their longest text --------------


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
