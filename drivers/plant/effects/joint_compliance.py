"""Joints that twist under gravity like linear springs."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection, Posture


@dataclass(frozen=True, eq=False)
class JointCompliance(Effect):
    """Each joint yields until its spring balances gravity there: ``stiffness * angle = torque(deflected posture)``."""

    stiffness: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        return Deflection(joints=posture.gravity_torques / self.stiffness)


def joint_compliance(parameters: Parameters) -> Effect:
    """``stiffness``: [Nm/rad] per joint; ``inf`` is a stiff one."""
    parameters.only("stiffness")
    return JointCompliance(parameters.numbers("stiffness", above=0.0))
