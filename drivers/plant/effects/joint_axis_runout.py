"""Bearings whose centre moves as the joint turns: radial and axial run-out of an axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import JOINTS, NOT_NEGATIVES, Effect, Situation, before_joints
from drivers.plant.effects.joint_axis_wobble import with_waves
from drivers.plant.mechanism import Deflection
from drivers.plant.random_functions import RandomWaves


@dataclass(frozen=True, eq=False)
class JointAxisRunout(Effect):
    """The axis shifts with harmonics of its own angle, across itself by ``radial`` and along itself by ``axial`` [m].

    Error motions of a rotary axis (ISO 230-7). The shift is in the frame before the joint. The circular part of one
    cycle per revolution across the axis belongs to the geometry. Sizes: 5 to 30 um for bearings of this class (an
    estimate).
    """

    joints: np.ndarray
    sizes: Array  # (joints, 3)
    waves: tuple[RandomWaves, ...]

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        twists = np.zeros((len(situation.q), len(self.joints), 6))
        for k, (joint, waves) in enumerate(zip(self.joints, self.waves, strict=True)):
            twists[:, k, :3] = waves.at(situation.q[:, joint]) * self.sizes[k]
        return before_joints(situation, self.joints, twists)


joint_axis_runout = with_waves(
    lambda joints, radial, axial, waves: JointAxisRunout(joints, np.column_stack([radial, radial, axial]), waves),
    directions=3,
    joints=JOINTS,
    radial=NOT_NEGATIVES,
    axial=NOT_NEGATIVES,
)
"""``joints``: numbers from 1; for each ``radial`` and ``axial`` [m].

All joints share ``harmonics`` (cycles per revolution), as many ``shares``, and a ``seed`` of the phases.
"""
