"""Solving with positive semi-definite matrices: agreement with numpy, well conditioned and singular."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.calibration.least_squares import cholesky, inverse_psd, orthonormal_basis, solve_psd

pytestmark = pytest.mark.fast


@pytest.fixture
def design() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(60, 5))


def test_well_conditioned_systems_are_solved_by_cholesky(design: np.ndarray) -> None:
    gram, rhs = design.T @ design, np.arange(5.0)
    assert cholesky(gram) is not None
    np.testing.assert_allclose(solve_psd(gram, rhs), np.linalg.solve(gram, rhs), rtol=1e-12)
    np.testing.assert_allclose(inverse_psd(gram), np.linalg.inv(gram), rtol=1e-10, atol=1e-14)
    both = solve_psd(gram, np.stack([rhs, -rhs], axis=1))
    np.testing.assert_allclose(both[:, 1], -both[:, 0])


def test_the_units_of_the_columns_do_not_matter(design: np.ndarray) -> None:
    scaled = design * np.geomspace(1e-6, 1e6, 5)
    assert cholesky(scaled.T @ scaled) is not None


def test_a_redundant_column_gives_the_solution_of_least_norm(design: np.ndarray) -> None:
    redundant = np.column_stack([design, design[:, 0] + design[:, 1]])
    gram, y = redundant.T @ redundant, np.random.default_rng(1).normal(size=60)
    assert cholesky(gram) is None
    wanted = np.linalg.lstsq(redundant, y, rcond=None)[0]
    np.testing.assert_allclose(solve_psd(gram, redundant.T @ y), wanted, atol=1e-9)
    np.testing.assert_allclose(inverse_psd(gram), np.linalg.pinv(gram, rcond=1e-10, hermitian=True), atol=1e-9)
    Q = orthonormal_basis(redundant.T)
    assert Q.shape == (60, 5)
    np.testing.assert_allclose(Q.T @ Q, np.eye(5), atol=1e-10)
    np.testing.assert_allclose(Q @ (Q.T @ redundant), redundant, atol=1e-9)


def test_priors_enter_the_basis(design: np.ndarray) -> None:
    precision = np.array([0.0, 3.0, 0.0, 50.0, 1.0])
    Q = orthonormal_basis(design.T, precision)
    wanted = design @ np.linalg.solve(design.T @ design + np.diag(precision), design.T)
    np.testing.assert_allclose(Q @ Q.T, wanted, atol=1e-12)


@pytest.mark.parametrize("shape", [(0, 3), (3, 0)])
def test_nothing_to_solve_for_is_no_error(shape: tuple[int, int]) -> None:
    assert solve_psd(np.eye(shape[0]), np.ones(shape)).shape == shape
