"""What an arm must do, in the field's words. Any arm that does it can stand in the cell.

Joint vectors are read from the controller, shape (N,), radians. No call blocks for ever.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:  # only to say what is meant: a driver's own processes start without numpy
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True)
class ArmIdentity:
    """Who the arm is: what its controller says of itself.

    Attributes
    ----------
    dh_rows : array, shape (N, 4), or None
        The calibrated D-H rows theta, d, a, alpha that the controller computes with [rad, m, m, rad], where it tells
        them.
    dh_checksum : str
        What tells one factory calibration of the arm from another; empty where the controller has none.
    """

    model: str
    serial: str
    software: str
    dh_rows: NDArray[np.float64] | None = None
    dh_checksum: str = ""


@dataclass(frozen=True)
class JointLimits:
    """What the controller allows its joints.

    Attributes
    ----------
    position : array, shape (N, 2)
        Lowest and highest position [rad].
    speed, acceleration : array, shape (N,)
        [rad/s] and [rad/s^2].
    """

    position: NDArray[np.float64]
    speed: NDArray[np.float64]
    acceleration: NDArray[np.float64]


@dataclass(frozen=True)
class Tool:
    """What the controller believes the arm carries; None where it does not tell.

    Attributes
    ----------
    payload_kg : float or None
    payload_center_m : array, shape (3,), or None
        Centre of mass of the payload in the flange frame [m].
    tcp : array, shape (6,), or None
        Tool centre point in the flange frame: position [m] and rotation vector [rad].
    """

    payload_kg: float | None
    payload_center_m: NDArray[np.float64] | None
    tcp: NDArray[np.float64] | None


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
    robot_mode, safety_mode, program : str
        In the controller's words; empty where it has none.
    rest_since_s : float or None
        When the arm came to rest, on the cell's clock [s]; None if the controller does not report it.
    """

    q: NDArray[np.float64]
    time_s: float
    moving: bool
    ready: bool
    reason: str
    payload_kg: float | None
    joint_temperature_c: NDArray[np.float64] | None
    robot_mode: str = ""
    safety_mode: str = ""
    program: str = ""
    rest_since_s: float | None = None


def stale(before: str, now: str) -> str:
    """Return a sentence about a changed ``dh_checksum``."""
    return (
        f"the checksum of the controller's D-H was {before or 'none'}, now it is {now or 'none'}: a joint or the"
        " factory calibration was changed, and a model from before is stale; collect and calibrate anew"
    )


class ArmError(Exception):
    """Base of all that an arm can refuse or suffer."""


class ProtectiveStop(ArmError):
    """The controller stopped the arm to protect it; a person must look and release it."""


class EmergencyStop(ArmError):
    """Somebody pressed the button."""


class LinkLost(ArmError):
    """The controller no longer answers; the arm must be considered moving until it is seen at rest."""


class NotInRemoteControl(ArmError):
    """The controller takes no commands from outside: its pendant has the arm."""


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
        """Open the link, or open it anew after a fault; harmless when open. Nothing moves.

        Raises ``LinkLost``, or why the arm would refuse to move: ``WrongRobot``, ``NotInRemoteControl``,
        ``ProtectiveStop``, ``EmergencyStop``, ``LimitExceeded``, else ``ArmError``.
        """

    def identify(self) -> ArmIdentity:
        """Who the controller says it is."""

    def limits(self) -> JointLimits:
        """What the controller allows its joints."""

    def tool(self) -> Tool:
        """What the controller believes the arm carries."""

    def warnings(self) -> tuple[str, ...]:
        """What a person should know of this arm though it would move; a sentence each."""

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
