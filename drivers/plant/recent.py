"""Recent positions of the SMR of a moving arm, for a tracker that sends packets of points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from drivers.plant.config import Array
from drivers.plant.inertia import inertia_torques
from drivers.plant.mechanism import NO_DEFLECTION
from drivers.plant.plant import Plant
from drivers.plant.trail import Phase, joints_at
from drivers.plant.true_arm import TrueArm

_BACK_S = 0.024
"""Step of the differences that give accelerations. The future is not known, so accelerations are delayed by this much.
It is a multiple of all controllers' cycles, whose ripple is thus excluded."""


def recent_smr(plant: Plant, name: str, time_s: Array) -> tuple[Array, Array]:
    """Return apparent positions and viewing directions of an arm's SMR, (n, 3) each, in M, at recent times (n,) [s].

    The arm may have moved since; history older than about a second is not available.
    """
    arm = plant._arm(name)
    q, known = joints_at(arm, time_s, plant._clock_s)
    inertia = np.zeros_like(q)
    if arm.effects and any(phase.motion is not None for phase, _ in known):
        earlier, first = (joints_at(arm, time_s - n * _BACK_S, plant._clock_s)[0] for n in (1, 2))
        inertia = inertia_torques(arm.mechanism, first, earlier, q, _BACK_S)
    p_M, normal_M = np.empty((2, len(time_s), 3))
    moved = {other: joints_at(plant._arm(other), time_s, plant._clock_s)[0] for other in plant.names if other != name}
    for phase, rows in known:
        moving, others = phase.motion is not None, {other: its[rows] for other, its in moved.items()}
        p_M[rows], normal_M[rows] = smr_in(
            plant, arm, phase, q[rows], time_s[rows], others, moving=moving, inertia=inertia[rows]
        )
    return p_M, normal_M


def smr_in(
    plant: Plant,
    arm: TrueArm,
    phase: Phase,
    q: Array,
    time_s: Array,
    others: Mapping[str, Array],
    *,
    moving: bool,
    inertia: Array | None = None,
    response: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Return apparent positions and viewing directions (n, 3) of an arm's SMR at ``q`` (n, N) in a phase without
    reversal, with other arms at ``others`` (n, N). ``inertia`` (n, N) are torques of its acceleration [Nm];
    ``response`` (n, N) is the joint deviation caused by the course of the motion [rad]."""
    situation, memories = plant._in_phase(arm, phase, q, time_s, others, moving=moving)
    situation = replace(situation, inertia=inertia)
    posture, _ = plant._equilibrium(arm, situation, memories, NO_DEFLECTION, arm.stop_error[None] + response)
    return plant._apparent_smr(arm, situation, posture)
