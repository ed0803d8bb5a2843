"""A 6-D probe on a flange of the simulated cell."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.plant import ArmConfig, GeometryErrors, Plant
from drivers.plant.transforms import quaternion
from drivers.trackers.simulated import SimulatedTracker

pytestmark = pytest.mark.fast

TURN = Rotation.from_euler("xyz", [0.3, -0.2, 2.0]).as_matrix()
Q = np.array([[0.3, -1.2, 1.0, -0.5, 0.4, 0.7], [1.0, -0.7, 0.5, 0.2, -1.0, 2.0]])


@pytest.fixture
def plant(make_arm: Callable[..., ArmConfig], make_plant: Callable[..., Plant]) -> Plant:
    return make_plant(make_arm(probe=TURN, probe_sigma=5e-5))


def flange(dh_frames: Callable[..., Any], plant: Plant, q: np.ndarray) -> np.ndarray:
    frames = dh_frames(plant.config.arms[0].rows, q)
    return np.asarray(plant.true_T_M_B("left") @ frames[-1])


def test_the_probe_is_carried_by_the_flange(plant: Plant, dh_frames: Callable[..., Any]) -> None:
    for row, T_M_F in enumerate(flange(dh_frames, plant, q) for q in Q):
        turned = plant.probe_rotations("left", Q)[row]
        np.testing.assert_allclose(turned, T_M_F[:3, :3] @ TURN, atol=1e-12)


def test_a_perfect_tracker_measures_the_orientation(plant: Plant) -> None:
    tracker = SimulatedTracker(plant)
    tracker.connect()
    (target,) = plant.targets()
    point = tracker.measure(target.p_M, 1.0)
    assert point.sigma_rad == 5e-5
    assert point.quaternion_M is not None
    true = plant.probe_rotations("left", plant.q("left")[None])[0]
    np.testing.assert_allclose(point.quaternion_M, quaternion(true), atol=1e-12)


def test_noise_of_the_orientation_is_the_stated_one(
    make_arm: Callable[..., ArmConfig], make_plant: Callable[..., Plant]
) -> None:
    plant = make_plant(make_arm(probe=TURN, probe_sigma=5e-5), noise=True)
    tracker = SimulatedTracker(plant)
    tracker.connect()
    (target,) = plant.targets()
    true = Rotation.from_matrix(plant.probe_rotations("left", plant.q("left")[None])[0])
    found = np.array([tracker.measure(target.p_M, 1.0).quaternion_M for _ in range(400)])
    off = (Rotation.from_quat(np.roll(found, -1, axis=1)) * true.inv()).as_rotvec()
    assert off.std(axis=0) == pytest.approx([5e-5] * 3, rel=0.12)


def test_a_true_probe_is_turned(make_arm: Callable[..., ArmConfig], make_plant: Callable[..., Plant]) -> None:
    plant = make_plant(make_arm(probe=TURN), errors=GeometryErrors(smr=1e-3, probe=2e-3))
    mechanism = plant.true_mechanism("left")
    assert mechanism.probe is not None
    turned = Rotation.from_matrix(mechanism.probe @ TURN.T).magnitude()
    assert 1e-4 < turned < 1e-2


@pytest.mark.parametrize("turn", [0.0, 0.5, 3.1, np.pi])
def test_quaternions_are_those_of_scipy(turn: float) -> None:
    rotation = Rotation.from_rotvec(turn * np.array([2.0, -1.0, 2.0]) / 3.0)
    expected = np.roll(rotation.as_quat(canonical=True), 1)
    np.testing.assert_allclose(np.abs(quaternion(rotation.as_matrix()) @ expected), 1.0, atol=1e-14)
