"""A base from tracker points: the truth comes back, stated uncertainties hold, useless points are refused in words."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.estimation.calibration.registration import base_from_points
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import apply, invert, rotation_from_vector, rotation_vectors, transform

pytestmark = pytest.mark.fast

CORNERS = np.array([[0.8, 0.1, 0.3], [-0.2, 0.7, 0.9], [-0.6, -0.5, 0.2], [0.1, -0.4, 1.1]])
coordinate = st.floats(-10.0, 10.0)
turn = st.floats(-1.8, 1.8)  # per axis: rotation vectors up to about pi


@settings(max_examples=60, deadline=None)
@given(
    position=st.tuples(coordinate, coordinate, coordinate),
    vector=st.tuples(turn, turn, turn),
    count=st.sampled_from([3, 4]),
)
def test_exact_points_give_the_true_pose(position, vector, count) -> None:
    T = transform(rotation_from_vector(np.array(vector)), position)
    fit = base_from_points(CORNERS[:count], apply(T, CORNERS[:count]))
    assert np.allclose(fit.T_M_B, T, atol=1e-9)
    assert fit.rms < 1e-9
    assert fit.sentence.endswith("; good")


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_base_does_not_depend_on_the_order_of_the_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p_M = apply(transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)), CORNERS)
    p_M += rng.normal(scale=1e-3, size=p_M.shape)
    order = rng.permutation(4)
    fit, other = base_from_points(CORNERS, p_M), base_from_points(CORNERS[order], p_M[order])
    assert np.allclose(fit.T_M_B, other.T_M_B, atol=1e-9)
    assert math.isclose(fit.position_error, other.position_error, rel_tol=1e-6)
    assert order[other.worst] == fit.worst


@pytest.mark.parametrize("noise_m", [20e-6, 1e-3, 5e-3])
def test_errors_are_as_large_as_stated(noise_m: float) -> None:
    """Over many surveys the mean square of the true error is that of the stated one, for position and angle."""
    rng = np.random.default_rng(5)
    T = transform(rotation_from_vector([0.4, -0.2, 2.0]), [3.0, -1.0, 0.6])
    ratios = []
    for _ in range(400):
        p_M = apply(T, CORNERS) + rng.normal(scale=noise_m, size=CORNERS.shape)
        fit = base_from_points(CORNERS, p_M)
        off = invert(T) @ fit.T_M_B
        true = (np.sum((fit.T_M_B[:3, 3] - T[:3, 3]) ** 2), np.sum(rotation_vectors(off[None, :3, :3]) ** 2))
        ratios.append((*true, fit.position_error**2, fit.angle_error**2))
    position, angle, stated_position, stated_angle = np.mean(ratios, axis=0)
    assert position / stated_position == pytest.approx(1.0, abs=0.2)
    assert angle / stated_angle == pytest.approx(1.0, abs=0.2)


def test_a_poor_point_is_named() -> None:
    p_M = CORNERS.copy()
    p_M[2, 1] += 0.05
    fit = base_from_points(CORNERS, p_M)
    assert "poor: check point 3, off by" in fit.sentence


@pytest.mark.parametrize(
    ("p_B", "p_M", "words"),
    [
        (CORNERS[:2], CORNERS[:2], "2 points do not fix a base; measure at least 3"),
        (np.zeros((4, 3)), CORNERS, "lie within 0 mm of one place in the base frame"),
        (CORNERS, np.ones((4, 3)), "of one place in the tracker frame"),
        (np.outer([0.0, 0.3, 0.7, 1.0], [1.0, 2.0, 0.5]), CORNERS, "on one line in the base frame"),
        (CORNERS, CORNERS[[1, 0, 2, 3]], "check units, the order of the points"),
        (CORNERS, CORNERS * 1000.0, "check units"),
        (CORNERS, CORNERS * [1, 1, -1], "check units"),
    ],
)
def test_useless_points_are_refused(p_B, p_M, words: str) -> None:
    with pytest.raises(InputError, match=words):
        base_from_points(p_B, p_M)
