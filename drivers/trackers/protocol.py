"""Interface of a laser tracker. Points are in its own frame M [m]."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Accuracy = Literal["fast", "standard", "precise"]

ACCURACIES: tuple[Accuracy, ...] = ("fast", "standard", "precise")


@dataclass(frozen=True)
class TrackerIdentity:
    """Identity of the tracker."""

    model: str
    serial: str
    software: str


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
    reflector: str = ""
    quality: tuple[str, ...] = ()
    quaternion_M: NDArray[np.float64] | None = None
    sigma_rad: float | None = None

    @property
    def orientation(self) -> tuple[NDArray[np.float64], float] | None:
        """Quaternion and its standard uncertainty (0 if not reported); None if no orientation was measured."""
        return None if self.quaternion_M is None else (self.quaternion_M, self.sigma_rad or 0.0)


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
    """One tracker. Calls come one at a time; ``halt`` and ``data_age_s`` may be called at any time from any thread."""

    def connect(self) -> None:
        """Open the link and apply the settings given to the driver. Raises ``TrackerLinkLost``, ``TrackerRefused``."""

    def identify(self) -> TrackerIdentity:
        """Return model, serial number and software of the tracker."""

    def prepare(self, settings: Preparation) -> None:
        """Initialise if needed and apply ``settings``: right-handed Cartesian metres, stationary measurements.

        Raises ``NotReady`` with all unmet preconditions, ``ValueError`` for a setting that this tracker does not have.
        """

    def unmet(self) -> list[str]:
        """Return every unmet precondition of measuring, as sentences; empty if ready."""

    def confirm(self, within_s: float) -> None:
        """Check that the tracker itself answers now; unmet preconditions of measuring do not matter.

        A dropped connection is reopened once, at once. Never takes longer than ``within_s`` [s].

        Raises
        ------
        TrackerLinkLost
            At once if the connection is closed and cannot be reopened; or if no answer arrives within ``within_s``.
        TrackerTimeout
            If the tracker is still executing an earlier command that was halted or abandoned.
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

    def halt(self) -> None:
        """End the running measurement, which then raises ``Halted``; harmless if none runs. From any thread."""

    def disconnect(self) -> None:
        """Release the tracker and close the link; harmless when closed."""


PACKETS_HZ = 50.0
"""Largest rate of packets. A packet has several points, so only their own timestamps tell when they were measured."""


@dataclass(frozen=True)
class StreamLimits:
    """Limits of a tracker's stream: shortest and longest time between two points of a moving SMR [s]."""

    shortest_s: float
    longest_s: float

    def check(self, interval_s: float) -> None:
        """Raise ``ValueError`` for a point interval outside the limits."""
        if not self.shortest_s * (1.0 - 1e-9) <= interval_s <= self.longest_s * (1.0 + 1e-9):
            raise ValueError(
                f"tracker: a point each {interval_s:g} s was asked for; it measures one each {self.shortest_s:g} to"
                f" {self.longest_s:g} s"
            )


@dataclass(frozen=True, eq=False)
class Track:
    """Points of a moving SMR, measured continuously: all of them, or those of one packet.

    Attributes
    ----------
    device_time_s : array, shape (n,)
        Timestamps on the tracker's own clock [s].
    p_M : array, shape (n, 3)
        SMR centres [m].
    sigma_m : array, shape (n,)
        Standard uncertainty of one coordinate of each point [m]; NaN if not known.
    arrived_s : array, shape (n,)
        When the packet of each point arrived, on the cell's clock [s]: late by up to about 40 ms.
    """

    device_time_s: NDArray[np.float64]
    p_M: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    arrived_s: NDArray[np.float64]

    @classmethod
    def of(cls, packets: Sequence[Track]) -> Self:
        """Join all points of ``packets``, which are in order."""
        return cls(
            np.concatenate([np.empty(0), *(packet.device_time_s for packet in packets)]),
            np.concatenate([np.empty((0, 3)), *(packet.p_M for packet in packets)]),
            np.concatenate([np.empty(0), *(packet.sigma_m for packet in packets)]),
            np.concatenate([np.empty(0), *(packet.arrived_s for packet in packets)]),
        )

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Times on the cell's clock (n,) [s]: the timestamps, shifted by the shortest delay of a packet.

        Two errors remain: the shortest delay itself, and 0.1 ms a minute for each 2 ppm of rate difference of the
        clocks.
        """
        if not len(self.device_time_s):
            return self.device_time_s
        return np.asarray(self.device_time_s + (self.arrived_s - self.device_time_s).min())

    def within(self, rows: NDArray[np.bool_]) -> Track:
        """Return the points of the mask ``rows`` (n,)."""
        return Track(self.device_time_s[rows], self.p_M[rows], self.sigma_m[rows], self.arrived_s[rows])

    def missing(self, interval_s: float) -> int:
        """Return the number of lost points, given one every ``interval_s``: the tracker could not send them."""
        steps = np.rint(np.diff(self.device_time_s) / interval_s)
        return int(np.maximum(steps - 1.0, 0.0).sum())


def no_packet(packet: Track) -> None:
    """Ignore a packet; the default for callers that use the whole track only."""


@runtime_checkable
class StreamingTracker(Protocol):
    """Additional interface of a tracker whose driver measures an SMR while it moves; see ``stream_of``."""

    def stream_limits(self) -> StreamLimits | None:
        """Return the limits of the stream; None if there is none. Raises ``TrackerLinkLost`` unless connected."""

    def start_track(
        self,
        expected_M: NDArray[np.float64],
        interval_s: float,
        lost: Callable[[TrackerError], None],
        received: Callable[[Track], None] = no_packet,
    ) -> None:
        """Lock the SMR at ``expected_M`` (3,) [m], at rest, and measure it every ``interval_s`` [s] from now on.

        ``received`` is called with each packet, and ``lost`` when the beam breaks or the tracker dies. Both are called
        from any thread and must return soon. After a broken beam the track gets no further points. During a track call
        ``confirm`` several times a second: it fetches the points. Another measurement ends the track. Raises like
        ``Tracker.measure``, and ``ValueError`` beyond ``stream_limits``.
        """

    def end_track(self) -> Track:
        """End the track and return all points, also those before the beam broke. Raises ``TrackerLinkLost``."""


def stream_limits_of(tracker: Tracker) -> StreamLimits | None:
    """Return the limits of a tracker's stream; None if it, or its driver, cannot stream. Raises ``TrackerLinkLost``."""
    return tracker.stream_limits() if isinstance(tracker, StreamingTracker) else None


def stream_of(tracker: Tracker) -> StreamingTracker | None:
    """Return the tracker if it can measure an SMR while it moves, else None. Raises ``TrackerLinkLost``."""
    return tracker if isinstance(tracker, StreamingTracker) and tracker.stream_limits() is not None else None


def checked_point(
    expected_M: NDArray[np.float64], averaging_s: float, longest_s: float = math.inf
) -> NDArray[np.float64]:
    """Check and return the point (3,) [m] of a measurement of ``averaging_s``. Raises ``ValueError`` if invalid."""
    if not 0.0 < averaging_s < math.inf or averaging_s > longest_s:
        raise ValueError(f"tracker: averaging must last longer than 0 s, not {averaging_s!r} s")
    expected = np.asarray(expected_M, dtype=np.float64)
    if expected.shape != (3,) or not np.isfinite(expected).all():
        raise ValueError("tracker: the expected point must be three finite coordinates in metres")
    return expected


def require_ready(unmet: Sequence[str]) -> None:
    """Raise ``NotReady`` with all unmet preconditions, if any."""
    if unmet:
        raise NotReady(f"tracker: not ready to measure: {'; '.join(unmet)}")
