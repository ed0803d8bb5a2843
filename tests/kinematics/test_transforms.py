"""Rotations, registration."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.kinematics.transforms import (
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
