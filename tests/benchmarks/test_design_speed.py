"""Speed of the choice of stops: 400 of 20 000 candidates with 150 columns, and a step of it against fresh products."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.design.block_design import BlockDesign, Candidates, Criterion, choose_blocks, reference_errors
from tests.benchmarks.test_speed import best_of

COLUMNS, STOPS = 150, 400


def candidates_of(count):
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(count, 3, COLUMNS)) * rng.uniform(0.2, 2.0, (count, 1, 1))
    candidates = Candidates(rows, np.eye(COLUMNS))
    reference = reference_errors(candidates.mean_information, STOPS, candidates.prior, COLUMNS)
    return candidates, Criterion(reference, rng.normal(size=(600, 3, COLUMNS)))


@pytest.mark.benchmark(group="400 of 20 000 stops, 150 columns")
def test_choice_of_400_of_20000_stops(benchmark):
    candidates, criterion = candidates_of(20_000)
    chosen = benchmark.pedantic(
        choose_blocks, (candidates, STOPS, criterion, np.random.default_rng(1)), rounds=1, iterations=1
    )
    assert len(set(chosen.tolist())) == STOPS


def test_an_update_of_rank_three_against_fresh_products():
    candidates, criterion = candidates_of(1000)
    chosen = np.arange(STOPS)
    weights = criterion.weights(candidates.covariance(chosen))
    design = BlockDesign(candidates.information(chosen), weights)
    design.track(candidates.rows)

    def update():
        design.remove(candidates.rows[0])
        design.add(candidates.rows[0])

    def fresh():
        again = BlockDesign(candidates.information(chosen), weights)
        again.track(candidates.rows)

    updates, products = best_of(20, update, fresh)
    print(f"\nupdate / fresh products, 1000 candidates, 150 columns: {updates / 2.0 / products:.3f}")  # noqa: T201
    assert updates / 2.0 < 0.4 * products  # well above what is measured: only a real loss trips it
