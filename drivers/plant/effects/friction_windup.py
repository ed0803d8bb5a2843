"""Coulomb friction behind the drive's spring: it comes to rest wound up against the last motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection, Posture


@dataclass(frozen=True, eq=False)
class FrictionWindup(Effect):
    """The motor has dragged the joint along against ``friction + load_friction * |load|``; the spring holds that.

    The friction acts at the joint, the encoder sits at the motor. The load is gravity at the deflected posture. A last
    step shorter than the wind-up winds no further than itself. A joint that has not moved is not wound up. Sizes: an
    estimate, 1e-4 rad at 50 Nm.
    """

    friction: Array
    load_friction: Array
    stiffness: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        wound = (self.friction + self.load_friction * np.abs(posture.gravity_torques)) / self.stiffness
        step = np.abs(situation.last_step)
        return Deflection(joints=-situation.approach * np.where(step == 0.0, wound, np.minimum(wound, step)))


def friction_windup(parameters: Parameters) -> Effect:
    """Per joint: ``friction`` [Nm], ``load_friction`` [Nm/Nm], ``stiffness`` of the drive [Nm/rad]."""
    parameters.only("friction", "load_friction", "stiffness")
    return FrictionWindup(
        parameters.numbers("friction", least=0.0),
        parameters.numbers("load_friction", least=0.0),
        parameters.stiffnesses("stiffness"),
    )
