"""Nonlinear least squares: Gauss-Newton steps, damped after a step that made the fit worse.

Undamped steps converge fast where the residuals are small or the data determine all parameters. Along a direction that
they hardly determine, residuals of unmodelled physics can bend the objective as much as the Jacobian does; steps then
shrink slowly, and the secant of the last two takes the place of the missing second derivatives (Anderson, J. ACM 12
(1965) 547, with one step of memory). Levenberg-Marquardt damping is added only where a step raises the objective, and
taken away again after steps that succeed. Source: Marquardt, J. SIAM 11 (1963) 431.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from cellapp.estimation.calibration.linear import solve_psd
from cellapp.robot.kinematics.transforms import Array

Point = TypeVar("Point")

_FIRST_DAMPING = 1e-4
"""Share of the normal matrix's diagonal that is added after the first failed step; tenfold after each further one."""
_NO_DAMPING = 1e-6
"""Damping below this changes a step by less than a millionth, and is dropped."""
_MOST_DAMPING = 1e8
"""Largest damping. Steps are then 1e-8 of a Gauss-Newton step: no descent direction is left."""
_ROUNDING = 1e-9
"""A relative rise of the objective by less than this is rounding of its sum, not a worse fit."""
_NEGLIGIBLE_STEP = 1e-7
"""Steps below 0.1 um (0.1 urad) are not tested: the objective does not resolve them."""
_SLOW = 0.1
"""Ratio of a step to the one before from which the secant is used; below, the next step is negligible or nearly so."""


class Problem(Protocol[Point]):
    """A least-squares problem; a point holds parameter values and everything computed at them."""

    def reweighted(self, point: Point) -> Point:
        """The same parameters with weights that follow from the residuals there; the point itself for fixed weights."""
        ...

    def step(self, point: Point, damping: float) -> tuple[Array, Array]:
        """The damped Gauss-Newton step (k,), and the same in metres (radians) at the scale of the arm (k,)."""
        ...

    def moved(self, point: Point, step: Array) -> Point:
        """The point after a step, with the weights of ``point``."""
        ...

    def objective(self, point: Point) -> float:
        """The weighted sum of squares to minimise."""
        ...


@dataclass(frozen=True)
class Minimum(Generic[Point]):
    """Where and why the iteration ended; ``steps`` are the sizes of all steps, those that were rejected included."""

    point: Point
    steps: tuple[float, ...]
    converged: bool
    message: str


def minimise(problem: Problem[Point], start: Point, *, tolerance: float, max_iterations: int) -> Minimum[Point]:
    """Iterate from ``start`` until the next step is at most ``tolerance``.

    That last step is not taken, so that residuals, gradient and parameters of the result belong together.
    """
    point = problem.reweighted(start)
    sizes: list[float] = []
    damping, last = 0.0, None
    for _ in range(max_iterations):
        step, scaled = problem.step(point, damping)
        size = float(np.max(np.abs(scaled)))
        sizes.append(size)
        if size <= tolerance:
            return Minimum(point, tuple(sizes), True, f"converged: the next step is below {tolerance:g}")
        tried = [step] if last is None or damping > 0.0 else [*last.secant(step, scaled), step]
        for taken in tried:
            trial = problem.moved(point, taken)
            worse = problem.objective(trial) > problem.objective(point) * (1.0 + _ROUNDING)
            if not worse or size <= _NEGLIGIBLE_STEP:
                break
        else:
            last, damping = None, max(_FIRST_DAMPING, 10.0 * damping)
            if damping > _MOST_DAMPING:
                return Minimum(point, tuple(sizes), False, "not converged: no step improves the fit")
            continue
        last = _Step(step, scaled, taken)
        damping = 0.0 if damping < _NO_DAMPING else damping / 10.0
        point = problem.reweighted(trial)
    return Minimum(point, tuple(sizes), False, f"not converged after {max_iterations} iterations")


@dataclass(frozen=True)
class _Step:
    """A Gauss-Newton step (k,), the same in metres, and the step that was taken instead."""

    step: Array
    scaled: Array
    taken: Array

    def secant(self, step: Array, scaled: Array) -> tuple[Array, ...]:
        """The next step (k,) if steps change linearly along the one taken; none where they shrink fast anyway."""
        change = scaled - self.scaled
        if np.linalg.norm(scaled) < _SLOW * np.linalg.norm(self.scaled) or not change.any():
            return ()
        share = float(scaled @ change) / float(change @ change)
        return (step - share * (self.taken + step - self.step),)


def damped_step(A: Array, b: Array, damping: float) -> Array:
    """Solution of ``(A + damping diag(A)) step = b``; the one of least norm where ``A`` (k, k) is singular."""
    return solve_psd(A + damping * np.diag(np.diag(A)) if damping > 0.0 else A, b)
