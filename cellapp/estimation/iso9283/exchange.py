"""Exchangeability E (7.7): difference of attained positions when one arm replaces another of its type, same program.

Attained positions are relative to the measured base of each arm, because the place where an arm is mounted is not a
property of the arm. The standard takes five arms; here there are as many as tests, one of each arm.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from cellapp.estimation.iso9283.records import Exchangeability, IsoValue, PoseCharacteristics
from cellapp.robot.kinematics.transforms import Array


def exchangeability(means: Array) -> Array:
    """Compute E at each pose (m,) [m]: largest distance between the mean attained positions (k, m, 3) [m] of k arms.

    Raise ``ValueError`` for fewer than two arms.
    """
    if len(means) < 2:
        raise ValueError("exchangeability needs two arms or more")
    return np.asarray(
        np.max([np.linalg.norm(means[a] - means[b], axis=-1) for a, b in combinations(range(len(means)), 2)], axis=0)
    )


def exchanged(
    own: tuple[PoseCharacteristics, ...], other: tuple[PoseCharacteristics, ...], where: str
) -> Exchangeability | None:
    """Compute E of two tests at their worst common pose; None without one. ``where`` names the other test's run."""
    theirs = {pose.pose: pose for pose in other}
    both = [(pose, theirs[pose.pose]) for pose in own if pose.pose in theirs]
    if not both:
        return None
    errors = np.array([[pose.error_mm for pose in column] for column in zip(*both, strict=True)])
    at_poses = exchangeability(errors)
    worst = int(np.argmax(at_poses))
    expanded = [pose.accuracy.expanded_mm for pose in both[worst]]
    known = [value for value in expanded if value is not None]
    return Exchangeability(
        with_run=where,
        pose=both[worst][0].pose,
        value=IsoValue(
            value_mm=float(at_poses[worst]),
            expanded_mm=math.hypot(*known) if len(known) == 2 else None,
            n=min(pose.accuracy.n for pose in both[worst]),
        ),
    )
