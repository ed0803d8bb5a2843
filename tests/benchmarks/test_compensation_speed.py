"""Speed of compensation: 1000 poses of the twin's UR10, all branches, gate, calibrated model; and its closed form."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.targets import Target
from cellapp.robot.kinematics.chain import flange_poses, smr_positions
from cellapp.robot.kinematics.inverse import closed_form_solutions
from cellapp.robot.kinematics.transforms import zyx_angles
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm, pose_matrix, up_in_tracker
from tests.twin import small_twin

TARGETS = 1000


def model_of(profile):
    arms = {}
    for name, arm in profile.arms.items():
        nominal = nominal_arm(arm).with_T_M_B(np.linalg.inv(pose_matrix(profile.tracker.pose)) @ pose_matrix(arm.base))
        vector = nominal.vector() + 1e-4 * np.random.default_rng(1).standard_normal(len(nominal.vector()))
        arms[name] = ArmModel(nominal.with_vector(vector), nominal, bodies_of(arm), up_in_tracker(profile))
    return CellModel(arms=arms)


@pytest.mark.benchmark(group="1000 targets of a UR10")
def test_commands_of_1000_targets(benchmark):
    profile = small_twin()
    model = model_of(profile)
    targets = targets_of(model.arms["left"])
    commands = benchmark.pedantic(compensate, (profile, model, targets), rounds=1, iterations=1)
    assert sum(not command.refusal for command in commands) > 0.5 * TARGETS


@pytest.mark.benchmark(group="1000 targets of a UR10")
def test_closed_form_of_1000_poses(benchmark):
    geometry = nominal_arm(small_twin().arms["left"])
    q = np.random.default_rng(0).uniform(-2.5, 2.5, (TARGETS, 6))
    found = benchmark(closed_form_solutions, geometry, smr_positions(geometry, q), flange_poses(geometry, q)[0])
    assert np.isfinite(found[:, :, 0]).any(axis=1).all()


def targets_of(arm):
    q = np.random.default_rng(0).uniform(-2.5, 2.5, (TARGETS, 6))
    in_base = arm.in_base()
    rotations, _ = in_base.flange(q)
    targets = []
    for k, (position, rotation) in enumerate(zip(in_base.predict(q), rotations, strict=True)):
        yaw, pitch, roll = (float(angle) for angle in zyx_angles(rotation))
        targets.append(Target(name=f"t{k}", arm="left", position=tuple(position.tolist()), rpy=(roll, pitch, yaw)))
    return targets
