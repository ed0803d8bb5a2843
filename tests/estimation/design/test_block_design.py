"""Choice of stops: updates equal fresh inverses, exchange only gains; units and order do not matter."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.estimation.design import block_design
from cellapp.estimation.design.block_design import (
    GAP_OF_EVEN_STOPS,
    SHARES,
    BlockDesign,
    Candidates,
    Criterion,
    choose_blocks,
    close_gaps,
    gap_limits,
    largest_gaps,
    least_informative_last,
    reference_errors,
)
from cellapp.ground.progress import UNTOLD

P, M, COUNT = 8, 300, 20


def problem(seed: int = 0, m: int = M) -> tuple[Candidates, Criterion]:
    """Candidates of unequal size, the first six parameters wanted."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(m, 3, P)) * rng.uniform(0.2, 2.0, (m, 1, 1)) * np.geomspace(0.3, 3.0, P)
    candidates = Candidates(rows, np.diag(np.geomspace(0.1, 1.0, P)))
    points = rng.normal(size=(50, 3, P))
    return candidates, Criterion(reference_errors(candidates.mean_information, COUNT, candidates.prior, 6), points)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_updates_equal_fresh_inverses(seed: int) -> None:
    candidates, criterion = problem(seed % 7)
    rng = np.random.default_rng(seed)
    inside = list(rng.permutation(M)[:10])
    weights = criterion.weights(candidates.covariance(np.array(inside)))
    design = BlockDesign(candidates.information(np.array(inside)), weights)
    design.track(candidates.rows)
    for number in rng.permutation(M)[:8].tolist():
        if number in inside:
            inside.remove(number)
            design.change(candidates.rows[number], -1.0)
        else:
            inside.append(number)
            design.change(candidates.rows[number])
    comes = int(np.setdiff1d(np.arange(M), inside)[0])
    design.change(candidates.rows[[inside[0], comes]].reshape(6, P), np.repeat([-1.0, 1.0], 3))
    inside[0] = comes
    fresh = BlockDesign(candidates.information(np.array(inside)), weights)
    fresh.track(candidates.rows)
    np.testing.assert_allclose(design.covariance, fresh.covariance, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(design.gains(), fresh.gains(), rtol=1e-6)
    np.testing.assert_allclose(design.gains(-1.0)[inside], fresh.gains(-1.0)[inside], rtol=1e-6)


@given(st.integers(0, 1000))
@settings(max_examples=8)
def test_exchange_never_makes_a_choice_worse(seed: int) -> None:
    candidates, criterion = problem(seed)
    values = []
    for passes in range(4):
        rng = np.random.default_rng(seed)
        with patch.multiple(block_design, SUBSET=60, PASSES=passes):
            chosen = choose_blocks(candidates, COUNT, criterion, rng)
        assert len(set(chosen.tolist())) == COUNT
        values.append(criterion.value(candidates.covariance(chosen)))
    assert values == sorted(values, reverse=True)


def test_a_choice_beats_random_ones_in_each_error() -> None:
    candidates, criterion = problem(m=1000)
    rng = np.random.default_rng(5)
    chosen = choose_blocks(candidates, COUNT, criterion, rng)
    unseen = replace(criterion, points=rng.normal(size=(200, 3, P)))

    def errors(design: np.ndarray) -> tuple[float, float, float]:
        ratios, points = unseen.parts(candidates.covariance(design))
        return float(ratios.mean()), float(points.mean()), float(points.max())

    draws = [errors(rng.permutation(1000)[:COUNT]) for _ in range(20)]
    assert np.all(np.array(errors(chosen)) < np.min(draws, axis=0))


@patch.object(block_design, "SUBSET", M)
def test_a_choice_does_not_depend_on_units_nor_on_the_order_of_candidates() -> None:
    candidates, criterion = problem()
    chosen = choose_blocks(candidates, COUNT, criterion, np.random.default_rng(2))
    unit = 2.0 ** np.arange(-P, P, 2)  # exact in floating point
    other = Candidates(candidates.rows * unit, candidates.prior * unit * unit[:, None])
    in_units = Criterion(criterion.reference / unit[:6], criterion.points * unit)
    assert set(choose_blocks(other, COUNT, in_units, np.random.default_rng(2))) == set(chosen)
    order = np.random.default_rng(3).permutation(M)
    mixed = Candidates(candidates.rows[order], candidates.prior)
    with patch.object(block_design, "PASSES", 0):
        again = choose_blocks(mixed, COUNT, criterion, np.random.default_rng(2))
        plain = choose_blocks(candidates, COUNT, criterion, np.random.default_rng(9))
    assert set(order[again]) == set(plain)


def test_the_last_stops_tell_least() -> None:
    candidates, criterion = problem()
    chosen = choose_blocks(candidates, COUNT, criterion, np.random.default_rng(1))
    ordered = least_informative_last(candidates, chosen, criterion)
    assert sorted(ordered) == sorted(chosen)
    rng = np.random.default_rng(2)
    mixed = [criterion.value(candidates.covariance(rng.permutation(chosen)[:-5])) for _ in range(30)]
    assert criterion.value(candidates.covariance(ordered[:-5])) < np.min(mixed)
    np.testing.assert_array_equal(least_informative_last(candidates, chosen[:1], criterion), chosen[:1])


# -- The same seed chooses the same stops on any processor: OpenBLAS has kernels for each, which round differently -----

KERNELS = ("Haswell", "Sandybridge", "Nehalem")
"""Any x86 processor of the last ten years runs these; they are compared with its own. Without OpenBLAS, or on another
architecture, the setting has no effect, and all are its own."""

CHOICE = """
import numpy as np
from cellapp.estimation.design.block_design import (
    Candidates, Criterion, choose_blocks, least_informative_last, reference_errors
)
rng = np.random.default_rng(0)
rows = np.repeat(rng.normal(size=(150, 3, 20)), 2, axis=0)
rows *= 1.0 + 1e-7 * rng.normal(size=(300, 1, 1))  # each candidate has an alternative that tells as much, nearly
candidates = Candidates(rows, np.eye(20))
reference = reference_errors(candidates.mean_information, 40, candidates.prior, 15)
criterion = Criterion(reference, rng.normal(size=(50, 3, 20)))
chosen = choose_blocks(candidates, 40, criterion, rng)
print(least_informative_last(candidates, chosen, criterion).tolist())
"""

PLAN = """
import hashlib
import numpy as np
from cellapp.cell.planning.designed_plan import design_stops
from tests.twin import small_twin
planned, _ = design_stops(small_twin(12), 12)
print({name: hashlib.sha256(np.round(q, 9).tobytes()).hexdigest() for name, q in planned.q.items()})
"""


@pytest.mark.parametrize(
    ("what", "kernels"),
    [
        pytest.param(CHOICE, KERNELS, marks=pytest.mark.slow, id="choice"),
        pytest.param(PLAN, KERNELS, marks=pytest.mark.slow, id="plan"),
    ],
)
def test_all_kernels_give_the_same(what: str, kernels: tuple[str, ...]) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    given = {}
    for kernel in ("", *kernels):
        own = {name: value for name, value in environment.items() if name != "OPENBLAS_CORETYPE"}
        of_kernel = {**own, "OPENBLAS_CORETYPE": kernel} if kernel else own
        ended = subprocess.run(
            [sys.executable, "-c", what], env=of_kernel, capture_output=True, text=True, timeout=120.0, check=True
        )
        given[kernel or "its own"] = ended.stdout
    assert all(given.values())
    assert len(set(given.values())) == 1, given


# -- Phase coverage: gaps that candidates can close are closed, others are left, and little is lost --------------------

COUNT_OF_GAPS, NONE = 30, np.empty((0, 2))


def clustered() -> tuple[Candidates, np.ndarray, Criterion, np.ndarray]:
    """Stops at the ends of the first joint tell most, so that a choice leaves its middle empty."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.0, 2.0, (800, 2))
    rows = rng.normal(size=(800, 3, 4)) * np.abs(q[:, :1, None])
    candidates = Candidates(rows, np.eye(4))
    criterion = Criterion(
        reference_errors(candidates.mean_information, COUNT_OF_GAPS, candidates.prior, 4), rng.normal(size=(40, 3, 4))
    )
    return candidates, q, criterion, choose_blocks(candidates, COUNT_OF_GAPS, criterion, rng)


def closed(q: np.ndarray, limits: np.ndarray, kept: np.ndarray = NONE) -> tuple[np.ndarray, float]:
    candidates, _, criterion, chosen = clustered()
    rng = np.random.default_rng(1)
    found = close_gaps(candidates, q, chosen, criterion, limits, kept, rng, UNTOLD)
    assert len(set(found.tolist())) == COUNT_OF_GAPS
    lost = criterion.value(candidates.covariance(found)) - criterion.value(candidates.covariance(chosen))
    return found, lost


def test_gaps_are_closed_at_little_loss() -> None:
    _, q, _, chosen = clustered()
    limits = gap_limits(q, COUNT_OF_GAPS, None)
    assert limits == pytest.approx(GAP_OF_EVEN_STOPS * 4.0 / COUNT_OF_GAPS, rel=0.05)
    assert largest_gaps(q[chosen])[0] > 2.0 * limits[0]
    found, lost = closed(q, limits)
    assert np.all(largest_gaps(q[found]) <= limits)
    assert lost < 0.1 * sum(SHARES)
    assert len(np.setdiff1d(found, chosen)) < COUNT_OF_GAPS / 2
