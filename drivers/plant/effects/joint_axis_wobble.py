"""Bearing races that are not flat: the axis tilts with two and three cycles per revolution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection
from drivers.plant.random_functions import RandomWaves

_BALLS = 2.0 * np.pi * np.arange(24) / 24
_CONTACTS = 1.0 + 0.6 * np.cos(_BALLS) + 0.3 * np.cos(2.0 * _BALLS)
"""Relative stiffness of the seat under each ball; uneven, because the housing is bolted on one side."""


def _plane_fit() -> Array:
    """Return the matrix (3, 24) from the race's heights at the balls to rise, slope along x and slope along y."""
    planes = np.stack([np.ones_like(_BALLS), np.cos(_BALLS), np.sin(_BALLS)])
    weighted = planes * _CONTACTS
    fit: Array = np.linalg.solve(weighted @ planes.T, weighted)
    return fit


def tilt_of_two_lobes() -> float:
    """Return the rms tilt of the axis over a revolution, per unit height of two lobes divided by the race's radius."""
    turns = np.linspace(0.0, np.pi, 90, endpoint=False)
    slopes = _plane_fit()[1:] @ np.cos(2.0 * (_BALLS[:, None] - turns))
    return float(np.sqrt((slopes**2).sum(axis=0).mean()))


@dataclass(frozen=True, eq=False)
class JointAxisWobble(Effect):
    """A race with two and three lobes rotates on balls and takes the plane of least strain energy.

    The seat is not equally stiff all round; otherwise the lobes would lift the race without tilting it. One lobe would
    be a constant tilt of the axis, which belongs to the geometry. Sizes: a tilt of 5 to 20 urad (an estimate).
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
        fit = _plane_fit()
        angles = _BALLS - (situation.q[:, self.joints] + self.phase)[..., None]
        heights = self.two_lobes[:, None] * np.cos(2.0 * angles) + self.three_lobes[:, None] * np.cos(3.0 * angles)
        rise, x, y = np.moveaxis(heights @ fit.T, -1, 0)
        for k, joint in enumerate(self.joints):
            # the axis is z of the previous frame
            twist = base if joint == 0 else twists[:, joint - 1]
            twist[:, 2] = rise[:, k]
            twist[:, 3] = y[:, k] / self.radius[k]
            twist[:, 4] = -x[:, k] / self.radius[k]
        return Deflection(base=base, links=twists)


@dataclass(frozen=True, eq=False)
class HarmonicWobble(Effect):
    """The axis tilts with any harmonics of its own angle, with different phases about x and y.

    About each of the two perpendicular axes the tilt is ``tilt`` [rad] times a sum of harmonics with random phases. One
    cycle per revolution is therefore an ellipse; only its circular part belongs to the geometry.
    """

    joints: np.ndarray
    tilt: Array
    waves: tuple[RandomWaves, ...]

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        n, count = situation.q.shape
        twists, base = np.zeros((n, count, 6)), np.zeros((n, 6))
        for joint, tilt, waves in zip(self.joints, self.tilt, self.waves, strict=True):
            twist = base if joint == 0 else twists[:, joint - 1]
            twist[:, 3:5] = tilt * waves.at(situation.q[:, joint])
        return Deflection(base=base, links=twists)


def joint_axis_wobble(parameters: Parameters) -> Effect:
    """Build wobble. ``joints``: from 1; for each ``radius``, ``two_lobes``, ``three_lobes`` [m], ``phase`` [rad].

    With ``law`` harmonics instead: ``joints``, for each ``tilt`` [rad]; ``harmonics`` (cycles per revolution), as many
    ``shares``, and a ``seed`` of the phases.
    """
    law, parameters = parameters.by_law("lobes", "harmonics")
    if law == "harmonics":
        parameters.require("joints", "tilt", "harmonics", "shares", "seed")
        joints = parameters.joint_numbers("joints")
        return HarmonicWobble(joints, parameters.numbers("tilt", len(joints)), random_waves(parameters, len(joints), 2))
    parameters.require("joints", "radius", "two_lobes", "three_lobes", "phase")
    joints = parameters.joint_numbers("joints")
    return JointAxisWobble(
        joints,
        parameters.numbers("radius", len(joints), above=0.0),
        parameters.numbers("two_lobes", len(joints), least=0.0),
        parameters.numbers("three_lobes", len(joints), least=0.0),
        parameters.numbers("phase", len(joints)),
    )


def random_waves(parameters: Parameters, joints: int, directions: int) -> tuple[RandomWaves, ...]:
    """Draw sums of ``harmonics`` with ``shares`` by ``seed`` for some joints, each in ``directions`` directions."""
    harmonics = parameters.numbers("harmonics", parameters.length("harmonics"), least=1.0)
    shares = parameters.numbers("shares", len(harmonics))
    rng = np.random.default_rng(parameters.integer("seed", least=0))
    return tuple(RandomWaves.drawn(rng, directions, harmonics, shares) for _ in range(joints))
