"""The structured process on a simulated arm: what is there stays, what is not is removed, with any weights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import fit_terms, refit
from cellapp.estimation.discovery.process import LEAST_READINGS, fit_process, process_terms
from cellapp.estimation.discovery.terms import has_smooth_terms
from cellapp.estimation.readings import Readings
from cellapp.robot.effects.law import circle_variances
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm
from tests.arms import STATION
from tests.twin import PROFILES

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


@pytest.mark.fast
@pytest.mark.parametrize("stated", [True, False])
def test_noise_needs_no_process(stated):
    data = data_of(np.zeros_like, N=150, stated=stated)
    assert fit_process(data, fit_terms(data, ()), NEEDED) is None


@pytest.mark.fast
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
