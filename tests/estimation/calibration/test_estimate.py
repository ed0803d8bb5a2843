"""A geometry beside many effects: elimination of the effects solves the whole normal equations."""

from __future__ import annotations

import numpy as np

from cellapp.estimation.calibration.identification import Eliminated, Estimate
from cellapp.estimation.calibration.normal_equations import NormalEquations

SIZE, EFFECTS = 5, 40


def estimate(*, repeated: bool = False) -> Estimate:
    """From random rows; a column of the effects that is ``repeated``, without priors, cannot be told apart."""
    rng = np.random.default_rng(4)
    J = rng.normal(size=(200, SIZE + EFFECTS)) * rng.uniform(0.1, 10.0, SIZE + EFFECTS)
    if repeated:
        J[:, -1] = J[:, -2]
    normal = NormalEquations(J.T @ J, J.T @ rng.normal(size=200), np.eye(SIZE), 1.0, np.abs(J).mean(axis=0), np.eye(3))
    precision = np.zeros(SIZE + EFFECTS) if repeated else rng.uniform(0.0, 50.0, SIZE + EFFECTS)
    return Estimate(np.zeros(SIZE + EFFECTS), normal, None, precision)


def test_steps_and_variances_are_those_of_all_parameters_together_whatever_the_geometrys_priors_become() -> None:
    point = estimate()
    found = Eliminated.of(point.normal, point.precision, SIZE)
    assert found is not None
    rhs = point.normal.unit * point.normal.b
    for factor in (1.0, 30.0):  # effects keep theirs
        precision = np.concatenate([point.precision[:SIZE] * factor, point.precision[SIZE:]])
        now = Estimate(point.values, point.normal, None, precision)
        H = now.posterior_precision(1.0)
        priors = now.geometric_priors(SIZE)
        np.testing.assert_allclose(found.solve(rhs, priors), np.linalg.solve(H, rhs), rtol=1e-9)
        np.testing.assert_allclose(found.variances(priors), np.diag(np.linalg.inv(H))[:SIZE], rtol=1e-9)
        np.testing.assert_allclose(priors * found.variances(priors), now.by_priors[:SIZE], rtol=1e-9)


def test_effects_that_nothing_tells_apart_are_not_eliminated() -> None:
    point = estimate(repeated=True)
    assert Eliminated.of(point.normal, point.precision, SIZE) is None
