"""Interface of an arm. Any arm with a driver of this interface can be used in the cell.

Joint vectors are read from the controller, shape (N,), radians. Every call returns in bounded time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from drivers.findings import ArmIdentity

if TYPE_CHECKING:  # for annotations only: a driver's worker process starts without numpy
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True)
class JointLimits:
    """Limits of the joints in the controller.

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
    """Payload and TCP as configured in the controller; None if not reported.

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
    """State of the arm at one moment.

    Attributes
    ----------
    q : array, shape (N,)
        Joint positions from the controller's encoders [rad].
    time_s : float
        Controller time [s].
    moving : bool
        Whether any joint moves or a motion is running.
    ready : bool
        Whether it would accept a motion: no stop, no fault, brakes released.
    reason : str
        Why it is not ready; empty when it is.
    payload_kg : float or None
        Payload configured in the controller.
    joint_temperature_c : array, shape (N,), or None
        Joint temperatures [degC]; None if not reported.
    robot_mode, safety_mode, program : str
        As named by the controller; empty if it has none.
    rest_since_s : float or None
        When the arm came to rest, on the cell's clock [s]; None if not reported.
    speed_fraction : float or None
        Speed slider of the controller, 0 to 1: it scales every motion; None if not reported.
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
    speed_fraction: float | None = None


@dataclass(frozen=True)
class LiveArm:
    """What is known of an arm without a query.

    Attributes
    ----------
    age_s : float
        Age of the newest state from the controller [s]; inf if there is none.
    moving : bool
        Whether a joint moved in that state or a motion has been accepted since; true if neither can be excluded.
    """

    age_s: float
    moving: bool


def stale(before: str, now: str) -> str:
    """Return a sentence about a changed ``dh_checksum``."""
    return (
        f"the checksum of the controller's D-H was {before or 'none'}, now it is {now or 'none'}: a joint or the"
        " factory calibration was changed, and an earlier model is stale; collect and calibrate again"
    )


class ArmError(Exception):
    """Base of all errors of an arm."""


class ProtectiveStop(ArmError):
    """The controller stopped the arm to protect it; a person must inspect and release it."""


class EmergencyStop(ArmError):
    """An emergency stop button is pressed."""


class LinkLost(ArmError):
    """The controller no longer answers; the arm must be considered moving until it is seen at rest."""


class NotInRemoteControl(ArmError):
    """The controller accepts no commands over the network, because its pendant is in local control."""


class LimitExceeded(ArmError):
    """A joint position, speed or acceleration outside the limits, or not a number; nothing has moved."""


class WrongRobot(ArmError):
    """The controller is not the one named in the profile."""


class ArmTimeout(ArmError):
    """The arm did not come to rest in time."""


class MotionStopped(ArmError):
    """The motion was stopped by ``brake`` or ``stop``; the arm is not at its goal."""


class HostStalled(ArmError):
    """The controller stopped its program because this computer was silent for too long; nothing is wrong at the arm."""


FaultListener = Callable[[ArmError], None]
"""Callback for the first fault of an arm. It is called from any thread and must return at once."""


class Arm(Protocol):
    """One arm. Starting a motion and waiting for its end are separate, so that two arms can move at once."""

    @property
    def name(self) -> str:
        """The arm's name in the profile."""

    def connect(self) -> None:
        """Open the link, or reopen it after a fault or ``brake``; harmless when open. Nothing moves.

        ``refuse_motion`` or ``brake`` of another thread ends it within 0.5 s with ``MotionStopped``: from that moment
        on nothing is started on the controller, and what had been started is stopped.

        Raises ``LinkLost``, or the reason why the arm would refuse to move: ``WrongRobot``, ``NotInRemoteControl``,
        ``ProtectiveStop``, ``EmergencyStop``, ``LimitExceeded``, else ``ArmError``.
        """

    def identify(self) -> ArmIdentity:
        """Return the identity reported by the controller."""

    def limits(self) -> JointLimits:
        """Return the limits of the joints."""

    def tool(self) -> Tool:
        """Return payload and TCP as configured in the controller."""

    def warnings(self) -> tuple[str, ...]:
        """Return findings that a person should know and that do not prevent motion; one sentence each."""

    def watch(self, listener: FaultListener) -> None:
        """Report to ``listener`` the first fault after each ``connect``: its own, a lost link, no state for 0.3 s.

        The report comes before any diagnosis, so that the other arms of the cell can brake at once.
        """

    def refused_by_controller(self, q: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return a mask (n,) of the joint positions (n, N) [rad] that the controller's safety configuration forbids.

        All False if the controller cannot be asked. Raises ``LinkLost``.
        """

    def state(self) -> ArmState:
        """Return the current state, never an old one. Raises ``LinkLost``."""

    def live(self) -> LiveArm:
        """Return the newest known state of motion and its age. From any thread; sends no query and never waits."""

    def confirm(self) -> None:
        """Check within 0.3 s that every link over which the arm is moved, observed and stopped answers now.

        Usually takes a few milliseconds: it is called for all arms directly before every motion of any of them. Raises
        ``LinkLost``, or the fault of the arm; the listener of ``watch`` has been told before.
        """

    def start_move(self, q: NDArray[np.float64], speed: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Start a joint motion to ``q`` (N,), at most at ``speed`` (N,) [rad/s] and ``acceleration`` (N,) [rad/s^2].

        Raises ``LimitExceeded`` before anything moves, ``ProtectiveStop`` or ``EmergencyStop`` if the arm is stopped,
        ``MotionStopped`` between ``brake`` and the next ``connect``.
        """

    def wait_settled(self, timeout_s: float) -> ArmState:
        """Wait until the arm rests at the end of its motion.

        Raises ``ArmTimeout``, or at once the error that stopped it: ``MotionStopped`` after ``brake`` or ``stop``.
        """

    def refuse_motion(self) -> None:
        """Accept no motion until the next ``connect``. From any thread, at once: no device is waited for.

        It need not stop a running motion: ``brake`` follows, and includes it. A driver that can send its stop without
        waiting sends it here already.
        """

    def brake(self) -> None:
        """Command a controlled stop at full deceleration, by the fastest means, and return without waiting for rest.

        From any thread, during any other call; harmless at rest. Until the next ``connect`` the arm accepts no motion.
        Raises ``LinkLost`` if the stop could not be commanded; the controller's watchdog then stops the arm.
        """

    def stop(self) -> None:
        """Stop the arm and wait until it rests; harmless when it rests. From any thread.

        Raises ``LinkLost`` if it was not seen at rest.
        """

    def disconnect(self) -> None:
        """Close the link and leave the robot as it was before ``connect``; harmless when closed."""


@runtime_checkable
class PathFollower(Protocol):
    """Additional interface of an arm whose controller follows a stream of joint positions."""

    @property
    def path_period_s(self) -> float:
        """Time between two positions of a stream [s]; known when connected."""

    def start_path(self, q: NDArray[np.float64], period_s: float) -> None:
        """Stream the joint positions ``q`` (m, N) [rad], one every ``period_s``, beginning at the arm's position.

        ``wait_settled`` waits for the end. Everything that ends a motion also ends the stream: ``brake`` and ``stop``
        from any thread, a fault, a lost link, a late computer. Raises as ``Arm.start_move`` does, and ``LimitExceeded``
        if the arm is not at the first position or a step is faster than the limits allow.
        """

    def end_path(self) -> None:
        """Slow down along the path within about a second and come to rest on it; ``wait_settled`` returns then.

        From any thread; harmless when no path is being followed. The arm stays ready to move. Raises ``LinkLost``.
        """

    def reached(self) -> float:
        """Return the row of the last path at which the arm came to rest, with a fraction; inf: at its end."""
