"""Conversion of LMF's stationary measurement, and its accuracy, which LMF does not report."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.trackers.lmf_objects import Lmf, precision_m, to_si, unwrap
from drivers.trackers.protocol import Face, TrackerError

_AIR_RANGES = {"Temperature": (-40.0, 85.0), "Pressure": (500.0, 1200.0), "Humidity": (0.0, 100.0)}
"""Ranges of plausible air [degC, hPa, %], in the units that ``lmf_setup`` selects."""
_QUATERNION = ("Value0", "Value1", "Value2", "Value3")
"""A probe's rotation, scalar first."""
_UNIT_LENGTH = 1e-3
"""Tolerance of a quaternion's length."""
_TICKS_1970 = 621_355_968_000_000_000
""".NET's timestamp of the start of 1970, in ticks of 100 ns since the year 1."""


@dataclass(frozen=True)
class ErrorLaw:
    """Maximum permissible errors ``constant + proportional * distance`` [m, m/m], across the beam and along it.

    Half of a maximum permissible error is taken as one standard deviation: the maker calls half of it typical.
    ``rotation`` is the maximum permissible error of a probe about each axis [rad]; Leica states 0.01 degrees for a
    T-Mac.
    """

    transverse: tuple[float, float] = (15e-6, 6e-6)
    range: tuple[float, float] = (10e-6, 0.3e-6)
    rotation: float = math.radians(0.01)

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of a measured rotation about each axis [rad]."""
        return 0.5 * self.rotation

    def covariance(self, p_M: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance (3, 3) [m^2] of a point (3,) [m] in the axes of M."""
        distance = float(np.linalg.norm(p_M))
        across = 0.5 * (self.transverse[0] + self.transverse[1] * distance)
        along = 0.5 * (self.range[0] + self.range[1] * distance)
        beam = np.outer(p_M, p_M) / distance**2
        return across**2 * (np.eye(3) - beam) + along**2 * beam


def read_position(lmf: Lmf, position: Any, face: Face) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the point (3,) and the precision of each coordinate (3,) [m]. Raises ``TrackerError`` if invalid."""
    kind = unwrap(position.CoordinateType)
    if str(kind) != "Cartesian" and int(kind) != int(lmf.enumeration("ECoordinateType").Cartesian):
        raise TrackerError(f"tracker: the point comes in {kind} coordinates; another program changed that")
    coordinates = (position.Coordinate1, position.Coordinate2, position.Coordinate3)
    p_M = np.array([to_si(coordinate, "length") for coordinate in coordinates])
    precision_M = np.array([precision_m(coordinate) for coordinate in coordinates])
    if not (np.isfinite(p_M).all() and np.isfinite(precision_M).all() and np.linalg.norm(p_M) > 0.0):
        raise TrackerError("tracker: it reports a point that is not valid")
    if bool(unwrap(position.IsFace2)) != (face == 2):
        raise TrackerError(f"tracker: it measured in another face than {face}")
    return p_M, precision_M


def read_rotation(lmf: Lmf, result: Any) -> NDArray[np.float64] | None:
    """Return the orientation of a probe in M, a unit quaternion (4,), scalar first; None for a reflector.

    Raises ``TrackerError`` if it is not a unit quaternion.
    """
    rotation = getattr(result, "Rotation", None)
    if rotation is None:
        return None
    kind = unwrap(rotation.RotationType)
    if str(kind) != "Quaternion" and int(kind) != int(lmf.enumeration("ERotationType").Quaternion):
        raise TrackerError(f"tracker: the probe's rotation comes as {kind}; another program changed that")
    if missing := [name for name in _QUATERNION if not hasattr(rotation, name)]:
        has = ", ".join(name for name in dir(rotation) if name[:1].isupper())
        raise TrackerError(f"tracker: the probe's rotation has no {', '.join(missing)} in this LMF, only {has}")
    quaternion = np.array([float(unwrap(getattr(rotation, name))) for name in _QUATERNION])
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) < _UNIT_LENGTH:  # true also for NaN
        raise TrackerError(f"tracker: the probe's rotation is a quaternion of length {length:.4g}, not one")
    return quaternion / length


def read_air(result: Any) -> tuple[dict[str, float | None], list[str]]:
    """Return the air of the refraction correction, and warnings about implausible values and LMF's flags."""
    air: dict[str, float | None] = {}
    warnings = []
    for name, (low, high) in _AIR_RANGES.items():
        value = float(unwrap(getattr(result, name)))
        air[name] = value if low <= value <= high else None
        if air[name] is None:
            warnings.append(f"{name.lower()} applied to the point reads {value:g}, which is not plausible")
    flags = str(unwrap(result.Info.FlagsWithWarnings))
    if flags != "AllOk":
        warnings.append(flags)
    return air, warnings


def tracker_time_s(result: Any) -> float | None:
    """Return the timestamp of a result on the tracker's clock, since 1970 [s]; None if it has none."""
    ticks = int(result.TimeStamp.Ticks)
    return (ticks - _TICKS_1970) * 1e-7 if ticks else None
