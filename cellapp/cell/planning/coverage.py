"""How much of the range of each joint a plan uses."""

from __future__ import annotations

import numpy as np

from cellapp.cell.planning.records import JointCoverage
from cellapp.robot.kinematics.transforms import Array


def joint_coverage(ranges: Array, q: Array) -> tuple[JointCoverage, ...]:
    """Compute what configurations ``q`` (n, N) [rad] use of the ``ranges`` (N, 2) [rad], and the largest gaps."""
    within = np.clip(q, ranges[:, 0], ranges[:, 1])
    sorted_q = np.sort(np.concatenate([ranges.T, within]), axis=0)
    gaps = np.diff(sorted_q, axis=0).max(axis=0)
    return tuple(
        JointCoverage(
            joint=j + 1,
            allowed=(float(ranges[j, 0]), float(ranges[j, 1])),
            used=(float(within[:, j].min()), float(within[:, j].max())),
            largest_gap=float(gaps[j]),
        )
        for j in range(q.shape[1])
    )
