"""Reflector error that depends on the angle of incidence: a cover glass, and mirrors that are not square."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation


@dataclass(frozen=True, eq=False)
class TargetIncidence(Effect):
    """A glass plate of thickness d and index n before the corner cube, with dihedral angle errors ``dihedral``.

    At incidence angle t the optical path through the plate, minus that through the same air, is
    ``d (sqrt(n^2 - sin^2 t) - cos t)`` (Snell's law); its value at t = 0 is part of the reflector constant. A dihedral
    error deflects the returned beam, in proportion to the distance and the sine of t. Sizes: 2 to 20 um, larger for
    glass (estimates).
    """

    thickness: float
    index: float
    dihedral: float

    def apparent_position(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        distance = np.linalg.norm(p_M, axis=1, keepdims=True)
        beam = p_M / distance
        cosine = -(beam * normal_M).sum(axis=1, keepdims=True)
        path = np.sqrt(self.index**2 - 1.0 + cosine**2) - cosine
        longer = self.thickness * (path - (self.index - 1.0))
        aside = normal_M + cosine * beam  # perpendicular to the beam, length sin(t)
        apparent: Array = p_M + longer * beam + self.dihedral * distance * aside
        return apparent


@dataclass(frozen=True, eq=False)
class IncidencePower(Effect):
    """An error along the beam that grows with a power of the incidence t: ``size (2 sin t)^power``, size at 30 deg.

    A worn or tilted coating: the phase of the returned beam changes faster than a glass plate's path.
    """

    size: float
    power: float
    dihedral: float

    def apparent_position(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        distance = np.linalg.norm(p_M, axis=1, keepdims=True)
        beam = p_M / distance
        cosine = -(beam * normal_M).sum(axis=1, keepdims=True)
        aside = normal_M + cosine * beam  # perpendicular to the beam, length sin(t)
        longer = self.size * (2.0 * np.linalg.norm(aside, axis=1, keepdims=True)) ** self.power
        apparent: Array = p_M + longer * beam + self.dihedral * distance * aside
        return apparent


def target_incidence(parameters: Parameters) -> Effect:
    """Build target incidence. ``thickness`` of the glass [m], its ``index`` of refraction, ``dihedral`` [rad].

    With ``law`` power: ``size`` [m] at 30 degrees, ``power``, ``dihedral``.
    """
    law, parameters = parameters.by_law("glass", "power")
    if law == "power":
        parameters.require("size", "power", "dihedral")
        size, power = parameters.number("size"), parameters.number("power", above=0.0)
        return IncidencePower(size, power, parameters.number("dihedral"))
    parameters.require("thickness", "index", "dihedral")
    return TargetIncidence(
        parameters.number("thickness", least=0.0),
        parameters.number("index", least=1.0),
        parameters.number("dihedral"),
    )
