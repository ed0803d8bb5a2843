"""Joint-error curves: the prior is Matern's, and maximum evidence recovers the parameters it was drawn with."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellapp.calibration.curve_prior import curve_standard_deviation, fit_curve_prior, harmonics, spectrum_variances

pytestmark = pytest.mark.fast


@pytest.mark.parametrize(("length", "amplitude"), [(0.05, 1e-4), (0.3, 2e-4), (2.0, 5e-5)])
def test_prior_variances_sum_to_the_amplitude_squared(length, amplitude):
    each = spectrum_variances(length, amplitude, 4000)
    assert each.sum() == pytest.approx(amplitude**2, rel=1e-12)
    assert (np.diff(each) < 0.0).all()


def test_the_prior_correlates_like_materns():
    """On a circle much longer than the length the periodic process is the plain one with smoothness 5/2."""
    length, lag = 0.15, np.array([0.0, 0.05, 0.1, 0.2, 0.4])
    variance = spectrum_variances(length, 1.0, 4000)
    found = np.cos(np.outer(lag, np.arange(1, 4001))) @ variance
    scaled = np.sqrt(5.0) * lag / length
    plain = (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
    mean = variance[0] * 0.5  # the constant, which is a joint zero, is not in the sum
    np.testing.assert_allclose((found + mean) / (1.0 + mean), plain, atol=2e-3)


def planar(seed, n=400, noise=20e-6):
    """An arm of two joints in the plane, the first with a curve drawn from the prior; and what is measured."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-math.pi, math.pi, (n, 2))
    by_joint = np.zeros((3, 2, n))
    by_joint[0, 0], by_joint[1, 0] = -np.sin(q[:, 0]), np.cos(q[:, 0])
    by_joint[0, 1], by_joint[2, 1] = np.sin(q[:, 1]), np.cos(q[:, 1])
    coefficients = np.sqrt(np.repeat(spectrum_variances(0.12, 3e-4, 60)[1:], 2)) * rng.standard_normal(118)
    curve = coefficients @ harmonics(q[:, 0], 60)
    moved = by_joint[:, 0] * curve + noise * rng.standard_normal((3, n))
    white = np.broadcast_to(np.eye(3)[:, :, None] / noise, (3, 3, n))
    return q, by_joint, white, moved, coefficients


def test_length_amplitude_and_noise_are_found_and_a_still_joint_gets_no_curve():
    lengths, amplitudes = [], []
    for seed in range(4):
        q, by_joint, white, moved, _ = planar(seed)
        basis = np.linalg.qr(np.random.default_rng(seed).standard_normal((3 * len(q), 3)))[0]
        residual = (moved / 20e-6).ravel()
        residual = residual - basis @ (basis.T @ residual)
        found = fit_curve_prior(q, by_joint, white, basis, residual, (0, 1), 60)
        assert found.noise == pytest.approx(1.0, rel=0.1)
        assert found.evidence > 500.0
        assert found.amplitudes[1] < 0.1 * found.amplitudes[0]
        lengths.append(found.lengths[0])
        amplitudes.append(found.amplitudes[0])
    assert np.exp(np.mean(np.log(lengths))) == pytest.approx(0.12, rel=0.3)
    assert np.exp(np.mean(np.log(amplitudes))) == pytest.approx(3e-4, rel=0.3)


def test_noise_alone_has_no_evidence_for_a_curve():
    for seed in range(4):
        q, by_joint, white, _, _ = planar(seed)
        residual = np.random.default_rng([seed, 1]).standard_normal(3 * len(q))
        basis = np.zeros((3 * len(q), 0))
        found = fit_curve_prior(q, by_joint, white, basis, residual, (0, 1), 60)
        assert found.evidence < 12.0


def test_the_spread_of_a_curve_is_what_its_coefficients_leave_open():
    rng = np.random.default_rng(2)
    root = rng.standard_normal((38, 38)) * 1e-5
    covariance = root @ root.T
    drawn = root @ rng.standard_normal((38, 20000))
    around = np.linspace(-math.pi, math.pi, 12, endpoint=False)
    wanted = (drawn.T @ harmonics(around, 20)).std(axis=0)
    np.testing.assert_allclose(curve_standard_deviation(covariance, 12), wanted, rtol=0.05)
