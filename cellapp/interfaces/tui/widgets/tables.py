"""Tables of the screens Cell and Plan, their map of the cell, and functions for screens with tabs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.text import Text
from textual import work
from textual.widgets import DataTable, TabbedContent, Tabs
from textual.worker import get_current_worker

from cellapp.commands.docs.keys import SHOWN
from cellapp.interfaces.tui.widgets.chart_plot import ChartPlot

if TYPE_CHECKING:
    from cellapp.cell.planning.planned_stops import PlannedStops
    from cellapp.commands.doctor.result import DoctorResult
    from cellapp.commands.plan.result import PlannedStop
    from cellapp.ground.profile import Profile


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


def explain_tabs(tabs: TabbedContent) -> None:
    """Set a tooltip that explains the tabs."""
    tabs.query_one(Tabs).tooltip = f"Left and right choose a tab; {SHOWN['tab']} shows the next one"


class CellMap(ChartPlot):
    """Bases, tracker and stops from above."""

    def show_cell(self, profile: Profile | None, stops: Sequence[PlannedStop] = ()) -> None:
        """Draw the cell of a profile with its planned stops; blank without a profile."""
        if profile is None:
            self.workers.cancel_node(self)
            self.chart = None
        else:
            self._make(profile, stops)

    @work(thread=True, exclusive=True, description="charts")  # by default the repr of all arguments: 40 ms
    def _make(self, profile: Profile, stops: Sequence[PlannedStop]) -> None:
        from cellapp.commands.plan.charts import cell_map_chart

        made = cell_map_chart(profile, stops)
        if not get_current_worker().is_cancelled:  # else another one is being made
            self.call_later(setattr, self, "chart", made)


_ORDER = {"failed": 0, "warning": 1, "ok": 2}
_MARKS = {"failed": "✗ failed", "warning": "! warning", "ok": "✓ ok"}
_STYLES = {"failed": "bold red", "warning": "yellow", "ok": "green"}


class FindingsTable(TextTable):
    """The doctor's checks, failed ones first. The text of the row under the cursor is in ``selected_text``."""

    def on_mount(self) -> None:
        """Create the columns."""
        self.cursor_type = "row"
        self.add_columns("status", "what", "found")

    def show(self, result: DoctorResult | None) -> None:
        """Draw the findings; None: nothing yet."""
        self.clear()
        findings = sorted(() if result is None else result.findings, key=lambda finding: _ORDER[finding.status])
        self.texts = [f"{finding.subject}: {finding.text}" for finding in findings]
        for finding in findings:
            self.add_row(_mark(finding.status), Text(finding.subject), Text(finding.text))


def age_words(seconds: float) -> str:
    """Format an age: "now", "12 s ago", "3 min ago"."""
    if seconds < 2.0:
        return "now"
    return f"{seconds:.0f} s ago" if seconds < 90.0 else f"{seconds / 60.0:.0f} min ago"


def _mark(status: str) -> Text:
    return Text(_MARKS[status], style=_STYLES[status])


class StopsTable(TextTable):
    """The stops in their order."""

    def __init__(self, *, id: str) -> None:
        super().__init__(id=id, cursor_type="row")
        self._stops: Sequence[PlannedStop] = ()
        self._ways: PlannedStops | None = None

    def on_mount(self) -> None:
        """Create the columns."""
        self.add_columns("stop", "frozen", "state", "part", "how")

    def show(self, stops: Sequence[PlannedStop], ways: PlannedStops | None) -> None:
        """Draw the stops of a plan, unless they are already shown."""
        if stops is self._stops or (stops == self._stops and _same_ways(ways, self._ways)):
            return
        self._stops, self._ways = stops, ways
        rows = [_stop_row(stop, ways) for stop in stops]
        texts = [text for _, text in rows]
        if texts != self.texts:  # the cursor stays if nothing changed
            self.texts = texts
            self.clear()
            for cells, _ in rows:
                self.add_row(*map(Text, cells))


def _same_ways(one: PlannedStops | None, other: PlannedStops | None) -> bool:
    """Return whether the data of two plans with the same joint positions are equal, and so the ways to their stops."""
    if one is None or other is None:
        return one is other
    return bool((one.frozen == other.frozen).all() and (one.block == other.block).all())


def _stop_row(stop: PlannedStop, ways: PlannedStops | None) -> tuple[tuple[str, ...], str]:
    """Return cells and sentence of one stop, counted from 1."""
    from cellapp.commands.plan.check_view import stop_words

    number, state = stop.configuration + 1, "measured" if stop.measured else "planned"
    joints = "; ".join(
        f"arm {name} " + ", ".join(f"{math.degrees(angle):z.0f}" for angle in q) + " deg" for name, q in stop.q.items()
    )
    if ways is None:
        return (str(number), "", state, "", ""), f"Stop {number}: {joints}."
    frozen, how = bool(ways.frozen[stop.configuration]), stop_words(ways, stop.configuration)
    cells = (str(number), "yes" if frozen else "", state, str(ways.block[stop.configuration] + 1), how)
    words = f"{how}; frozen: a new design leaves it" if frozen else how
    return cells, f"Stop {number}: {joints}. {words[:1].upper()}{words[1:]}."
