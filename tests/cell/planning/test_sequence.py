"""Planned sequences: the gate accepts every motion, factors correlate with nothing, less travel than by chance."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from cellapp.cell.planning import sequence
from cellapp.cell.planning.balance import correlations, travel_time
from cellapp.cell.planning.plan import sample_stops
from cellapp.cell.planning.planned_stops import PlannedStops, Route, route_s
from cellapp.cell.planning.sequence import nearest_turns, sequenced
from cellapp.cell.planning.transit_paths import TransitPlanner
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, refuse_motion
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import BoxObstacle, CylinderObstacle, Placement
from cellapp.ground.progress import Cancelled, JobToken
from tests.cell.planning.planned_cells import one_arm, planned_twin, refusals, seven_joints, three_arms
from tests.twin import with_arms

SPARE = 1.2
"""Drawn stops for each that is planned: some lie nearer to the floor than motions may come."""


Sequenced = tuple[PlannedStops, list[str]]


def in_order(profile: Profile, chosen: dict[str, np.ndarray], seed: int = 1, **rest) -> Sequenced:
    rng = np.random.default_rng(seed)
    return sequenced(TransitPlanner(profile, cell_bodies(profile), rng), chosen, rng, **rest)


def planned(profile: Profile, seed: int = 1, **rest) -> Sequenced:
    count = math.ceil(SPARE * (profile.plan.stops + profile.plan.reserve))
    chosen = sample_stops(cell_bodies(profile), profile, count, np.random.default_rng(seed))
    return in_order(profile, chosen, seed, **rest)


@cache
def large() -> tuple[Profile, PlannedStops]:
    """A plan of 100 stops of the twin."""
    profile = planned_twin(100, repeats=6, dwell=(0.0, 2.0))
    return profile, planned(profile)[0]


@pytest.mark.parametrize(
    ("make", "stops"),
    [
        (one_arm, 1),
        (one_arm, 12),
        (three_arms, 12),
        (seven_joints, 12),
        (planned_twin, 1),
        (planned_twin, 2),
        (planned_twin, 5),
    ],
)
def test_plans_of_other_cells_and_sizes(make: Callable[[int], Profile], stops: int) -> None:
    profile = make(stops)
    cell, homes = cell_bodies(profile), home_positions(profile)
    plan, _ = planned(profile)
    assert len(plan) == stops
    assert list(plan.q) == list(profile.arms)
    assert refusals(cell, plan, homes, homes) == []
    assert all(abs(one.correlation) <= 1.0 + 1e-9 for one in correlations(profile, cell, plan))


@pytest.mark.parametrize("plane", [{"floor": -0.08}, {"ceiling": 1.75}])
def test_tight_cells_are_planned_with_detours_or_sentences(plane: dict[str, float]) -> None:
    """The arms stand close to a plane, so that many straight ways are blocked."""
    profile = planned_twin(25, **plane)
    cell, homes = cell_bodies(profile), home_positions(profile)
    stops, given_up = planned(profile)
    assert len(stops) >= 20
    assert refusals(cell, stops, homes, homes) == []
    assert all("cannot be reached" in one or "no way" in one for one in given_up)


def test_the_order_saves_travel() -> None:
    profile, stops = large()
    rng = np.random.default_rng(0)
    travel = travel_time(stops, TransitPlanner(profile, cell_bodies(profile), rng), rng)
    assert travel.planned_s < 0.8 * travel.random_order_s  # blocks of 25 stops; with 400 stops more than a third


def test_blocks_are_equal_fair_samples_one_after_the_other() -> None:
    _, stops = large()
    assert np.all(np.diff(stops.block) >= 0)
    sizes = np.bincount(stops.block)
    assert len(sizes) == 4
    assert np.ptp(sizes) <= 4  # one more or less, and the repeats that were inserted
    for q in stops.q.values():
        for function in (np.sin(q), np.cos(q)):
            means = np.array([function[stops.block == block].mean(axis=0) for block in range(4)])
            chance = function.std(axis=0) / math.sqrt(sizes.min())
            assert np.sqrt(np.mean(((means - function.mean(axis=0)) / chance) ** 2)) < 0.8


def test_repeats_come_from_the_other_side_much_later() -> None:
    _, stops = large()
    copies = np.flatnonzero(stops.repeat_of >= 0)
    assert len(copies) == 6
    first = stops.repeat_of[copies]
    assert np.all(copies - first >= 25)
    assert len(set(first.tolist())) == 6
    for name, q in stops.q.items():
        np.testing.assert_array_equal(q[copies], q[first])
        step = q - stops.approach_from[name]
        np.testing.assert_allclose(step[copies], -step[first], atol=1e-12)


def test_joints_near_a_limit_come_from_inside() -> None:
    limits = tuple((-2.6, -0.5) if joint == 1 else (-3.1, 3.1) for joint in range(6))
    profile = with_arms(planned_twin(15), limits=limits)
    stops, _ = planned(profile)
    for name in stops.q:
        start = stops.approach_from[name]
        assert np.nanmin(start[:, 1]) >= -2.6
        assert np.nanmax(start[:, 1]) <= -0.5


def test_reserves_follow_and_are_reached_from_the_asked_stops() -> None:
    profile = planned_twin(12, reserve=4, repeats=2)
    cell, homes = cell_bodies(profile), home_positions(profile)
    stops, _ = planned(profile)
    assert len(stops) == 16
    assert np.all(stops.repeat_of[12:] < 0)
    assert stops.block[12] > stops.block[11]
    assert refusals(cell, stops, homes, homes) == []


def test_an_extension_begins_at_the_last_stop_that_exists() -> None:
    profile, before = large()
    cell, homes = cell_bodies(profile), home_positions(profile)
    kept = {name: q.copy() for name, q in before.q.items()}
    chosen = sample_stops(cell, profile, 12, np.random.default_rng(9))
    stops, _ = in_order(profile, chosen, 9, after=before.targets(99))
    assert refusals(cell, stops, before.targets(99), homes) == []
    for name, q in kept.items():
        np.testing.assert_array_equal(q, before.q[name])
        assert len(stops.q[name]) <= 12


def test_stops_that_no_motion_reaches_are_given_up_with_the_reason() -> None:
    """An arm below the floor is reached by nothing."""
    profile = planned_twin(6, repeats=0)
    cell = cell_bodies(profile)
    chosen = sample_stops(cell, profile, 6, np.random.default_rng(1))
    chosen["left"][:2, 1] = 1.2
    stops, given_up = in_order(profile, chosen)
    assert len(stops) <= 4
    assert any(one.startswith("arm left: 2 of 6 chosen") and "floor" in one for one in given_up)
    chosen["left"][:, 1] = 1.2
    with pytest.raises(InputError, match=r"none of the chosen stops can be reached.*floor"):
        in_order(profile, chosen)


def test_further_stops_without_a_way_home_are_given_up_and_cost_no_others(monkeypatch: pytest.MonkeyPatch) -> None:
    profile, before = large()
    monkeypatch.setattr(sequence, "can_go", lambda *_: False)
    further = {name: q[:1] for name, q in before.q.items()}
    more, reasons = in_order(profile, further, after=before.targets(99))
    assert (len(more), reasons) == (0, ["the last stop has no way home"])
    with pytest.raises(InputError, match="none of the chosen stops can be reached: the last stop has no way home"):
        in_order(profile, further)


def test_planning_can_be_cancelled() -> None:
    token = JobToken()
    token.cancel()
    with pytest.raises(Cancelled):
        planned(planned_twin(8), job=token)


# -- Distances between segments: known cases, and every case against a search over both segments -----------------------


# -- Ways round what blocks the straight one: the gate accepts every leg; what cannot be reached has a reason ----------

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


def replay(cell: CellBodies, here: dict[str, np.ndarray], way: Route, there: dict[str, np.ndarray]) -> list[str]:
    found = []
    for leg in (*way, there):
        after = {**here, **leg}
        found.append(refuse_motion(cell, here, after))
        here = after
    return [one for one in found if one]


def test_a_way_leads_round_a_pillar() -> None:
    profile = with_pillar(one_arm())
    cell = cell_bodies(profile)
    here, there = both_sides(cell)
    way = TransitPlanner(profile, cell, np.random.default_rng(0)).find(here, there)
    assert isinstance(way, tuple)
    assert way
    assert replay(cell, here, way, there) == []
    home = home_positions(profile)
    assert route_s(profile, here, (*way, there)) <= route_s(profile, here, (home, there)) + 1e-9


def test_arms_that_would_meet_go_another_way() -> None:
    profile = planned_twin(200)
    cell = cell_bodies(profile)
    drawn = sample_stops(cell, profile, 200, np.random.default_rng(4))
    q = {name: nearest_turns(profile, cell, name, rows) for name, rows in drawn.items()}
    stops = [{name: rows[k] for name, rows in q.items()} for k in range(200)]
    meeting = [one for one in pairwise(stops) if refuse_motion(cell, *one).startswith("arms ")][:3]
    finder = TransitPlanner(profile, cell, np.random.default_rng(0))
    found = [finder.find(*one) for one in meeting]
    assert any(isinstance(way, tuple) for way in found)
    for (here, there), way in zip(meeting, found, strict=True):
        assert isinstance(way, str) or replay(cell, here, way, there) == []


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_plans_among_obstacles_pass_the_gate(seed: int) -> None:
    profile = with_pillar(planned_twin(16))
    cell, homes = cell_bodies(profile), home_positions(profile)
    chosen = sample_stops(cell, profile, 20, np.random.default_rng(seed))
    stops, _ = in_order(profile, chosen, seed)
    assert len(stops) >= 14
    assert refusals(cell, stops, homes, homes) == []
