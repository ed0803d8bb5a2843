"""The gain of a term on left-out readings is that of fits to the other readings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cellapp.estimation.discovery.joint_fit import _FOLD_SEED, NormalMatrix, cross_validated_gain

pytestmark = pytest.mark.fast

READINGS, FOLDS, SEED = 60, 5, 3


class Data(SimpleNamespace):
    """What the cross-validation needs of the data of an arm."""

    points = reading = None

    def __len__(self) -> int:
        return READINGS


def left_out_square(rows, precision, target, fold):
    """Sum of squares of each fold, predicted by a fit to the others."""
    total = 0.0
    for k in range(FOLDS):
        out = fold == k
        X = rows[:, ~out]
        solution = np.linalg.solve(X @ X.T + np.diag(precision), X @ target[~out])
        total += np.sum((target[out] - solution @ rows[:, out]) ** 2)
    return total


@pytest.mark.parametrize("signal", [0.0, 0.5])
def test_the_gain_is_that_of_fits_to_the_other_folds(signal):
    rng = np.random.default_rng(1)
    rows, new = rng.normal(size=(12, 3 * READINGS)), rng.normal(size=(3, 3 * READINGS))
    precision = np.concatenate([np.zeros(6), rng.uniform(1.0, 500.0, 6)])
    target = rng.normal(size=3 * READINGS) + signal * new[0]
    data: Any = Data(profile=SimpleNamespace(seed=SEED, discovery=SimpleNamespace(folds=FOLDS)))
    normal = NormalMatrix.of(rows, target)
    fit: Any = SimpleNamespace(rows=rows, precision=precision, target=target, normal=normal, derived={})
    fold = np.tile(np.random.default_rng([SEED, _FOLD_SEED]).permutation(READINGS) % FOLDS, 3)
    before = left_out_square(rows, precision, target, fold)
    after = left_out_square(np.concatenate([rows, new]), np.concatenate([precision, np.zeros(3)]), target, fold)
    gain = cross_validated_gain(data, fit, new)
    assert gain == pytest.approx(before - after, rel=1e-9)
    assert (gain > 0.0) == (signal > 0.0)
