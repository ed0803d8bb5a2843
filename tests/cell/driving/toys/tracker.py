"""The kind ``toy`` of trackers: it reads every point where it was expected, shifted along x."""

from __future__ import annotations

import time
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.findings import Finding
from drivers.quantities import Length
from drivers.trackers.protocol import Point, Preparation, TrackerIdentity
from drivers.trackers.settings import TrackerContext, TrackerSettings


class ToyTrackerSettings(TrackerSettings):
    """A tracker with a constant error."""

    kind: Literal["toy"] = "toy"
    shift: Length = 0.0

    def open(self, tracker: TrackerContext) -> ToyTracker:
        """Return the driver."""
        return ToyTracker(self.shift, tracker.transverse[0])

    def probe(self, tracker: TrackerContext, patience_s: float) -> list[Finding]:
        """Report the shift."""
        return [Finding("", "ok", f"a toy that is {self.shift * 1e3:g} mm off")]


class ToyTracker:
    """Reads points without looking."""

    def __init__(self, shift_m: float, sigma_m: float) -> None:
        self._shift_m, self._sigma_m = shift_m, sigma_m

    def connect(self) -> None: ...

    def disconnect(self) -> None: ...

    def halt(self) -> None: ...

    def prepare(self, settings: Preparation) -> None: ...

    def identify(self) -> TrackerIdentity:
        return TrackerIdentity("toy", "1", "none")

    def unmet(self) -> list[str]:
        return []

    def confirm(self, within_s: float) -> None: ...

    def data_age_s(self) -> float:
        return 0.0

    def measure(self, expected_M: NDArray[np.float64], averaging_s: float) -> Point:
        p_M = expected_M + np.array([self._shift_m, 0.0, 0.0])
        covariance_M = self._sigma_m**2 * np.eye(3)
        return Point(p_M, covariance_M, time.monotonic(), averaging_s, temperature_c=None)
