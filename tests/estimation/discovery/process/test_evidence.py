"""Evidence of a structured process: it is the marginal likelihood of the readings, and its derivatives are right."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from cellapp.estimation.discovery.process import (
    CURVE_LENGTHS,
    Component,
    Hyperparameters,
    ProcessData,
    evidence,
    first_guess,
    log_evidence,
    losses,
    most_evident,
)
from cellapp.robot.effects import Channel, EffectColumn, LawForm
from cellapp.robot.effects.context import Wave
from cellapp.robot.effects.law import circle_variances

pytestmark = pytest.mark.fast

N = 300
CYCLES = 20
FORM = LawForm("smooth", "smooth")


def columns(cycles):
    return tuple(EffectColumn(f"c{k}", "rad", "", -1.0, 1.0, Channel.BASE, wave=Wave(int(k), False)) for k in cycles)


def curve(rng):
    """A free function of one angle: cosines and sines of 1 ... ``CYCLES`` cycles, one amplitude, one length scale."""
    z = rng.uniform(-np.pi, np.pi, N)
    k = np.arange(1, CYCLES + 1)
    rows = np.concatenate([np.cos(np.outer(k, z)), np.sin(np.outer(k, z))])
    return Component(
        slug="transmission_error",
        columns=columns(np.tile(k, 2)),
        rows=rows,
        form=FORM,
        constants={},
        groups=np.zeros(2 * CYCLES, dtype=np.intp),
        amplitude_keys=("amplitude",),
        start=1.0,
        weights=np.ones(2 * CYCLES),
        lengths=CURVE_LENGTHS,
        length_keys=("length",),
    )


def plain(rng):
    """Four random columns with two amplitudes."""
    return Component(
        slug="backlash",
        columns=columns(range(1, 5)),
        rows=rng.normal(size=(4, N)),
        form=FORM,
        constants={},
        groups=np.array([0, 0, 1, 1]),
        amplitude_keys=("amplitude1", "amplitude2"),
        start=1.0,
        weights=np.array([1.0, 0.5, 1.0, 2.0]),
    )


def gathered(components, y):
    rows = np.concatenate([one.rows for one in components])
    return ProcessData(rows @ rows.T, rows @ y, float(y @ y), float(N))


def simulated(rng, components, values):
    """Readings (N,) of the components' prior."""
    rows = np.concatenate([one.rows for one in components])
    weights = rng.normal(size=len(rows)) * np.sqrt(values.variances(components))
    return weights @ rows + rng.normal(0.0, math.sqrt(values.noise), N)


TRUE = Hyperparameters((np.array([0.8]), np.array([0.5, 0.3])), (0.4, 1.0), 0.1)


def test_it_is_the_marginal_likelihood_of_the_readings():
    rng = np.random.default_rng(1)
    parts = (curve(rng), plain(rng))
    y = simulated(rng, parts, TRUE)
    X = np.concatenate([one.rows for one in parts]).T
    variance = TRUE.variances(parts)
    dense = multivariate_normal(np.zeros(N), (X * variance) @ X.T + TRUE.noise * np.eye(N))
    wanted = dense.logpdf(y) + 0.5 * N * math.log(2.0 * math.pi)
    # columns whose prior is below a thousandth of the noise are left out
    assert log_evidence(gathered(parts, y), variance, TRUE.noise) == pytest.approx(wanted, abs=0.02)
    assert evidence(gathered(parts, y), variance, TRUE.noise).value == pytest.approx(wanted, abs=0.02)


def test_without_columns_it_is_that_of_noise():
    y = np.random.default_rng(2).normal(0.0, 0.3, N)
    data = ProcessData(np.zeros((0, 0)), np.zeros(0), float(y @ y), float(N))
    wanted = -0.5 * (N * math.log(0.09) + data.square / 0.09)
    assert log_evidence(data, np.zeros(0), 0.09) == pytest.approx(wanted)


def test_the_derivatives_are_those_of_differences():
    rng = np.random.default_rng(3)
    parts = (plain(rng), plain(rng))
    data = gathered(parts, simulated(rng, parts, Hyperparameters((np.array([0.5, 0.3]),) * 2, (1.0, 1.0), 0.1)))
    variance, noise, step = np.array([0.2, 0.1, 0.3, 0.05, 0.4, 0.2, 0.1, 0.6]), 0.2, 1e-5
    found = evidence(data, variance, noise)
    for k in range(len(variance)):
        up, down = variance.copy(), variance.copy()
        up[k] *= math.exp(step)
        down[k] *= math.exp(-step)
        slope = (log_evidence(data, up, noise) - log_evidence(data, down, noise)) / (2.0 * step)
        assert found.by_variance[k] == pytest.approx(slope, rel=1e-4, abs=1e-4)
    above = log_evidence(data, variance, noise * math.exp(step))
    below = log_evidence(data, variance, noise * math.exp(-step))
    assert found.by_noise == pytest.approx((above - below) / (2.0 * step), rel=1e-4, abs=1e-4)


def test_a_loss_is_that_of_the_evidence_without_a_group():
    rng = np.random.default_rng(7)
    parts = (curve(rng), plain(rng), plain(rng))
    y = simulated(rng, parts[:2], TRUE)
    data = gathered(parts, y)
    variance = np.concatenate([TRUE.variances(parts[:2]), [0.01, 0.0, 0.02, 1e-9]])
    sizes = [len(one.columns) for one in parts]
    ends = np.cumsum(sizes)
    found = losses(data, variance, TRUE.noise, ends.tolist())
    whole = log_evidence(data, variance, TRUE.noise)
    for end, size, loss in zip(ends, sizes, found):
        kept = np.delete(np.arange(len(variance)), np.s_[end - size : end])
        rest = log_evidence(data.take(kept), variance[kept], TRUE.noise)
        assert loss == pytest.approx(whole - rest, abs=1e-6)


def test_hyperparameters_of_a_simulated_curve_are_recovered():
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(12):
        one = curve(rng)
        data = gathered([one], simulated(rng, [one], Hyperparameters((np.array([0.8]),), (0.4,), 0.1)))
        values, _ = most_evident([one], data, first_guess([one], data), 60)
        found = np.array([values.amplitudes[0][0] / 0.8, values.lengths[0] / 0.4, values.noise / 0.1])
        errors.append(np.log(found))
    # a turn holds some 2 pi / 0.8 independent values of the curve: 25 % for its amplitude, 8 % for the noise
    np.testing.assert_allclose(np.mean(errors, axis=0), 0.0, atol=0.2)
    assert (np.std(errors, axis=0) < (0.4, 0.4, 0.16)).all()


def test_an_amplitude_that_is_not_there_becomes_negligible():
    rng = np.random.default_rng(5)
    parts = (curve(rng), plain(rng))
    y = simulated(rng, parts, Hyperparameters((np.array([0.8]), np.array([0.5, 1e-9])), (0.4, 1.0), 0.1))
    data = gathered(parts, y)
    values, found = most_evident(parts, data, first_guess(parts, data), 80)
    assert values.amplitudes[1][1] < 0.05
    assert values.amplitudes[1][0] > 0.15
    assert found >= log_evidence(data, TRUE.variances(parts), TRUE.noise)


def test_the_slower_spectrum_has_the_longer_length():
    one = curve(np.random.default_rng(6))
    for length in (0.1, 0.5):
        variances = one.relative_variances(length)
        np.testing.assert_allclose(variances, np.tile(circle_variances(length, CYCLES), 2))
    assert one.relative_variances(0.5)[0] > one.relative_variances(0.1)[0]
    assert {column.cycles for column in one.coarse().columns} == set(range(1, CYCLES // 2 + 1))
    assert len(one.coarse().rows) == len(one.coarse().columns) == CYCLES
