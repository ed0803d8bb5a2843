"""True geometry: nominal without errors, and with errors of the configured sizes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cellapp.robot.kinematics.chain import parameter_names, smr_positions
from drivers.plant import ArmConfig, CapsuleConfig, Plant
from drivers.plant.transforms import quaternion, rigid, transform_points
from drivers.trackers.simulated import SimulatedTracker
from tests.approved import assert_refused
from tests.arms import OFF_AXIS, UR10, at_station, dh_frames, plant_of
from tests.evidence.shared.changes import lengthened, link_moved, zero_shifted
from tests.sure import sure


@settings(max_examples=40)
@given(joints=st.integers(2, 8), seed=st.integers(0, 2**32 - 1))
def test_a_perfect_cell_is_its_dh_chain(make_arm, make_config, make_plant, dh_smr, joints, seed):
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    pose[:3, 3] = rng.uniform(-1, 1, 3)
    arm = make_arm(
        rows=rng.uniform(-1, 1, (joints, 4)) * [np.pi, 0.7, 0.7, np.pi],
        limits=np.tile([-7.0, 7.0], (joints, 1)),
        speed=np.ones(joints),
        acceleration=np.ones(joints),
        T_C_B=pose,
        smr_offset=rng.uniform(-0.1, 0.1, 3),
        masses=np.ones(joints),
        centers_of_mass=rng.uniform(-0.3, 0.3, (joints, 3)),
        capsules=(),
    )
    q = rng.uniform(-2 * np.pi, 2 * np.pi, (5, joints))
    found = make_plant(arm, seed=seed).smr_positions("left", q)
    assert np.abs(found - dh_smr(make_config(arm), q)).max() < 1e-12


def test_a_configuration_of_the_wrong_shape_is_named(make_arm, make_config):
    with pytest.raises(ValueError, match=r"arm left: masses has shape \(5,\), expected \(6,\)"):
        make_arm(masses=np.ones(5))
    with pytest.raises(ValueError, match="arm left: payload_center holds a value that is not a finite number"):
        make_arm(payload_center=[0, np.nan, 0])
    with pytest.raises(ValueError, match="capsule in frame 7, but frames are 0 to 6"):
        make_arm(capsules=(CapsuleConfig(7, np.zeros(3), np.zeros(3), 0.1),))
    with pytest.raises(ValueError, match="two arms have the same name"):
        make_config(make_arm(), make_arm())


def test_an_unknown_arm_is_named(make_plant):
    with pytest.raises(ValueError, match="no arm 'middle'; it has left"):
        make_plant().true_T_M_B("middle")


# -- Optional arguments of ``Plant.smr_positions`` and their effect ----------------------------------------------------

Q = np.random.default_rng(4).uniform(-2.5, 2.5, (6, 6))


def test_a_wrong_shape_is_one_clear_error_as_approved(make_plant):
    """Lines name an argument, its shape, and what it is full of instead of 0."""

    def refused(name: str, shape: str, value: str = "0") -> object:
        array = np.full(tuple(map(int, shape.split())), float(value))
        return make_plant().smr_positions("left", Q, **{name: array})

    assert_refused(Path(__file__).parent / "approved" / "wrong-shapes.txt", refused)


def test_a_moved_tracker_sees_the_same_cell_from_elsewhere(make_plant):
    plant, moved = make_plant(), make_plant()
    T_C_M = rigid(np.array([3.0, 0.7, 0.2, 0.1, -0.2, 2.5]))
    moved.move_tracker(T_C_M)
    in_cell = transform_points(plant.config.tracker.T_C_M, plant.smr_positions("left", Q))
    np.testing.assert_allclose(transform_points(T_C_M, moved.smr_positions("left", Q)), in_cell, atol=1e-12)
    (found,) = (target for target in moved.targets() if target.arm == "left")
    np.testing.assert_allclose(found.p_M, moved.smr_positions("left", moved.q("left")[None])[0], atol=1e-9)


# -- The collision monitor against distances from dense sampling -------------------------------------------------------

SPEED, ACCELERATION = np.full(6, 2.0), np.full(6, 3.0)


def _slow(a, b, c, d, count=201):
    share = np.linspace(0, 1, count)[:, None]
    p, q = a + share * (b - a), c + share * (d - c)
    return np.linalg.norm(p[:, None] - q[None], axis=-1).min()


def _capsules(arm, frames):
    ends = [(c.frame, c.start, c.end, c.radius) for c in arm.capsules]
    poses = [arm.T_C_B @ frame for frame in frames]
    return [((poses[f] @ [*s, 1.0])[:3], (poses[f] @ [*e, 1.0])[:3], r, f) for f, s, e, r in ends]


def test_the_collision_monitor_finds_the_smallest_distance_of_a_motion(make_arm, make_config):
    left, right = make_arm(), make_arm("ur5", "right", 1.5)
    plant = Plant(make_config(left, right), watch_clearance=True)
    goals = {"left": np.array([0.9, -1.0, 1.2, 0.4, 0.3, 0.0]), "right": np.array([2.4, -0.7, 1.5, 0.0, 0.5, 0.0])}
    for name, goal in goals.items():
        plant.start_move(name, goal, SPEED, ACCELERATION)
    motions = {name: motion for name in goals if (motion := plant._arm(name).motion) is not None}
    assert plant.clearance is not None
    while any(plant.moving(name) for name in goals):
        plant.advance(0.13)
    arms, floor = np.inf, np.inf
    for time in np.arange(0.0, 2.0, 0.02):
        both = []
        for arm in (left, right):
            q = motions[arm.name].position(np.array([time]))[0]
            both.append(_capsules(arm, dh_frames(arm.rows, q)))
        for a, b, r, _ in both[0]:
            for c, d, s, _ in both[1]:
                arms = min(arms, _slow(a, b, c, d, 41) - r - s)
        floor = min([floor, *(min(a[2], b[2]) - r for body in both for a, b, r, frame in body if frame > 0)])
    assert plant.clearance.arms_m == pytest.approx(arms, abs=0.02)
    assert plant.clearance.floor_m == pytest.approx(floor, abs=0.02)
    assert 0.0 <= plant.clearance.arms_time_s <= 2.0


# -- Changes of a true mechanism between two days are those of D-H parameters ------------------------------------------

Q_OF_CHANGES = np.random.default_rng(4).uniform(-2.0, 2.0, (9, 6))
SIZE = 1e-3


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("name", ["theta", "d", "a", "alpha", "beta"])
def test_a_change_of_the_mechanism_is_that_of_a_parameter(name, joint):
    twist = SIZE * np.eye(6)[{"a": 0, "alpha": 3, "beta": 4}.get(name, 0)]
    change = {
        "theta": partial(zero_shifted, joint=joint, angle=SIZE),
        "d": partial(lengthened, joint=joint, length=SIZE),
    }.get(name, partial(link_moved, joint=joint, twist=twist))
    plant = plant_of(UR10, OFF_AXIS)
    before = plant.smr_positions("arm", Q_OF_CHANGES)
    plant.change_mechanism("arm", change)
    geometry = at_station(UR10, OFF_AXIS)
    vector = geometry.vector()
    vector[parameter_names(6).index(f"{name}{joint + 1}")] += SIZE
    np.testing.assert_allclose(
        plant.smr_positions("arm", Q_OF_CHANGES), smr_positions(geometry.with_vector(vector), Q_OF_CHANGES), atol=1e-9
    )
    assert np.abs(plant.smr_positions("arm", Q_OF_CHANGES) - before).max() > 1e-5


# -- A 6-D probe on a flange of the simulated cell ---------------------------------------------------------------------

TURN = Rotation.from_euler("xyz", [0.3, -0.2, 2.0]).as_matrix()


@pytest.fixture
def plant(make_arm: Callable[..., ArmConfig], make_plant: Callable[..., Plant]) -> Plant:
    return make_plant(make_arm(probe=TURN, probe_sigma=5e-5))


def test_a_perfect_tracker_measures_the_orientation(plant: Plant) -> None:
    tracker = SimulatedTracker(plant)
    tracker.connect()
    (target,) = plant.targets()
    point = tracker.measure(target.p_M, 1.0)
    assert point.sigma_rad == 5e-5
    true = plant.probe_rotations("left", plant.q("left")[None])[0]
    np.testing.assert_allclose(sure(point.quaternion_M), quaternion(true), atol=1e-12)
