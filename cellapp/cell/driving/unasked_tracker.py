"""Tracker for cells whose arms are driven without one."""

from __future__ import annotations

import math
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from drivers.trackers.protocol import NotReady, Preparation


class UnaskedTracker:
    """Placeholder in a cell whose tracker is not connected: it measures nothing and stops nothing."""

    def connect(self) -> None:
        """Do nothing."""

    def identify(self) -> NoReturn:
        """Raise ``NotReady``."""
        self._refuse()

    def prepare(self, settings: Preparation) -> None:
        """Do nothing."""

    def unmet(self) -> list[str]:
        """Return that the tracker is not used."""
        return ["the tracker is not asked"]

    def confirm(self, within_s: float) -> None:
        """Do nothing: no job depends on this tracker."""

    def data_age_s(self) -> float:
        """Return infinity: there are no data."""
        return math.inf

    def measure(self, expected_M: NDArray[np.float64], averaging_s: float) -> NoReturn:
        """Raise ``NotReady``."""
        self._refuse()

    def measure_two_face(self, expected_M: NDArray[np.float64], averaging_s: float) -> NoReturn:
        """Raise ``NotReady``."""
        self._refuse()

    def inclination(self) -> None:
        """Return None: the inclination is unknown."""

    def halt(self) -> None:
        """Do nothing."""

    def disconnect(self) -> None:
        """Do nothing."""

    def _refuse(self) -> NoReturn:
        raise NotReady("the tracker is not asked in a rehearsal")
