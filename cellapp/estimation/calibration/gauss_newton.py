"""Nonlinear least squares: Gauss-Newton steps, damped after a step that made the fit worse.

Undamped steps converge fast if the residuals are small or the data determine all parameters. Along a direction that
they hardly determine, residuals of unmodelled physics can bend the objective as much as the Jacobian does. Steps then
shrink slowly, and the secant of the last two replaces the missing second derivatives (Anderson, J. ACM 12
(1965) 547, with one step of memory). Levenberg-Marquardt damping is added only after a step that raises the objective,
and removed again after steps that succeed. Source: Marquardt, J. SIAM 11 (1963) 431.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import scipy

from cellapp.estimation.calibration.linear import solve_psd
from cellapp.ground.errors import NotConverged
from cellapp.robot.kinematics.transforms import Array

Point = TypeVar("Point")

_FIRST_DAMPING = 1e-4
"""Share of the normal matrix's diagonal that is added after the first failed step; tenfold after each further one."""
_NO_DAMPING = 1e-6
"""Damping below which it is dropped: it changes a step by less than a millionth."""
_MOST_DAMPING = 1e8
"""Largest damping. Steps are then 1e-8 of a Gauss-Newton step: no descent direction is left."""
_HALVINGS = 30
"""Most halvings of a step: a billionth of it is then left."""
_ROUNDING = 1e-9
"""Relative rise of the objective below which the fit is not worse: its sum rounds by as much."""
_NO_GAIN = 1e-5
"""Share of the objective that the next step must promise: chance changes a chi-squared by a hundredth of itself."""
_SMALLEST = 1e-300
"""Guards a division by an objective of zero."""
_NEGLIGIBLE_STEP = 1e-7
"""Size below which steps are not tested, 0.1 um (0.1 urad): the objective does not resolve them."""
_SLOW = 0.1
"""Ratio of a step to the one before from which the secant is used; below it, the next step is nearly negligible."""


class Problem(Protocol[Point]):
    """A least-squares problem; a point holds parameter values and everything computed at them."""

    def reweighted(self, point: Point) -> Point:
        """Return the same parameters with weights from the residuals there; the point itself if weights are fixed."""
        ...

    def step(self, point: Point, damping: float) -> tuple[Array, Array]:
        """Compute the damped Gauss-Newton step (k,), and the same in metres (radians) at the scale of the arm (k,)."""
        ...

    def promise(self, point: Point, step: Array) -> float:
        """Compute by how much a Gauss-Newton step would lower the objective if the residuals were linear."""
        ...

    def moved(self, point: Point, step: Array) -> Point:
        """Return the point after a step, with the weights of ``point``."""
        ...

    def objective(self, point: Point) -> float:
        """Compute the weighted sum of squares to minimise."""
        ...


@dataclass(frozen=True)
class Minimum(Generic[Point]):
    """Where and why the iteration ended; ``steps`` are the sizes of all steps, rejected ones included."""

    point: Point
    steps: tuple[float, ...]
    converged: bool
    message: str

    def settled(self, fit: str) -> Minimum[Point]:
        """Return this; raise ``NotConverged`` with the name of the ``fit`` if it did not converge."""
        if not self.converged:
            raise NotConverged.of(fit, self.message)
        return self


def minimise(problem: Problem[Point], start: Point, *, tolerance: float, max_iterations: int) -> Minimum[Point]:
    """Iterate from ``start`` until the next step, undamped, is at most ``tolerance``.

    That last step is not taken, so that residuals, gradient and parameters of the result are consistent. No step raises
    the objective, with the weights it was computed with, above rounding, and all steps together do not raise it: if
    steps that are too small to be tested do so, the start is returned. Where steps fail or are used up, the iteration
    has converged nevertheless if the next one promises nothing: it follows a direction that is not determined.
    """
    first = point = problem.reweighted(start)
    sizes: list[float] = []
    damping, last, fallen = _Damping(), None, 0.0

    def ended(why: str = "") -> Minimum[Point]:
        converged, message = (
            (True, f"the next step is below {tolerance:g}") if not why else _promise(problem, point, why)
        )
        message = f"converged: {message}" if converged else message
        return Minimum(point if fallen >= 0.0 else first, tuple(sizes), converged, message)

    for _ in range(max_iterations):
        step, scaled = problem.step(point, damping.value)
        size, shorter = float(np.max(np.abs(scaled))), False
        if size <= tolerance and damping.value > 0.0:  # short by damping alone? Then go a part of the way undamped
            step, scaled = problem.step(point, 0.0)
            size, shorter = float(np.max(np.abs(scaled))), True
        sizes.append(size)
        if size <= tolerance:
            return ended()
        now = problem.objective(point)
        secants = () if damping.value > 0.0 else _secants(last, step, scaled)
        for taken in _parts(step, size, tolerance) if shorter else (*secants, step):
            trial = problem.moved(point, taken)
            rise = problem.objective(trial) - now
            if rise <= _ROUNDING * now or (size <= _NEGLIGIBLE_STEP and math.isfinite(rise)):
                break
        else:
            last = None
            if shorter or not damping.after_failure():
                return ended("no step lowers the objective")
            continue
        fallen -= rise
        last = None if shorter else _Step(step, scaled, taken)
        damping.after_success()
        point = problem.reweighted(trial)
    return ended(f"{max_iterations} steps were not enough")


def shortened(fit: str, step: Array, loss: Callable[[Array], float]) -> Array:
    """Return a ``step`` (k,), halved until the ``loss`` after it is not above that at zero; else ``NotConverged``."""
    most = loss(np.zeros(len(step))) * (1.0 + _ROUNDING)
    for _ in range(_HALVINGS):
        if loss(step) <= most:  # False at NaN
            return step
        step = 0.5 * step
    raise NotConverged.of(fit, "no step lowers the objective")


@dataclass(frozen=True, eq=False)
class Linearised(Generic[Point]):
    """A state with its residuals r (d,), their derivatives A (d, k), and a factor L (d, d) of their covariance.

    A step x leaves ``r - A x``. L is lower triangular; None for the identity.
    """

    state: Point
    r: Array
    A: Array
    L: Array | None = None

    @cached_property
    def white(self) -> tuple[Array, Array]:
        """``L^-1 r`` and ``L^-1 A``."""
        if self.L is None:
            return self.r, self.A
        both = scipy.linalg.solve_triangular(self.L, np.column_stack([self.A, self.r]), lower=True)
        return both[:, -1], both[:, :-1]


@dataclass(frozen=True, eq=False)
class LeastSquares(Generic[Point]):
    """Problem of few parameters for ``minimise``: least ``|L^-1 r|^2`` over states of any kind.

    Attributes
    ----------
    linearised : callable
        State -> residuals r (d,) and derivatives A (d, k), as in ``Linearised``.
    after : callable
        State and step (k,) [m, rad] -> state after the step.
    factor : array, shape (d, d), or callable, optional
        Factor L of the covariance of r, or state -> L there; it is that of the state from which a step starts.
    """

    linearised: Callable[[Point], tuple[Array, Array]]
    after: Callable[[Point, Array], Point]
    factor: Callable[[Point], Array] | Array | None = None

    def best(self, fit: str, start: Point, *, tolerance: float = 1e-10, max_iterations: int = 50) -> Minimum[Any]:
        """Return the minimum, with a ``Linearised`` state; raise ``NotConverged`` with the name of the ``fit``."""
        first = Linearised(start, *self.linearised(start))
        return minimise(self, first, tolerance=tolerance, max_iterations=max_iterations).settled(fit)

    def reweighted(self, point: Linearised[Point]) -> Linearised[Point]:
        """Return the point with the covariance there."""
        return replace(point, L=self.factor(point.state) if callable(self.factor) else self.factor)

    def step(self, point: Linearised[Point], damping: float) -> tuple[Array, Array]:
        """Compute the damped step; lengths and angles count alike."""
        r, A = point.white
        step = damped_step(A.T @ A, A.T @ r, damping)
        return step, step

    def promise(self, point: Linearised[Point], step: Array) -> float:
        """Compute by how much a Gauss-Newton step would lower the objective if the residuals were linear."""
        r, A = point.white
        return float(step @ A.T @ r)

    def moved(self, point: Linearised[Point], step: Array) -> Linearised[Point]:
        """Return the point after a step, with the same covariance."""
        state = self.after(point.state, step)
        return Linearised(state, *self.linearised(state), point.L)

    def objective(self, point: Linearised[Point]) -> float:
        """Compute ``|L^-1 r|^2``."""
        r, _ = point.white
        return float(r @ r)


def _promise(problem: Problem[Point], point: Point, why: str) -> tuple[bool, str]:
    """Return whether the next undamped step promises too little to count, and say so behind ``why`` steps ended."""
    step, scaled = problem.step(point, 0.0)
    share = problem.promise(point, step) / max(problem.objective(point), _SMALLEST)
    next_step = f"the next step, {np.max(np.abs(scaled)):.1e} long, promises {share:.1e} of the objective"
    return share <= _NO_GAIN, f"{why}; {next_step}"


@dataclass
class _Damping:
    """Damping of the next step; ``least`` is that below which it is dropped.

    If undamped steps fail again and again, the direction that they follow is hardly determined: the damping then goes
    down further before it is dropped, and starts from where it was good enough.
    """

    value: float = 0.0
    least: float = _NO_DAMPING
    _again: bool = False

    def after_failure(self) -> bool:
        """Raise the damping; return whether a descent direction may be left."""
        if self.value > 0.0:
            self.value *= 10.0
        elif self._again:
            self.value, self.least = self.least, 1e-3 * self.least
        else:
            self.value, self._again = _FIRST_DAMPING, True
        return self.value <= _MOST_DAMPING

    def after_success(self) -> None:
        """Lower the damping, or drop it."""
        self.value = 0.0 if self.value < self.least else self.value / 10.0


@dataclass(frozen=True)
class _Step:
    """Gauss-Newton step (k,), the same in metres, and the step that was actually taken."""

    step: Array
    scaled: Array
    taken: Array


def _secants(last: _Step | None, step: Array, scaled: Array) -> tuple[Array, ...]:
    """Predict the next step (k,) if steps change linearly along the ``last``; empty if they shrink fast anyway."""
    if last is None:
        return ()
    change = scaled - last.scaled
    if np.linalg.norm(scaled) < _SLOW * np.linalg.norm(last.scaled) or not change.any():
        return ()
    share = float(scaled @ change) / float(change @ change)
    return (step - share * (last.taken + step - last.step),)


def _parts(step: Array, size: float, tolerance: float) -> Iterator[Array]:
    """Halve an undamped step (k,), as long as it is longer than the tolerance."""
    while size > tolerance:
        step, size = 0.5 * step, 0.5 * size
        yield step


def damped_step(A: Array, b: Array, damping: float) -> Array:
    """Solve ``(A + damping diag(A)) step = b``; return the solution of least norm if ``A`` (k, k) is singular."""
    return solve_psd(A + damping * np.diag(np.diag(A)) if damping > 0.0 else A, b)
