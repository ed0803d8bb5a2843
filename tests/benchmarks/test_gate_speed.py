"""Speed of the safety gate: what obstacles cost, and many stops at once against one by one."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import clear_stops, refuse_motion, refuse_stop, visible_stops
from tests.benchmarks.test_speed import best_of
from tests.twin import PROFILES

REAL = load_profile(PROFILES / "ur10-ur5.yaml")
"""The real cell: a table, two pedestals and a pillar."""


def drawn(count):
    rng = np.random.default_rng(1)
    ranges = {name: np.array(arm.limits) for name, arm in REAL.arms.items()}
    return {name: rng.uniform(one[:, 0], one[:, 1], (count, 6)) for name, one in ranges.items()}


@pytest.mark.benchmark(group="one motion of both arms among four obstacles")
def test_a_motion_among_obstacles(benchmark):
    cell, bare = cell_bodies(REAL), cell_bodies(REAL.model_copy(update={"obstacles": {}}))
    home, q = home_positions(REAL), drawn(4000)
    free = np.flatnonzero(clear_stops(cell, q))[:400]
    ways = [(home, {name: value[k] for name, value in q.items()}) for k in free]
    ways = [way for way in ways if not refuse_motion(cell, *way)][:40]
    assert len(ways) > 20
    benchmark(lambda: [refuse_motion(cell, *way) for way in ways[:20]])
    ours, without = best_of(
        9, lambda: [refuse_motion(cell, *way) for way in ways], lambda: [refuse_motion(bare, *way) for way in ways]
    )
    benchmark.extra_info["ratio_to_no_obstacles"] = ours / without
    assert ours / without < 3.0


@pytest.mark.benchmark(group="20 000 stops of both arms among four obstacles")
def test_many_stops_at_once(benchmark):
    cell, q = cell_bodies(REAL), drawn(20_000)
    clear = benchmark(clear_stops, cell, q)
    few = [{name: value[k] for name, value in q.items()} for k in range(200)]
    assert clear[:200].tolist() == [not refuse_stop(cell, one) for one in few]
    ours, one_by_one = best_of(3, lambda: clear_stops(cell, q), lambda: [refuse_stop(cell, one) for one in few])
    assert one_by_one / len(few) > 10.0 * ours / len(clear)


@pytest.mark.benchmark(group="20 000 stops of both arms among four obstacles")
def test_the_view_of_many_stops_at_once(benchmark):
    cell, q = cell_bodies(REAL), drawn(20_000)
    assert 0 < benchmark(visible_stops, cell, q).sum() < 1000
