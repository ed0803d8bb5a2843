"""Interface of a laser tracker. Points are in its own frame M [m]."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from drivers.findings import DeviceReport

Face = Literal[1, 2]
Accuracy = Literal["fast", "standard", "precise"]

ACCURACIES: tuple[Accuracy, ...] = ("fast", "standard", "precise")


@dataclass(frozen=True)
class TrackerIdentity:
    """Identity of the tracker."""

    model: str
    serial: str
    software: str

    def report(self) -> DeviceReport:
        """The identity as what a probe found."""
        return DeviceReport(model=self.model, serial=self.serial, software=self.software)


@dataclass(frozen=True)
class Preparation:
    """Setup of the tracker before measuring; applied again after every connect.

    Attributes
    ----------
    reflector : str
        Reflector type as named by the tracker's software; empty keeps the current selection. A tracker cannot detect
        the type, and a wrong type shifts every distance.
    accuracy : {"fast", "standard", "precise"}
        Profile of stationary measurements, if the tracker has several.
    temperature_c, pressure_hpa, humidity_percent : float or None
        Air data for the refraction correction [degC, hPa, %]; None: from the tracker's own weather station.
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
        Time of the measurement on the cell's clock [s]: the middle of the averaging.
    averaging_s : float
        Averaging time [s].
    temperature_c : float or None
        Air temperature of the refraction correction [degC].
    pressure_hpa, humidity_percent : float or None
        Pressure [hPa] and relative humidity [%] of the correction; None: not reported.
    precision_M : array, shape (3,), or None
        Standard deviation of each coordinate as reported by the tracker [m]; None: not reported.
    face : {1, 2}
        Face of the measurement.
    tracker_time_s, host_time_s : float or None
        Time of the result on the tracker's clock and on the clock of its computer [s], each with its own origin; None:
        not reported.
    reflector : str
        Reflector type whose offset was applied; empty: not reported.
    quality : tuple of str
        Warnings of the tracker about this point.
    quaternion_M : array, shape (4,), or None
        Orientation of a 6-D probe in the tracker frame, unit quaternion, scalar first; None: not measured.
    sigma_rad : float or None
        Its standard uncertainty about each axis [rad].
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
    quaternion_M: NDArray[np.float64] | None = None
    sigma_rad: float | None = None


@dataclass(frozen=True)
class TwoFace:
    """The same SMR in both faces. Their difference shows systematic errors that averaging does not reduce."""

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
    """Reading of the level.

    Attributes
    ----------
    tilt_rad : tuple of two float
        Tilt relative to gravity about the tracker's x and y axes [rad].
    drift_rad : float
        Change of the tilt since monitoring began [rad].
    threshold_rad : float
        Drift above which the tracker counts as moved [rad].
    """

    tilt_rad: tuple[float, float]
    drift_rad: float
    threshold_rad: float

    @property
    def moved(self) -> bool:
        """Whether the drift is beyond the threshold."""
        return self.drift_rad > self.threshold_rad


class TrackerError(Exception):
    """Base of all errors of a tracker."""


class NotReady(TrackerError):
    """Preconditions are not met; the message names all of them."""


class TargetLost(TrackerError):
    """No SMR at the expected point: turned away, hidden, out of the field of view or missing."""


class WrongTarget(TrackerError):
    """The locked SMR is too far from the prediction; it may be the other arm's."""


class Unstable(TrackerError):
    """The target moved while it was measured."""


class Halted(TrackerError):
    """The measurement was halted and has no result."""


class TrackerTimeout(TrackerError):
    """The tracker answers, but did not finish in time; no result is available."""


class TrackerRefused(TrackerError):
    """Access to the tracker is refused: another client holds it, or the token is wrong."""


class TrackerLinkLost(TrackerError):
    """The tracker no longer answers."""


class Tracker(Protocol):
    """One tracker. Calls come one at a time, but ``halt`` and ``data_age_s`` at any time and from any thread."""

    def connect(self) -> None:
        """Open the link and apply the settings given to the driver. Raises ``TrackerLinkLost``, ``TrackerRefused``."""

    def identify(self) -> TrackerIdentity:
        """Return model, serial number and software of the tracker."""

    def prepare(self, settings: Preparation) -> None:
        """Initialise where needed and apply ``settings``: right-handed Cartesian metres, stationary measurements.

        Raises ``NotReady`` with all unmet preconditions, ``ValueError`` for a setting that this tracker does not have.
        """

    def unmet(self) -> list[str]:
        """Return every unmet precondition of measuring, as sentences; empty if ready."""

    def confirm(self, within_s: float) -> None:
        """Make sure that the tracker itself answers now; what it lacks for measuring does not matter.

        A connection that was dropped is made again once, at once. Never lasts longer than ``within_s`` [s].

        Raises
        ------
        TrackerLinkLost
            At once if the connection is closed and cannot be made again; or if nothing comes within ``within_s``.
        TrackerTimeout
            If the tracker is still at work on an earlier command that was halted or abandoned.
        """

    def data_age_s(self) -> float:
        """Return the age of the newest data or sign of life from the tracker itself [s]; inf before the first.

        Never blocks.
        """

    def measure(self, expected_M: NDArray[np.float64], averaging_s: float) -> Point:
        """Point at ``expected_M`` (3,) [m], lock the SMR there and average it, in face 1.

        Raises ``TargetLost``, ``WrongTarget``, ``Unstable``, ``NotReady``, ``Halted``, ``TrackerTimeout`` or
        ``TrackerLinkLost``.
        """

    def measure_two_face(self, expected_M: NDArray[np.float64], averaging_s: float) -> TwoFace:
        """Measure the SMR at ``expected_M`` (3,) [m] in face 1, then face 2; end in face 1. Raises like ``measure``."""

    def inclination(self) -> Inclination | None:
        """Return the level's reading, or None if the tracker has no level."""

    def halt(self) -> None:
        """End the running measurement, which then raises ``Halted``; harmless if none runs. From any thread."""

    def disconnect(self) -> None:
        """Release the tracker and close the link; harmless when closed."""


@dataclass(frozen=True, eq=False)
class Track:
    """Points of a moving SMR, measured continuously.

    Attributes
    ----------
    time_s : array, shape (n,)
        Times on the cell's clock [s].
    p_M : array, shape (n, 3)
        SMR centres [m].
    """

    time_s: NDArray[np.float64]
    p_M: NDArray[np.float64]


@runtime_checkable
class StreamingTracker(Protocol):
    """What a tracker can do besides, if it measures an SMR while it moves."""

    def start_track(
        self, expected_M: NDArray[np.float64], interval_s: float, lost: Callable[[TrackerError], None]
    ) -> None:
        """Lock the SMR at ``expected_M`` (3,) [m], at rest, and measure it each ``interval_s`` [s] from now on.

        ``lost`` is called, from any thread, when the beam breaks; the track then has no further points. Raises like
        ``Tracker.measure``.
        """

    def end_track(self) -> Track:
        """End measuring and return all points. Raises ``TrackerLinkLost``."""


def checked_point(
    expected_M: NDArray[np.float64], averaging_s: float, longest_s: float = math.inf
) -> NDArray[np.float64]:
    """The point (3,) [m] at which to measure for ``averaging_s``. Raises ``ValueError`` for what cannot be measured."""
    if not 0.0 < averaging_s < math.inf or averaging_s > longest_s:
        raise ValueError(f"tracker: averaging must last longer than 0 s, not {averaging_s!r} s")
    expected = np.asarray(expected_M, dtype=np.float64)
    if expected.shape != (3,) or not np.isfinite(expected).all():
        raise ValueError("tracker: the expected point must be three finite coordinates in metres")
    return expected


def require_ready(unmet: Sequence[str]) -> None:
    """Raise ``NotReady`` with all preconditions that are not met, if any."""
    if unmet:
        raise NotReady(f"tracker: not ready to measure: {'; '.join(unmet)}")
