"""Elastic joints under the payload alone, for controllers that compensate the weight of the links."""

from __future__ import annotations

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import NOT_NEGATIVES, STIFFNESSES, VECTOR, Bend, Situation, by, by_law, made
from drivers.plant.effects.joint_compliance import Springs, linear, two_stage
from drivers.plant.mechanism import Deflection, Posture


class LoadSprings(Springs):
    """Drive springs that deflect under the load's torque in the deflected posture.

    Sizes: the stiffness of strain-wave drives, 2.5e4 to 1e5 Nm/rad for sizes 25 to 40 (catalogues).
    """

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        return Deflection(joints=self.law(posture.load_torques, **self.values))


def _off_centre(posture: Posture, stiffness: Array, shift: Array) -> Deflection:
    """A payload whose true centre of mass is off by ``shift`` (3,) [m] from the centre entered on the controller.

    The shift is given in the flange frame; its moment is that of the load's weight at the shifted centre.
    """
    aside = posture.load_mass[:, None] * (posture.flange[:, :3, :3] @ shift)
    rotated = np.cross(aside, posture.gravity)
    more = np.einsum("jnk,nk->nj", posture.axes[0], rotated)
    return Deflection(joints=(posture.load_torques + more) / stiffness)


def _softening(torque: Array, stiffness: Array, soft_stiffness: Array, knee: Array) -> Array:
    """Return the angles of drives that are softer above the load torque ``knee``: ``soft_stiffness`` applies to the
    excess."""
    return two_stage(torque, stiffness, soft_stiffness, knee)


payload_compliance = by_law(
    linear=made(by(LoadSprings, linear), stiffness=STIFFNESSES),
    off_centre=made(by(Bend, _off_centre), stiffness=STIFFNESSES, shift=VECTOR),
    softening=made(by(LoadSprings, _softening), stiffness=STIFFNESSES, soft_stiffness=STIFFNESSES, knee=NOT_NEGATIVES),
)
"""``stiffness``: [Nm/rad] per joint; ``inf`` is rigid.

Other laws: ``law`` off_centre with the ``shift`` (3) [m] of the load's centre in the flange frame; softening with
``soft_stiffness`` [Nm/rad] beyond the load torque ``knee`` [Nm], both per joint.
"""
