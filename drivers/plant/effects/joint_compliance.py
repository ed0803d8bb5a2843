"""Elastic joints under gravity: linear, or stiffening with the load in one of several ways."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import NOT_NEGATIVES, POSITIVES, Effect, Parameters, Read, Situation, by_law, made
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

    first: Array
    second: Array
    third: Array
    first_knee: Array
    second_knee: Array

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        torque = posture.torques
        low, middle = (np.clip(torque, -knee, knee) for knee in (self.first_knee, self.second_knee))
        return Deflection(joints=low / self.first + (middle - low) / self.second + (torque - middle) / self.third)


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


def _linear_or_with_knee(parameters: Parameters) -> Effect:
    parameters.require("stiffness", optional=("soft_stiffness", "knee"))
    stiffness = parameters.stiffnesses("stiffness")
    if not parameters.all_or_none("soft_stiffness", "knee"):
        return JointCompliance(stiffness)
    soft = parameters.stiffnesses("soft_stiffness")
    if (soft > stiffness).any():
        raise parameters.error("soft_stiffness", "must not be greater than stiffness")
    return HardeningJointCompliance(stiffness, soft, parameters.numbers("knee", least=0.0))


_STAGES: Mapping[str, Read] = dict.fromkeys(("first", "second", "third"), POSITIVES)

joint_compliance = by_law(
    linear=_linear_or_with_knee,
    three_stage=made(ThreeStageCompliance, **_STAGES, first_knee=NOT_NEGATIVES, second_knee=NOT_NEGATIVES),
    stiffening=made(StiffeningCompliance, stiffness=POSITIVES, soft_stiffness=POSITIVES, knee=POSITIVES),
    hardening=made(HardeningSpring, stiffness=POSITIVES, cubic=POSITIVES),
)
"""``stiffness``: [Nm/rad] per joint; ``inf`` is rigid.

With ``knee`` [Nm] per joint, ``soft_stiffness`` [Nm/rad] applies below the knee torque. Other laws, all per joint:
``law`` three_stage with ``first``, ``second``, ``third`` [Nm/rad] and ``first_knee``, ``second_knee`` [Nm]; stiffening
with ``stiffness``, ``soft_stiffness``, ``knee``; hardening with ``stiffness`` and ``cubic`` [Nm/rad^3].
"""
