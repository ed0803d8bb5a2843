"""Cells for tests of planned stops: one, two and three arms, seven joints; replay of a plan through the gate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cellapp.cell.planning.planned_stops import PlannedStops
from cellapp.cell.safety.gate import CellBodies, refuse_motion
from cellapp.ground.profile import Profile
from tests.twin import small_twin


def planned_twin(stops: int = 30, **plan: Any) -> Profile:
    """The twin; keys of its section ``plan`` changed."""
    return small_twin(stops, plan={"reserve": 0, **plan})


def one_arm(stops: int = 12, **plan: Any) -> Profile:
    """The left arm alone."""
    profile = planned_twin(stops, **plan)
    return profile.model_copy(update={"arms": {"left": profile.arms["left"]}})


def three_arms(stops: int = 12, **plan: Any) -> Profile:
    """The twin with a second UR5 behind the first."""
    profile = planned_twin(stops, **plan)
    right = profile.arms["right"]
    assert right.base is not None
    third = right.model_copy(update={"base": right.base.model_copy(update={"position": (-0.6, -2.2, 0.0)})})
    return profile.model_copy(update={"arms": {**profile.arms, "third": third}})


def seven_joints(stops: int = 12, **plan: Any) -> Profile:
    """The twin whose left arm stands on one more joint, which turns about the same axis as the first."""
    profile = planned_twin(stops, **plan)
    left = profile.arms["left"]
    turntable = left.type.joints[0].model_copy(update={"d": 0.0, "alpha": 0.0, "mass": 0.0})
    capsules = tuple(one.model_copy(update={"frame": one.frame + 1}) for one in left.type.capsules)
    kind = left.type.model_copy(update={"joints": (turntable, *left.type.joints), "capsules": capsules})
    assert left.home is not None
    arms = {**profile.arms, "left": left.model_copy(update={"type": kind, "home": (0.0, *left.home)})}
    return profile.model_copy(update={"arms": arms})


def refusals(
    cell: CellBodies, stops: PlannedStops, start: Mapping[str, np.ndarray], end: Mapping[str, np.ndarray] | None = None
) -> list[str]:
    """What the gate refuses of the motions of a plan, from ``start`` through every leg, and of the way to ``end``."""
    here, found = dict(start), []
    for stop in range(len(stops)):
        begin = {**stops.targets(stop), **stops.approach_starts(stop)}
        for targets in (*stops.legs[stop], begin, stops.targets(stop)):
            there = {**here, **targets}
            found.append(refuse_motion(cell, here, there))
            here = there
    if end is not None:
        found.append(refuse_motion(cell, here, end))
    return [one for one in found if one]
