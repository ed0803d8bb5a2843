"""The kind ``simulated``: the tracker of the simulated cell."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

from drivers.findings import Finding
from drivers.settings import simulated_cell
from drivers.trackers.settings import TrackerContext, TrackerSettings

if TYPE_CHECKING:
    from drivers.trackers.protocol import Preparation, Tracker


class SimulatedTrackerSettings(TrackerSettings):
    """The tracker of the simulated cell."""

    kind: Literal["simulated"] = "simulated"
    needs_plant: ClassVar[bool] = True

    def preparation(self) -> Preparation:
        """Return default settings: after a restart, preparing initialises the tracker."""
        from drivers.trackers.protocol import Preparation

        return Preparation()

    def open(self, tracker: TrackerContext) -> Tracker:
        """Return the tracker of the plant."""
        from drivers.trackers.simulated import SimulatedTracker

        return SimulatedTracker(simulated_cell(tracker.plant))

    def probe(self, tracker: TrackerContext, patience_s: float) -> list[Finding]:
        """Report that there is nothing to check."""
        return [Finding("", "ok", "simulated; no hardware is touched")]
