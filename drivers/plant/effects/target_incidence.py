"""An SMR behind a cover glass, its mirrors not quite square: what it shows changes as it is looked at aslant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation


@dataclass(frozen=True, eq=False)
class TargetIncidence(Effect):
    """A plate of thickness d and index n before the corner; the mirrors' dihedral angles are off by ``dihedral``.

    At the incidence t the beam's optical path through the plate, less that through the same air, is
    ``d (sqrt(n^2 - sin^2 t) - cos t)`` (Snell); at t = 0 it is set off with the reflector's constant. A wrong dihedral
    angle sends the beam back aside by that times the distance, the more the more the corner is turned. Sizes: 2 to
    20 um, larger for glass (estimates).
    """

    thickness: float
    index: float
    dihedral: float

    def seen(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        distance = np.linalg.norm(p_M, axis=1, keepdims=True)
        beam = p_M / distance
        cosine = -(beam * normal_M).sum(axis=1, keepdims=True)
        path = np.sqrt(self.index**2 - 1.0 + cosine**2) - cosine
        longer = self.thickness * (path - (self.index - 1.0))
        aside = normal_M + cosine * beam  # across the beam, as long as the sine of the incidence
        return p_M + longer * beam + self.dihedral * distance * aside


def target_incidence(parameters: Parameters) -> Effect:
    """``thickness`` of the glass [m], its ``index`` of refraction, ``dihedral`` [rad]."""
    parameters.only("thickness", "index", "dihedral")
    return TargetIncidence(
        parameters.number("thickness", least=0.0),
        parameters.number("index", least=1.0),
        parameters.number("dihedral"),
    )
