"""Elastic joints under the payload alone, for controllers that compensate the weight of the links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import NOT_NEGATIVES, STIFFNESSES, VECTOR, Effect, Situation, by_law, made
from drivers.plant.mechanism import Deflection, Posture


@dataclass(frozen=True, eq=False)
class PayloadCompliance(Effect):
    """Drive springs that deflect under the load's torque in the deflected posture.

    Sizes: the stiffness of strain-wave drives, 2.5e4 to 1e5 Nm/rad for sizes 25 to 40 (catalogues).
    """

    stiffness: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        return Deflection(joints=posture.load_torques / self.stiffness)


@dataclass(frozen=True, eq=False)
class OffCentrePayload(Effect):
    """A payload whose true centre of mass is off by ``shift`` (3,) [m] from the centre entered on the controller.

    The shift is given in the flange frame; its moment is that of the load's weight at the shifted centre.
    """

    stiffness: Array
    shift: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        aside = posture.load_mass[:, None] * (posture.flange[:, :3, :3] @ self.shift)
        turned = np.cross(aside, posture.gravity)
        more = np.einsum("jnk,nk->nj", posture.axes[0], turned)
        return Deflection(joints=(posture.load_torques + more) / self.stiffness)


@dataclass(frozen=True, eq=False)
class SofteningUnderPayload(Effect):
    """Drives that are softer above the load torque ``knee``: ``soft_stiffness`` applies to the excess."""

    stiffness: Array
    soft_stiffness: Array
    knee: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        torque = posture.load_torques
        stiff = np.clip(torque, -self.knee, self.knee)
        return Deflection(joints=stiff / self.stiffness + (torque - stiff) / self.soft_stiffness)


payload_compliance = by_law(
    linear=made(PayloadCompliance, stiffness=STIFFNESSES),
    off_centre=made(OffCentrePayload, stiffness=STIFFNESSES, shift=VECTOR),
    softening=made(SofteningUnderPayload, stiffness=STIFFNESSES, soft_stiffness=STIFFNESSES, knee=NOT_NEGATIVES),
)
"""``stiffness``: [Nm/rad] per joint; ``inf`` is rigid.

Other laws: ``law`` off_centre with the ``shift`` (3) [m] of the load's centre in the flange frame; softening with
``soft_stiffness`` [Nm/rad] beyond the load torque ``knee`` [Nm], both per joint.
"""
