"""Elastic joints under the payload alone, for controllers that compensate the weight of the links."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection, Posture


@dataclass(frozen=True, eq=False)
class PayloadCompliance(Effect):
    """Drive springs that deflect under the load's torque in the deflected posture.

    Sizes: the stiffness of strain-wave drives, 2.5e4 to 1e5 Nm/rad for sizes 25 to 40 (catalogues).
    """

    stiffness: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        return Deflection(joints=posture.load_torques / self.stiffness)


def payload_compliance(parameters: Parameters) -> Effect:
    """Build payload compliance. ``stiffness``: [Nm/rad] per joint; ``inf`` is rigid."""
    parameters.require("stiffness")
    return PayloadCompliance(parameters.stiffnesses("stiffness"))
