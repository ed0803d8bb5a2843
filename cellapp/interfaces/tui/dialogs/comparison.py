"""Differences between runs, over the screen Runs."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.widgets import Static

from cellapp.commands.compare.result import RunComparison
from cellapp.commands.compare.view import comparison_sentences, comparison_tables
from cellapp.interfaces.tui.dialogs.question import Question
from cellapp.interfaces.tui.widgets.tables import TablesView


class Comparison(Question[None]):
    """Sentences and tables of a comparison, to scroll, to copy, to save."""

    def __init__(self, result: RunComparison) -> None:
        super().__init__()
        self._result = result

    def body(self) -> ComposeResult:
        yield Static("Two runs compared", classes="title", markup=False)
        yield TablesView("The runs do not differ.")
        yield Static(f"Up, down scroll; y copies, w saves; {self.closing_key} closes.", classes="muted", markup=False)

    def on_mount(self) -> None:
        """Draw the comparison, and focus it so that keys scroll it."""
        tables = self.query_one(TablesView)
        tables.show(comparison_tables(self._result), comparison_sentences(self._result))
        tables.focus()
