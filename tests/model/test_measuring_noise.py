"""Scatter of measurements by direction: a tracker's own law is found again; one uncertainty is alike in all of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.model.measuring_noise import MeasuringNoise

pytestmark = pytest.mark.fast

AT960 = MeasuringNoise(along=(5e-6, 0.15e-6), across=(7.5e-6, 3e-6))
"""Half the maximum permissible errors of a Leica AT960."""


def points(seed: int, n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.asarray(rng.uniform([2.5, -1.5, -1.0], [5.0, 1.5, 1.5], (n, 3)))


@given(st.integers(0, 2**32 - 1))
def test_the_law_of_a_tracker_is_found_from_its_readings(seed: int) -> None:
    p_M = points(seed)
    found = MeasuringNoise.of_readings(AT960.covariance(p_M), p_M)
    np.testing.assert_allclose([*found.along, *found.across], [*AT960.along, *AT960.across], rtol=1e-6)
    elsewhere = points(seed + 1)
    np.testing.assert_allclose(found.covariance(elsewhere), AT960.covariance(elsewhere), rtol=1e-5, atol=1e-16)


@given(st.floats(1e-7, 1e-3), st.integers(0, 2**32 - 1))
def test_one_uncertainty_is_alike_in_all_directions(sigma: float, seed: int) -> None:
    p_M = points(seed, 20)
    found = MeasuringNoise.of_readings(np.full(20, sigma), p_M)
    off = found.covariance(p_M) / sigma**2 - np.eye(3)
    np.testing.assert_allclose(off, 0.0, atol=1e-9)


def test_readings_at_one_distance_do_not_tell_how_noise_grows() -> None:
    directions = points(3)
    p_M = 3.0 * directions / np.linalg.norm(directions, axis=1)[:, None]
    found = MeasuringNoise.of_readings(AT960.covariance(p_M), p_M)
    assert found.along[1] == found.across[1] == 0.0
    np.testing.assert_allclose(found.covariance(p_M), AT960.covariance(p_M), rtol=1e-9, atol=1e-20)


def test_the_mean_square_is_that_of_the_readings_and_no_deviation_is_negative() -> None:
    p_M = points(4)
    falling = (1e-5 * (8.0 - np.linalg.norm(p_M, axis=1)))[:, None, None] ** 2 * np.eye(3)
    found = MeasuringNoise.of_readings(falling, p_M)
    assert np.trace(found.covariance(p_M), axis1=1, axis2=2).mean() == pytest.approx(
        np.trace(falling, axis1=1, axis2=2).mean()
    )
    steep = MeasuringNoise(along=(-1.0, 0.1), across=(0.0, 0.0))
    assert not steep.covariance(p_M).any()
    assert MeasuringNoise.from_json(AT960.scaled(2.0).to_json()) == AT960.scaled(2.0)
