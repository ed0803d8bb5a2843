"""True geometry: nominal without errors, and with errors of the configured sizes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.plant import CapsuleConfig, GeometryErrors
from drivers.plant.mechanism import nominal, with_errors
from drivers.plant.transforms import across, inverse, rigid


@settings(max_examples=40, deadline=None)
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


def test_each_axis_is_displaced_and_tilted_by_the_configured_sizes(make_arm):
    drawn = nominal(make_arm())
    errors = GeometryErrors(length=3e-4, angle=1e-3, smr=2e-3)
    cells = [with_errors(drawn, errors, np.random.default_rng(seed)) for seed in range(400)]
    shift = np.array([cell.points for cell in cells]) - drawn.points
    assert np.abs((shift * drawn.directions).sum(axis=-1)).max() < 1e-18
    sideways = across(drawn.directions)
    # 400 draws of 12 coordinates: 1.02 % relative error of a standard deviation; five of them are allowed
    assert np.einsum("njx,jkx->njk", shift, sideways).std() == pytest.approx(3e-4, rel=0.05)
    tilt = np.array([np.cross(drawn.directions, cell.directions) for cell in cells])
    assert np.einsum("njx,jkx->njk", tilt, sideways).std() == pytest.approx(1e-3, rel=0.05)
    assert np.abs(np.linalg.norm([cell.directions for cell in cells], axis=-1) - 1).max() < 1e-14
    assert np.std([cell.zeros for cell in cells]) == pytest.approx(1e-3, rel=0.08)
    assert np.std([cell.smr - drawn.smr for cell in cells]) == pytest.approx(2e-3, rel=0.11)


def test_base_errors_have_the_configured_sizes(make_arm, make_plant):
    errors = GeometryErrors(base_length=5e-3, base_angle=4e-3)
    arm = make_arm()
    off = [inverse(arm.T_C_B) @ make_plant(arm, seed=s, errors=errors).true_T_C_B("left") for s in range(300)]
    assert np.std([pose[:3, 3] for pose in off]) == pytest.approx(5e-3, rel=0.12)
    turns = Rotation.from_matrix([pose[:3, :3] for pose in off]).as_rotvec()
    assert turns.std() == pytest.approx(4e-3, rel=0.12)


def test_the_seed_alone_decides_the_cell(make_arm, make_plant):
    errors = GeometryErrors(3e-4, 1e-3, 5e-3, 5e-3, 1e-3)
    q = np.random.default_rng(0).uniform(-3, 3, (10, 6))
    first = make_plant(seed=5, errors=errors).smr_positions("left", q)
    assert np.array_equal(first, make_plant(seed=5, errors=errors).smr_positions("left", q))
    assert np.abs(first - make_plant(seed=6, errors=errors).smr_positions("left", q)).min(axis=0).max() > 1e-5


def test_a_second_arm_or_another_size_changes_no_other_draw(make_arm, make_plant):
    left, right = make_arm(), make_arm("ur5", "right", 1.2)
    q = np.random.default_rng(0).uniform(-3, 3, (10, 6))
    errors = GeometryErrors(length=3e-4, angle=1e-3)
    alone = make_plant(left, errors=errors).smr_positions("left", q)
    assert np.array_equal(alone, make_plant(left, right, errors=errors).smr_positions("left", q))
    offset = make_plant(left, errors=GeometryErrors(smr=1e-3)).true_mechanism("left").smr
    both = make_plant(left, errors=GeometryErrors(length=1e-2, smr=1e-3)).true_mechanism("left").smr
    assert np.array_equal(offset, both)


def test_base_to_base_fits_base_to_tracker(make_arm, make_plant):
    errors = GeometryErrors(base_length=5e-3, base_angle=5e-3)
    plant = make_plant(make_arm(), make_arm("ur5", "right", 1.2), errors=errors)
    expected = np.linalg.inv(plant.true_T_M_B("right")) @ plant.true_T_M_B("left")
    assert np.abs((inverse(plant.true_T_C_B("right")) @ plant.true_T_C_B("left")) - expected).max() < 1e-13


def test_turning_one_joint_moves_the_smr_on_a_circle_about_the_true_axis(make_plant):
    plant = make_plant(errors=GeometryErrors(1e-3, 5e-3, 5e-3, 5e-3, 1e-3), seed=3)
    q = np.tile(np.random.default_rng(1).uniform(-1, 1, 6), (200, 1))
    for joint in range(6):
        turned = q.copy()
        turned[:, joint] = np.linspace(0, 2 * np.pi, 200, endpoint=False)
        p = plant.smr_positions("left", turned)
        spread = p - p.mean(axis=0)
        radius = np.linalg.norm(spread, axis=1)
        assert np.ptp(radius) < 1e-12
        assert np.linalg.svd(spread, compute_uv=False)[-1] < 1e-12


def test_rigid_is_the_rotation_vector_then_the_shift():
    twist = np.random.default_rng(0).normal(0, 2, (50, 6))
    twist[0] = 0.0
    motion = rigid(twist)
    assert np.abs(motion[:, :3, :3] - Rotation.from_rotvec(twist[:, 3:]).as_matrix()).max() < 1e-14
    assert np.array_equal(motion[:, :3, 3], twist[:, :3])
    assert np.abs(inverse(motion) @ motion - np.eye(4)).max() < 1e-14


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
