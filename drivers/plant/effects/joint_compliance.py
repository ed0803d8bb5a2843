"""Elastic joints under gravity: linear, or stiffening with the load in one of several ways."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import NOT_NEGATIVES, POSITIVES, Parameters, PlantEffect, Read, Situation, by, by_law, made
from drivers.plant.mechanism import Deflection, Posture


@dataclass(frozen=True, eq=False)
class Springs(PlantEffect):
    """Springs in equilibrium with gravity: ``angle(torque(deflected posture))``, by the ``law`` of a drive."""

    law: Callable[..., Array]
    values: Mapping[str, Any]

    def bend(self, situation: Situation, posture: Posture) -> Deflection:
        return Deflection(joints=self.law(posture.torques, **self.values))


def linear(torque: Array, stiffness: Array) -> Array:
    """Return the angles of linear springs."""
    return np.asarray(torque / stiffness)


def two_stage(torque: Array, below: Array, beyond: Array, knee: Array) -> Array:
    """Return the angles of a strain-wave drive: soft while few teeth carry the load, stiffer above a knee torque.

    Catalogues give K1 < K2 < K3 and the torques between them; this model keeps two.
    """
    first = np.clip(torque, -knee, knee)
    return np.asarray(first / below + (torque - first) / beyond)


def _three_stage(
    torque: Array, first: Array, second: Array, third: Array, first_knee: Array, second_knee: Array
) -> Array:
    """Return the angles by the catalogues' three stiffnesses K1 < K2 < K3 with the torques T1 < T2 between them."""
    low, middle = (np.clip(torque, -knee, knee) for knee in (first_knee, second_knee))
    return np.asarray(low / first + (middle - low) / second + (torque - middle) / third)


def _stiffening(torque: Array, stiffness: Array, soft_stiffness: Array, knee: Array) -> Array:
    """Return the angles of teeth that come into contact gradually: the compliance falls smoothly to the stiff value.

    ``angle = torque / stiffness + (1 / soft_stiffness - 1 / stiffness) knee tanh(torque / knee)``.
    """
    extra = (1.0 / soft_stiffness - 1.0 / stiffness) * knee * np.tanh(torque / knee)
    return np.asarray(torque / stiffness + extra)


def _hardening(torque: Array, stiffness: Array, cubic: Array) -> Array:
    """Return the angles of springs with ``torque = stiffness * angle + cubic * angle^3`` (Duffing), as of a preloaded
    toothing.

    The angle is the only real root, by Cardano's formula in its hyperbolic form.
    """
    size = np.sqrt(stiffness / (3.0 * cubic))
    asinh = np.arcsinh(torque / (2.0 * cubic * size**3))
    return np.asarray(2.0 * size * np.sinh(asinh / 3.0))


def _linear_or_with_knee(parameters: Parameters) -> PlantEffect:
    parameters.require("stiffness", optional=("soft_stiffness", "knee"))
    stiffness = parameters.stiffnesses("stiffness")
    if not parameters.all_or_none("soft_stiffness", "knee"):
        return Springs(linear, {"stiffness": stiffness})
    soft = parameters.stiffnesses("soft_stiffness")
    if (soft > stiffness).any():
        raise parameters.error("soft_stiffness", "must not be greater than stiffness")
    knee = parameters.numbers("knee", least=0.0)
    return Springs(two_stage, {"below": soft, "beyond": stiffness, "knee": knee})


_STAGES: Mapping[str, Read] = dict.fromkeys(("first", "second", "third"), POSITIVES)

joint_compliance = by_law(
    linear=_linear_or_with_knee,
    three_stage=made(by(Springs, _three_stage), **_STAGES, first_knee=NOT_NEGATIVES, second_knee=NOT_NEGATIVES),
    stiffening=made(by(Springs, _stiffening), stiffness=POSITIVES, soft_stiffness=POSITIVES, knee=POSITIVES),
    hardening=made(by(Springs, _hardening), stiffness=POSITIVES, cubic=POSITIVES),
)
"""``stiffness``: [Nm/rad] per joint; ``inf`` is rigid.

With ``knee`` [Nm] per joint, ``soft_stiffness`` [Nm/rad] applies below the knee torque. Other laws, all per joint:
``law`` three_stage with ``first``, ``second``, ``third`` [Nm/rad] and ``first_knee``, ``second_knee`` [Nm]; stiffening
with ``stiffness``, ``soft_stiffness``, ``knee``; hardening with ``stiffness`` and ``cubic`` [Nm/rad^3].
"""
