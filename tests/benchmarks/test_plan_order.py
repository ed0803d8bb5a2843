"""Speed of pairing and ordering the stops of a plan; ``python -m tests.cell.planning.measure_order`` prints the table.

pytest tests/benchmarks/test_plan_order.py
"""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.planning.balance import balanced_levels, standardised
from cellapp.cell.planning.transit_paths import TourTask, best_order
from cellapp.ground.progress import CancelToken

STEPS = 200


def task(stops: int) -> TourTask:
    """Two arms, blocks of 100 stops, as many functions of posture as the twin has."""
    rng = np.random.default_rng(0)
    blocks = stops // 100
    points = rng.uniform(size=(2, blocks, 100, 6))
    time_s = np.abs(points[:, :, :, None] - points[:, :, None]).max(axis=-1)
    postures = [
        standardised(("",) * 17, rng.normal(size=(stops, 17))).values.reshape(blocks, 100, 17) for _ in range(2)
    ]
    return TourTask(np.full(blocks, 100), time_s, np.zeros((1, blocks, 100, 100)), postures, 0.1, 1.0)


@pytest.mark.benchmark(group="order of stops, 200 steps of the search")
@pytest.mark.parametrize("stops", [400, 4000])
def test_steps_of_the_search_for_an_order(benchmark, stops: int) -> None:
    given, rng = task(stops), np.random.default_rng(0)
    order = benchmark.pedantic(lambda: best_order(given, STEPS, rng, CancelToken()), rounds=3)
    assert order.shape == (2, stops // 100, 100)


@pytest.mark.fast
@pytest.mark.benchmark(group="levels of one factor, 100 variables")
@pytest.mark.parametrize("stops", [400, 4000])
def test_balanced_levels(benchmark, stops: int) -> None:
    rng = np.random.default_rng(0)
    against = standardised(("",) * 100, rng.normal(size=(stops, 100))).values
    allowed = np.ones((stops, 2), dtype=bool)
    chosen = benchmark.pedantic(lambda: balanced_levels(np.array([-1.0, 1.0]), allowed, against, rng, 0.05), rounds=3)
    assert abs(np.mean(chosen) - 0.5) < 0.1
