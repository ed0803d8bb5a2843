"""Model file: lossless round trip; unknown content is rejected."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellapp.estimation.calibration.identification import identify
from cellapp.ground.errors import InputError
from cellapp.robot.effects import EFFECTS, MeasurementConditions
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.statics import Bodies
from cellapp.robot.model import ArmModel, CellModel, ResidualNetwork
from cellapp.robot.model.model import PosteriorSamples, ReadingsNoise
from tests.arms import OFF_AXIS, UR10, UR10_CENTERS, UR10_MASSES, at_station, effect_term, true_geometry


def network(rng):
    """A committee of two with random weights: 12 inputs, 4 hidden, 3 outputs."""
    members = tuple(
        ((rng.normal(size=(4, 12)), rng.normal(size=4)), (rng.normal(size=(3, 4)), rng.normal(size=3)))
        for _ in range(2)
    )
    return ResidualNetwork("sincos", np.full(6, -2.5), np.full(6, 2.5), np.full(6, 0.4), True, 1e-4, members)


def cell_model():
    rng = np.random.default_rng(0)
    nominal = at_station(UR10, OFF_AXIS)
    terms = (
        effect_term("joint_compliance", {"compliance2": 1.7e-5}, "rad/Nm", error=1e-8),
        effect_term("backlash", {"half_play1": 1e-4}, error=1e-6),
    )
    arm = ArmModel(
        geometry=true_geometry(nominal, rng),
        nominal=nominal,
        bodies=Bodies(UR10_MASSES, UR10_CENTERS, 1.5, np.array([0.0, 0.01, 0.08])),
        up_M=np.array([0.0, 0.0, 1.0]),
        effects=terms,
        network=network(rng),
        identified=("x0", "compliance2"),
        covariance=np.array([[1e-12, 1e-15], [1e-15, 1e-16]]),
    )
    return CellModel({"left": arm}, provenance={"profile": "test"})


def test_a_saved_model_predicts_what_it_predicted(tmp_path):
    model = cell_model()
    model.save(tmp_path / "calibration.json")
    loaded = CellModel.load(tmp_path / "calibration.json")
    rng = np.random.default_rng(1)
    q, approach = rng.uniform(-3, 3, (50, 6)), rng.integers(-1, 2, (50, 6)).astype(np.int8)
    payload = rng.uniform(0, 5, 50)
    np.testing.assert_array_equal(
        loaded.predict("left", q, approach, payload), model.predict("left", q, approach, payload)
    )
    np.testing.assert_array_equal(loaded.arms["left"].covariance, model.arms["left"].covariance)
    assert loaded.to_json() == model.to_json()
    bare = replace(model.arms["left"], network=None)
    conditions = MeasurementConditions(approach=approach, payload_kg=payload)
    gap = model.predict("left", q, approach, payload) - bare.predict(q, conditions=conditions)
    rotation = bare.geometry.T_M_B()[:3, :3]  # the network speaks in the base frame
    np.testing.assert_allclose(gap, model.arms["left"].network.correct(q) @ rotation.T, atol=1e-15)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda c: c.update(version=2), "version 2"),
        (lambda c: c.update(schema="other"), '"schema"'),
        (lambda c: c["arms"]["left"].pop("geometry"), "geometry"),
        (lambda c: c["arms"]["left"]["effects"][0].update(effect="magic"), "magic"),
    ],
)
def test_an_unknown_or_damaged_file_is_refused_with_its_name(tmp_path, spoil, says):
    content = json.loads(cell_model().to_json())
    spoil(content)
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        CellModel.load(path)
    assert str(path) in str(refused.value)
    assert says in str(refused.value)


def test_a_missing_or_cut_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="cellapp calibrate"):
        CellModel.load(tmp_path / "none.json")
    path = tmp_path / "cut.json"
    path.write_text(cell_model().to_json()[:500], encoding="utf-8")
    with pytest.raises(InputError, match="not JSON"):
        CellModel.load(path)


def test_every_effect_is_documented_and_keeps_its_columns():
    arm = cell_model().arms["left"]
    one, many = arm.context(np.zeros((1, 6))), arm.context(np.random.default_rng(0).uniform(-3, 3, (30, 6)))
    for slug, effect in EFFECTS.items():
        assert effect.slug == slug
        assert "``" in (type(effect).__doc__ or "") or " = " in (type(effect).__doc__ or "")  # its equation
        for law in effect.laws(many):
            assert [c.name for c in effect.columns(one, law)] == [c.name for c in effect.columns(many, law)]
            assert all(c.lower < c.upper for c in effect.columns(one, law))


# -- Draws of the fitted parameters: they spread as their covariance says, survive JSON, and give honest intervals -----


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
        draws = PosteriorSamples.of_covariance(columns, [], Sigma, ReadingsNoise(sigma_m), (seed,))
        bodies = Bodies(UR10_MASSES, UR10_CENTERS, 0.0, np.zeros(3))
        model = ArmModel(found.geometry, nominal, bodies, np.array([0.0, 0.0, 1.0]), posterior=draws)
        within.append(np.abs(p_M[60:] - model.predict(q[60:])) <= 1.96 * model.measured_uncertainty(q[60:])[:, None])
        uncertain.append(model.uncertainty(q[60:]))
    assert np.mean(within) == pytest.approx(0.95, abs=0.015)
    # 27 parameters from 180 coordinates: their part of the variance of a prediction is at least their share
    assert np.mean(np.square(uncertain)) > sigma_m**2 * 27.0 / 180.0
