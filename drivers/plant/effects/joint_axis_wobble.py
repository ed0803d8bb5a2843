"""Bearing races that are not flat: the axis tilts with two and three cycles per revolution."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import (
    JOINTS,
    NOT_NEGATIVES,
    NUMBERS,
    POSITIVES,
    SEED,
    Factory,
    Offset,
    Parameters,
    PlantEffect,
    Read,
    Situation,
    before_joints,
    by,
    by_law,
    made,
)
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


def _lobes(
    situation: Situation, joints: np.ndarray, radius: Array, two_lobes: Array, three_lobes: Array, phase: Array
) -> Deflection:
    """A race with two and three lobes rotates on balls and takes the plane of least strain energy.

    The seat is not equally stiff all round; otherwise the lobes would lift the race without tilting it. One lobe would
    be a constant tilt of the axis, which belongs to the geometry. Sizes: a tilt of 5 to 20 urad (an estimate).
    """
    angles = _BALLS - (situation.q[:, joints] + phase)[..., None]
    heights = two_lobes[:, None] * np.cos(2.0 * angles) + three_lobes[:, None] * np.cos(3.0 * angles)
    rise, x, y = np.moveaxis(heights @ _plane_fit().T, -1, 0)
    none = np.zeros_like(rise)  # the axis is z of the previous frame
    twists = np.stack([none, none, rise, y / radius, -x / radius, none], axis=-1)
    return before_joints(situation, joints, twists)


def waving(
    situation: Situation, joints: np.ndarray, sizes: Array, waves: tuple[RandomWaves, ...], part: slice
) -> Deflection:
    """Return the deviation by axes that move with harmonics of their own angle, in a ``part`` of the twist of each."""
    twists = np.zeros((len(situation.q), len(joints), 6))
    for k, (joint, own) in enumerate(zip(joints, waves, strict=True)):
        twists[:, k, part] = sizes[k] * own.at(situation.q[:, joint])
    return before_joints(situation, joints, twists)


def _harmonic(joints: np.ndarray, tilt: Array, waves: tuple[RandomWaves, ...]) -> PlantEffect:
    """Make an axis that tilts with any harmonics of its own angle, with different phases about x and y.

    About each of the two perpendicular axes the tilt is ``tilt`` [rad] times a sum of harmonics with random phases. One
    cycle per revolution is therefore an ellipse; only its circular part belongs to the geometry.
    """
    return Offset(waving, {"joints": joints, "sizes": tilt, "waves": waves, "part": slice(3, 5)})


def _own_length(parameters: Parameters, key: str) -> Array:
    return parameters.numbers(key, parameters.length(key), least=1.0)


def _shares(parameters: Parameters, key: str) -> Array:
    return parameters.numbers(key, parameters.length("harmonics"))


def with_waves(effect: Callable[..., PlantEffect], directions: int, **reads: Read) -> Factory:
    """Return the factory of an effect with ``waves`` of each joint: sums of ``harmonics`` with ``shares``, their phases
    sampled by ``seed`` in ``directions`` directions."""

    def build(harmonics: Array, shares: Array, seed: int, **values: Any) -> PlantEffect:
        rng = np.random.default_rng(seed)
        waves = [RandomWaves.sampled(rng, directions, harmonics, shares) for _ in values["joints"]]
        return effect(**values, waves=tuple(waves))

    return made(build, **reads, harmonics=_own_length, shares=_shares, seed=SEED)


_LOBES: Mapping[str, Read] = dict.fromkeys(("two_lobes", "three_lobes"), NOT_NEGATIVES)

joint_axis_wobble = by_law(
    lobes=made(by(Offset, _lobes), joints=JOINTS, radius=POSITIVES, **_LOBES, phase=NUMBERS),
    harmonics=with_waves(_harmonic, directions=2, joints=JOINTS, tilt=NUMBERS),
)
"""``joints``: from 1; for each ``radius``, ``two_lobes``, ``three_lobes`` [m], ``phase`` [rad].

With ``law`` harmonics instead: ``joints``, for each ``tilt`` [rad]; ``harmonics`` (cycles per revolution), as many
``shares``, and a ``seed`` of the phases.
"""
