"""Elastic supports: a column under the arm's own weight, a common beam under the other arm's weight."""

from __future__ import annotations

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import (
    NOT_NEGATIVE,
    POSITIVE,
    STIFFNESS,
    Bend,
    Offset,
    Parameters,
    PlantEffect,
    Situation,
    by,
    by_law,
    made,
)
from drivers.plant.mechanism import Deflection, Posture

_PARTS = 6
"""Parts of a column that bend each under the moment about its middle."""


def _column(posture: Posture, height: float, stiffness: Array) -> Deflection:
    """A column below the base, clamped at its foot, under the weight of the deflected arm.

    Each part of the column bends under the moment of the arm's weight about its middle: constant along an upright
    column, growing towards the foot of a leaning one. All above a part rotates about it. Sizes: 2e6 Nm/rad (estimated).
    """
    place = posture.first_moments.sum(axis=0)
    mass = posture.masses_beyond[0][:, None]
    twist = np.zeros((len(posture.q), 6))
    for part in range(_PARTS):
        below = np.array([0.0, 0.0, -height * (part + 0.5) / _PARTS])
        moment = np.cross(place - mass * below, posture.gravity)
        rotation = moment / (stiffness * _PARTS)
        twist[:, :3] += np.cross(rotation, -below)
        twist[:, 3:] += rotation
    return Deflection(base=twist)


def _beam(situation: Situation, bending: float, torsion: float, depth: float, limit: float = np.inf) -> Deflection:
    """Both arms stand on one level beam from base to base: the moment of the other arm rotates this base too.

    The component along the beam causes torsion, the rest bending. The base rotates about the beam's centre line,
    ``depth`` below it. Bolted joints whose gaps close under load yield less than proportionally to large moments: the
    rotation is divided by ``1 + |moment| / limit``, ``limit`` in Nm.
    Sizes: 2e6 Nm/rad, that is 28 urad from a stretched UR5 (an estimate).
    """
    twist = np.zeros((len(situation.q), 6))
    for name, other in situation.others.items():
        to_here = situation.T_B_others[name]
        up = -to_here[:3, :3] @ other.gravity / np.linalg.norm(other.gravity)
        beam = to_here[:3, 3] - up * (to_here[:3, 3] @ up)
        length = np.linalg.norm(beam)
        # no beam direction is defined for bases above one another
        along = beam / length if length > 1e-6 else np.zeros(3)
        moment = other.base_moment @ to_here[:3, :3].T
        moment = moment * (1.0 / (1.0 + np.linalg.norm(moment, axis=1, keepdims=True) / limit))
        twisting = (moment @ along)[:, None] * along
        rotation = twisting / torsion + (moment - twisting) / bending
        twist[:, :3] += np.cross(rotation, depth * up)
        twist[:, 3:] += rotation
    return Deflection(base=twist)


def _frame_rotates(posture: Posture, pivot: Array, compliance: Array) -> Deflection:
    """A welded frame: a full symmetric compliance matrix, and a rotation about a pivot that is not below the base.

    The moment of the arm's weight about the ``pivot`` rotates everything above it: ``rotation = compliance moment``.
    Off-diagonal entries turn the base about one axis under a moment about another.
    """
    place = posture.first_moments.sum(axis=0) - posture.masses_beyond[0][:, None] * pivot
    rotation = np.cross(place, posture.gravity) @ compliance
    return Deflection(base=np.concatenate([np.cross(rotation, -pivot), rotation], axis=1))


def _frame(parameters: Parameters) -> PlantEffect:
    parameters.require("pivot", "direct", "cross")
    xy, xz, yz = parameters.numbers("cross", 3)
    compliance = np.diag(parameters.numbers("direct", 3, least=0.0))
    compliance += np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
    if np.linalg.eigvalsh(compliance)[0] < 0.0:
        raise parameters.error("cross", "must be smaller: under some moment the frame would turn against it")
    return Bend(_frame_rotates, {"pivot": parameters.numbers("pivot", 3), "compliance": compliance})


pedestal_compliance = by_law(
    column=made(
        lambda height, bending, torsion: Bend(_column, {"height": height, "stiffness": np.append(bending, torsion)}),
        height=NOT_NEGATIVE,
        bending=lambda parameters, key: parameters.stiffnesses(key, 2),
        torsion=STIFFNESS,
    ),
    frame=_frame,
)
"""``height`` [m]; ``bending`` (2) [Nm/rad] about x and y of B; ``torsion`` [Nm/rad] about z.

With ``law`` frame: ``pivot`` (3) [m] in B, ``direct`` (3) and ``cross`` (3: xy, xz, yz) compliances [rad/Nm].
"""

pedestal_coupling = by_law(
    linear=made(by(Offset, _beam), bending=STIFFNESS, torsion=STIFFNESS, depth=NOT_NEGATIVE),
    hardening=made(by(Offset, _beam), bending=STIFFNESS, torsion=STIFFNESS, depth=NOT_NEGATIVE, limit=POSITIVE),
)
"""``bending``, ``torsion`` [Nm/rad]; ``depth`` [m] of the beam's centre line below the base.

With ``law`` hardening also the ``limit`` [Nm] of the moment at which it yields half as much.
"""
