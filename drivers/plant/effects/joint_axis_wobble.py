"""Bearings whose races are out of flat: the axis tilts a little as the joint turns, twice and three times a turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection

_BALLS = 2.0 * np.pi * np.arange(24) / 24
_CONTACTS = 1.0 + 0.6 * np.cos(_BALLS) + 0.3 * np.cos(2.0 * _BALLS)
"""Stiffness of the seat under each ball: the housing is bolted on one side."""


def _rests() -> Array:
    """What takes the race's heights over the balls (24,) into rise, slope along x and slope along y, (3, 24)."""
    planes = np.stack([np.ones_like(_BALLS), np.cos(_BALLS), np.sin(_BALLS)])
    weighted = planes * _CONTACTS
    rests: Array = np.linalg.solve(weighted @ planes.T, weighted)
    return rests


def tilt_of_two_lobes() -> float:
    """Tilt of the axis, in units of the height of two lobes over the radius of the race: its rms over a turn."""
    turns = np.linspace(0.0, np.pi, 90, endpoint=False)
    slopes = _rests()[1:] @ np.cos(2.0 * (_BALLS[:, None] - turns))
    return float(np.sqrt((slopes**2).sum(axis=0).mean()))


@dataclass(frozen=True, eq=False)
class JointAxisWobble(Effect):
    """A race with two and three lobes turns on balls and settles on the plane that strains them least.

    The seat is not equally stiff all round, or the lobes would lift the race without tilting it. One lobe would be a
    fixed tilt of the axis, which is geometry. Sizes: a tilt of 5 to 20 urad (an estimate).
    """

    joints: np.ndarray
    radius: Array
    two_lobes: Array
    three_lobes: Array
    phase: Array

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        n, count = situation.q.shape
        twists = np.zeros((n, count, 6))
        base = np.zeros((n, 6))
        rests = _rests()
        turned = _BALLS - (situation.q[:, self.joints] + self.phase)[..., None]
        heights = self.two_lobes[:, None] * np.cos(2.0 * turned) + self.three_lobes[:, None] * np.cos(3.0 * turned)
        rise, x, y = np.moveaxis(heights @ rests.T, -1, 0)
        for k, joint in enumerate(self.joints):
            # the axis lies along z of the frame before it
            twist = base if joint == 0 else twists[:, joint - 1]
            twist[:, 2] = rise[:, k]
            twist[:, 3] = y[:, k] / self.radius[k]
            twist[:, 4] = -x[:, k] / self.radius[k]
        return Deflection(base=base, links=twists)


def joint_axis_wobble(parameters: Parameters) -> Effect:
    """``joints``: numbers from 1; for each ``radius`` [m], ``two_lobes``, ``three_lobes`` [m], ``phase`` [rad]."""
    parameters.only("joints", "radius", "two_lobes", "three_lobes", "phase")
    joints = parameters.joint_numbers("joints")
    return JointAxisWobble(
        joints,
        parameters.numbers("radius", len(joints), above=0.0),
        parameters.numbers("two_lobes", len(joints), least=0.0),
        parameters.numbers("three_lobes", len(joints), least=0.0),
        parameters.numbers("phase", len(joints)),
    )
