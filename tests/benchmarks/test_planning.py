"""Speed of the pool of candidates and of the view map: times are printed, none is asserted."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.planning.candidates import draw_pool
from cellapp.cell.planning.view import view_workspace
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import clear_alone, visible
from tests.twin import PROFILES

PROFILE = load_profile(PROFILES / "twin.yaml")
CELL = cell_bodies(PROFILE)


@pytest.mark.benchmark(group="candidates of one arm")
def test_a_pool_of_20_000_candidates(benchmark):
    pool = benchmark.pedantic(lambda: draw_pool(CELL, PROFILE, "left", 20_000, np.random.default_rng(1)), rounds=3)
    assert len(pool.q) == 20_000


@pytest.mark.benchmark(group="candidates of one arm")
def test_plain_rejection_of_100_000_configurations(benchmark):
    low, high = CELL.arms["left"].limits.T / 2.0

    def draw():
        q = np.random.default_rng(1).uniform(low, high, (100_000, 6))
        q = q[visible(CELL, "left", q)]
        return q[clear_alone(CELL, place(CELL.arms["left"], q))]

    assert len(benchmark.pedantic(draw, rounds=3)) > 500


@pytest.mark.benchmark(group="view of both arms")
def test_the_view_of_both_arms(benchmark):
    view = benchmark.pedantic(view_workspace, args=(PROFILE,), rounds=1)
    assert set(view.arms) == {"left", "right"}
