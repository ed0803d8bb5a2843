"""Approaches to a pose: the last step of each joint and the dwell before the measurement."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from cellapp.robot.effects import DriverVariable
from cellapp.robot.kinematics.transforms import Array

STEPS_RAD = (0.03, 0.5)
"""Small and large last step of a joint [rad]: within and far beyond the play and wind-up of a gear (1e-4 to 1e-3)."""
DWELLS_S = (0.5, 5.0)
"""Short and long rest before a measurement [s]: within and beyond the settling of an arm (about 1 s)."""


@dataclass(frozen=True, eq=False)
class Approaches:
    """The approaches (f of them) to each pose of one arm.

    ``steps`` (n, f, N) are last steps [rad], all zero without a detour; ``dwells`` (f,) [s].
    """

    steps: Array
    dwells: Array

    def __len__(self) -> int:
        return len(self.dwells)

    def first(self, poses: int) -> Approaches:
        """Return the approaches to the first ``poses`` poses."""
        return Approaches(self.steps[:poses], self.dwells)

    def needed_for(self, variables: Collection[DriverVariable]) -> Approaches:
        """Leave out detours and dwells that no variable depends on."""
        steps, dwells = self.steps, self.dwells
        if DriverVariable.DWELL not in variables:
            steps, dwells = steps[:, :: len(DWELLS_S)], np.zeros(len(dwells) // len(DWELLS_S))
        if not {DriverVariable.APPROACH, DriverVariable.STEP} & set(variables):
            dwells = np.unique(dwells)
            steps = np.zeros((len(steps), len(dwells), steps.shape[2]))
        return Approaches(steps, dwells)


def all_approaches(poses: int, joints: int, rng: np.random.Generator) -> Approaches:
    """Combine each of 12 last steps with each dwell.

    Signs: all joints forward, all backward, two opposite mixtures. Sizes: small, large, mixed.
    """
    mixed = rng.choice([-1.0, 1.0], (poses, 1, joints))
    forward = np.ones((poses, 1, joints))
    signs = np.concatenate([forward, -forward, mixed, -mixed], axis=1)
    small, large = STEPS_RAD
    sizes = (np.full(signs.shape, small), np.full(signs.shape, large), rng.choice(STEPS_RAD, signs.shape))
    steps = np.concatenate([signs * size for size in sizes], axis=1)
    return Approaches(np.repeat(steps, len(DWELLS_S), axis=1), np.tile(np.array(DWELLS_S), steps.shape[1]))
