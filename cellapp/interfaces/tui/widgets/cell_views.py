"""A map of the cell. The chart is made in a thread: the kinematics of the arms takes half a second to load.

Table of the screen Cell: the doctor's findings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from rich.text import Text
from textual import on, work
from textual.message import Message

from cellapp.interfaces.tui.plots import ChartPlot
from cellapp.interfaces.tui.widgets.tables import TextTable

if TYPE_CHECKING:
    from cellapp.commands.doctor.result import DoctorResult
    from cellapp.commands.plan.result import PlannedStop
    from cellapp.commands.view.charts import Chart
    from cellapp.ground.profile import Profile


class CellMap(ChartPlot):
    """Bases, tracker and stops, seen from above or from the tracker."""

    class Made(Message):
        """The chart for the request with this number was made."""

        def __init__(self, number: int, chart: Chart) -> None:
            super().__init__()
            self.number, self.chart = number, chart

    def __init__(self, view: Literal["above", "tracker"], *, id: str) -> None:
        super().__init__(id=id)
        self._view: Literal["above", "tracker"] = view
        self._number = 0
        self._profile: Profile | None = None
        self._stops: Sequence[PlannedStop] = ()

    def show_cell(self, profile: Profile | None, stops: Sequence[PlannedStop] = ()) -> None:
        """Draw the cell of a profile with its planned stops; blank without a profile."""
        self._profile, self._stops = profile, stops
        self._draw_cell()

    def _draw_cell(self) -> None:
        self._number += 1
        if self._profile is None:
            self.chart = None
            return
        self._make(self._number, self._profile, self._stops)

    @work(thread=True)
    def _make(self, number: int, profile: Profile, stops: Sequence[PlannedStop]) -> None:
        from cellapp.commands.plan.charts_obstacles import cell_map_chart

        self.post_message(self.Made(number, cell_map_chart(profile, stops, self._view)))

    @on(Made)
    def take_chart(self, event: Made) -> None:
        """Draw the chart, unless another one was requested meanwhile."""
        event.stop()
        if event.number == self._number:
            self.chart = event.chart


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
