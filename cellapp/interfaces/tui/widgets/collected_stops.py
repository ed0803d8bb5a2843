"""List of the stops of a collection: filtered, with a cursor that the plot of the residuals follows."""

from __future__ import annotations

from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical
from textual.reactive import var
from textual.widgets import DataTable, Static

from cellapp.commands.collect.result import CollectedStop, CollectionResult
from cellapp.commands.collect.view import residual_range_words, stops_table
from cellapp.commands.docs.keys import SHOWN
from cellapp.ground.counting import counted
from cellapp.interfaces.tui.keys import bind
from cellapp.interfaces.tui.widgets.tables import TextTable


class CollectedStops(Vertical):
    """Stops of a run as read from its file; the normal range of residuals is stated above them."""

    BINDINGS: ClassVar[list[BindingType]] = [
        bind("filter", "filter", "Only suspicious", "show only stops with a suspicion; again: all"),
        bind("mark", "mark", "Mark", "mark the stop, both arms: {again} measures marked stops again".format_map(SHOWN)),
    ]

    chosen: var[CollectedStop | None] = var(None)
    """The stop under the cursor."""

    def __init__(self, *, id: str) -> None:
        super().__init__(id=id)
        self._state: CollectionResult | None = None
        self._shown: list[CollectedStop] = []
        self._empty = ""
        self._only_suspicious = False
        self._marked: dict[int, int] = {}  # stop -> how many of its readings were replaced when it was marked

    def compose(self) -> ComposeResult:
        yield Static("", markup=False)
        yield TextTable(cursor_type="row", zebra_stripes=True)

    def on_mount(self) -> None:
        """Set the tooltip with its key."""
        self.table.tooltip = f"{SHOWN['filter']} shows only suspicious stops"

    @property
    def table(self) -> TextTable:
        """The table, which has the focus."""
        return self.query_one(TextTable)

    @property
    def again(self) -> list[int]:
        """The marked stops, or else the one under the cursor."""
        under_cursor = [] if self.chosen is None else [self.chosen.stop]
        return sorted(self._marked) or under_cursor

    def show(self, state: CollectionResult | None) -> None:
        """Draw the stops of a run; None if there is no collection."""
        if state is not None and state == self._state:
            return
        same_run = state is not None and self._state is not None and state.run == self._state.run
        self._state = state
        if self.chosen not in self._stops:
            self.chosen = None
        marked = self._marked if same_run else {}
        self._marked = {stop: count for stop, count in marked.items() if count == self._replaced(stop)}
        self._draw()

    def say_empty(self, sentence: str) -> None:
        """Set the text while there is no stop."""
        if sentence != self._empty:
            self._empty = sentence
            self._say()

    def step(self, by: int) -> None:
        """Move the cursor by some rows; in a plot, to the next or previous point."""
        self.table.move_cursor(row=self.table.cursor_row + by)

    def action_filter(self) -> None:
        """Show only stops with a suspicion, or all again."""
        self._only_suspicious = not self._only_suspicious
        self._draw()

    @on(DataTable.RowHighlighted)
    def choose(self, event: DataTable.RowHighlighted) -> None:
        """Note that the cursor is on another stop."""
        event.stop()
        if event.cursor_row < len(self._shown):
            self.chosen = self._shown[event.cursor_row]

    @property
    def _stops(self) -> tuple[CollectedStop, ...]:
        return () if self._state is None else self._state.stops

    def _replaced(self, stop: int) -> int:
        """Return how many readings of a stop were replaced; the number grows when it is measured again."""
        return sum(one.again for one in self._stops if one.stop == stop)

    def action_mark(self) -> None:
        """Mark or unmark the stop under the cursor."""
        if self.chosen is not None and self._marked.pop(self.chosen.stop, None) is None:
            self._marked[self.chosen.stop] = self._replaced(self.chosen.stop)
        self._draw()

    def _draw(self) -> None:
        """Filter and draw; the cursor stays on its stop if that is still shown."""
        self._shown = [one for one in self._stops if one.suspicion or not self._only_suspicious]
        row = self._shown.index(self.chosen) if self.chosen in self._shown else 0
        marked = [number for number, one in enumerate(self._shown) if one.stop in self._marked]
        self.table.show(stops_table(self._shown), row, marked)
        self._say()

    def _say(self) -> None:
        """Show the normal range and the number of shown stops, or why there are none."""
        words = self._empty
        if self._state is not None and self._stops:
            count = f"{len(self._shown)} of {len(self._stops)}, suspicious only" if self._only_suspicious else ""
            shown = count and f"Shown: {count} ({SHOWN['filter']}: all)."
            marked = f"{counted(len(self._marked), 'stop is', 'stops are')} marked: {SHOWN['again']} measures again."
            words = " ".join(filter(None, (residual_range_words(self._state), shown, marked if self._marked else "")))
        self.query_one(Static).update(words)
