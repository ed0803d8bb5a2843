"""Configurations that represent the workspace: where targets will be, whichever way the SMR faces."""

from __future__ import annotations

import numpy as np

from cellapp.cell.planning.joint_draws import joint_ranges
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.gate import CellBodies, clear_alone
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array

_MOST_BATCHES = 50
"""Number of batches after which drawing ends where hardly any configuration is clear."""


def workspace_configurations(
    profile: Profile, cell: CellBodies, name: str, count: int, rng: np.random.Generator
) -> Array:
    """Draw ``count`` configurations (count, N) [rad], uniform in the plan's joint ranges where the arm is clear.

    The tracker need not see them: targets are work, not measurements. Fewer where hardly any is clear.
    """
    low, high = joint_ranges(cell, profile, name).T
    found: list[Array] = []
    for _ in range(_MOST_BATCHES):
        q = rng.uniform(low, high, size=(4 * count, len(low)))
        found.append(q[clear_alone(cell, place(cell.arms[name], q))])
        if sum(map(len, found)) >= count:
            break
    return np.concatenate(found)[:count]
