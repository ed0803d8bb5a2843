"""What an arm must do, in the field's words. Any arm that does it can stand in the cell.

Joint vectors are read from the controller, shape (N,), radians. No call blocks for ever.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ArmIdentity:
    """Who the arm is: what its controller says of itself."""

    model: str
    serial: str
    software: str


@dataclass(frozen=True)
class ArmState:
    """The arm at one moment.

    Attributes
    ----------
    q : array, shape (N,)
        Joint positions from the controller's encoders [rad].
    time_s : float
        Controller time [s].
    moving : bool
        Whether any joint moves or a motion is under way.
    ready : bool
        Whether it would accept a motion: no stop, no fault, brakes released.
    reason : str
        Why it is not ready; empty when it is.
    payload_kg : float or None
        Payload the controller believes in.
    joint_temperature_c : array, shape (N,), or None
        Joint temperatures where the controller gives them [degC].
    """

    q: NDArray[np.float64]
    time_s: float
    moving: bool
    ready: bool
    reason: str
    payload_kg: float | None
    joint_temperature_c: NDArray[np.float64] | None


class ArmError(Exception):
    """Base of all that an arm can refuse or suffer."""


class ProtectiveStop(ArmError):
    """The controller stopped the arm to protect it; a person must look and release it."""


class EmergencyStop(ArmError):
    """Somebody pressed the button."""


class LinkLost(ArmError):
    """The controller no longer answers; the arm must be considered moving until it is seen at rest."""


class LimitExceeded(ArmError):
    """A joint position, speed or acceleration outside the limits, or not a number; nothing has moved."""


class WrongRobot(ArmError):
    """The controller is not the one that the profile names."""


class ArmTimeout(ArmError):
    """The arm did not come to rest in time."""


class Arm(Protocol):
    """One arm. A motion is started, then awaited, so that two arms can move at once."""

    @property
    def name(self) -> str:
        """The arm's name in the profile."""

    def connect(self) -> None:
        """Open the link. Raises ``LinkLost``."""

    def identify(self) -> ArmIdentity:
        """Ask the controller who it is."""

    def state(self) -> ArmState:
        """The state now; never an old one: raises ``LinkLost`` instead."""

    def start_move(self, q: NDArray[np.float64], speed: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Start a joint motion to ``q`` (N,), at most at ``speed`` (N,) [rad/s] and ``acceleration`` (N,) [rad/s^2].

        Raises ``LimitExceeded`` before anything moves, ``ProtectiveStop`` or ``EmergencyStop`` if the arm is stopped.
        """

    def wait_settled(self, timeout_s: float) -> ArmState:
        """Wait until the arm rests at the end of its motion. Raises ``ArmTimeout`` or what stopped it."""

    def stop(self) -> None:
        """Bring the arm to rest now; harmless when it rests."""

    def disconnect(self) -> None:
        """Close the link and leave the robot as it was found; harmless when closed."""
