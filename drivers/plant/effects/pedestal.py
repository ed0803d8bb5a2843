"""What the arms stand on yields: a column under the arm's own weight, a beam under the other arm's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection, Posture


@dataclass(frozen=True, eq=False)
class PedestalCompliance(Effect):
    """A column below the base, clamped at its foot, under the arm's weight where the deflected arm has it.

    The weight's moment is the same all the way down a column that stands upright, and grows as it leans: the part of
    the column a fraction u above its foot feels the moment about that place. It bends evenly over its height, so each
    of its parts turns by its share; all above turns about it. Sizes: 2e6 Nm/rad (an estimate).
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
    """Both arms stand on one beam that runs level from base to base: the moment of another arm turns this base too.

    About the beam it twists, across it it bends; the base turns about the beam's middle line, ``depth`` below it.
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
            # bases above one another share a post, which has no direction to twist about
            along = beam / length if length > 1e-6 else np.zeros(3)
            moment = other.base_moment @ to_here[:3, :3].T
            twisting = (moment @ along)[:, None] * along
            turn = twisting / self.torsion + (moment - twisting) / self.bending
            twist[:, :3] += np.cross(turn, self.depth * up)
            twist[:, 3:] += turn
        return Deflection(base=twist)


def pedestal_compliance(parameters: Parameters) -> Effect:
    """``height`` [m]; ``bending`` (2) [Nm/rad] of the whole column about x and y of B; ``torsion`` [Nm/rad] about z."""
    parameters.only("height", "bending", "torsion")
    return PedestalCompliance(
        parameters.number("height", least=0.0),
        np.append(parameters.stiffnesses("bending", 2), parameters.stiffness("torsion")),
    )


def pedestal_coupling(parameters: Parameters) -> Effect:
    """``bending``, ``torsion`` [Nm/rad] of the beam between the arms; ``depth`` [m] of its middle below the base."""
    parameters.only("bending", "torsion", "depth")
    return PedestalCoupling(
        parameters.stiffness("bending"),
        parameters.stiffness("torsion"),
        parameters.number("depth", least=0.0),
    )
