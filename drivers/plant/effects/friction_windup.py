"""Coulomb friction behind the drive's spring: the joint comes to rest wound up against the last motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection, Posture


@dataclass(frozen=True, eq=False)
class FrictionWindup(Effect):
    """At rest the spring holds the friction torque ``friction + load_friction * |load|`` of the last motion.

    The friction acts at the joint, the encoder is at the motor. The load is gravity in the deflected posture. The
    wind-up does not exceed the last step; a joint that has not moved has none. Sizes: an estimate, 1e-4 rad at 50 Nm.
    """

    friction: Array
    load_friction: Array
    stiffness: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        wound = (self.friction + self.load_friction * np.abs(posture.gravity_torques)) / self.stiffness
        step = np.abs(situation.last_step)
        return Deflection(joints=-situation.approach * np.where(step == 0.0, wound, np.minimum(wound, step)))


def friction_windup(parameters: Parameters) -> Effect:
    """Build wind-up. Per joint: ``friction`` [Nm], ``load_friction`` [Nm/Nm], drive ``stiffness`` [Nm/rad]."""
    parameters.require("friction", "load_friction", "stiffness")
    return FrictionWindup(
        parameters.numbers("friction", least=0.0),
        parameters.numbers("load_friction", least=0.0),
        parameters.stiffnesses("stiffness"),
    )
