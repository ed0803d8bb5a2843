"""What screens with tabs share."""

from __future__ import annotations

from textual.widgets import TabbedContent, TabPane, Tabs


def show_next_tab(tabs: TabbedContent) -> None:
    """Show the tab after the present one; after the last, the first."""
    names = [pane.id or "" for pane in tabs.query(TabPane)]
    tabs.active = names[(names.index(tabs.active) + 1) % len(names)]


def explain_tabs(tabs: TabbedContent) -> None:
    """Say how the tabs are used."""
    tabs.query_one(Tabs).tooltip = "Left and right choose a tab; t shows the next one"
