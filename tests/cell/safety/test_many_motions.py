"""Many motions together are judged as the gate judges them one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import CellBodies, refuse_motion
from cellapp.cell.safety.many_motions import FreeMotions, free_motions
from tests.cell.safety.test_obstacles import crowded, random_stops
from tests.twin import small_twin

pytestmark = pytest.mark.fast


def motions(cell: CellBodies, count: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Short and long motions; with a position that is no number, and a target outside the limits."""
    start, end = random_stops(cell, count, 1), random_stops(cell, count, 2)
    rng = np.random.default_rng(3)
    for name, q in end.items():
        q[::2] = start[name][::2] + rng.normal(0.0, 0.05, q[::2].shape)
        end[name] = np.clip(q, *cell.arms[name].limits.T)
    first, last = next(iter(start)), next(reversed(end))
    start[first][5, 2] = end[last][6, 0] = np.nan
    end[last][7, 1] = cell.arms[last].limits[1, 1] + 0.1
    return start, end


@pytest.mark.slow
@pytest.mark.parametrize(
    ("profile", "apart"), [(small_twin(), 0.0), (small_twin(), 0.3), (crowded(), 0.0)], ids=["twin", "apart", "crowded"]
)
def test_many_motions_are_judged_as_one_by_one(profile, apart, monkeypatch) -> None:
    cell = replace(cell_bodies(profile), apart=apart)
    start, end = motions(cell, 160)
    of = [({name: q[k] for name, q in start.items()}, {name: q[k] for name, q in end.items()}) for k in range(160)]
    expected = np.array([not refuse_motion(cell, *motion) for motion in of])
    assert 5 < expected.sum() < 155
    np.testing.assert_array_equal(free_motions(cell, start, end), expected)
    known = FreeMotions(cell)
    known.ask(of[:100])
    monkeypatch.setattr("cellapp.cell.safety.many_motions.free_motions", None)  # what was asked is not asked again
    known.ask(of[:100])
    assert [known.free(*motion) for motion in of] == expected.tolist()


def test_a_path_that_only_comes_near_between_its_ends_is_refused() -> None:
    cell = cell_bodies(small_twin())
    start, end = motions(cell, 400)
    ends_free = free_motions(cell, start, start) & free_motions(cell, end, end)
    refused = np.flatnonzero(ends_free & ~free_motions(cell, start, end))
    assert len(refused) > 5
    for k in refused[:5].tolist():
        assert refuse_motion(cell, {n: q[k] for n, q in start.items()}, {n: q[k] for n, q in end.items()})


def test_other_arms_than_those_of_the_cell_are_no_motion() -> None:
    cell = cell_bodies(small_twin())
    with pytest.raises(ValueError, match="for the arms left, right"):
        free_motions(cell, {"left": np.zeros((1, 6))}, {"left": np.zeros((1, 6))})
