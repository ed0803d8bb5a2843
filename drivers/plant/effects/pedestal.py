"""Elastic supports: a column under the arm's own weight, a common beam under the other arm's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection, Posture


@dataclass(frozen=True, eq=False)
class PedestalCompliance(Effect):
    """A column below the base, clamped at its foot, under the weight of the deflected arm.

    Each part of the column bends under the moment of the arm's weight about its middle: constant along an upright
    column, growing towards the foot of a leaning one. All above a part rotates about it. Sizes: 2e6 Nm/rad (estimated).
    """

    height: float
    stiffness: Array  # (3,) about x, y and z of B

    _PARTS = 6

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        place = posture.first_moments.sum(axis=0)
        mass = posture.masses_beyond[0][:, None]
        twist = np.zeros((len(posture.q), 6))
        for part in range(self._PARTS):
            below = np.array([0.0, 0.0, -self.height * (part + 0.5) / self._PARTS])
            turn = np.cross(place - mass * below, posture.gravity) / (self.stiffness * self._PARTS)
            twist[:, :3] += np.cross(turn, -below)
            twist[:, 3:] += turn
        return Deflection(base=twist)


@dataclass(frozen=True, eq=False)
class PedestalCoupling(Effect):
    """Both arms stand on one level beam from base to base: the moment of the other arm rotates this base too.

    The component along the beam causes torsion, the rest bending. The base rotates about the beam's centre line,
    ``depth`` below it.
    Sizes: 2e6 Nm/rad, that is 28 urad from a stretched UR5 (an estimate).
    """

    bending: float
    torsion: float
    depth: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        twist = np.zeros((len(situation.q), 6))
        for name, other in situation.others.items():
            to_here = situation.T_B_others[name]
            up = -to_here[:3, :3] @ other.gravity / np.linalg.norm(other.gravity)
            beam = to_here[:3, 3] - up * (to_here[:3, 3] @ up)
            length = np.linalg.norm(beam)
            # for bases above one another no beam direction is defined
            along = beam / length if length > 1e-6 else np.zeros(3)
            moment = other.base_moment @ to_here[:3, :3].T
            twisting = (moment @ along)[:, None] * along
            turn = twisting / self.torsion + (moment - twisting) / self.bending
            twist[:, :3] += np.cross(turn, self.depth * up)
            twist[:, 3:] += turn
        return Deflection(base=twist)


def pedestal_compliance(parameters: Parameters) -> Effect:
    """Build the column. ``height`` [m]; ``bending`` (2) [Nm/rad] about x and y of B; ``torsion`` [Nm/rad] about z."""
    parameters.require("height", "bending", "torsion")
    return PedestalCompliance(
        parameters.number("height", least=0.0),
        np.append(parameters.stiffnesses("bending", 2), parameters.stiffness("torsion")),
    )


def pedestal_coupling(parameters: Parameters) -> Effect:
    """Build the beam. ``bending``, ``torsion`` [Nm/rad]; ``depth`` [m] of its centre line below the base."""
    parameters.require("bending", "torsion", "depth")
    return PedestalCoupling(
        parameters.stiffness("bending"),
        parameters.stiffness("torsion"),
        parameters.number("depth", least=0.0),
    )
