"""The norm's cube: planes, poses, and the largest cube of a lattice."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from cellapp.estimation.iso9283.norm import (
    CORNERS,
    CYCLE,
    PLANES,
    POSES,
    circle_positions,
    lattice_cube,
    pose_positions,
)

pytestmark = pytest.mark.fast

CENTRE, EDGE = np.array([0.3, -0.4, 0.5]), 0.6


@pytest.mark.parametrize("plane", PLANES, ids="-".join)
def test_poses_are_on_the_diagonals_of_an_inclined_plane(plane: tuple[str, str, str, str]) -> None:
    poses = pose_positions(CENTRE, EDGE, plane)
    assert tuple(poses) == POSES
    np.testing.assert_allclose(poses["P1"], CENTRE)
    diagonal = math.sqrt(3.0) * EDGE
    for first, opposite in (("P2", "P4"), ("P3", "P5")):
        assert np.linalg.norm(poses[first] - poses[opposite]) == pytest.approx(0.8 * diagonal)
        np.testing.assert_allclose(0.5 * (poses[first] + poses[opposite]), CENTRE)
    sides = np.array([poses[name] - CENTRE for name in POSES[1:]])
    assert np.linalg.matrix_rank(sides, tol=1e-9) == 2
    corners = CENTRE + 0.5 * EDGE * np.array([CORNERS[name] for name in plane])
    gaps = [float(np.linalg.norm(corner - poses[name])) for corner, name in zip(corners, POSES[1:], strict=True)]
    np.testing.assert_allclose(gaps, 0.1 * diagonal)


def test_planes_are_the_four_that_hold_an_upper_edge_and_the_opposite_lower_one() -> None:
    assert sorted(CYCLE) == sorted(POSES)
    assert len({frozenset(plane) for plane in PLANES}) == len(PLANES)
    for plane in PLANES:
        first, second, third, fourth = (np.array(CORNERS[name]) for name in plane)
        np.testing.assert_array_equal(first, -third)
        np.testing.assert_array_equal(second, -fourth)
        assert first[2] == second[2] == 1


def test_the_circle_is_in_the_plane_and_inside_the_cube() -> None:
    poses = pose_positions(CENTRE, EDGE, PLANES[0])
    points = circle_positions(poses, EDGE) - CENTRE
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.4 * EDGE)
    np.testing.assert_allclose(points[0], points[-1], atol=1e-12)
    normal = np.cross(poses["P2"] - CENTRE, poses["P3"] - CENTRE)
    np.testing.assert_allclose(points @ normal, 0.0, atol=1e-12)
    assert np.abs(points).max() <= 0.5 * EDGE


@given(arrays(np.bool_, (4, 5, 4)))
def test_the_lattice_cube_is_the_largest(held: NDArray[np.bool_]) -> None:
    found = lattice_cube(held)

    def fits(edge: int, corner: tuple[int, ...]) -> bool:
        part = held[tuple(slice(c, c + edge + 1) for c in corner)]
        return part.shape == (edge + 1,) * 3 and bool(part.all())

    places = list(itertools.product(*(range(n) for n in held.shape)))
    assert (found is None) == (not held.any())
    if found is not None:
        edge, corner = found
        assert fits(edge, corner)
        assert not any(fits(edge + 1, place) for place in places)
