"""Discovery of an arm that was recorded in motion: its model where it predicts better, and its words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from cellapp.cell.profile import load_profile
from cellapp.commands.discover.view import view
from cellapp.estimation.discovery.discover import discover_cell
from cellapp.estimation.discovery.records import ArmDiscoveryResult, DiscoverResult
from cellapp.estimation.motion.calibrate import calibrate_with_motion
from cellapp.estimation.motion.discovery import SearchWithRecordings
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Discovery
from cellapp.ground.threads import one_blas_thread
from cellapp.robot.kinematics.chain import smr_positions
from tests.estimation.motion.simulated import record, sweep, true_arm

PROFILE = load_profile(Path(__file__).parents[3] / "profiles" / "ur10-real.yaml")
QUICK = PROFILE.model_copy(
    update={"discovery": Discovery(null_simulations=20, folds=2, false_alarm=0.05, network="never")}
)
"""With a short search of the samples: what recordings show is searched as ever."""


def test_dense_lines_and_play_enter_the_model_and_a_lag_does_not():
    rng = np.random.default_rng(1)
    arm = replace(
        true_arm(rng, half_play=[40e-6] * 6),
        cycles=40.0,
        amplitude=np.array([60e-6, 50e-6, 0, 0, 0, 0, 0]),
        phase=rng.uniform(0.0, 6.0, 7),
        lag_s=np.array([0.0, 0.0, 0.0, 0.0, 0.003, 0.0, 0.0]),
    )
    motion = sweep(rng, 6)
    recordings = {"left": (record(rng, arm, motion, seconds=100.0, point_hz=50.0, slow=10e-6),)}
    none = Readings(
        configuration=np.zeros(0, dtype=np.int64),
        time_s=np.zeros(0),
        q=np.zeros((0, 6)),
        approach=np.zeros((0, 6), dtype=np.int8),
        p_M=np.zeros((0, 3)),
    )
    with one_blas_thread():
        moved = calibrate_with_motion(QUICK, {"left": none}, recordings)
        model = moved.calibration.model
        samples = moved.samples["left"]
        search = SearchWithRecordings(model.arms, {"left": none}, recordings)
        found = discover_cell(QUICK, model, {"left": samples}, search_arm=search)
    discovery = found.arms["left"]
    assert discovery.result.motion is not None
    assert discovery.result.motion.used
    assert {term.slug for term in discovery.terms} == {"backlash", "transmission_error"}
    assert {one.effect for one in discovery.result.motion.effects} == {"backlash", "transmission_error", "tracking_lag"}
    model_arm = found.model.arms["left"]
    assert model_arm.covariance is not None
    assert model_arm.covariance.shape == (len(model_arm.identified),) * 2
    q, side = motion.at(np.linspace(0.0, 50.0, 200)), np.sign(motion.speed(np.linspace(0.0, 50.0, 200)))
    true = arm.points(q - arm.half_play * side + arm.amplitude[:6] * np.sin(40.0 * q + arm.phase[:6]))
    with_effects = np.linalg.norm(model_arm.predict(q, side) - true, axis=1)
    without = np.linalg.norm(smr_positions(model.arms["left"].geometry, q) - true, axis=1)
    assert np.sqrt(np.mean(with_effects**2)) < 0.5 * np.sqrt(np.mean(without**2))
    assert ArmDiscoveryResult.model_validate_json(discovery.result.model_dump_json(by_alias=True)) is not None
    text = str(view(DiscoverResult(arms={"left": discovery.result})))
    assert "a delay moves nothing at rest" in text
    assert "stays out of commands" in text
