"""The tracker of the simulated cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.plant import Plant
from drivers.trackers.protocol import NotReady, Point, TargetLost, TrackerIdentity, TrackerLinkLost, Unstable

SEARCH_RADIUS_M = 0.1
"""How far from the expected point an SMR is still found."""
POINTING_S = 0.5
"""Turning the head and locking."""


class SimulatedTracker:
    """The tracker of a ``Plant``. It locks the visible SMR nearest to where it is told to look, whosever that is.

    Attributes
    ----------
    obstacles : list of str
        Preconditions that are not met, in words; add some to make it refuse.
    covered : set of str
        Arms whose SMR something hides.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._connected = False
        self._link_cut = False
        self.obstacles: list[str] = []
        self.covered: set[str] = set()

    def connect(self) -> None:
        """Open the link. Raises ``TrackerLinkLost`` while it is cut."""
        if self._link_cut:
            raise TrackerLinkLost("tracker: the simulated link is cut")
        self._connected = True

    def _link(self) -> None:
        if self._link_cut or not self._connected:
            raise TrackerLinkLost(
                f"tracker: the simulated link is {'cut' if self._link_cut else 'not open; connect first'}"
            )

    def identify(self) -> TrackerIdentity:
        """Who it is: a simulated tracker."""
        self._link()
        return TrackerIdentity(model="simulated tracker", serial="SIM-tracker", software="simulated")

    def unmet(self) -> list[str]:
        """Every precondition that keeps it from measuring."""
        self._link()
        return list(self.obstacles)

    def measure(self, expected_M: NDArray[np.float64], averaging_s: float) -> Point:
        """Lock the visible SMR nearest to ``expected_M`` (3,) [m] and average it for ``averaging_s``.

        What it locks may be another arm's: only who asked can tell, from the distance to the expected point.
        Raises ``TargetLost``, ``Unstable``, ``NotReady`` or ``TrackerLinkLost``.
        """
        self._link()
        if self.obstacles:
            raise NotReady(f"tracker: not ready to measure: {'; '.join(self.obstacles)}")
        if not averaging_s > 0.0:
            raise ValueError(f"tracker: averaging must last longer than 0 s, not {averaging_s!r} s")
        self._plant.advance(POINTING_S)
        expected = np.asarray(expected_M, dtype=np.float64)
        around = []
        for target in self._plant.targets():
            distance = float(np.linalg.norm(target.p_M - expected))
            if distance <= SEARCH_RADIUS_M:
                why = "something covers it" if target.arm in self.covered else target.hidden
                around.append((distance, target, why))
        visible = [(distance, target) for distance, target, why in around if not why]
        if not visible:
            place = ", ".join(f"{v:.3f}" for v in expected)
            causes = "".join(f"; that of arm {target.arm} is there, but {why}" for _, target, why in around)
            raise TargetLost(f"tracker: no SMR within {SEARCH_RADIUS_M * 1e3:.0f} mm of ({place}) m{causes}")
        locked = min(visible, key=lambda pair: pair[0])[1]
        if locked.moving:
            raise Unstable(f"tracker: the SMR of arm {locked.arm} moved while it was measured")
        read, covariance = self._plant.measure_positions(locked.p_M[None], averaging_s=averaging_s)
        taken_s = self._plant.clock_s
        self._plant.advance(averaging_s)
        return Point(
            p_M=read[0],
            covariance_M=covariance[0],
            time_s=taken_s + 0.5 * averaging_s,
            averaging_s=averaging_s,
            temperature_c=self._plant.air_temperature_c,
        )

    def disconnect(self) -> None:
        """Close the link; harmless when closed."""
        self._connected = False

    def cut_link(self) -> None:
        """Let no call through until ``release`` and ``connect``."""
        self._link_cut = True
        self._connected = False

    def release(self) -> None:
        """Mend the link."""
        self._link_cut = False
