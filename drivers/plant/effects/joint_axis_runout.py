"""Bearings whose centre moves as the joint turns: radial and axial run-out of an axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.effects.joint_axis_wobble import random_waves
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
    radial: Array
    axial: Array
    waves: tuple[RandomWaves, ...]

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        n, count = situation.q.shape
        twists, base = np.zeros((n, count, 6)), np.zeros((n, 6))
        for joint, radial, axial, waves in zip(self.joints, self.radial, self.axial, self.waves, strict=True):
            twist = base if joint == 0 else twists[:, joint - 1]
            twist[:, :3] = waves.at(situation.q[:, joint]) * np.array([radial, radial, axial])
        return Deflection(base=base, links=twists)


def joint_axis_runout(parameters: Parameters) -> Effect:
    """Build run-out. ``joints``: numbers from 1; for each ``radial`` and ``axial`` [m].

    All joints share ``harmonics`` (cycles per revolution), as many ``shares``, and a ``seed`` of the phases.
    """
    parameters.require("joints", "radial", "axial", "harmonics", "shares", "seed")
    joints = parameters.joint_numbers("joints")
    radial, axial = (parameters.numbers(key, len(joints), least=0.0) for key in ("radial", "axial"))
    return JointAxisRunout(joints, radial, axial, random_waves(parameters, len(joints), 3))
