"""Common base of the screens whose tabs show views of stored results."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.widgets import TabbedContent, TabPane

from cellapp.interfaces.tui.run_state import RunState
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.parts_view import PartsView


class TabsScreen(DayScreen):
    """A screen whose tabs show parts of views; ``EMPTY`` is said where the step has no result yet."""

    TABS: ClassVar[tuple[str, ...]]
    """Their titles."""
    EMPTY: ClassVar[str] = ""

    def body(self) -> ComposeResult:
        with TabbedContent():
            for title in self.TABS:
                with TabPane(title, id=id_of(title)):
                    yield PartsView()

    def tab(self, title: str) -> PartsView:
        """Return the view of a tab."""
        return self.query_one(f"#{id_of(title)}", TabPane).query_one(PartsView)

    def show_state(self, state: RunState) -> None:
        """Say why there is no result."""
        empty = "" if self.workspace.stored(self.STEP) else state.nothing(self.STEP, self.EMPTY)
        for view in self.query(PartsView):
            view.say_empty(empty)


def id_of(title: str) -> str:
    """Return the id of the tab with a title."""
    return title.lower().replace(" ", "-")
