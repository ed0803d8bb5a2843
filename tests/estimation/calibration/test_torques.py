"""Masses from measured torques or currents: known truth, the better ones drive elasticity, faults by joint and row."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration import torques
from cellapp.estimation.calibration.torques import fit_torques, has_torques
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import NotConverged
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import frame_poses, smr_positions
from cellapp.robot.kinematics.statics import gravity_loads
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm, up_in_tracker

PROFILE = load_profile(Path(__file__).parents[3] / "profiles" / "twin-small.yaml")
ARM = PROFILE.arms["left"]
STATED = bodies_of(ARM)
UP_M = up_in_tracker(PROFILE)
CONSTANTS = np.array([11.0, 11.0, 10.5, 8.0, -8.0, 7.5])
"""Nm/A; the fifth motor is mounted the other way round."""
COMPLIANCE = np.array([2e-5, 3e-5, 4e-5, 6e-5, 6e-5, 8e-5])


TRUE = replace(
    STATED,
    masses=STATED.masses * np.array([1.3, 1.25, 1.4, 1.3, 0.8, 2.0]),
    centers=STATED.centers + np.array([[0.0, 0.02, 0.0], [-0.05, 0.0, 0.02], [0.04, 0.03, 0.0]] * 2),
)


def drives(geometry, bodies, q, payload_kg):
    return -gravity_loads(frame_poses(geometry, q), bodies, UP_M, payload_kg).joint_torques()


def measured(seed=1, n=150, noise=0.4, compliance=COMPLIANCE, true=TRUE):
    """Model of the identified arm, readings of an elastic arm with other masses than stated, and these masses."""
    rng = np.random.default_rng(seed)
    geometry = nominal_arm(ARM)
    q = rng.uniform(-2.0, 2.0, (n, 6))
    payload_kg = np.where(np.arange(n) % 2, 0.0, 4.0)
    approach = rng.choice([-1, 1], (n, 6)).astype(np.int8)
    held = drives(geometry, true, q, payload_kg)
    tau = held + 3.0 * approach + rng.normal(0.0, noise, (n, 6))
    p_M = smr_positions(geometry, q - compliance * held) + rng.normal(0.0, 15e-6, (n, 3))
    readings = Readings(
        configuration=np.arange(n),
        time_s=np.arange(float(n)),
        q=q,
        approach=approach,
        p_M=p_M,
        payload_kg=payload_kg,
        tau_nm=tau,
        split=tuple(("identify", "identify", "identify", "validate")[i % 4] for i in range(n)),
    )
    return ArmModel(geometry, geometry, STATED, UP_M), readings, true


def torque_error(bodies, true):
    q = np.random.default_rng(99).uniform(-2.0, 2.0, (300, 6))
    geometry, load = nominal_arm(ARM), np.full(300, 2.0)
    return np.sqrt(np.mean((drives(geometry, bodies, q, load) - drives(geometry, true, q, load)) ** 2))


def test_masses_from_torques_predict_another_load():
    arm, readings, true = measured()
    found = fit_torques(arm, readings)
    assert found.used
    assert found.held_out[1] < 0.3 * found.held_out[0]
    assert torque_error(found.bodies, true) < 0.1 * torque_error(STATED, true)
    np.testing.assert_allclose([joint.friction for joint in found.joints], 3.0, atol=0.3)
    assert all(joint.constant is None and not joint.fault for joint in found.joints)
    assert not found.faults


def test_currents_give_motor_constants_by_the_known_load():
    arm, readings, true = measured(noise=0.0)
    current = readings.tau_nm / CONSTANTS + np.random.default_rng(7).normal(0.0, 0.03, readings.tau_nm.shape)
    found = fit_torques(arm, replace(readings, tau_nm=None, current_a=current))
    assert found.kind == "current"
    assert found.used
    constants = np.array([joint.constant or np.nan for joint in found.joints])
    np.testing.assert_allclose(constants[1:4], CONSTANTS[1:4], rtol=0.05)
    assert constants[4] < 0.0
    assert torque_error(found.bodies, true) < 0.4 * torque_error(STATED, true)


def test_masses_that_nobody_stated():
    arm, readings, true = measured()
    found = fit_torques(replace(arm, bodies=replace(STATED, masses=np.zeros(6))), readings)
    assert found.used
    assert torque_error(found.bodies, true) < 2.0


def test_stated_masses_stay_where_torques_are_no_better():
    arm, readings, _ = measured(noise=30.0, true=STATED)
    found = fit_torques(arm, readings)
    assert not found.used
    stiff_arm, stiff, _ = measured(compliance=np.zeros(6))
    assert abs(fit_torques(stiff_arm, stiff).evidence) < 3.0  # the positions show no elasticity that could tell


@pytest.mark.parametrize(("factor", "words"), [(-1.0, "opposite sign"), (1000.0, "are they in Nm")])
def test_a_joint_with_another_sign_or_unit_is_named_and_left_out(factor, words):
    arm, readings, true = measured()
    tau = readings.tau_nm.copy()
    tau[:, 2] *= factor
    found = fit_torques(arm, replace(readings, tau_nm=tau))
    assert words in found.joints[2].fault
    assert [joint.fault for joint in found.joints if joint.joint != 3] == [""] * 5
    assert torque_error(found.bodies, true) < 0.3 * torque_error(STATED, true)


def test_a_row_with_the_opposite_sign_is_named():
    arm, readings, true = measured()
    tau = readings.tau_nm.copy()
    row = int(np.argmax(np.abs(tau[:, 1])))
    tau[row, 1] *= -1.0
    found = fit_torques(arm, replace(readings, tau_nm=tau))
    assert len(found.faults) == 1
    assert found.faults[0].startswith(f"configuration {row}: tau2 is ")
    assert found.faults[0].endswith("with the opposite sign it fits")
    assert torque_error(found.bodies, true) < 0.1 * torque_error(STATED, true)


def test_few_torques_are_not_learnt_from():
    _, readings, _ = measured(n=20)
    tau = readings.tau_nm.copy()
    tau[9:] = np.nan
    assert not has_torques(replace(readings, tau_nm=tau))
    assert not has_torques(replace(readings, tau_nm=None))
    assert has_torques(readings)


def test_the_payloads_center_moves_its_torque_by_row():
    arm, readings, _ = measured(n=40)
    center = np.tile([0.0, 0.0, 0.2], (40, 1))
    center[::2] = np.nan  # the stated one
    geometry = nominal_arm(ARM)
    frames, load = frame_poses(geometry, readings.q), np.full(40, 4.0)
    by_row = gravity_loads(frames, STATED, UP_M, load, center).joint_torques()
    stated = gravity_loads(frames, STATED, UP_M, load).joint_torques()
    moved = gravity_loads(frames, replace(STATED, payload_center=center[1]), UP_M, load).joint_torques()
    np.testing.assert_allclose(by_row[::2], stated[::2], atol=1e-12)
    np.testing.assert_allclose(by_row[1::2], moved[1::2], atol=1e-12)
    conditions = MeasurementConditions(payload_kg=load, payload_center_F=center)
    np.testing.assert_allclose(arm.context(readings.q, conditions=conditions).torques, by_row, atol=1e-12)


def test_masses_that_do_not_settle_are_refused(monkeypatch):
    arm, readings, _ = measured()
    monkeypatch.setattr(torques, "_ROUNDS", 1)
    with pytest.raises(NotConverged, match="fit of masses to torques did not converge: 1 rounds"):
        fit_torques(arm, readings)
