"""A map of the cell. The chart is made in a thread: the kinematics of the arms takes half a second to load.

Table of the screen Cell: the doctor's findings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from rich.text import Text
from textual import work
from textual.worker import get_current_worker

from cellapp.interfaces.tui.plots import ChartPlot
from cellapp.interfaces.tui.widgets.tables import TextTable

if TYPE_CHECKING:
    from cellapp.commands.doctor.result import DoctorResult
    from cellapp.commands.plan.result import PlannedStop
    from cellapp.ground.profile import Profile


class CellMap(ChartPlot):
    """Bases, tracker and stops, seen from above or from the tracker."""

    def __init__(self, view: Literal["above", "tracker"], *, id: str) -> None:
        super().__init__(id=id)
        self._view: Literal["above", "tracker"] = view

    def show_cell(self, profile: Profile | None, stops: Sequence[PlannedStop] = ()) -> None:
        """Draw the cell of a profile with its planned stops; blank without a profile."""
        if profile is None:
            self.workers.cancel_node(self)
            self.chart = None
        else:
            self._make(profile, stops)

    @work(thread=True, exclusive=True)
    def _make(self, profile: Profile, stops: Sequence[PlannedStop]) -> None:
        from cellapp.commands.plan.charts_obstacles import cell_map_chart

        made = cell_map_chart(profile, stops, self._view)
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
