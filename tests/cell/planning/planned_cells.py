"""Cells to plan in, and plans made by hand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.planning.planned_stops import Configuration, PlannedStops, Route, routes, straight_stops
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, refuse_motion
from cellapp.ground.profile import Profile
from tests.sure import sure
from tests.twin import altered, small_twin, with_arm


def some_stops(count: int, seed: int = 3, *, loads: bool = False) -> PlannedStops:
    """``count`` stops of the arms left and right of the twin, in blocks of two; not for driving."""
    rng = np.random.default_rng(seed)
    q = {name: rng.uniform(-1.0, 1.0, (count, 6)) for name in ("left", "right")}
    start = {name: rows + rng.choice([-0.05, 0.05], rows.shape) for name, rows in q.items()}
    start["left"][::3] = np.nan
    between = {name: rng.uniform(-1.0, 1.0, 6) for name in q}
    legs = [(between, {"right": between["right"] + 0.1}) if stop % 3 == 0 else () for stop in range(count)]
    return PlannedStops(
        q=q,
        approach_from=start,
        dwell_s={"left": rng.uniform(0.0, 3.0, count), "right": np.zeros(count)},
        legs=tuple(legs),
        block=np.arange(count, dtype=np.intp) // 2,
        repeat_of=np.where(np.arange(count) == 3, 0, -1).astype(np.intp),
        frozen=np.arange(count) == 2,
        load=np.arange(count, dtype=np.intp) // 4 if loads else np.zeros(count, dtype=np.intp),
        proposed=np.zeros(count, dtype=np.bool_),
    )


def same_stops(first: PlannedStops, second: PlannedStops) -> None:
    """Assert that two plans are the same bit for bit."""
    assert list(first.q) == list(second.q)
    for name in first.q:
        np.testing.assert_array_equal(first.q[name], second.q[name])
        np.testing.assert_array_equal(first.approach_from[name], second.approach_from[name])
        np.testing.assert_array_equal(first.dwell_s[name], second.dwell_s[name])
    assert [[sorted(leg) for leg in legs] for legs in first.legs] == [
        [sorted(leg) for leg in legs] for legs in second.legs
    ]
    for ours, theirs in zip(first.legs, second.legs, strict=True):
        for one, other in zip(ours, theirs, strict=True):
            for name in one:
                np.testing.assert_array_equal(one[name], other[name])
    for kind in ("block", "repeat_of", "frozen", "load", "proposed"):
        np.testing.assert_array_equal(getattr(first, kind), getattr(second, kind))


def drivable_stops(count: int, step: np.ndarray, seed: int = 0) -> PlannedStops:
    """Visible stops of the twin that can be reached at once, one arm after the other, and from home.

    The last motion of the arm left to each is ``step`` (N,) [rad], that of the right one the opposite.
    """
    profile = small_twin(8 * count).model_copy(update={"seed": seed})
    cell, homes = cell_bodies(profile), home_positions(profile)
    drawn = straight_stops(plan_stops(profile))
    for name, sign in (("left", 1.0), ("right", -1.0)):
        drawn.approach_from[name][:] = drawn.q[name] - sign * step

    def reached(here: Configuration, route: Route) -> bool:
        for motion in route:
            there = {**here, **motion}
            if refuse_motion(cell, here, there):
                return False
            here = there
        return True

    chosen: list[int] = []
    here: Configuration = homes
    for stop in range(len(drawn)):
        ways = list(routes(drawn, stop, as_planned=True))
        if len(chosen) < count and all(reached(one, way) for way in ways for one in (here, homes)):
            chosen.append(stop)
            here = drawn.targets(stop)
    assert len(chosen) == count
    return drawn.take(chosen)


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
    third = altered(right, base={"position": (-0.6, -2.2, 0.0)})
    return profile.model_copy(update={"arms": {**profile.arms, "third": third}})


def seven_joints(stops: int = 12, **plan: Any) -> Profile:
    """The twin whose left arm stands on one more joint, which turns about the same axis as the first."""
    profile = planned_twin(stops, **plan)
    left = profile.arms["left"]
    turntable = left.type.joints[0].model_copy(update={"d": 0.0, "alpha": 0.0, "mass": 0.0})
    capsules = tuple(one.model_copy(update={"frame": one.frame + 1}) for one in left.type.capsules)
    kind = {"joints": (turntable, *left.type.joints), "capsules": capsules}
    return with_arm(profile, "left", type=kind, home=(0.0, *sure(left.home)))


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
