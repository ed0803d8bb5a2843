"""Functions for screens with tabs."""

from __future__ import annotations

from collections.abc import Sequence

from textual.widgets import TabbedContent, TabPane, Tabs

from cellapp.interfaces.tui.keys import SHOWN


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
