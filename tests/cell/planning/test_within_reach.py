"""Candidates within easy reach: what lies behind a wall that no way passes is none, and free ways are free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellapp.cell.planning.candidates import draw_pool
from cellapp.cell.planning.designed import design_stops, free_ways, hubs_of, within_reach
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import clear_alone, refuse_motion
from tests.twin import PROFILES, small_twin


def test_free_ways_agree_with_finely_placed_bodies() -> None:
    profile = small_twin()
    cell, home = cell_bodies(profile), home_positions(profile)["left"]
    q = draw_pool(cell, profile, "left", 60, np.random.default_rng(4)).q
    free = free_ways(cell, "left", home, q)
    shares = np.linspace(0.0, 1.0, 12)[1:-1]
    for row, found in zip(q, free, strict=True):
        at = home + shares[:, None] * (row - home)
        assert found == clear_alone(cell, place(cell.arms["left"], at)).all()


def test_poses_beyond_a_locked_range_are_out_of_reach() -> None:
    """The real cell's joint limits leave pockets: those within reach have straight ways that the gate accepts."""
    profile = load_profile(PROFILES / "ur10-ur5.yaml")
    cell, homes = cell_bodies(profile), home_positions(profile)
    q = draw_pool(cell, profile, "right", 300, np.random.default_rng(2)).q
    reached = within_reach(cell, "right", q, hubs_of(cell, "right", q, homes["right"]))
    assert 0.5 < reached.mean() < 0.98
    alone = replace(cell, arms={"right": cell.arms["right"]})

    def ways(rows: np.ndarray) -> float:
        hubs = np.vstack([homes["right"][None], q[reached][:8]])
        free = [[not refuse_motion(alone, {"right": hub}, {"right": row}) for hub in hubs] for row in rows]
        return float(np.mean(free))

    assert ways(q[reached][8:28]) > 2.0 * ways(q[~reached][:20])


def test_a_design_is_the_same_by_seed_and_keeps_what_it_is_given() -> None:
    profile = small_twin(12, plan={"candidates": 200})
    first, again = design_stops(profile, 12), design_stops(profile, 12)
    other = design_stops(profile.model_copy(update={"seed": 8}), 12)
    for name, q in first.stops.q.items():
        np.testing.assert_array_equal(q, again.stops.q[name])
        assert not np.array_equal(q, other.stops.q[name])
    longer = design_stops(profile, 3, kept=first.stops)
    assert len(longer.stops) == 15
    for name, q in first.stops.q.items():
        np.testing.assert_array_equal(longer.stops.q[name][:12], q)
        np.testing.assert_array_equal(longer.stops.approach_from[name][:12], first.stops.approach_from[name])
    assert longer.stops.block[12:].min() > first.stops.block.max()
    assert all(pool.rejected for pool in first.pools.values())
