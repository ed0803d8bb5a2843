"""Ways round what blocks the straight one: the gate accepts every leg; what cannot be reached has a reason."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from cellapp.cell.planning.balance import correlations
from cellapp.cell.planning.duration import motion_s, route_s, stop_times_of
from cellapp.cell.planning.plan import draw_stops
from cellapp.cell.planning.planned_stops import straight_stops
from cellapp.cell.planning.sequence import nearest_turns, sequenced
from cellapp.cell.planning.transit_paths import ArmRoadmap, TransitPath, TransitPlanner, random_tree_path
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, refuse_motion
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import BoxObstacle, CylinderObstacle, Placement
from tests.cell.planning.hand_made import some_stops
from tests.cell.planning.planned_cells import one_arm, planned_twin, refusals

OUT = np.array([0.0, -0.6, 0.3, -1.0, 0.3, 0.2])
"""Joint positions with which the left arm is stretched out."""


def with_pillar(profile: Profile) -> Profile:
    """A pillar where the left arm stretches out to, and a table between the arms."""
    x, y, _ = place(cell_bodies(profile).arms["left"], OUT[None]).smr[0]
    pillar = CylinderObstacle(shape="cylinder", radius=0.05, length=1.4, pose=Placement(position=(x, y, 0.5)))
    table = BoxObstacle(shape="box", size=(0.5, 0.4, 0.3), pose=Placement(position=(-0.5, 0.0, -0.05)))
    return profile.model_copy(update={"obstacles": {"pillar": pillar, "table": table}})


def both_sides(cell: CellBodies) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The left arm stretched out on either side of the pillar; the straight way leads through it."""
    here, there = ({"left": OUT + np.array([turn, 0.0, 0.0, 0.0, 0.0, 0.0])} for turn in (-0.5, 0.5))
    assert not refuse_motion(cell, here, here)
    assert not refuse_motion(cell, there, there)
    assert "pillar" in refuse_motion(cell, here, there)
    return here, there


def replay(cell: CellBodies, here: dict[str, np.ndarray], way: TransitPath, there: dict[str, np.ndarray]) -> list[str]:
    found = []
    for leg in (*way.legs, there):
        after = {**here, **leg}
        found.append(refuse_motion(cell, here, after))
        here = after
    return [one for one in found if one]


def test_a_way_leads_round_a_pillar() -> None:
    profile = with_pillar(one_arm())
    cell = cell_bodies(profile)
    here, there = both_sides(cell)
    way = TransitPlanner(profile, cell, np.random.default_rng(0)).find(here, there)
    assert isinstance(way, TransitPath)
    assert way.legs
    assert replay(cell, here, way, there) == []
    assert way.seconds == pytest.approx(route_s(profile, here, (*way.legs, there)))
    home = home_positions(profile)
    assert way.seconds <= route_s(profile, here, (home, there)) + 1e-9


@pytest.mark.fast
def test_a_random_tree_leads_round_a_pillar() -> None:
    cell = cell_bodies(with_pillar(one_arm()))
    here, there = both_sides(cell)
    path = random_tree_path(cell, here, there, np.random.default_rng(0))
    assert path
    stations = [here, *path, there]
    assert not any(refuse_motion(cell, a, b) for a, b in pairwise(stations))


def test_arms_that_would_meet_go_another_way() -> None:
    profile = planned_twin(200)
    cell = cell_bodies(profile)
    drawn = draw_stops(cell, profile, 200, np.random.default_rng(4))
    q = {name: nearest_turns(profile, cell, name, rows) for name, rows in drawn.items()}
    stops = [{name: rows[k] for name, rows in q.items()} for k in range(200)]
    meeting = [one for one in pairwise(stops) if refuse_motion(cell, *one).startswith("arms ")][:3]
    finder = TransitPlanner(profile, cell, np.random.default_rng(0))
    found = [finder.find(*one) for one in meeting]
    assert any(isinstance(way, TransitPath) for way in found)
    for (here, there), way in zip(meeting, found, strict=True):
        assert not isinstance(way, TransitPath) or replay(cell, here, way, there) == []


@pytest.mark.fast
def test_roadmaps_know_what_the_limits_shut_off() -> None:
    """With limits of half a turn, wrist 1 beyond a quarter turn is on the other side of the forearm."""
    profile = one_arm()
    left = profile.arms["left"].model_copy(update={"limits": ((-math.pi, math.pi),) * 6})
    profile = profile.model_copy(update={"arms": {"left": left}})
    roadmap = ArmRoadmap(profile, cell_bodies(profile), "left", np.random.default_rng(0))
    home = roadmap.rest
    beyond = home + np.array([0.0, 0.0, 0.0, math.radians(240.0), 0.0, 0.0])
    near = home + np.array([0.5, 0.2, 0.1, 0.3, 0.0, 0.0])
    below = home + np.array([0.0, 2.4, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(roadmap.reaches(np.array([near, beyond, below, home])), [True, False, False, True])
    path = roadmap.path(near, home)
    assert path is not None
    assert len(path) == 0


def test_an_arm_without_home_has_a_roadmap() -> None:
    profile = one_arm()
    arm = profile.arms["left"].model_copy(update={"home": None})
    profile = profile.model_copy(update={"arms": {"left": arm}})
    cell = cell_bodies(profile)
    roadmap = ArmRoadmap(profile, cell, "left", np.random.default_rng(0))
    q = draw_stops(cell, profile, 12, np.random.default_rng(0))
    assert roadmap.reaches(q["left"]).mean() > 0.5
    found = sequenced(profile, cell, q, np.random.default_rng(0))
    first = {name: rows[0] for name, rows in found.stops.approach_from.items()}
    assert refusals(cell, found.stops, first) == []


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_plans_among_obstacles_pass_the_gate(seed: int) -> None:
    profile = with_pillar(planned_twin(16))
    cell, homes = cell_bodies(profile), home_positions(profile)
    chosen = draw_stops(cell, profile, 20, np.random.default_rng(seed))
    found = sequenced(profile, cell, chosen, np.random.default_rng(seed))
    assert len(found.stops) >= 14
    assert refusals(cell, found.stops, homes, homes) == []


@pytest.mark.fast
def test_times_of_stops_are_those_of_their_motions() -> None:
    profile = planned_twin(6)
    stops = some_stops(6)
    times = stop_times_of(profile, stops)
    here = home_positions(profile)
    for stop in range(6):
        begin = {**stops.targets(stop), **stops.approach_starts(stop)}
        route = (*stops.legs[stop], begin, stops.targets(stop))
        assert times.moving_s[stop] == pytest.approx(route_s(profile, here, route))
        here = stops.targets(stop)
    straight = straight_stops(stops.q)
    ways = {name: np.diff(q, axis=0) for name, q in stops.q.items()}
    expected = np.max([motion_s(profile.arms[name], way) for name, way in ways.items()], axis=0)
    np.testing.assert_allclose(stop_times_of(profile, straight).moving_s[1:], expected)


@pytest.mark.fast
def test_a_confounded_factor_is_found() -> None:
    """All last motions of joint 2 come from above where its sine is positive."""
    profile = planned_twin(40)
    rng = np.random.default_rng(0)
    stops = straight_stops({name: rng.uniform(-2.0, 2.0, (40, 6)) for name in profile.arms})
    for name, q in stops.q.items():
        step = rng.choice([-0.1, 0.1], q.shape)
        step[:, 1] = np.where(np.sin(q[:, 1]) > 0.0, 0.1, -0.1) if name == "left" else step[:, 1]
        stops.approach_from[name][:] = q - step
    found = correlations(profile, cell_bodies(profile), stops)
    worst = max(found, key=lambda one: abs(one.correlation) * one.factor.startswith("approach"))
    assert worst.factor == "approach side of joint 2 of left"
    assert worst.other == "sin q2 of left"
    assert worst.correlation > 0.8
