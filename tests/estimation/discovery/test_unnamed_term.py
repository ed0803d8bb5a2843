"""What cannot be named: it stays in the model without a name, with the noise of the joints, whatever readings state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.cell.exports.arm_export import lost_parts, workspace
from cellapp.cell.planning.propose import _unnamed_advice
from cellapp.cell.profile import load_profile
from cellapp.commands.discover.words import remainder_sentences
from cellapp.estimation.calibration.quantities import ArmReadings, measurement_conditions
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.discovery.search import stepwise
from cellapp.estimation.discovery.search.state import Posteriors
from cellapp.estimation.readings import Readings
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm
from tests.arms import STATION
from tests.series import readings_at
from tests.sure import sure
from tests.twin import PROFILES

N, LEARNT, SIGMA_M, JOINT_RAD = 260, 200, 1e-5, 5e-5
PROFILE = load_profile(PROFILES / "twin.yaml")
GEOMETRY = nominal_arm(PROFILE.arms["left"]).with_T_M_B(STATION)
MODEL = ArmModel(GEOMETRY, GEOMETRY, bodies_of(PROFILE.arms["left"]), STATION[:3, 2])


def readings_of(factor: float) -> Readings:
    """An arm whose joints err by rough curves and scatter; it states ``factor`` times its tracker's noise."""
    rng = np.random.default_rng(3)
    q = rng.uniform(-2.0, 2.0, (N, 6))
    waves = np.arange(2, 12)[:, None, None]
    phase, size = rng.uniform(0.0, 6.28, (2, 10, 1, 6))
    moved = np.sum(4e-4 * size / waves * np.sin(waves * q + phase), axis=0) + rng.normal(0.0, JOINT_RAD, (N, 6))
    return measured(q, moved, factor, rng)


def measured(q: Array, moved: Array, factor: float, rng: np.random.Generator) -> Readings:
    """Readings of joints that are off by ``moved`` (N, 6) [rad]."""
    p_M = smr_positions(GEOMETRY, q + moved) + rng.normal(0.0, SIGMA_M, (N, 3))
    split = ("identify",) * LEARNT + ("validate",) * (N - LEARNT)
    return readings_at(q, p_M, time_s=60.0 * np.arange(N), sigma_m=factor * SIGMA_M, split=split)


@pytest.mark.parametrize("factor", [1.0, pytest.param(30.0, marks=pytest.mark.slow)])
def test_what_has_no_name_stays_in_the_model_whatever_is_stated(factor, monkeypatch):
    monkeypatch.setattr(
        stepwise, "posteriors_of", lambda found, scan: Posteriors((0.3,) * len(found.reviews), {})
    )  # no name is probable
    readings = readings_of(factor)
    conditions = measurement_conditions(readings)
    found = discover_arm(ArmReadings(PROFILE, "left", MODEL, readings, conditions))
    result, unnamed = found.result, found.result.unnamed
    assert result.accepted == ()
    assert unnamed is not None
    assert unnamed.in_force
    assert unnamed.causes[0] == "transmission_error"
    assert {"joint 2", "joint 3"} & set(unnamed.acts_on)
    assert result.verdict == "unknown effect"
    assert f"unnamed: {unnamed.rms_mm:.3f} mm rms, mostly joint" in result.sentence
    assert result.heldout_mm.after < 0.6 * result.heldout_mm.before
    assert (result.claim is not None) == (factor > 1.0)
    assert ("an expanded or maximum figure?" in result.sentence) == (factor > 1.0)
    assert ("times the estimated noise" in " ".join(remainder_sentences(result))) == (factor > 1.0)

    out = slice(LEARNT, N)
    q, then = readings.q[out], conditions.take(np.arange(LEARNT, N))
    predicted = found.model.predict(q, conditions=then)
    within = np.abs(readings.p_M[out] - predicted) <= 1.96 * found.model.measured_uncertainty(q, then)[:, None]
    assert 0.88 < within.mean() < 0.99
    noise = found.model.noise(q)
    assert noise.max() > 1.5 * noise.min(), "joints scatter by their levers"
    assert "most like transmission error" in _unnamed_advice("left", unnamed)[0]
    again = CellModel.from_json(CellModel({"left": found.model}).to_json(), "model").arms["left"]
    np.testing.assert_array_equal(again.predict(q, conditions=then), predicted)
    lost = lost_parts(replace(found.model, network=None), workspace(readings.q, conditions, 1))
    assert set(lost) == {"unnamed"}


def test_joints_that_depend_on_their_neighbours_are_predicted_to_the_noise_without_a_name():
    rng = np.random.default_rng(4)
    q = rng.uniform(-2.0, 2.0, (N, 6))
    moved = np.zeros((N, 6))
    moved[:, 1], moved[:, 2] = 1e-4 * np.sin(2.0 * q[:, 1] + q[:, 2]), 1e-4 * np.cos(q[:, 2] - q[:, 3])
    found = discover_arm(ArmReadings.alone(PROFILE, "left", MODEL, measured(q, moved, 1.0, rng))).result
    assert sure(found.unnamed).in_force
    assert found.accepted == ()
    assert found.heldout_mm.after < 1.25e3 * np.sqrt(3.0) * SIGMA_M < 0.5 * found.heldout_mm.before
