"""The inter-base transform from distances alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.estimation.calibration import pair_calibration
from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.calibration.pair_calibration import distances, identify_pair
from cellapp.ground.errors import NotConverged
from cellapp.robot.kinematics.transforms import rotation_from_vector, rotation_zyx, transform

pytestmark = pytest.mark.fast


def cell(seed, n=100, noise=0.0):
    rng = np.random.default_rng(seed)
    T_R_L = transform(rotation_from_vector(rng.normal(0, 1.0, 3)), [0.1, -1.7, 0.2])
    p_L, p_R = rng.uniform(-1, 1, (n, 3)), rng.uniform(-0.8, 0.8, (n, 3))
    return rng, T_R_L, p_L, p_R, distances(T_R_L, p_L, p_R) + rng.normal(0.0, noise, n)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_exact_distances_give_the_exact_transform(seed):
    rng, T_R_L, p_L, p_R, measured = cell(seed)
    start = transform(rotation_from_vector(rng.normal(0, 0.02, 3)) @ T_R_L[:3, :3], T_R_L[:3, 3] + 0.02)
    found = identify_pair(start, p_L, p_R, measured)
    np.testing.assert_allclose(found.T_R_L, T_R_L, atol=1e-9)
    x, y, z, theta, beta, alpha = found.values
    np.testing.assert_allclose(transform(rotation_zyx(theta, beta, alpha), [x, y, z]), T_R_L, atol=1e-8)


def test_standard_errors_are_those_of_repetition():
    errors, stated = [], []
    for k in range(300):
        _, T_R_L, p_L, p_R, _ = cell(0)
        measured = distances(T_R_L, p_L, p_R) + np.random.default_rng(k).normal(0.0, 20e-6, 100)
        found = identify_pair(T_R_L, p_L, p_R, measured)
        errors.append(found.T_R_L[:3, 3] - T_R_L[:3, 3])
        stated.append(found.standard_errors[:3])
        assert found.scale == pytest.approx(20e-6, rel=0.35)
    np.testing.assert_allclose(np.std(errors, axis=0), np.mean(stated, axis=0), rtol=0.15)


def test_six_stops_are_refused():
    _, T_R_L, p_L, p_R, measured = cell(0, n=6)
    with pytest.raises(TooFewReadings, match="at least 7"):
        identify_pair(T_R_L, p_L, p_R, measured)


def square(T_R_L, p_L, p_R, measured):
    return float(np.sum((measured**2 - distances(T_R_L, p_L, p_R) ** 2) ** 2))


@pytest.mark.parametrize("seed", range(10))
def test_from_a_start_that_is_far_off_it_never_ends_above_it(seed, monkeypatch):
    rng, T_R_L, p_L, p_R, measured = cell(seed, noise=2e-5)
    start = transform(rotation_from_vector(rng.normal(0, 1.0, 3)) @ T_R_L[:3, :3], T_R_L[:3, 3] + rng.normal(0, 0.3, 3))
    found = identify_pair(start, p_L, p_R, measured)
    assert square(found.T_R_L, p_L, p_R, measured) <= square(start, p_L, p_R, measured)
    monkeypatch.setattr(pair_calibration, "_MOST_ITERATIONS", 1)
    with pytest.raises(NotConverged, match="inter-base transform from distances did not converge: 1 steps"):
        identify_pair(start, p_L, p_R, measured)
