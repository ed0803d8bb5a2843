"""Elastic joints under gravity: linear, or stiffening with the load in one of several ways."""

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
        return Deflection(joints=posture.torques / self.stiffness)


@dataclass(frozen=True, eq=False)
class HardeningJointCompliance(Effect):
    """A strain-wave drive: soft while few teeth carry the load, stiffer above a knee torque.

    Catalogues give K1 < K2 < K3 and the torques between them; this model keeps two.
    """

    stiffness: Array
    soft_stiffness: Array
    knee: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        torque = posture.torques
        soft = np.clip(torque, -self.knee, self.knee)
        return Deflection(joints=soft / self.soft_stiffness + (torque - soft) / self.stiffness)


@dataclass(frozen=True, eq=False)
class ThreeStageCompliance(Effect):
    """The catalogues' three stiffnesses K1 < K2 < K3 with the torques T1 < T2 between them."""

    stiffnesses: Array  # (3, N)
    knees: Array  # (2, N)

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        torque = posture.torques
        first, second = (np.clip(torque, -knee, knee) for knee in self.knees)
        parts = (first, second - first, torque - second)
        angles = [part / stiffness for part, stiffness in zip(parts, self.stiffnesses, strict=True)]
        return Deflection(joints=angles[0] + angles[1] + angles[2])


@dataclass(frozen=True, eq=False)
class StiffeningCompliance(Effect):
    """Teeth that come into contact gradually: the compliance falls smoothly from the soft to the stiff value.

    ``angle = torque / stiffness + (1 / soft_stiffness - 1 / stiffness) knee tanh(torque / knee)``.
    """

    stiffness: Array
    soft_stiffness: Array
    knee: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        torque = posture.torques
        extra = (1.0 / self.soft_stiffness - 1.0 / self.stiffness) * self.knee * np.tanh(torque / self.knee)
        return Deflection(joints=torque / self.stiffness + extra)


@dataclass(frozen=True, eq=False)
class HardeningSpring(Effect):
    """A spring with ``torque = stiffness * angle + cubic * angle^3`` (Duffing), as of a preloaded toothing.

    The angle is the only real root, by Cardano's formula in its hyperbolic form.
    """

    stiffness: Array
    cubic: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        size = np.sqrt(self.stiffness / (3.0 * self.cubic))
        turned = np.arcsinh(posture.torques / (2.0 * self.cubic * size**3))
        return Deflection(joints=2.0 * size * np.sinh(turned / 3.0))


def joint_compliance(parameters: Parameters) -> Effect:
    """Build joint compliance. ``stiffness``: [Nm/rad] per joint; ``inf`` is rigid.

    With ``knee`` [Nm] per joint, ``soft_stiffness`` [Nm/rad] applies below the knee torque. Other laws, all
    per joint: ``law`` three_stage with ``first``, ``second``, ``third`` [Nm/rad] and ``first_knee``, ``second_knee``
    [Nm]; stiffening with ``stiffness``, ``soft_stiffness``, ``knee``; hardening with ``stiffness`` and ``cubic``
    [Nm/rad^3].
    """
    law, parameters = parameters.by_law("linear", "three_stage", "stiffening", "hardening")
    if law == "three_stage":
        stages, knees = ("first", "second", "third"), ("first_knee", "second_knee")
        parameters.require(*stages, *knees)
        return ThreeStageCompliance(
            np.array([parameters.numbers(key, above=0.0) for key in stages]),
            np.array([parameters.numbers(key, least=0.0) for key in knees]),
        )
    if law == "stiffening":
        parameters.require("stiffness", "soft_stiffness", "knee")
        keys = ("stiffness", "soft_stiffness", "knee")
        return StiffeningCompliance(*(parameters.numbers(key, above=0.0) for key in keys))
    if law == "hardening":
        parameters.require("stiffness", "cubic")
        return HardeningSpring(*(parameters.numbers(key, above=0.0) for key in ("stiffness", "cubic")))
    parameters.require("stiffness", optional=("soft_stiffness", "knee"))
    stiffness = parameters.stiffnesses("stiffness")
    if not parameters.all_or_none("soft_stiffness", "knee"):
        return JointCompliance(stiffness)
    soft = parameters.stiffnesses("soft_stiffness")
    if (soft > stiffness).any():
        raise parameters.error("soft_stiffness", "must not be greater than stiffness")
    return HardeningJointCompliance(stiffness, soft, parameters.numbers("knee", least=0.0))
