"""What other programs get is the same arm, and what they cannot get is said."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.exports.urdf import ur_deltas, urdf_joints
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import rotation_z, rotation_zyx, transform
from tests.arms import OFF_AXIS, SEVEN, UR10, at_station, true_geometry

pytestmark = pytest.mark.fast


def test_urdf_origins_make_the_same_arm():
    rng = np.random.default_rng(0)
    for rows in (UR10, SEVEN):
        geometry = true_geometry(at_station(rows, OFF_AXIS), rng, length=5e-3, angle=0.02)
        joints = urdf_joints(geometry)
        assert [joint.type for joint in joints] == ["revolute"] * len(rows) + ["fixed"]
        for q in rng.uniform(-3, 3, (5, len(rows))):
            T = geometry.T_M_B()
            for joint, angle in zip(joints, [*q, 0.0], strict=True):
                roll, pitch, yaw = joint.rpy_rad
                T = T @ transform(rotation_zyx(yaw, pitch, roll), joint.xyz_m)
                T = T @ transform(rotation_z(angle), np.zeros(3))
            np.testing.assert_allclose(
                T[:3, :3] @ geometry.tool + T[:3, 3], smr_positions(geometry, q[None])[0], atol=1e-12
            )


def test_ur_deltas_say_what_they_lose():
    nominal = at_station(UR10, OFF_AXIS)
    identified = true_geometry(nominal, np.random.default_rng(1))
    deltas = ur_deltas(nominal.rows[:, :4], identified)
    np.testing.assert_allclose(deltas.delta_a_m, identified.rows[:, 2] - nominal.rows[:, 2])
    assert set(deltas.lost.beta_rad) == {"beta2", "beta3"}
    lost = deltas.lost.position_mm
    assert 0.05 < lost.rms < lost.max < 10.0
    plain = ur_deltas(nominal.rows[:, :4], nominal)
    assert plain.lost.beta_rad == {}
    assert plain.lost.position_mm.max == 0.0
