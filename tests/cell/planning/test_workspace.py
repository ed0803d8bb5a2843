"""Points of the workspace: clear, inside the ranges, seen by the tracker or not."""

from __future__ import annotations

import numpy as np

from cellapp.cell.planning.candidates import workspace_configurations
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import clear_alone, visible
from tests.twin import small_twin


def test_targets_are_clear_wherever_the_smr_looks() -> None:
    profile = small_twin()
    cell = cell_bodies(profile)
    q = workspace_configurations(profile, cell, "left", 200, np.random.default_rng(5))
    assert q.shape == (200, 6)
    assert clear_alone(cell, place(cell.arms["left"], q)).all()
    assert visible(cell, "left", q).mean() < 0.2
    again = workspace_configurations(profile, cell, "left", 200, np.random.default_rng(5))
    np.testing.assert_array_equal(q, again)
