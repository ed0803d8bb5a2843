"""Information beside nuisance parameters: the projection is the joint regression, with priors generalised."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.design.information import (
    VISIBLE,
    NuisanceProjector,
    detectable_size,
    visible_root,
    visible_squares,
)

N = 300


def rows_of(seed: int, *sizes: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.normal(size=(size, N)) for size in sizes]


def test_regression_in_the_complement_is_the_joint_regression() -> None:
    nuisance, rows, (y,) = rows_of(0, 10, 3, 1)
    projector = NuisanceProjector.of(nuisance)
    joint = np.linalg.lstsq(np.concatenate([nuisance, rows]).T, y, rcond=None)[0][-3:]
    alone = np.linalg.lstsq(projector.project(rows).T, projector.project(y), rcond=None)[0]
    np.testing.assert_allclose(alone, joint, atol=1e-12)
    assert projector.effective_parameters == pytest.approx(10.0)


def test_with_priors_the_projection_is_generalised_least_squares() -> None:
    nuisance, (y,) = rows_of(6, 10, 1)
    sd = np.random.default_rng(6).uniform(0.1, 2.0, 10)
    projector = NuisanceProjector.of(nuisance, 1.0 / sd**2)
    covariance = np.eye(N) + (nuisance.T * sd**2) @ nuisance
    np.testing.assert_allclose(projector.project(y), np.linalg.solve(covariance, y), atol=1e-10)
    assert projector.effective_parameters < 10.0


def test_the_root_makes_visible_directions_orthonormal_and_drops_the_others() -> None:
    nuisance, rows = rows_of(1, 10, 3)
    rows[1] = nuisance[0] + 0.1 * VISIBLE * rows[1]
    projector = NuisanceProjector.of(nuisance)
    projected = projector.project(rows)
    root, count = visible_root(rows @ projected.T, np.linalg.norm(rows, axis=1))
    assert count == 2
    np.testing.assert_allclose(root.T @ (rows @ projected.T) @ root, np.diag([0.0, 1.0, 1.0]), atol=1e-9)


def test_the_detectable_size_has_the_needed_noncentrality() -> None:
    nuisance, rows = rows_of(2, 10, 1)
    projector = NuisanceProjector.of(nuisance)
    size = detectable_size(float(np.sqrt(projector.behind(rows).squares[0])), 25.0)
    assert size**2 * float(rows[0] @ projector.project(rows[0])) == pytest.approx(25.0)


@pytest.mark.parametrize("hidden", [0, 1])
def test_squares_along_visible_directions_are_those_of_the_root(hidden: int) -> None:
    """Whether all directions of a batch show, or one of its last member is hidden."""
    nuisance, _ = rows_of(3, 10, 1)
    rows = np.random.default_rng(4).normal(size=(5, 3, nuisance.shape[1]))
    rows[-1, :hidden] = nuisance[0]
    projected = NuisanceProjector.of(nuisance).project(rows)
    gram, norms = rows @ projected.swapaxes(1, 2), np.linalg.norm(rows, axis=2)
    moments = projected @ np.random.default_rng(5).normal(size=nuisance.shape[1])
    root, count = visible_root(gram, norms)
    squares, found = visible_squares(gram, norms, moments)
    np.testing.assert_allclose(squares, np.sum(np.einsum("bkr,bk->br", root, moments) ** 2, axis=1), rtol=1e-9)
    assert found.tolist() == count.tolist() == [3, 3, 3, 3, 3 - hidden]
