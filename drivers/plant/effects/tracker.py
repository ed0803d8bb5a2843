"""What is wrong with the tracker: its idea of the air, its circles and axes, its distance zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.effects.transmission_error import cardan


@dataclass(frozen=True, eq=False)
class TrackerScale(Effect):
    """The distance is counted in wavelengths of the air as the weather station has it, not as it is.

    About 1 ppm per kelvin and 0.27 ppm per hectopascal, of opposite signs (Edlen). No plan at one station shows it.
    """

    ppm: float

    def seen(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        return p_M * (1.0 + 1e-6 * self.ppm)


@dataclass(frozen=True, eq=False)
class TrackerDistanceOffset(Effect):
    """The distance does not begin where the axes meet. Sizes: the makers permit 5 to 10 um."""

    offset_m: float

    def seen(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        return p_M * (1.0 + self.offset_m / np.linalg.norm(p_M, axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class Circle:
    """A graduated circle with one head: ``eccentric`` by a share of its radius (once a turn), slanted (twice)."""

    eccentric: float
    eccentric_phase: float
    slant: float
    slant_phase: float

    def reading(self, angle: Array) -> Array:
        """What is read at a true angle (n,): the centre of the circle sees the head from aside."""
        turned = angle + self.eccentric_phase
        read = angle + np.arctan2(self.eccentric * np.sin(turned), 1.0 - self.eccentric * np.cos(turned))
        return read + cardan(angle + self.slant_phase, np.array(self.slant))


@dataclass(frozen=True, eq=False)
class TrackerAngleError(Effect):
    """Two circles that are off centre and slanted, and a transit axis that is not square to the standing axis.

    With the transit axis slanted by t, the beam at the elevation e of its own circle points to
    ``(cos e, -sin t sin e, cos t sin e)`` in the standing axis' frame at azimuth 0; the angles at which it meets the
    SMR follow from that. Sizes: makers permit 15 um and 6 um/m across the beam; second orders of 65 um at 7 m were
    found in older trackers.
    """

    azimuth: Circle
    elevation: Circle
    transit: float

    def seen(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        x, y, z = p_M.T
        distance = np.linalg.norm(p_M, axis=1)
        steepest = np.cos(self.transit)
        elevation = np.arcsin(np.clip(z / (distance * steepest), -1.0, 1.0))
        azimuth = np.arctan2(y, x) - np.arctan2(-np.sin(self.transit) * np.sin(elevation), np.cos(elevation))
        azimuth, elevation = self.azimuth.reading(azimuth), self.elevation.reading(elevation)
        flat = distance * np.cos(elevation)
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1)


def tracker_scale(parameters: Parameters) -> Effect:
    """``ppm``: how much longer distances are read, in parts per million."""
    parameters.only("ppm")
    return TrackerScale(parameters.number("ppm"))


def tracker_distance_offset(parameters: Parameters) -> Effect:
    """``offset`` [m]: how much longer distances are read."""
    parameters.only("offset")
    return TrackerDistanceOffset(parameters.number("offset"))


def _circle(parameters: Parameters, key: str) -> Circle:
    values = parameters.numbers(key, 4)
    if not (0.0 <= values[0] < 1.0 and 0.0 <= values[2] < 1.0):
        raise parameters.error(key, "must have eccentric and slant, its first and third, from 0 to less than 1")
    return Circle(*(float(v) for v in values))


def tracker_angle_error(parameters: Parameters) -> Effect:
    """``azimuth``, ``elevation``: each (eccentric [m/m], its phase [rad], slant [rad], its phase); ``transit`` [rad].

    A slant of s reads up to ``s^2 / 4`` wrong, twice a turn.
    """
    parameters.only("azimuth", "elevation", "transit")
    circles = _circle(parameters, "azimuth"), _circle(parameters, "elevation")
    transit = parameters.number("transit")
    if not abs(transit) < 0.1:
        raise parameters.error("transit", f"must be a small angle, less than 0.1 rad, not {transit:g}")
    return TrackerAngleError(*circles, transit)
