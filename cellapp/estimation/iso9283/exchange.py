"""Exchangeability E (7.7): how far arms of one type miss each other when one takes another's place with its programme.

Attained positions are taken relative to the base of each arm, as each base was found: where an arm is bolted down is no
property of the arm. The norm takes five arms; here are as many as there are tests, one of each arm.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from cellapp.estimation.iso9283.records import Exchangeability, IsoValue, PoseCharacteristics
from cellapp.robot.kinematics.transforms import Array


def exchangeability(means: Array) -> Array:
    """E at each pose (m,) [m]: largest distance between the mean attained positions (k, m, 3) [m] of k arms.

    Raises ``ValueError`` for fewer than two arms.
    """
    if len(means) < 2:
        raise ValueError("exchangeability needs two arms or more")
    return np.asarray(
        np.max([np.linalg.norm(means[a] - means[b], axis=-1) for a, b in combinations(range(len(means)), 2)], axis=0)
    )


def exchanged(
    own: tuple[PoseCharacteristics, ...], other: tuple[PoseCharacteristics, ...], where: str
) -> Exchangeability | None:
    """E of two tests of the same poses, the worst pose; None without a common pose. ``where`` is the other test."""
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
