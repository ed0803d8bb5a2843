"""What a laser tracker must do. Points are in its own frame M [m]."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Face = Literal[1, 2]
Accuracy = Literal["fast", "standard", "precise"]

ACCURACIES: tuple[Accuracy, ...] = ("fast", "standard", "precise")


@dataclass(frozen=True)
class TrackerIdentity:
    """Who the tracker is."""

    model: str
    serial: str
    software: str


@dataclass(frozen=True)
class Preparation:
    """How the tracker is set up before it measures; applied again after every connect.

    Attributes
    ----------
    reflector : str
        The reflector type by the name that the tracker's software gives it; empty leaves what is selected there. A
        tracker cannot tell reflectors apart, and the wrong type shifts every distance.
    accuracy : {"fast", "standard", "precise"}
        Profile of stationary measurements, where the tracker has several.
    temperature_c, pressure_hpa, humidity_percent : float or None
        Air to correct the refraction with [degC, hPa, %]; None where the tracker shall use its own weather station.
    """

    reflector: str = ""
    accuracy: Accuracy = "standard"
    temperature_c: float | None = None
    pressure_hpa: float | None = None
    humidity_percent: float | None = None

    def __post_init__(self) -> None:
        if self.accuracy not in ACCURACIES:
            raise ValueError(f"tracker: accuracy must be one of {', '.join(ACCURACIES)}, not {self.accuracy!r}")
        for name, value, low, high, unit in (
            ("temperature", self.temperature_c, -40.0, 85.0, "degC"),
            ("pressure", self.pressure_hpa, 500.0, 1200.0, "hPa"),
            ("humidity", self.humidity_percent, 0.0, 100.0, "%"),
        ):
            if value is not None and not low <= value <= high:
                raise ValueError(f"tracker: air {name} must lie between {low:g} and {high:g} {unit}, not {value!r}")


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
        When it was taken, on the cell's clock [s]: the middle of the averaging.
    averaging_s : float
        How long was averaged [s].
    temperature_c : float or None
        Air temperature that the refraction was corrected with [degC].
    pressure_hpa, humidity_percent : float or None
        Likewise pressure [hPa] and relative humidity [%]; None where the tracker does not tell.
    precision_M : array, shape (3,), or None
        Standard deviation of each coordinate as the tracker reports it [m]; None where it reports none.
    face : {1, 2}
        The face it was measured in.
    tracker_time_s, host_time_s : float or None
        When the result was made, by the tracker's own clock and by that of the computer it is wired to [s], each from
        an origin of its own; None where not told.
    reflector : str
        The reflector type whose offset was applied; empty where not told.
    quality : tuple of str
        What the tracker warns of about this point, in words; empty when it warns of nothing.
    """

    p_M: NDArray[np.float64]
    covariance_M: NDArray[np.float64]
    time_s: float
    averaging_s: float
    temperature_c: float | None
    pressure_hpa: float | None = None
    humidity_percent: float | None = None
    precision_M: NDArray[np.float64] | None = None
    face: Face = 1
    tracker_time_s: float | None = None
    host_time_s: float | None = None
    reflector: str = ""
    quality: tuple[str, ...] = ()


@dataclass(frozen=True)
class TwoFace:
    """The same SMR in both faces. Their difference shows errors of the tracker that averaging does not."""

    first: Point
    second: Point

    @property
    def across_m(self) -> float:
        """Full difference of the two faces perpendicular to the beam [m]; half of it is ISO 10360-10's convention."""
        difference, beam = self._split()
        return float(np.linalg.norm(difference - (difference @ beam) * beam))

    @property
    def along_m(self) -> float:
        """Difference of the distances, second minus first [m]."""
        difference, beam = self._split()
        return float(difference @ beam)

    def _split(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        middle = self.first.p_M + self.second.p_M
        return self.second.p_M - self.first.p_M, middle / np.linalg.norm(middle)


@dataclass(frozen=True)
class Inclination:
    """What the level says.

    Attributes
    ----------
    tilt_rad : tuple of two float
        Rotation against gravity about the tracker's x and y axes [rad].
    drift_rad : float
        How far it has turned since monitoring began [rad].
    threshold_rad : float
        The drift at which the tracker must be considered bumped [rad].
    """

    tilt_rad: tuple[float, float]
    drift_rad: float
    threshold_rad: float

    @property
    def moved(self) -> bool:
        """Whether the drift is beyond the threshold."""
        return self.drift_rad > self.threshold_rad


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


class Halted(TrackerError):
    """Somebody told the tracker to halt; there is no measurement."""


class TrackerTimeout(TrackerError):
    """The tracker answers, but did not finish in time; there is no measurement."""


class TrackerRefused(TrackerError):
    """Whoever guards the tracker lets nobody in: another client holds it, or the token is wrong."""


class TrackerLinkLost(TrackerError):
    """The tracker no longer answers."""


class Tracker(Protocol):
    """One tracker. All calls but ``halt`` come from one thread, one at a time."""

    def connect(self) -> None:
        """Open the link and apply the settings given to the driver. Raises ``TrackerLinkLost``, ``TrackerRefused``."""

    def identify(self) -> TrackerIdentity:
        """Ask the tracker who it is."""

    def prepare(self, settings: Preparation) -> None:
        """Initialise where needed and apply ``settings``: right-handed Cartesian metres, stationary measurements.

        Raises ``NotReady`` with what it lacks, ``ValueError`` for a setting that this tracker does not have.
        """

    def unmet(self) -> list[str]:
        """Every precondition that keeps it from measuring, in words; empty when ready."""

    def measure(self, expected_M: NDArray[np.float64], averaging_s: float) -> Point:
        """Point at ``expected_M`` (3,) [m], lock the SMR there and average it, in face 1.

        Raises ``TargetLost``, ``WrongTarget``, ``Unstable``, ``NotReady``, ``Halted``, ``TrackerTimeout`` or
        ``TrackerLinkLost``.
        """

    def measure_two_face(self, expected_M: NDArray[np.float64], averaging_s: float) -> TwoFace:
        """Measure the SMR at ``expected_M`` (3,) [m] in face 1, then in face 2; it ends in face 1. Raises likewise."""

    def inclination(self) -> Inclination | None:
        """The level, or None where there is none."""

    def halt(self) -> None:
        """End what is under way, which then raises ``Halted``; harmless when nothing is. From any thread."""

    def disconnect(self) -> None:
        """Release the tracker and close the link; harmless when closed."""


def measure_nests(
    tracker: Tracker, nests: Mapping[str, NDArray[np.float64]], averaging_s: float
) -> tuple[dict[str, Point], dict[str, TrackerError]]:
    """Measure the SMRs in fixed nests, name -> (3,) [m] in M: what was read, and why the others were not.

    Done at the start, now and then, and at the end of a run, nests tell whether the tracker has moved.
    A lost link, or a tracker that is not ready, ends it: those are raised.
    """
    points: dict[str, Point] = {}
    missed: dict[str, TrackerError] = {}
    for name, expected_M in nests.items():
        try:
            points[name] = tracker.measure(expected_M, averaging_s)
        except (TargetLost, WrongTarget, Unstable) as error:
            missed[name] = error
    return points, missed
