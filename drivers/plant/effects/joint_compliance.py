"""Elastic joints under gravity, linear or stiffening with the load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection, Posture


@dataclass(frozen=True, eq=False)
class JointCompliance(Effect):
    """Linear springs in equilibrium with gravity: ``stiffness * angle = torque(deflected posture)``."""

    stiffness: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        return Deflection(joints=posture.gravity_torques / self.stiffness)


@dataclass(frozen=True, eq=False)
class HardeningJointCompliance(Effect):
    """A strain-wave drive: soft while few teeth carry the load, stiffer above a knee torque.

    Catalogues give K1 < K2 < K3 and the torques between them; this model keeps two.
    """

    stiffness: Array
    soft_stiffness: Array
    knee: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        torque = posture.gravity_torques
        soft = np.clip(torque, -self.knee, self.knee)
        return Deflection(joints=soft / self.soft_stiffness + (torque - soft) / self.stiffness)


def joint_compliance(parameters: Parameters) -> Effect:
    """Build joint compliance. ``stiffness``: [Nm/rad] per joint; ``inf`` is rigid.

    With ``knee`` [Nm] per joint, ``soft_stiffness`` [Nm/rad] applies below the knee torque.
    """
    parameters.require("stiffness", optional=("soft_stiffness", "knee"))
    stiffness = parameters.stiffnesses("stiffness")
    if not parameters.all_or_none("soft_stiffness", "knee"):
        return JointCompliance(stiffness)
    soft = parameters.stiffnesses("soft_stiffness")
    if (soft > stiffness).any():
        raise parameters.error("soft_stiffness", "must not be greater than stiffness")
    return HardeningJointCompliance(stiffness, soft, parameters.numbers("knee", least=0.0))
