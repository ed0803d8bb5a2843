"""Gravity torques against published sizes, against the gradient of the potential, and against the plant."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.robot.kinematics.chain import frame_poses
from cellapp.robot.kinematics.statics import STANDARD_GRAVITY, Bodies, base_moment, gravity_loads
from tests.arms import (
    OFF_AXIS,
    UR5,
    UR5_CENTERS,
    UR5_MASSES,
    UR10,
    UR10_CENTERS,
    UR10_MASSES,
    at_station,
)

UP = np.array([0.0, 0.0, 1.0])


def bodies(masses, centers, payload=0.0):
    return Bodies(masses, centers, payload, np.array([0.0, 0.0, 0.08]))


def gravity_torques(geometry, hanging, q, up, payload_kg=None):
    return gravity_loads(frame_poses(geometry, q), hanging, up, payload_kg).joint_torques()


@pytest.mark.parametrize(
    ("rows", "hanging", "published"),
    [
        (UR10, bodies(UR10_MASSES, UR10_CENTERS), [122.0, 41.0, 3.0]),
        (UR10, bodies(UR10_MASSES, UR10_CENTERS, 10.0), [257.0, 117.0, 23.0]),
        (UR5, bodies(UR5_MASSES, UR5_CENTERS), [55.0, 17.0, 1.5]),
        (UR5, bodies(UR5_MASSES, UR5_CENTERS, 5.0), [104.0, 45.0, 10.0]),
    ],
    ids=["UR10", "UR10 with 10 kg", "UR5", "UR5 with 5 kg"],
)
def test_largest_torques_are_the_published_ones(rows, hanging, published):
    # computed from the makers' tables by others, given to the newton metre; the load 80 mm in front of the flange
    geometry = at_station(rows, OFF_AXIS, np.eye(4))
    grid = np.deg2rad(np.arange(-180, 180, 15.0))
    q2, q3, q4 = np.meshgrid(grid, grid, grid, indexing="ij")
    q = np.zeros((q2.size, 6))
    q[:, 1], q[:, 2], q[:, 3] = q2.ravel(), q3.ravel(), q4.ravel()
    largest = np.zeros(3)
    for q5 in (0.0, np.pi / 2.0):
        q[:, 4] = q5
        largest = np.maximum(largest, np.abs(gravity_torques(geometry, hanging, q, UP)[:, 1:4]).max(axis=0))
    np.testing.assert_allclose(largest, published, rtol=0.02, atol=0.6)


def test_torque_is_the_falling_slope_of_the_potential():
    rng = np.random.default_rng(0)
    geometry, hanging = at_station(UR10, OFF_AXIS), bodies(UR10_MASSES, UR10_CENTERS, 4.0)
    up = np.array([0.1, -0.2, 0.97])
    up /= np.linalg.norm(up)
    q = rng.uniform(-3, 3, (20, 6))

    def potential(q):
        rotations, origins = frame_poses(geometry, q)
        heights = (origins[1:] + np.einsum("inab,ib->ina", rotations[1:], hanging.centers)) @ up
        load = (origins[-1] + rotations[-1] @ hanging.payload_center) @ up
        return STANDARD_GRAVITY * (hanging.masses @ heights + hanging.payload_mass * load)

    torques = gravity_torques(geometry, hanging, q, up)
    for j in range(6):
        step = np.zeros(6)
        step[j] = 1e-5
        np.testing.assert_allclose(torques[:, j], -(potential(q + step) - potential(q - step)) / 2e-5, atol=1e-6)


def test_a_payload_per_reading_replaces_the_stated_one():
    geometry, hanging = at_station(UR10, OFF_AXIS, np.eye(4)), bodies(UR10_MASSES, UR10_CENTERS, 2.0)
    q = np.random.default_rng(1).uniform(-3, 3, (3, 6))
    given_loads = gravity_torques(geometry, hanging, q, UP, np.array([np.nan, 2.0, 0.0]))
    stated = gravity_torques(geometry, hanging, q, UP)
    np.testing.assert_allclose(given_loads[:2], stated[:2], atol=1e-12)
    np.testing.assert_allclose(
        given_loads[2], gravity_torques(geometry, bodies(UR10_MASSES, UR10_CENTERS), q, UP)[2], atol=1e-12
    )


def test_torques_of_single_masses_sum_to_the_joint_torques():
    geometry, hanging = at_station(UR10, OFF_AXIS), bodies(UR10_MASSES, UR10_CENTERS, 4.0)
    q = np.random.default_rng(2).uniform(-3, 3, (8, 6))
    loads = gravity_loads(frame_poses(geometry, q), hanging, UP)
    np.testing.assert_allclose(sum(loads.torques_of(k) for k in range(7)), loads.joint_torques(), atol=1e-9)
    np.testing.assert_array_equal(loads.torques_of(6), loads.torques_of(-1))
    assert not loads.torques_of(2)[:, 3:].any(), "body 3 is before joint 4"


def test_the_moment_beyond_a_frame_gives_the_torque_of_its_joint():
    geometry, hanging = at_station(UR10, OFF_AXIS), bodies(UR10_MASSES, UR10_CENTERS, 4.0)
    q = np.random.default_rng(3).uniform(-3, 3, (8, 6))
    loads = gravity_loads(frame_poses(geometry, q), hanging, UP)
    for j in range(6):
        force, moment = loads.beyond(j)
        axis = loads.rotations[j][:, :, 2]
        np.testing.assert_allclose(np.einsum("na,na->n", axis, moment), loads.joint_torques()[:, j], atol=1e-9)
        carried = hanging.masses[j:].sum() + hanging.payload_mass
        np.testing.assert_allclose(force, np.tile(-STANDARD_GRAVITY * carried * UP, (8, 1)))
    np.testing.assert_array_equal(base_moment(geometry, hanging, q, UP), loads.beyond(0)[1])
