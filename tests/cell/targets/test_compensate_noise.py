"""Noise of measuring: the tracker's shape, the readings' size."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.targets.ranges import MeasuringNoise
from cellapp.estimation.readings import Readings

POINTS = np.random.default_rng(0).uniform([2.0, -2.0, -1.0], [6.0, 2.0, 1.0], (50, 3))


def stated(points: np.ndarray) -> np.ndarray:
    """Half of 15 um + 6 um/m across the beam and of 0.5 um/m along it, squared."""
    distance = np.linalg.norm(points, axis=1)
    beam = points / distance[:, None]
    along, across = 2.5e-7 * distance, 7.5e-6 + 3e-6 * distance
    outer = beam[:, :, None] * beam[:, None]
    return np.asarray(along[:, None, None] ** 2 * outer + across[:, None, None] ** 2 * (np.eye(3) - outer))


def readings(points: np.ndarray, covariance: np.ndarray | None) -> Readings:
    n = len(points)
    return Readings(
        configuration=np.arange(n),
        time_s=np.arange(n, dtype=np.float64),
        q=np.zeros((n, 6)),
        approach=np.zeros((n, 6), dtype=np.int8),
        p_M=points,
        covariance_M=covariance,
    )


def test_the_statement_is_found_again_and_scatter_beyond_it_is_added() -> None:
    covariance = stated(POINTS)
    noise = MeasuringNoise.of(readings(POINTS, covariance))
    assert noise is not None
    as_stated = float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean() / 3.0))
    elsewhere = POINTS[:10] * 1.2
    np.testing.assert_allclose(noise.covariance(elsewhere, as_stated), stated(elsewhere), rtol=1e-6, atol=1e-16)
    more = noise.covariance(elsewhere, np.hypot(as_stated, 2e-5))
    np.testing.assert_allclose(more - stated(elsewhere), np.tile(4e-10 * np.eye(3), (10, 1, 1)), atol=1e-16)
    assert noise.excess(np.hypot(as_stated, 2e-5)) == pytest.approx(4e-10, rel=1e-6)
    assert noise.excess(0.5 * as_stated) == 0.0
    less = noise.covariance(elsewhere, 0.5 * as_stated)
    np.testing.assert_allclose(less, 0.25 * stated(elsewhere), rtol=1e-6, atol=1e-16)


def test_readings_that_state_nothing_or_stand_at_one_distance() -> None:
    assert MeasuringNoise.of(readings(POINTS, None)) is None
    ring = POINTS / np.linalg.norm(POINTS, axis=1)[:, None] * 3.0
    noise = MeasuringNoise.of(readings(ring, stated(ring)))
    assert noise is not None
    assert noise.across == pytest.approx((1.65e-5, 0.0))
