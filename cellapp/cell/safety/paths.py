"""Paths of arms as samples, with bounds on how far a body can be from its position at the nearest sample."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.bodies import ArmBodies, Placed, place
from cellapp.robot.kinematics.transforms import Array

EVERY = 2
"""Stride of the samples that are checked against other arms, where all pairs of samples are compared. Other checks use
all samples. The coarser spacing is added to the clearance."""
STRIDE = 8
"""Stride of the coarse samples, which are checked first; a multiple of 2 * ``EVERY``."""


@dataclass(frozen=True, eq=False)
class SampledPath:
    """Evenly spaced samples of one arm's path; no point of a body is farther than ``deviation`` [m] from its nearest.

    Most of a path is far from everything. Therefore every ``STRIDE``-th sample is checked first. Bodies are placed at
    the samples around it only where a body, displaced as far as possible, could come too near.
    """

    arm: ArmBodies
    start: Array
    target: Array
    count: int

    @cached_property
    def half_step(self) -> Array:
        """Largest motion of each joint from any point of the path to the nearest sample, shape (N,) [rad]."""
        return np.asarray(np.abs(self.target - self.start) * (0.5 / (self.count - 1)))

    @cached_property
    def deviation(self) -> float:
        """Largest displacement of any point of a body relative to its place at the nearest sample [m]."""
        return float(self.half_step @ self.arm.levers)

    @cached_property
    def deviations(self) -> Array:
        """``deviation`` of each body, shape (m,) [m]."""
        return np.asarray(self.arm.body_levers @ self.half_step)

    @property
    def spread(self) -> float:
        """Largest displacement of a point of a body at a sample relative to the nearest coarse sample [m]."""
        return STRIDE * self.deviation

    @cached_property
    def coarse(self) -> np.ndarray:
        """Indices of every ``STRIDE``-th sample and of the last one."""
        return np.append(np.arange(0, self.count - 1, STRIDE), self.count - 1)

    @cached_property
    def coarse_bodies(self) -> Placed:
        """The bodies at the coarse samples."""
        return self.placed(self.coarse)

    def placed(self, samples: np.ndarray) -> Placed:
        """Place the bodies at some of the samples."""
        share = np.where(samples == self.count - 1, 1.0, samples * (1.0 / (self.count - 1)))
        return place(self.arm, self.start + share[:, None] * (self.target - self.start))

    def around(self, doubtful: np.ndarray, every: int = 1) -> np.ndarray:
        """Return, of every ``every``-th sample, those nearest to the ``doubtful`` ones (bool) of the coarse samples."""
        near = self.coarse[doubtful][:, None] + np.arange(-(STRIDE // 2), STRIDE // 2 + 1)
        chosen = np.zeros(self.count, dtype=bool)
        chosen[np.clip(near, 0, self.count - 1)] = True
        return np.flatnonzero(chosen[::every]) * every


def sample_path(arm: ArmBodies, start: Array, target: Array, spacing: float) -> SampledPath:
    """Sample a path so that no point of a body moves more than ``spacing`` [m] in ``EVERY`` steps."""
    return SampledPath(arm, start, target, int(sample_counts(arm, start[None], target[None], spacing)[0]))


def sample_counts(arm: ArmBodies, start: Array, target: Array, spacing: float) -> NDArray[np.intp]:
    """Return the number of samples (n,) of n such paths."""
    longest = np.abs(target - start) @ arm.levers
    return np.asarray(EVERY * np.maximum(1, np.ceil(longest / spacing)) + 1, dtype=np.intp)
