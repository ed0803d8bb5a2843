"""The kind ``lmf``: a Leica AT960 (or its kin) through Leica's LMF, on the Windows PC that it is wired to."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.findings import Finding
from drivers.trackers.lmf_options import LmfOptions
from drivers.trackers.settings import TrackerContext, probed

if TYPE_CHECKING:
    from drivers.trackers.protocol import Preparation, Tracker


class LmfSettings(LmfOptions):
    """The options of LMF and its tracker, and how it is opened and probed."""

    def preparation(self) -> Preparation:
        """Return the set-up of the tracker; connecting applies it, but leaves the head uninitialised."""
        from drivers.trackers.protocol import Preparation

        if self.air is None:
            return Preparation(self.reflector, self.accuracy)
        air = self.air
        return Preparation(self.reflector, self.accuracy, air.temperature, air.pressure_hpa, air.humidity_percent)

    def open(self, tracker: TrackerContext) -> Tracker:
        """Create the driver, not connected yet."""
        from drivers.trackers.lmf import LmfTracker
        from drivers.trackers.lmf_objects import ErrorLaw

        law = ErrorLaw(tracker.transverse, tracker.range)
        return LmfTracker(self, self.preparation(), law=law)

    def probe(self, tracker: TrackerContext, patience_s: float) -> list[Finding]:
        """Connect and query the tracker. This applies settings; LMF's own time limits apply, up to a minute."""
        from drivers.trackers import lmf
        from drivers.trackers.protocol import TrackerError, TrackerLinkLost

        device = lmf.LmfTracker(self, self.preparation())
        try:
            return probed(device, notices=device.notices)
        except TrackerLinkLost as error:
            return [Finding("", "failed", f"{error}; {device.visible_trackers()}")]
        except (TrackerError, ValueError) as error:
            return [Finding("", "failed", str(error))]
