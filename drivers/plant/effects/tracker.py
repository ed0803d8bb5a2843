"""Systematic errors of the tracker: scale, distance offset, circles and axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import NUMBER, POSITIVE, Apparent, Parameters, PlantEffect, Read, Situation, by, by_law, made
from drivers.plant.effects.transmission_error import cardan

_REFERENCE_C = 20.0
"""Air temperature for which a temperature-dependent scale is stated [degC]."""


def _scaled(p_M: Array, normal_M: Array, situation: Situation, ppm: float, per_kelvin: float = 0.0) -> Array:
    """Scale error of the distance from wrong air data: wavelengths are counted for the air of the weather station.

    About 1 ppm per kelvin and 0.27 ppm per hectopascal, of opposite signs (Edlen). It changes by ``per_kelvin`` [ppm/K]
    with the air temperature, as when the weather station is not near the beam.
    """
    at_temperature = ppm + per_kelvin * (situation.air_c - _REFERENCE_C)
    return np.asarray(p_M * (1.0 + 1e-6 * at_temperature[:, None]))


def _farther(p_M: Array, normal_M: Array, situation: Situation, offset_m: float, length: float = 0.0) -> Array:
    """Zero error of the distance from the intersection of the axes. Sizes: makers permit 5 to 10 um.

    With a ``length`` it is ``offset_m (1 - exp(-distance / length))``, as of a receiver that depends on the signal.
    """
    distance = np.linalg.norm(p_M, axis=1, keepdims=True)
    grown = -np.expm1(-distance / length) if length else 1.0
    return np.asarray(p_M * (1.0 + offset_m * grown / distance))


@dataclass(frozen=True, eq=False)
class Circle:
    """A graduated circle with one head: ``eccentric`` by a fraction of its radius (1 cycle), inclined (2 cycles)."""

    eccentric: float
    eccentric_phase: float
    slant: float
    slant_phase: float
    higher: tuple[tuple[float, float, float], ...] = ()
    """Cycles per revolution, amplitude [rad] and phase [rad] of further harmonics, as of a circle that is clamped."""

    def reading(self, angle: Array) -> Array:
        """Return the reading at a true angle (n,)."""
        for cycles, amplitude, phase in self.higher:
            angle = angle + amplitude * np.sin(cycles * angle + phase)
        rotated = angle + self.eccentric_phase
        read = angle + np.arctan2(self.eccentric * np.sin(rotated), 1.0 - self.eccentric * np.cos(rotated))
        return read + cardan(angle + self.slant_phase, np.array(self.slant))


@dataclass(frozen=True, eq=False)
class TrueAngleError(PlantEffect):
    """Eccentric and inclined circles, and a transit axis that is not perpendicular to the standing axis.

    With the transit axis inclined by t, the beam at elevation e of its circle points to
    ``(cos e, -sin t sin e, cos t sin e)`` in the standing axis' frame at azimuth 0; the circle angles of an SMR follow
    from that. Sizes: makers permit 15 um and 6 um/m across the beam; second orders of 65 um at 7 m were found in older
    trackers.
    """

    azimuth: Circle
    elevation: Circle
    transit: float

    def apparent_position(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        x, y, z = p_M.T
        distance = np.linalg.norm(p_M, axis=1)
        steepest = np.cos(self.transit)
        elevation = np.arcsin(np.clip(z / (distance * steepest), -1.0, 1.0))
        azimuth = np.arctan2(y, x) - np.arctan2(-np.sin(self.transit) * np.sin(elevation), np.cos(elevation))
        azimuth, elevation = self.azimuth.reading(azimuth), self.elevation.reading(elevation)
        flat = distance * np.cos(elevation)
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1)


tracker_scale = by_law(
    constant=made(by(Apparent, _scaled), ppm=NUMBER), air=made(by(Apparent, _scaled), ppm=NUMBER, per_kelvin=NUMBER)
)
"""``ppm``: relative excess of measured distances, in parts per million.

With ``law`` air also ``per_kelvin`` [ppm/K], by which it changes with the air that the weather station misses.
"""


def _offset(offset: float, length: float = 0.0) -> PlantEffect:
    return Apparent(_farther, {"offset_m": offset, "length": length})


tracker_distance_offset = by_law(
    constant=made(_offset, offset=NUMBER), growing=made(_offset, offset=NUMBER, length=POSITIVE)
)
"""``offset`` [m]: excess of measured distances.

With ``law`` growing also the ``length`` [m] within which it grows from zero to ``offset``.
"""


def _circle(parameters: Parameters, key: str) -> Circle:
    values = parameters.numbers(key, 4)
    if not (0.0 <= values[0] < 1.0 and 0.0 <= values[2] < 1.0):
        raise parameters.error(key, "must have eccentric and slant, its first and third, from 0 to less than 1")
    return Circle(*values.tolist())


def _transit(parameters: Parameters, key: str) -> float:
    transit = parameters.number(key)
    if not abs(transit) < 0.1:
        raise parameters.error(key, f"must be a small angle, less than 0.1 rad, not {transit:g}")
    return transit


def _harmonics(parameters: Parameters, key: str) -> tuple[tuple[float, float, float], ...]:
    third, third_phase, fourth, fourth_phase = parameters.numbers(key, 4).tolist()
    return (3.0, third, third_phase), (4.0, fourth, fourth_phase)


_CIRCLES: Mapping[str, Read] = {"azimuth": _circle, "elevation": _circle, "transit": _transit}

tracker_angle_error = by_law(
    two=made(TrueAngleError, **_CIRCLES),
    higher=made(
        lambda azimuth, elevation, transit, azimuth_higher, elevation_higher: TrueAngleError(
            replace(azimuth, higher=azimuth_higher), replace(elevation, higher=elevation_higher), transit
        ),
        **_CIRCLES,
        azimuth_higher=_harmonics,
        elevation_higher=_harmonics,
    ),
)
"""``azimuth``, ``elevation``: (eccentric [m/m], phase, slant, phase [rad]); ``transit`` [rad].

A slant s causes an error of amplitude ``s^2 / 4`` with two cycles per revolution. With ``law`` higher also
``azimuth_higher``, ``elevation_higher``: amplitude and phase [rad] of three and of four cycles per revolution.
"""
