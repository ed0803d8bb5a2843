"""Choice of stops: updates equal fresh inverses, exchange only gains, bounds hold; units and order do not matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.estimation.design.block_design import (
    BlockDesign,
    Candidates,
    Criterion,
    Effort,
    Shares,
    choose_blocks,
    information_of,
    most_informative_first,
    reference_errors,
)
from cellapp.ground.progress import Cancelled, CancelToken
from tests.estimation.design.relaxation import least_errors

pytestmark = pytest.mark.fast

P, M, COUNT = 8, 300, 20
ALL = Effort(subset=M)


def problem(seed: int = 0, m: int = M) -> tuple[Candidates, Criterion]:
    """Candidates of unequal size, the first six parameters wanted."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(m, 3, P)) * rng.uniform(0.2, 2.0, (m, 1, 1)) * np.geomspace(0.3, 3.0, P)
    candidates = Candidates(rows, np.diag(np.geomspace(0.1, 1.0, P)))
    points = rng.normal(size=(50, 3, P))
    return candidates, Criterion(reference_errors(candidates.mean_information, COUNT, candidates.prior, 6), points)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
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
            design.remove(candidates.rows[number])
        else:
            inside.append(number)
            design.add(candidates.rows[number])
    fresh = BlockDesign(candidates.information(np.array(inside)), weights)
    fresh.track(candidates.rows)
    np.testing.assert_allclose(design.covariance, fresh.covariance, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(design.gains(), fresh.gains(), rtol=1e-3)
    np.testing.assert_allclose(design.gains_of(candidates.rows), fresh.gains(), rtol=1e-3)
    np.testing.assert_allclose(design.losses()[inside], fresh.losses()[inside], rtol=1e-3)


def test_gains_and_losses_are_what_the_criterion_changes_by() -> None:
    candidates, criterion = problem()
    chosen = np.arange(COUNT)
    C = candidates.covariance(chosen)
    W = criterion.weights(C)
    design = BlockDesign(candidates.information(chosen), W)
    design.track(candidates.rows)
    more, fewer = candidates.covariance(np.arange(COUNT + 1)), candidates.covariance(np.arange(1, COUNT))
    assert design.gains()[COUNT] == pytest.approx(np.trace((C - more) @ W), rel=1e-4)
    assert design.losses()[0] == pytest.approx(np.trace((fewer - C) @ W), rel=1e-4)


def test_the_weights_are_the_derivative_of_the_criterion() -> None:
    candidates, criterion = problem()
    criterion = replace(criterion, shares=Shares(1.0, 0.7, 1.3))
    C = candidates.covariance(np.arange(COUNT))
    direction = np.random.default_rng(1).normal(size=(P, P)) * 1e-7 * C.max()
    direction += direction.T
    change = criterion.value(C + direction) - criterion.value(C - direction)
    assert np.trace(criterion.weights(C) @ direction) == pytest.approx(change / 2.0, rel=1e-5)


@pytest.mark.slow
@given(st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_exchange_never_makes_a_choice_worse(seed: int) -> None:
    candidates, criterion = problem(seed)
    values = []
    for passes in range(4):
        effort = Effort(subset=60, passes=passes)
        chosen = choose_blocks(candidates, COUNT, criterion, np.random.default_rng(seed), effort)
        assert len(set(chosen.tolist())) == COUNT
        values.append(criterion.value(candidates.covariance(chosen)))
    assert values == sorted(values, reverse=True)


def test_a_choice_beats_random_ones_in_each_error_and_no_choice_beats_the_bound() -> None:
    candidates, criterion = problem(m=1000)
    rng = np.random.default_rng(5)
    chosen = choose_blocks(candidates, COUNT, criterion, rng)
    unseen = replace(criterion, points=rng.normal(size=(200, 3, P)))
    best, there = unseen.errors(candidates.covariance(chosen)), criterion.errors(candidates.covariance(chosen))
    draws = [unseen.errors(candidates.covariance(rng.permutation(1000)[:COUNT])) for _ in range(20)]
    assert np.all(np.array(best) < np.min(draws, axis=0))
    bound = least_errors(candidates, COUNT, criterion, 60, CancelToken())
    assert np.all(np.array(bound) < there)
    # A- and I-optimal choices alone come near their bounds
    for k in range(2):
        only = replace(criterion, shares=Shares(*np.eye(3)[k]))
        alone = choose_blocks(candidates, COUNT, only, rng, Effort(subset=1000))
        reached = only.errors(candidates.covariance(alone))[k]
        assert bound[k] <= reached < 1.1 * bound[k]


def test_a_choice_does_not_depend_on_units_nor_on_the_order_of_candidates() -> None:
    candidates, criterion = problem()
    chosen = choose_blocks(candidates, COUNT, criterion, np.random.default_rng(2), ALL)
    unit = 2.0 ** np.arange(-P, P, 2)  # exact in floating point
    other = Candidates(candidates.rows * unit, candidates.prior * unit * unit[:, None])
    in_units = Criterion(criterion.reference / unit[:6], criterion.points * unit)
    assert set(choose_blocks(other, COUNT, in_units, np.random.default_rng(2), ALL)) == set(chosen)
    order = np.random.default_rng(3).permutation(M)
    mixed = Candidates(candidates.rows[order], candidates.prior)
    again = choose_blocks(mixed, COUNT, criterion, np.random.default_rng(2), replace(ALL, passes=0))
    plain = choose_blocks(candidates, COUNT, criterion, np.random.default_rng(9), replace(ALL, passes=0))
    assert set(order[again]) == set(plain)


def test_the_seed_makes_the_choice() -> None:
    candidates, criterion = problem()
    first, second = (choose_blocks(candidates, COUNT, criterion, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_all_candidates_are_chosen_where_there_are_no_more() -> None:
    candidates, criterion = problem()
    chosen = choose_blocks(candidates, M + 5, criterion, np.random.default_rng(0))
    np.testing.assert_array_equal(chosen, np.arange(M))


def test_what_is_there_before_is_not_chosen_again() -> None:
    """With much known about the first parameters, the choice turns to the others."""
    candidates, criterion = problem()
    known = Candidates(candidates.rows, candidates.prior + np.diag([1e6] * 3 + [0.0] * (P - 3)))
    criterion = replace(criterion, shares=Shares(1.0, 0.0, 0.0))

    def told(which: Candidates) -> np.ndarray:
        chosen = choose_blocks(which, COUNT, criterion, np.random.default_rng(1), ALL)
        return np.diag(information_of(candidates.rows[chosen]))

    assert np.all(told(known)[3:6].mean() > told(candidates)[3:6].mean())


def test_the_first_stops_tell_most() -> None:
    candidates, criterion = problem()
    chosen = choose_blocks(candidates, COUNT, criterion, np.random.default_rng(1))
    ordered = most_informative_first(candidates, chosen, criterion)
    assert sorted(ordered) == sorted(chosen)
    rng = np.random.default_rng(2)
    mixed = [criterion.value(candidates.covariance(rng.permutation(chosen)[:5])) for _ in range(30)]
    assert criterion.value(candidates.covariance(ordered[:5])) < np.median(mixed)
    np.testing.assert_array_equal(most_informative_first(candidates, chosen[:1], criterion), chosen[:1])


def test_a_choice_can_be_cancelled() -> None:
    candidates, criterion = problem()
    token = CancelToken()
    token.cancel()
    with pytest.raises(Cancelled):
        choose_blocks(candidates, COUNT, criterion, np.random.default_rng(0), cancel=token)
