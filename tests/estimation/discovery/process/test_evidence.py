"""Evidence of a structured process: it is the marginal likelihood of the readings, and its derivatives are right."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import fit_terms, refit
from cellapp.estimation.discovery.process import (
    CURVE_LENGTHS,
    LEAST_READINGS,
    Component,
    Hyperparameters,
    ProcessData,
    evidence,
    first_guess,
    fit_process,
    log_evidence,
    losses,
    most_evident,
    process_terms,
)
from cellapp.estimation.discovery.terms import has_smooth_terms
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import Channel, EffectColumn, LawForm
from cellapp.robot.effects.context import Wave
from cellapp.robot.effects.law import circle_variances
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm
from tests.arms import STATION
from tests.twin import PROFILES

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


# -- The structured process on a simulated arm: what is there stays, what is not is removed, with any weights ----------

SIGMA_M = 12e-6
NEEDED = 30.0
LENGTH, AMPLITUDE = np.radians(12.0), 1.5e-4
CURVED = (0, 2)


def curves(rng):
    """Joint offsets that are draws of a smooth function of the joint's own angle, at two joints.

    One cycle per revolution is left out: that is an eccentric encoder, another effect.
    """
    k = np.arange(2, 81)
    sd = AMPLITUDE * np.sqrt(circle_variances(LENGTH, 80)[1:])
    weights = {joint: rng.normal(size=(2, len(k))) * sd for joint in CURVED}

    def bend(q):
        bent = np.zeros_like(q)
        for joint, (a, b) in weights.items():
            waves = np.outer(q[:, joint], k)
            bent[:, joint] = np.cos(waves) @ a + np.sin(waves) @ b
        return bent

    return bend


def data_of(bend, *, N=300, stated=True, seed=7):
    """Readings of an arm whose joints are off by ``bend(q)``, with white noise."""
    profile = load_profile(PROFILES / "twin.yaml")
    geometry = nominal_arm(profile.arms["left"]).with_T_M_B(STATION)
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2.5, 2.5, (N, 6))
    readings = Readings(
        configuration=np.arange(N, dtype=np.int64),
        time_s=60.0 * np.arange(N, dtype=np.float64),
        q=q,
        approach=np.sign(rng.uniform(-1.0, 1.0, (N, 6))).astype(np.int8),
        p_M=smr_positions(geometry, q + bend(q)) + rng.normal(0.0, SIGMA_M, (N, 3)),
        sigma_m=np.full(N, SIGMA_M if stated else np.nan),
    )
    up = STATION[:3, :3] @ np.array([0.0, 0.0, 1.0])
    model = ArmModel(geometry=geometry, nominal=geometry, bodies=bodies_of(profile.arms["left"]), up_M=up)
    return ArmData.of(profile, model, readings, measurement_conditions(readings))


@pytest.mark.parametrize("stated", [True, False])
def test_a_curve_of_two_joints_is_found_with_its_hyperparameters(stated):
    data = data_of(curves(np.random.default_rng(3)), stated=stated)
    assert (data.stated is not None) == stated
    found = fit_process(data, fit_terms(data, ()), NEEDED)
    assert found is not None
    process, scatter = found
    (one,) = process.components
    assert one.slug == "transmission_error"
    amplitudes = dict(zip(one.amplitude_keys, process.values.amplitudes[0], strict=True))
    curved = [amplitudes.pop(f"amplitude{joint + 1}") for joint in CURVED]
    np.testing.assert_allclose(curved, AMPLITUDE, rtol=0.5)
    assert max(amplitudes.values(), default=0.0) < 0.05 * AMPLITUDE
    assert process.values.lengths[0] == pytest.approx(LENGTH, rel=0.4)
    # all of the scatter where no uncertainty is stated, nearly nothing beyond it where it is
    assert scatter.m < 0.5 * SIGMA_M if stated else scatter.m == pytest.approx(SIGMA_M, rel=0.1)
    (term,) = process_terms(process, scatter)
    assert term.smooth is not None
    assert term.smooth.evidence > NEEDED
    assert term.smooth.hyperparameters == len(one.amplitude_keys) + 1
    _, after = refit(data, (term,))
    assert has_smooth_terms(after.terms)
    # geometry and curves take some 150 of the 900 coordinates
    assert np.std(after.identification.residuals) == pytest.approx(SIGMA_M * np.sqrt(750.0 / 900.0), rel=0.1)


@pytest.mark.parametrize("stated", [True, False])
def test_noise_needs_no_process(stated):
    data = data_of(np.zeros_like, N=150, stated=stated)
    assert fit_process(data, fit_terms(data, ()), NEEDED) is None


def test_few_readings_have_no_process():
    data = data_of(curves(np.random.default_rng(3)), N=LEAST_READINGS - 1)
    assert fit_process(data, fit_terms(data, ()), NEEDED) is None


def test_a_component_more_or_less_changes_the_evidence_as_its_gain_says():
    data = data_of(curves(np.random.default_rng(3)))
    found = fit_process(data, fit_terms(data, ()), 0.0)
    assert found is not None
    process, _ = found
    for number, gain in enumerate(process.gains()):
        rest = process.without(number)
        assert gain == pytest.approx(2.0 * (process.log_evidence - rest.log_evidence) - process.price(number))
    again = replace(process).refitted(20)
    assert again.log_evidence >= process.log_evidence - 1e-6
