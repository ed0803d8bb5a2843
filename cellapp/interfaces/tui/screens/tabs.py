"""Common base of the screens with tabs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from textual.app import ComposeResult
from textual.widgets import TabbedContent, TabPane, Tabs

from cellapp.commands.docs.keys import SHOWN
from cellapp.interfaces.tui.day_state import DayState
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.parts_view import PartsView


class TabsScreen(DayScreen):
    """A screen with tabs. A tab shows parts of views, unless a subclass puts other widgets into it."""

    TABS: ClassVar[Mapping[str, str]]
    """Title of each tab -> what it says while there is nothing to show."""

    def body(self) -> ComposeResult:
        with TabbedContent():
            for title in self.TABS:
                with TabPane(title, id=id_of(title)):
                    yield from self.in_tab(title)

    def in_tab(self, title: str) -> ComposeResult:
        """The widgets of a tab."""
        yield PartsView(self.TABS[title])

    def on_mount(self) -> None:
        """Explain the tabs."""
        self.query_one(Tabs).tooltip = f"Left and right choose a tab; {SHOWN['tab']} shows the next one"

    @property
    def tabs(self) -> TabbedContent:
        """All tabs; the id of the active one is ``id_of`` its title."""
        return self.query_one(TabbedContent)

    def tab(self, title: str) -> PartsView:
        """Return the view of a tab."""
        return self.query_one(f"#{id_of(title)}", TabPane).query_one(PartsView)

    def show_tab(self, title: str) -> None:
        """Show a tab, and let the keys go through its content."""
        self.tabs.active = id_of(title)
        if self.tabs.active_pane is not None:
            for content in self.tabs.active_pane.query("DataTable, PartsView"):
                self.call_after_refresh(content.focus)

    def show_nothing(self) -> None:
        """Let every tab say what it says without a result."""
        for title in self.TABS:
            self.tab(title).show([])

    def action_next_tab(self) -> None:
        """Show the tab after the current one; after the last, the first."""
        titles = list(self.TABS)
        shown = next(place for place, title in enumerate(titles) if id_of(title) == self.tabs.active)
        self.show_tab(titles[(shown + 1) % len(titles)])

    def show_state(self, state: DayState) -> None:
        """Say why there is no result of the step."""
        for title, empty in self.TABS.items():
            self.tab(title).say_empty("" if self.workspace.stored(self.STEP) else state.nothing(self.STEP, empty))


def id_of(title: str) -> str:
    """Return the id of the tab with a title."""
    return f"tab-{title.lower().replace(' ', '-')}"
