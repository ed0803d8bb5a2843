"""Reflector error that depends on the angle of incidence: a cover glass, and mirrors that are not square."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import partial

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import NOT_NEGATIVE, NUMBER, POSITIVE, PlantEffect, Situation, by_law, made


@dataclass(frozen=True, eq=False)
class TrueIncidence(PlantEffect):
    """An error along the beam that depends on the angle of incidence, and dihedral angle errors ``dihedral``.

    A dihedral error deflects the returned beam, in proportion to the distance and the sine of the incidence.
    """

    dihedral: float

    @abstractmethod
    def longer(self, cosine: Array, sine: Array) -> Array:
        """Return how much longer the beam appears (n, 1) [m] at the incidence."""

    def apparent_position(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        distance = np.linalg.norm(p_M, axis=1, keepdims=True)
        beam = p_M / distance
        cosine = -(beam * normal_M).sum(axis=1, keepdims=True)
        aside = normal_M + cosine * beam  # perpendicular to the beam, length sin(t)
        longer = self.longer(cosine, np.linalg.norm(aside, axis=1, keepdims=True))
        return np.asarray(p_M + longer * beam + self.dihedral * distance * aside)


@dataclass(frozen=True, eq=False)
class CoverGlass(TrueIncidence):
    """A glass plate of thickness d and index n before the corner cube.

    At incidence angle t the optical path through the plate, minus that through the same air, is
    ``d (sqrt(n^2 - sin^2 t) - cos t)`` (Snell's law); its value at t = 0 is part of the reflector constant. Sizes: 2 to
    20 um, larger for glass (estimates).
    """

    thickness: float
    index: float

    def longer(self, cosine: Array, sine: Array) -> Array:
        path = np.sqrt(self.index**2 - 1.0 + cosine**2) - cosine
        return np.asarray(self.thickness * (path - (self.index - 1.0)))


@dataclass(frozen=True, eq=False)
class IncidencePower(TrueIncidence):
    """An error along the beam that grows with a power of the incidence t: ``size (2 sin t)^power``, size at 30 deg.

    A worn or tilted coating: the phase of the returned beam changes faster than a glass plate's path.
    """

    size: float
    power: float

    def longer(self, cosine: Array, sine: Array) -> Array:
        return np.asarray(self.size * (2.0 * sine) ** self.power)


target_incidence = by_law(
    glass=made(CoverGlass, thickness=NOT_NEGATIVE, index=partial(NUMBER, least=1.0), dihedral=NUMBER),
    power=made(IncidencePower, size=NUMBER, power=POSITIVE, dihedral=NUMBER),
)
"""``thickness`` of the glass [m], its ``index`` of refraction, ``dihedral`` [rad].

With ``law`` power: ``size`` [m] at 30 degrees, ``power``, ``dihedral``.
"""
