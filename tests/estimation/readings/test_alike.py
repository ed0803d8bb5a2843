"""Rows that splits and folds do not divide."""

from __future__ import annotations

import numpy as np

from cellapp.estimation.readings.readings import folds_of, repeats, undivided


def test_groups_are_configurations_or_neighbourhoods() -> None:
    rng = np.random.default_rng(0)
    far = rng.uniform(-2.0, 2.0, (40, 6))
    order = rng.permutation(120) % 40
    jittered = far[order] + rng.normal(0.0, 5e-5, (120, 6))
    np.testing.assert_array_equal(undivided(far), np.arange(40))
    group = undivided(jittered)
    assert (group[:, None] == group).tolist() == (order[:, None] == order).tolist()
    fold = folds_of(group, 5, rng)
    assert all(len(set(fold[order == one])) == 1 for one in range(40))
    line = np.linspace(0.0, 2.0, 200)[:, None] * np.ones(6)
    assert (len(set(repeats(line))), len(set(undivided(line)))) == (200, 10)
