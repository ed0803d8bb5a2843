"""What a laser tracker must do. Points are in its own frame M [m]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TrackerIdentity:
    """Who the tracker is."""

    model: str
    serial: str
    software: str


@dataclass(frozen=True)
class Point:
    """One stationary measurement.

    Attributes
    ----------
    p_M : array, shape (3,)
        Centre of the SMR in the tracker frame [m].
    covariance_M : array, shape (3, 3)
        Its covariance [m^2].
    time_s : float
        When it was taken, on the cell's clock [s].
    averaging_s : float
        How long was averaged [s].
    temperature_c : float or None
        Air temperature that the refraction was corrected with [degC].
    """

    p_M: NDArray[np.float64]
    covariance_M: NDArray[np.float64]
    time_s: float
    averaging_s: float
    temperature_c: float | None


class TrackerError(Exception):
    """Base of all that a tracker can refuse or suffer."""


class NotReady(TrackerError):
    """A precondition is not met; the message names every one of them."""


class TargetLost(TrackerError):
    """No SMR where one was expected: turned away, hidden, out of the field or not there."""


class WrongTarget(TrackerError):
    """An SMR was locked, but too far from the prediction: perhaps the other arm's."""


class Unstable(TrackerError):
    """The target moved while it was measured."""


class TrackerLinkLost(TrackerError):
    """The tracker no longer answers."""


class Tracker(Protocol):
    """One tracker."""

    def connect(self) -> None:
        """Open the link. Raises ``TrackerLinkLost``."""

    def identify(self) -> TrackerIdentity:
        """Ask the tracker who it is."""

    def unmet(self) -> list[str]:
        """Every precondition that keeps it from measuring, in words; empty when ready."""

    def measure(self, expected_M: NDArray[np.float64], averaging_s: float) -> Point:
        """Point at ``expected_M`` (3,) [m], lock the SMR there and average it.

        Raises ``TargetLost``, ``WrongTarget``, ``Unstable``, ``NotReady`` or ``TrackerLinkLost``.
        """

    def disconnect(self) -> None:
        """Close the link; harmless when closed."""
