"""Distances between segments: known cases, and every case against a search over both segments."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.optimize import lsq_linear

from cellapp.cell.safety.bodies import segment_distance

KNOWN = [
    # a0, a1, b0, b1, distance
    ((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0), 1.0),  # parallel, side by side
    ((0, 0, 0), (1, 0, 0), (3, 0, 0), (2, 0, 0), 1.0),  # on one line
    ((0, 0, 0), (2, 0, 0), (1, 0, 0), (3, 0, 0), 0.0),  # on one line, overlapping
    ((0, 0, 0), (1, 0, 0), (2, 1, 0), (4, 1, 0), np.sqrt(2.0)),  # parallel, past each other
    ((-1, 0, 0), (1, 0, 0), (0, -1, 0.3), (0, 1, 0.3), 0.3),  # crossing inside both
    ((-1, 0, 0), (1, 0, 0), (0, 2, 0), (0, 1, 0), 1.0),  # an end against an inside
    ((0, 0, 0), (0, 0, 0), (0, 3, 4), (0, 3, 4), 5.0),  # two points
    ((0, 0, 0), (0, 0, 0), (-1, 2, 0), (1, 2, 0), 2.0),  # a point and a segment
    ((-1, 2, 0), (1, 2, 0), (0, 0, 0), (0, 0, 0), 2.0),
    ((0, 0, 0), (1, 0, 0), (2, 2, 0), (3, 4, 0), np.sqrt(5.0)),  # both at an end
]


@pytest.mark.parametrize(("a0", "a1", "b0", "b1", "distance"), KNOWN)
def test_known_distances(a0: tuple, a1: tuple, b0: tuple, b1: tuple, distance: float) -> None:
    ends = [np.array(end, dtype=np.float64) for end in (a0, a1, b0, b1)]
    assert segment_distance(*ends) == pytest.approx(distance, abs=1e-12)
    assert segment_distance(ends[2], ends[3], ends[0], ends[1]) == pytest.approx(distance, abs=1e-12)
    assert segment_distance(ends[1], ends[0], ends[3], ends[2]) == pytest.approx(distance, abs=1e-12)


def searched(a0: np.ndarray, a1: np.ndarray, b0: np.ndarray, b1: np.ndarray) -> float:
    """The distance as a bounded least-squares problem over both shares."""
    A = np.column_stack([a1 - a0, b0 - b1])
    found = lsq_linear(A, b0 - a0, bounds=(0.0, 1.0), method="bvls", tol=1e-14)
    return float(np.sqrt(2.0 * found.cost))


POINTS = hnp.arrays(np.float64, (4, 3), elements=st.integers(-4, 4).map(lambda k: 0.25 * k))


@settings(max_examples=300, deadline=None)
@given(points=POINTS, turned=st.floats(-1e-6, 1e-6))
@example(points=np.zeros((4, 3)), turned=0.0)
@example(points=np.array([[0, 0, 0], [1, 0, 0], [0.5, 0, 0], [1.5, 0, 0]]), turned=1e-7)
def test_against_a_search(points: np.ndarray, turned: float) -> None:
    # a coarse lattice gives points, parallel and touching segments; the turn makes them nearly so
    a0, a1, b0, b1 = points
    b1 = b1 + turned * np.array([0.3, -0.7, 0.2])
    assert float(segment_distance(a0, a1, b0, b1)) == pytest.approx(searched(a0, a1, b0, b1), abs=2e-6)


def test_many_at_once_are_each_alone() -> None:
    rng = np.random.default_rng(5)
    a0, a1 = rng.normal(size=(2, 7, 1, 3))
    b0, b1 = rng.normal(size=(2, 1, 5, 3))
    all_of_them = segment_distance(a0, a1, b0, b1)
    assert all_of_them.shape == (7, 5)
    for i in range(7):
        for k in range(5):
            assert all_of_them[i, k] == pytest.approx(searched(a0[i, 0], a1[i, 0], b0[0, k], b1[0, k]), abs=1e-9)
