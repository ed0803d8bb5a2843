"""The one least squares: it never ends above its start, and says whether it converged."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.calibration.least_squares import LeastSquares, Linearised, Minimum, minimise, shortened
from cellapp.ground.errors import CheckFailed, InputError, NotConverged, tried, with_not_fitted
from cellapp.robot.kinematics.transforms import Array

pytestmark = pytest.mark.fast


def valley(x: Array) -> tuple[Array, Array]:
    """Residuals of a bent valley (Rosenbrock) and their derivatives; the minimum is at (1, 1)."""
    return np.array([1.0 - x[0], 10.0 * (x[0] ** 2 - x[1])]), np.array([[1.0, 0.0], [-20.0 * x[0], 10.0]])


def end(problem: LeastSquares[Array], start: list[float], steps: int = 50) -> Minimum[Linearised[Array]]:
    first = problem.reweighted(linearised(problem, start))
    return minimise(problem, first, tolerance=1e-10, max_iterations=steps)


def linearised(problem: LeastSquares[Array], start: list[float]) -> Linearised[Array]:
    return Linearised(np.array(start), *problem.linearised(np.array(start)))


@pytest.mark.parametrize("start", [[-1.2, 1.0], [30.0, -400.0], [-10.0, 10.0], [1.0, 1.0]])
@pytest.mark.parametrize("steps", [1, 2, 3, 500])
def test_the_end_is_never_above_the_start_and_says_whether_it_converged(start: list[float], steps: int) -> None:
    problem = LeastSquares(valley, np.add)
    found = end(problem, start, steps)
    assert problem.objective(found.point) <= problem.objective(linearised(problem, start))
    assert np.allclose(found.point.state, 1.0, atol=1e-8) or not found.converged
    assert found.converged or steps < 500
    assert found.message


def test_a_fit_that_did_not_converge_is_an_error_of_the_program_with_its_name() -> None:
    problem = LeastSquares(valley, np.add)
    with pytest.raises(
        NotConverged, match=r"fit of a valley did not converge: 2 steps .* promises .* no finding"
    ) as error:
        problem.best("fit of a valley", np.array([-1.2, 1.0]), max_iterations=2)
    assert not isinstance(error.value, InputError | CheckFailed)
    assert error.value.exit_code == 1


def test_a_step_that_is_short_by_damping_is_no_convergence() -> None:
    # derivatives of the opposite sign: no step lowers the objective, and damping makes the steps as short as you like
    problem = LeastSquares(lambda x: (x, np.eye(2)), lambda x, step: x + step)
    first = linearised(problem, [1.0, 2.0])
    found = minimise(problem, first, tolerance=1e-5, max_iterations=50)
    assert not found.converged
    assert problem.objective(found.point) <= problem.objective(first)
    assert "no step lowers the objective" in found.message


def test_a_value_that_is_no_number_is_no_progress() -> None:
    def root(x: Array) -> tuple[Array, Array]:
        inside = 1.0 - x[0]
        value = np.sqrt(inside) if inside >= 0.0 else np.nan
        return np.array([value + 0.1 * x[0] - 1.0]), np.array([[0.5 / max(value, 1e-3) - 0.1]])

    problem = LeastSquares(root, np.add)
    found = end(problem, [0.999], 50)
    assert np.isfinite(found.point.state).all()
    assert problem.objective(found.point) <= problem.objective(linearised(problem, [0.999]))


def test_directions_that_are_hardly_determined_are_followed_to_their_end() -> None:
    rng = np.random.default_rng(0)
    weak = np.array([1.0, 1e-2, 1e-4])
    rows = rng.normal(size=(40, 3)) * weak

    def bent(x: Array) -> tuple[Array, Array]:
        return rows @ (np.array([1.0, 2.0, 3.0]) - x - 0.2 * x**2), rows * (1.0 + 0.4 * x)

    found = end(LeastSquares(bent, np.add), [0.0, 0.0, 0.0], 200)
    assert found.converged
    np.testing.assert_allclose(found.point.state + 0.2 * found.point.state**2, [1.0, 2.0, 3.0], rtol=1e-5)


def test_a_covariance_that_depends_on_the_state_weighs_the_step_from_there() -> None:
    problem = LeastSquares(
        lambda x: (np.array([2.0 - x[0], 4.0 - x[0]]), np.ones((2, 1))),
        lambda x, step: x + step,
        lambda x: np.diag([1.0, 1.0 + x[0] ** 2]),
    )
    found = problem.best("mean", np.array([0.0])).point
    weight = (1.0 + found.state[0] ** 2) ** -2.0
    assert found.state[0] == pytest.approx((2.0 + 4.0 * weight) / (1.0 + weight), abs=1e-8)


def test_a_step_is_halved_until_it_does_not_make_the_fit_worse() -> None:
    step = shortened("fit", np.array([8.0]), lambda x: float((x[0] - 1.0) ** 2))
    assert step == pytest.approx([2.0])
    with pytest.raises(NotConverged, match="no step lowers"):
        shortened("fit", np.array([1.0]), lambda x: float(abs(x[0])))
    with pytest.raises(NotConverged):
        shortened("fit", np.array([1.0]), lambda x: float("nan") if x.any() else 0.0)


def test_a_candidate_whose_fit_fails_is_named_and_no_evidence() -> None:
    def fails() -> int:
        raise NotConverged.of("fit", "no reason")

    missed: list[str] = []
    assert tried("first", fails, missed) is None
    assert tried("second", lambda: 2, missed) == 2
    assert with_not_fitted("found nothing", missed) == "found nothing; not judged, as no fit of it converged: first"
    assert with_not_fitted("found nothing", []) == "found nothing"
