"""Two arms tied by sockets that both touched: found exactly, with what it states, and what cannot be seen."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.calibration.pair_by_touching import TouchedPair, TouchedPoints, tie_by_touching
from cellapp.estimation.readings import Distance
from cellapp.robot.kinematics.transforms import Array, rotation_from_vector, transform

pytestmark = pytest.mark.fast

T_R_L = transform(rotation_from_vector(np.array([0.1, -0.2, 1.4])), np.array([0.9, -0.4, 0.05]))
NEAR = transform(rotation_from_vector(np.array([0.12, -0.17, 1.45])), np.array([0.92, -0.37, 0.02]))
PLACES = np.array([[0.4, 0.3, 0.1], [0.5, -0.3, 0.3], [0.1, 0.2, 0.7], [-0.2, 0.4, 0.4], [0.3, 0.0, 0.9]])
NOISE_M = 2e-5


def touched(names: str, at_B: Array) -> TouchedPoints:
    n = len(at_B)
    return TouchedPoints(
        {name: k for k, name in enumerate(names)}, at_B, NOISE_M**2 * np.eye(3 * n), np.zeros(n), np.arange(n)
    )


def in_right(at_L: Array) -> Array:
    return at_L @ T_R_L[:3, :3].T + T_R_L[:3, 3]


def tie(common: int, *known: Distance, noise: Array | float = 0.0, own: int = 0) -> TouchedPair | None:
    """The first ``common`` places touched by both, the next ``own`` by the left one alone; X, Y, Z by the right."""
    names = "abcde"
    left = touched(names[: common + own], PLACES[: common + own])
    right = touched(names[:common] + "XYZ", np.concatenate([in_right(PLACES[:common]) + noise, in_right(PLACES[2:])]))
    return tie_by_touching(left, right, known, NEAR)


@pytest.mark.parametrize("common", [3, 5])
def test_exact_touches_give_the_exact_transform(common: int) -> None:
    found = tie(common)
    assert found is not None
    np.testing.assert_allclose(found.identification.T_R_L, T_R_L, atol=1e-9)
    assert found.held_out is (common > 3)
    assert found.errors_m.shape == (common,)


@pytest.mark.slow
def test_standard_errors_are_those_of_many_repetitions() -> None:
    rng = np.random.default_rng(1)
    drawn = [tie(5, noise=NOISE_M * np.sqrt(2.0) * rng.standard_normal((5, 3))) for _ in range(300)]
    found = [one for one in drawn if one is not None]
    values = np.array([one.identification.values[:3] for one in found])
    stated = np.sqrt(np.mean([one.identification.standard_errors[:3] ** 2 for one in found], axis=0))
    np.testing.assert_allclose(values.std(axis=0), stated, rtol=0.3)


def test_a_turn_about_the_line_of_two_sockets_is_open_until_a_distance_closes_it() -> None:
    assert tie(2) is None
    assert tie(0) is None
    crossing = (("d", 3, "X", 2), ("e", 4, "X", 2), ("Y", 3, "c", 2))  # from a place of one arm to one of the other
    closing = [Distance(a, b, float(np.linalg.norm(PLACES[k] - PLACES[m])), 2e-5) for a, k, b, m in crossing]
    found = tie(2, *closing, own=3)
    assert found is not None
    np.testing.assert_allclose(found.identification.T_R_L, T_R_L, atol=1e-7)
    assert not found.held_out


@pytest.mark.parametrize("seed", range(5))
def test_from_a_start_that_is_far_off_distances_alone_give_a_tie_no_worse_than_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    far = transform(rotation_from_vector(rng.normal(0.0, 1.0, 3)) @ T_R_L[:3, :3], T_R_L[:3, 3] + rng.normal(0, 0.3, 3))
    left, right = touched("abcde", PLACES), touched("VWXYZ", in_right(PLACES))
    known = [
        Distance(a, b, float(np.linalg.norm(in_right(PLACES)[k] - in_right(PLACES)[i])), NOISE_M)
        for i, a in enumerate("abcde")
        for k, b in enumerate("VWXYZ")
    ]

    def square(T: Array) -> float:
        at = PLACES @ T[:3, :3].T + T[:3, 3]
        off = [np.linalg.norm(in_right(PLACES)["VWXYZ".index(d.point_b)] - at["abcde".index(d.point_a)]) for d in known]
        return float(np.sum((np.array(off) - [d.distance_m for d in known]) ** 2))

    found = tie_by_touching(left, right, known, far)
    assert found is not None
    assert square(found.identification.T_R_L) <= square(far)
