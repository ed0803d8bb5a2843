"""A map of the cell. The chart is made in a thread: the mathematics of the arms takes half a second to load."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from textual import on, work
from textual.message import Message

from cellapp.interfaces.tui.plots import ChartPlot

if TYPE_CHECKING:
    from cellapp.commands.plan.result import PlannedStop
    from cellapp.commands.view.charts import Chart
    from cellapp.ground.profile import Profile


class CellMap(ChartPlot):
    """Bases, tracker and stops from above, or as the tracker sees them."""

    class Made(Message):
        """The chart for the request of this number was made."""

        def __init__(self, number: int, chart: Chart) -> None:
            super().__init__()
            self.number, self.chart = number, chart

    def __init__(self, view: Literal["above", "tracker"], *, id: str) -> None:
        super().__init__(id=id)
        self._view: Literal["above", "tracker"] = view
        self._number = 0

    def show_cell(self, profile: Profile | None, stops: Sequence[PlannedStop] = ()) -> None:
        """Draw the cell of a profile with its planned stops; blank without a profile."""
        self._number += 1
        if profile is None:
            self.chart = None
        else:
            self._make(self._number, profile, stops)

    @work(thread=True)
    def _make(self, number: int, profile: Profile, stops: Sequence[PlannedStop]) -> None:
        from cellapp.commands.plan.charts_map import cell_map_chart

        self.post_message(self.Made(number, cell_map_chart(profile, stops, self._view)))

    @on(Made)
    def take_chart(self, event: Made) -> None:
        """Draw the chart, unless another one was asked for meanwhile."""
        event.stop()
        if event.number == self._number:
            self.chart = event.chart
