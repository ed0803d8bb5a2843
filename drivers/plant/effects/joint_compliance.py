"""Joints that twist under gravity like springs, some of them softer under small loads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection, Posture


@dataclass(frozen=True, eq=False)
class JointCompliance(Effect):
    """Each joint yields until its spring balances gravity there: ``stiffness * angle = torque(deflected posture)``."""

    stiffness: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        return Deflection(joints=posture.gravity_torques / self.stiffness)


@dataclass(frozen=True, eq=False)
class HardeningJointCompliance(Effect):
    """A strain-wave drive: soft while only some teeth carry, stiffer above a knee torque.

    Catalogues of such drives give K1 < K2 < K3 with the torques where one passes into the next; two are kept here.
    """

    stiffness: Array
    soft_stiffness: Array
    knee: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        torque = posture.gravity_torques
        soft = np.clip(torque, -self.knee, self.knee)
        return Deflection(joints=soft / self.soft_stiffness + (torque - soft) / self.stiffness)


def joint_compliance(parameters: Parameters) -> Effect:
    """``stiffness``: [Nm/rad] per joint; ``inf`` is a stiff one.

    With ``knee`` [Nm] per joint and ``soft_stiffness`` [Nm/rad], the latter holds below the knee torque.
    """
    parameters.only("stiffness", optional=("soft_stiffness", "knee"))
    stiffness = parameters.stiffnesses("stiffness")
    if not parameters.together("soft_stiffness", "knee"):
        return JointCompliance(stiffness)
    soft = parameters.stiffnesses("soft_stiffness")
    if (soft > stiffness).any():
        raise parameters.error("soft_stiffness", "must not be greater than stiffness")
    return HardeningJointCompliance(stiffness, soft, parameters.numbers("knee", least=0.0))
