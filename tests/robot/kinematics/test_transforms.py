"""Rotations, registration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.robot.kinematics.transforms import (
    apply,
    invert,
    register,
    rotation_from_vector,
    rotation_vectors,
    rotation_zyx,
    transform,
    zyx_angles,
)

angles = st.floats(-3.0, 3.0)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_zyx_angles_are_read_back(z, y, x):
    np.testing.assert_allclose(rotation_zyx(*zyx_angles(rotation_zyx(z, y, x))), rotation_zyx(z, y, x), atol=1e-12)


@given(st.tuples(*[st.floats(-1.7, 1.7)] * 3))
def test_rotation_vectors_are_read_back(vector):
    np.testing.assert_allclose(rotation_vectors(rotation_from_vector(vector)[None])[0], vector, atol=1e-9)


AXES = np.array(
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.6, -0.8, 0.0], [-1.0, 2.0, 2.0], [3.0, 1.0, -2.0]]
)


@pytest.mark.parametrize("axis", AXES, ids=str)
@pytest.mark.parametrize("short_of_pi", [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1])
def test_rotation_vectors_near_half_a_turn(axis, short_of_pi):
    angle = np.pi - short_of_pi
    rotation = rotation_from_vector(angle * axis / np.linalg.norm(axis))
    (found,) = rotation_vectors(rotation[None])
    assert np.linalg.norm(found) == pytest.approx(angle, abs=1e-9)
    np.testing.assert_allclose(rotation_from_vector(found), rotation, atol=1e-9)


def test_half_a_turn_written_as_a_matrix_has_length_pi():
    flips = np.array([np.diag(signs) for signs in ([1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0])])
    np.testing.assert_allclose(np.abs(rotation_vectors(flips)), np.pi * np.eye(3), atol=1e-12)
    assert rotation_vectors(np.zeros((0, 3, 3))).shape == (0, 3)


def test_small_rotations_keep_their_digits():
    vector = np.array([3e-11, -4e-11, 1e-13])
    np.testing.assert_allclose(rotation_vectors(rotation_from_vector(vector)[None])[0], vector, rtol=1e-9)


@pytest.mark.parametrize("y", [np.pi / 2.0, -np.pi / 2.0, np.pi / 2.0 - 1e-11, 1e-9 - np.pi / 2.0])
def test_zyx_angles_at_gimbal_lock_give_the_same_rotation(y):
    rotation = rotation_zyx(0.4, y, -1.1)
    np.testing.assert_allclose(rotation_zyx(*zyx_angles(rotation)), rotation, atol=1e-12)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_registration_finds_the_pose_and_never_a_mirror(seed):
    rng = np.random.default_rng(seed)
    T = transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))
    p = rng.normal(size=(5, 3))
    found = register(apply(T, p), p)
    np.testing.assert_allclose(found, T, atol=1e-9)
    mirrored = register(apply(T, p) * [1, 1, -1], p)
    assert np.linalg.det(mirrored[:3, :3]) > 0.0
    np.testing.assert_allclose(invert(T) @ T, np.eye(4), atol=1e-12)
