"""Formulas of ISO 9283 on numbers worked by hand, and what they must not depend on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cellapp.estimation.iso9283 import characteristics as iso
from cellapp.robot.kinematics.transforms import Array, apply, rotation_from_vector, transform

pytestmark = pytest.mark.fast

CLOUDS = arrays(np.float64, (6, 3), elements=st.floats(-2.0, 2.0))
MOTIONS = arrays(np.float64, (6,), elements=st.floats(-3.0, 3.0))


def moved(motion: Array) -> Array:
    return transform(rotation_from_vector(motion[:3]), motion[3:])


def test_accuracy_is_that_of_the_mean_position() -> None:
    attained = np.array([[1.0, 2.0, 3.0], [3.0, 2.0, 1.0]])
    commanded = np.array([1.0, 2.0, 0.0])
    np.testing.assert_allclose(iso.accuracy_vector(attained, commanded), [1.0, 0.0, 2.0])
    assert iso.pose_accuracy(attained, commanded) == pytest.approx(math.sqrt(5.0))


def test_repeatability_is_the_mean_distance_and_three_deviations_of_it() -> None:
    # distances from the mean (0, 0, 0): 1, 1, 2, 2; their mean 1.5, S = sqrt(4 * 0.25 / 3) = 0.57735
    attained = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, -2.0, 0.0]])
    assert iso.pose_repeatability(attained) == pytest.approx(1.5 + 3.0 / math.sqrt(3.0))


def test_repeatability_of_many_cycles_is_that_of_the_maxwell_distribution() -> None:
    attained = np.random.default_rng(1).standard_normal((200_000, 3))
    mean, deviation = 2.0 * math.sqrt(2.0 / math.pi), math.sqrt(3.0 - 8.0 / math.pi)
    assert iso.pose_repeatability(attained) == pytest.approx(mean + 3.0 * deviation, rel=0.01)


def test_repeatability_of_one_cycle_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 2 cycles, not 1"):
        iso.pose_repeatability(np.zeros((1, 3)))
    with pytest.raises(ValueError, match="at least 2 cycles"):
        iso.distance_repeatability(np.zeros((1, 3)), np.ones((1, 3)))


def test_variation_of_directions_is_the_largest_distance_of_their_means() -> None:
    each = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]], [[3.0, 0.0, 1.0]] * 2, [[0.0, 4.0, 0.0], [0.0, 4.0, 2.0]]])
    assert iso.directional_variation(each) == pytest.approx(5.0)


def test_distances_have_a_signed_accuracy_and_three_deviations() -> None:
    first = np.zeros((3, 3))
    second = np.array([[0.0, 0.0, 9.0], [8.0, 0.0, 0.0], [0.0, 10.0, 0.0]])
    assert iso.distance_accuracy(first, second, 9.5) == pytest.approx(-0.5)
    assert iso.distance_repeatability(first, second) == pytest.approx(3.0)


def test_drift_is_the_largest_change_against_the_first_group() -> None:
    assert iso.drift(np.array([0.2, 0.25, 0.05, 0.2])) == pytest.approx(0.15)


def test_a_path_is_as_bad_as_its_worst_place() -> None:
    commanded = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    attained = np.array([[[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]], [[1.0, 0.5, 0.0], [1.0, 0.5, 0.0]]])
    assert iso.path_accuracy(attained, commanded) == pytest.approx(0.5)
    assert iso.path_repeatability(attained) == pytest.approx(1.0)


def test_a_track_crosses_the_planes_of_its_own_stretch() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    track = np.stack([1.01 * np.cos(angle), 1.01 * np.sin(angle), np.zeros_like(angle)], axis=1)
    at = np.array([0.5, 2.0, 4.0])
    commanded = np.stack([np.cos(at), np.sin(at), np.zeros(3)], axis=1)
    tangents = np.stack([-np.sin(at), np.cos(at), np.zeros(3)], axis=1)
    crossed = iso.plane_crossings(track, commanded, tangents, 0.1)
    np.testing.assert_allclose(crossed, 1.01 * commanded, atol=2e-5)  # chords of half a degree
    assert np.isnan(iso.plane_crossings(track[:100], commanded, tangents, 0.1)[1:]).all()


@given(CLOUDS, MOTIONS)
def test_no_characteristic_depends_on_the_frame(points: Array, motion: Array) -> None:
    T = moved(motion)
    there, commanded = apply(T, points), np.array([[0.1, 0.2, 0.3]])
    tolerance = 1e-9
    assert iso.pose_repeatability(there) == pytest.approx(iso.pose_repeatability(points), abs=tolerance)
    assert iso.pose_accuracy(there, apply(T, commanded)[0]) == pytest.approx(
        iso.pose_accuracy(points, commanded[0]), abs=tolerance
    )
    assert iso.distance_repeatability(there[:3], there[3:]) == pytest.approx(
        iso.distance_repeatability(points[:3], points[3:]), abs=tolerance
    )


@given(CLOUDS, st.floats(0.0, 5.0))
def test_repeatability_is_not_negative_and_scales(points: Array, scale: float) -> None:
    value = float(iso.pose_repeatability(points))
    assert value >= 0.0
    assert iso.pose_repeatability(scale * points) == pytest.approx(scale * value, abs=1e-9)
    lengths = np.linalg.norm(points - points.mean(axis=0), axis=1)
    assert value >= lengths.mean() - 1e-12


@given(CLOUDS)
def test_formulas_are_the_same_for_many_draws_at_once(points: Array) -> None:
    both = np.stack([points, 2.0 * points])
    np.testing.assert_allclose(iso.pose_repeatability(both)[1], iso.pose_repeatability(2.0 * points), atol=1e-12)
    np.testing.assert_allclose(
        iso.pose_accuracy(both, np.ones(3))[0], iso.pose_accuracy(points, np.ones(3)), atol=1e-12
    )


def test_velocity_of_two_cycles_worked_by_hand() -> None:
    """Places 10 mm apart; 0.04, 0.05 s in the first cycle (250, 200 mm/s), 0.05, 0.05 s in the second."""
    times = np.array([[0.0, 0.04, 0.09], [1.0, 1.05, 1.10]])
    found = iso.speeds(times, np.array([0.0, 0.01, 0.02]))
    np.testing.assert_allclose(found, [[0.25, 0.2], [0.2, 0.2]])
    assert iso.velocity_accuracy(found, 0.25) == pytest.approx((0.225 + 0.2) / 2.0 / 0.25 - 1.0)
    assert iso.velocity_repeatability(found, 0.25) == pytest.approx(3.0 * 0.025 / math.sqrt(2.0) / 0.25)
    assert iso.velocity_fluctuation(found) == pytest.approx(0.05)


def test_a_repeatability_of_the_velocity_of_one_cycle_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 2 cycles, not 1"):
        iso.velocity_repeatability(np.array([[0.2, 0.2]]), 0.2)
