"""Complete the profile of a cell in which nothing moves, so that commands can be computed from its readings alone."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Arm, Pose, Profile

UNPLACED = (
    "the profile does not say where arms and tracker stand: limits of the joints and the arms' own bodies were"
    " checked, floor, obstacles and the tracker's view were not; of several solutions the one nearest to the measured"
    " configurations is taken"
)
"""Note that must accompany commands for such a cell."""
_ORIGIN = Pose(position=(0.0, 0.0, 0.0))


def is_unplaced(profile: Profile) -> bool:
    """Return whether nothing can be driven, and something that only motion needs is not stated."""
    arms = profile.arms.values()
    if any(arm.driver.has_device for arm in arms):
        return False
    return profile.tracker.pose is None or any(arm.base is None or arm.home is None for arm in arms)


def commanded_profile(profile: Profile, readings: Mapping[str, Readings]) -> Profile:
    """Return the profile for computing commands: that of the readings, completed if it ``is_unplaced``.

    Then the tracker's frame is the cell's, there is no floor, and each arm's home is a measured configuration. The
    poses of the bases come from the calibrated model.
    """
    if not is_unplaced(profile):
        return profile
    arms = {name: _completed(arm, readings.get(name)) for name, arm in profile.arms.items()}
    plan = profile.plan.model_copy(update={"floor": -math.inf, "ceiling": None})
    tracker = profile.tracker.model_copy(update={"pose": _ORIGIN})
    return profile.model_copy(update={"arms": arms, "plan": plan, "tracker": tracker, "obstacles": {}})


# -- inside -----------------------------------------------------------------------------------------------------------


def _completed(arm: Arm, readings: Readings | None) -> Arm:
    home = arm.home if arm.home is not None or readings is None else _usual(readings)
    smr = arm.smr.model_copy(update={"acceptance": math.pi})  # visibility does not matter here
    return arm.model_copy(update={"base": _ORIGIN, "home": home, "smr": smr})


def _usual(readings: Readings) -> tuple[float, ...]:
    """Return the measured configuration nearest to the median of all [rad]."""
    away = np.abs(readings.q - np.median(readings.q, axis=0)).max(axis=1)
    return tuple(readings.q[int(np.argmin(away))].tolist())
