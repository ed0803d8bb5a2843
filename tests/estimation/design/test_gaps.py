"""Phase coverage: gaps that candidates can close are closed, others are left, and little is lost."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.design.block_design import (
    GAP_OF_EVEN_STOPS,
    Candidates,
    Criterion,
    Shares,
    choose_blocks,
    close_gaps,
    gap_limits,
    largest_gaps,
    reference_errors,
    without_turns,
)
from cellapp.ground.progress import CancelToken

pytestmark = pytest.mark.fast

COUNT, NONE = 30, np.empty((0, 2))


def clustered() -> tuple[Candidates, np.ndarray, Criterion, np.ndarray]:
    """Stops at the ends of the first joint tell most, so that a choice leaves its middle empty."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.0, 2.0, (800, 2))
    rows = rng.normal(size=(800, 3, 4)) * np.abs(q[:, :1, None])
    candidates = Candidates(rows, np.eye(4))
    criterion = Criterion(
        reference_errors(candidates.mean_information, COUNT, candidates.prior, 4), rng.normal(size=(40, 3, 4))
    )
    return candidates, q, criterion, choose_blocks(candidates, COUNT, criterion, rng)


def closed(q: np.ndarray, limits: np.ndarray, kept: np.ndarray = NONE) -> tuple[np.ndarray, float]:
    candidates, _, criterion, chosen = clustered()
    rng = np.random.default_rng(1)
    found = close_gaps(candidates, q, chosen, criterion, limits, kept, rng, CancelToken())
    assert len(set(found.tolist())) == COUNT
    lost = criterion.value(candidates.covariance(found)) - criterion.value(candidates.covariance(chosen))
    return found, lost


def test_gaps_are_closed_at_little_loss() -> None:
    _, q, _, chosen = clustered()
    limits = gap_limits(q, COUNT, None)
    assert limits == pytest.approx(GAP_OF_EVEN_STOPS * 4.0 / COUNT, rel=0.05)
    assert largest_gaps(q[chosen])[0] > 2.0 * limits[0]
    found, lost = closed(q, limits)
    assert np.all(largest_gaps(q[found]) <= limits)
    assert lost < 0.1 * sum(Shares())
    assert len(np.setdiff1d(found, chosen)) < COUNT / 2


def test_a_limit_of_the_profile_holds() -> None:
    _, q, _, _ = clustered()
    np.testing.assert_array_equal(gap_limits(q, COUNT, 0.4), [0.4, 0.4])
    found, _ = closed(q, np.array([0.4, 0.4]))
    assert np.all(largest_gaps(q[found]) <= 0.4)


def test_a_part_without_candidates_is_left_and_the_rest_is_covered() -> None:
    _, q, _, _ = clustered()
    q = q.copy()
    q[:, 0] = np.where(q[:, 0] > 0.0, q[:, 0] + 1.0, q[:, 0])
    limits = gap_limits(q, COUNT, None)
    assert limits[0] == pytest.approx(GAP_OF_EVEN_STOPS * 4.0 / COUNT, rel=0.05), "the empty part counts for nothing"
    found, _ = closed(q, limits)
    gaps = np.sort(np.diff(np.sort(q[found, 0])))
    assert gaps[-1] > 1.0
    assert gaps[-2] <= limits[0]


def test_kept_stops_cover_too() -> None:
    _, q, _, chosen = clustered()
    kept = np.column_stack([np.linspace(-2.0, 2.0, 40), np.linspace(-2.0, 2.0, 40)])
    found, lost = closed(q, np.array([0.4, 0.4]), kept)
    assert set(found) == set(chosen)
    assert lost == pytest.approx(0.0)


def test_whole_turns_do_not_count() -> None:
    _, q, _, chosen = clustered()
    turned = q[chosen] + 2.0 * np.pi * np.random.default_rng(0).integers(-1, 2, (COUNT, 2))
    np.testing.assert_allclose(without_turns(turned, q), q[chosen], atol=1e-12)


def test_too_strict_a_limit_keeps_the_number_of_stops() -> None:
    _, q, _, _ = clustered()
    found, _ = closed(q, np.array([1e-3, 1e-3]))
    assert len(found) == COUNT
