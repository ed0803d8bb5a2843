"""Splits are disjoint and do not depend on the order of readings; error statistics follow their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.estimation.calibration.calibrate import draw_splits, split_sizes
from cellapp.estimation.calibration.quantities import (
    distance_errors,
    distance_summary,
    evaluate,
    position_errors,
    repeatability,
    summarise,
)
from cellapp.ground.results import ErrorSummary


def interval_of_mean(summary: ErrorSummary) -> tuple[float, float]:
    """The bootstrap interval of the mean [mm], which must be there."""
    assert summary.mean_ci95 is not None
    return summary.mean_ci95


@pytest.mark.fast
@given(st.integers(2, 600), st.integers(1, 300), st.integers(0, 300), st.one_of(st.none(), st.integers(1, 300)))
def test_split_sizes_fit_and_neither_identify_nor_validate_is_empty(n, identify, train, validate):
    sizes = split_sizes(n, identify, train, validate)
    assert sizes.identify + sizes.train + sizes.validate <= n
    assert sizes.identify >= 1
    assert sizes.validate >= 1
    assert sizes.identify <= identify
    assert sizes.train <= train
    fits = identify + train + (validate or 1) <= n
    assert (sizes.notes == ()) == fits
    if fits and validate is not None:
        assert (sizes.identify, sizes.train, sizes.validate) == (identify, train, validate)
    if validate is None:
        assert sizes.identify + sizes.train + sizes.validate == n


@pytest.mark.fast
@given(st.sets(st.integers(0, 10_000), min_size=5, max_size=80), st.integers(0, 100))
def test_the_draw_depends_on_the_numbers_and_the_seed_alone(numbers, seed):
    ordered = np.array(sorted(numbers))
    shuffled = np.random.default_rng(1).permutation(np.concatenate([ordered, ordered]))  # both arms, any order
    assert draw_splits(ordered, 2, 1, 1, seed) == draw_splits(shuffled, 2, 1, 1, seed)


@pytest.mark.fast
def test_another_seed_gives_another_draw():
    numbers = np.arange(400)
    assert draw_splits(numbers, 100, 200, 100, 0)[0] != draw_splits(numbers, 100, 200, 100, 1)[0]


@pytest.mark.fast
def test_errors_on_a_worked_example():
    measured = np.array([[0.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0]])
    computed = np.array([[0.0, 0, 0], [1.003, 0.004, 0], [0, 1.0, 0]])
    np.testing.assert_allclose(position_errors(measured, computed), [0, 0.005, 0], atol=1e-12)
    expected = [np.hypot(1.003, 0.004) - 1.0, 0.0, abs(np.hypot(1.003, 0.996) - np.sqrt(2.0))]
    np.testing.assert_allclose(distance_errors(measured, computed), expected, atol=1e-12)
    summary = summarise(np.array([0.001, -0.003]))
    assert (summary.mean, summary.max, summary.n) == pytest.approx((2.0, 3.0, 2))
    assert summary.rms == pytest.approx(np.sqrt(5.0))
    assert summary.std == pytest.approx(np.sqrt(2.0))
    assert evaluate(measured[:1], computed[:1]).distance_mm is None


@pytest.mark.fast
@given(st.integers(0, 2**32 - 1))
def test_a_rigid_motion_changes_no_distance(seed):
    rng = np.random.default_rng(seed)
    p = rng.normal(size=(6, 3))
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    assert distance_errors(p, p @ rotation.T + rng.normal(size=3)).max() < 1e-12


def test_the_bootstrap_interval_of_the_mean_has_its_stated_coverage():
    held = 0
    for seed in range(300):
        errors = np.random.default_rng(seed).exponential(1e-3, 100)
        low, high = interval_of_mean(summarise(errors))
        held += low <= 1.0 <= high
    assert 0.90 < held / 300 < 0.98


@pytest.mark.fast
def test_the_interval_of_distance_errors_accounts_for_shared_points():
    rng = np.random.default_rng(0)
    measured = rng.normal(size=(60, 3))
    computed = measured + rng.normal(0.0, 1e-3, (60, 3))
    summary = distance_summary(measured, computed)
    assert summary.n == 60 * 59 // 2
    low, high = interval_of_mean(summary)
    assert low < summary.mean < high
    as_if_independent = interval_of_mean(summarise(distance_errors(measured, computed)))
    assert high - low > 1.5 * (as_if_independent[1] - as_if_independent[0])
    assert summary.p50 is not None
    assert summary.p95 is not None
    assert summary.p50 < summary.p95 < summary.max


@pytest.mark.fast
def test_repeatability_is_that_of_the_repeats_alone():
    rng = np.random.default_rng(0)
    q = np.repeat(rng.uniform(-3, 3, (40, 6)), 10, axis=0)
    p_M = np.repeat(rng.normal(size=(40, 3)), 10, axis=0) + rng.normal(0.0, 20e-6, (400, 3))
    found = repeatability(q, p_M)
    assert found is not None
    assert found.n == 400
    # mean length of three normal numbers is 1.596 sigma; the barycentre of ten takes a root of 0.9 off
    assert found.mean == pytest.approx(1.596 * 0.020 * np.sqrt(0.9), rel=0.05)
    assert found.rp > found.mean
    assert repeatability(rng.uniform(-3, 3, (40, 6)), p_M[:40]) is None
