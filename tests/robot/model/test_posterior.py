"""Draws of the fitted parameters: they spread as their covariance says, survive JSON, and give honest intervals."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellapp.estimation.calibration.identification import identify
from cellapp.robot.effects import EFFECTS, EffectTerm
from cellapp.robot.kinematics.chain import JointAngles, jacobian, joint_jacobian, smr_positions
from cellapp.robot.kinematics.statics import Bodies
from cellapp.robot.model import ArmModel
from cellapp.robot.model.model import DRAWS, PosteriorDraws, ReadingsNoise, posterior_from_json, posterior_to_json
from tests.arms import OFF_AXIS, STATION, UR10, UR10_CENTERS, UR10_MASSES, at_station, true_geometry

pytestmark = pytest.mark.fast

COLUMNS = tuple(range(12))
COMPLIANCE = EffectTerm(
    "joint_compliance",
    ("compliance2", "compliance3"),
    np.array([1.7e-5, 2.0e-5]),
    np.array([1e-6, 1e-6]),
    ("rad/Nm", "rad/Nm"),
    EFFECTS["joint_compliance"].law(),
)


def arm():
    nominal = at_station(UR10, OFF_AXIS)
    return ArmModel(
        geometry=true_geometry(nominal, np.random.default_rng(0)),
        nominal=nominal,
        bodies=Bodies(UR10_MASSES, UR10_CENTERS, 1.5, np.array([0.0, 0.01, 0.08])),
        up_M=STATION[:3, :3] @ np.array([0.0, 0.0, 1.0]),
        effects=(COMPLIANCE,),
    )


def covariance(rng):
    """Of twelve geometric parameters and two compliances, all correlated."""
    size = len(COLUMNS) + len(COMPLIANCE.names)
    scale = np.array([1e-5] * len(COLUMNS) + [1e-6] * len(COMPLIANCE.names))
    root = rng.normal(size=(size, size)) / np.sqrt(size) * scale[:, None]
    return root @ root.T


def draws_of(Sigma, seed):
    return PosteriorDraws.of_covariance(COLUMNS, [len(COMPLIANCE.names)], Sigma, ReadingsNoise(2e-5), (seed,))


def predicted_by(model, q):
    """Derivatives (n, 3, p) of the SMR by all parameters."""
    angles = JointAngles.of(q)
    _, J = jacobian(model.geometry, angles, COLUMNS)
    _, by_joint = joint_jacobian(model.geometry, angles)
    columns = EFFECTS[COMPLIANCE.slug].columns(model.context(q), COMPLIANCE.law, frozenset(COMPLIANCE.names))
    by_name = {column.name: column for column in columns}
    moved = []
    for column in (by_name[name] for name in COMPLIANCE.names):
        assert column.joint is not None
        assert column.offset is not None
        moved.append(by_joint[:, column.joint] * column.offset)
    return np.concatenate([J, np.stack(moved, axis=1)], axis=1).transpose(2, 0, 1)


def test_draws_spread_as_the_covariance_of_the_prediction():
    rng = np.random.default_rng(1)
    model, Sigma = arm(), covariance(rng)
    q = rng.uniform(-2.0, 2.0, (5, 6))
    by_parameter = predicted_by(model, q)
    wanted = np.einsum("nap,pr,nbr->nab", by_parameter, Sigma, by_parameter)
    many = [draws_of(Sigma, seed).displacements(model.geometry, model.effects, model.context(q)) for seed in range(40)]
    moved = np.concatenate(many)
    assert moved.shape == (40 * DRAWS, 5, 3)
    found = np.einsum("sna,snb->nab", moved, moved) / len(moved)
    # sampling error of a variance from S draws: sqrt(2 / S) = 2.8 %; of a covariance, relative to the sizes, the same
    size = np.sqrt(np.einsum("naa->na", wanted))
    assert np.abs((found - wanted) / (size[:, :, None] * size[:, None])).max() < 4.5 * np.sqrt(2.0 / len(moved))
    one = replace(model, posterior=draws_of(Sigma, 3))
    rms = np.sqrt(np.mean(size**2, axis=1))
    np.testing.assert_allclose(one.uncertainty(q), rms, rtol=4.0 / np.sqrt(2.0 * DRAWS))
    np.testing.assert_allclose(one.measured_uncertainty(q), np.hypot(one.uncertainty(q), 2e-5))
    assert not model.uncertainty(q).any(), "no draws, no uncertainty"


def test_the_second_moment_of_draws_of_few_parameters_is_the_covariance_itself():
    Sigma = covariance(np.random.default_rng(5))
    drawn = draws_of(Sigma, 1)
    values = np.hstack([drawn.geometry, *drawn.terms])
    size = np.sqrt(np.diag(Sigma))
    found = values.T @ values / DRAWS
    np.testing.assert_allclose(found / size / size[:, None], Sigma / size / size[:, None], atol=1e-9)


def test_a_parameter_that_is_certain_stays():
    Sigma = covariance(np.random.default_rng(2))
    Sigma[3], Sigma[:, 3] = 0.0, 0.0
    drawn = draws_of(Sigma, 0)
    assert np.abs(drawn.geometry[:, 3]).max() < 1e-12
    assert drawn.geometry.shape == (DRAWS, len(COLUMNS))
    assert [one.shape for one in drawn.terms] == [(DRAWS, 2)]


def test_draws_survive_json():
    drawn = draws_of(covariance(np.random.default_rng(4)), 0)
    back = posterior_from_json(json.loads(json.dumps(posterior_to_json(drawn))))
    assert (back.columns, back.noise_m) == (drawn.columns, drawn.noise_m)
    np.testing.assert_allclose(back.geometry, drawn.geometry, rtol=1e-3)
    np.testing.assert_allclose(back.terms[0], drawn.terms[0], rtol=1e-3)
    geometry_only = PosteriorDraws.of_covariance(COLUMNS, [], np.eye(len(COLUMNS)), ReadingsNoise(0.0), (0,))
    assert posterior_from_json(posterior_to_json(geometry_only)).terms == ()


def test_intervals_hold_95_percent_of_new_simulated_readings():
    """Geometry from 60 readings: new coordinates are within 1.96 standard deviations in 95 % of all cases."""
    sigma_m, within, uncertain = 20e-6, [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        nominal = at_station(UR10, OFF_AXIS)
        truth = true_geometry(nominal, rng)
        q = rng.uniform(-2.5, 2.5, (460, 6))
        p_M = smr_positions(truth, q) + rng.normal(0.0, sigma_m, (460, 3))
        found = identify(nominal, q[:60], p_M[:60], sigma=np.full(60, sigma_m))
        columns, Sigma = found.estimated.columns, found.estimated_covariance
        draws = PosteriorDraws.of_covariance(columns, [], Sigma, ReadingsNoise(sigma_m), (seed,))
        model = replace(arm(), geometry=found.geometry, nominal=nominal, effects=(), posterior=draws)
        left = np.abs(p_M[60:] - model.predict(q[60:]))
        within.append(left <= 1.96 * model.measured_uncertainty(q[60:])[:, None])
        uncertain.append(model.uncertainty(q[60:]))
    assert np.mean(within) == pytest.approx(0.95, abs=0.015)
    # 27 parameters from 180 coordinates: their part of the variance of a prediction is at least their share
    assert np.mean(np.square(uncertain)) > sigma_m**2 * 27.0 / 180.0
