"""Least squares: weights of readings, solutions with semi-definite matrices, damped Gauss-Newton steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, Literal, Protocol, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.ground.errors import NotConverged
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.model import ReadingsNoise

# Solve with symmetric positive semi-definite matrices: by Cholesky if that is accurate, else by truncated eigenvalues.
#
# Least squares with columns ``X`` (d, p) and prior precisions ``P`` needs ``G = X^T X + P``. Redundant parameters make
# G singular. All modules use this rule:
#
# 1. Factor ``G = L L^T``. ``L_ii^2 / G_ii`` is the share of column i that columns 1 to i - 1 do not explain (the
#    *tolerance* of regression, the inverse of the variance inflation factor). It does not depend on the columns' units.
#    If every ``L_ii > PIVOT sqrt(G_ii)``, use the factor.
# 2. Else decompose ``G = V diag(e) V^T`` and drop eigenvalues below ``EIGENVALUE`` times the largest. This gives the
#    solution of least norm in the caller's scaling: scale parameters to comparable size before (unit columns, or metres
#    at arm's length).
#
# Sources: Golub, Van Loan, Matrix Computations, 4th ed., sections 4.2 and 5.5; van der Sluis, Numer. Math. 14 (1969)
# 14 (Cholesky's accuracy does not depend on the scaling of the columns).

PIVOT = 3e-5
"""Least L_ii / sqrt(G_ii) for which the Cholesky factor is used. The relative error of a solution is about
eps / PIVOT^2 = 2e-7, a tenth of a nanometre on a correction of a millimetre."""
EIGENVALUE = 1e-11
"""Share of the largest eigenvalue below which one counts as zero: 1e5 eps, above rounding; about PIVOT^2 / 100, so that
a matrix just below the limit for Cholesky loses no direction."""
_SMALLEST = 1e-300
"""Lower bound of a norm that is divided by: far below any data and above the smallest float."""


def cholesky(gram: Array) -> Array | None:
    """Compute the lower Cholesky factor of ``gram`` (p, p), zero above the diagonal; None if it would be inaccurate."""
    factor, failed = scipy.linalg.lapack.dpotrf(gram, lower=1)
    if failed or not (factor.diagonal() > PIVOT * np.sqrt(gram.diagonal())).all():
        return None
    return np.asarray(factor)


def solve_psd(gram: Array, rhs: Array) -> Array:
    """``gram^-1 rhs`` for ``rhs`` (p,) or (p, r); the solution of least norm where ``gram`` (p, p) is singular."""
    return solver_psd(gram)(rhs) if rhs.size else np.zeros(rhs.shape)  # LAPACK refuses an empty one


def solver_psd(gram: Array) -> Callable[[Array], Array]:
    """Return ``solve_psd`` with ``gram`` (p, p), factored once, as a function of what is not empty."""
    factor = cholesky(gram)
    if factor is not None:
        return lambda rhs: np.asarray(scipy.linalg.lapack.dpotrs(factor, rhs, lower=1)[0])
    values, vectors = _significant(gram)
    return lambda rhs: np.asarray((vectors / values) @ (vectors.T @ rhs))


def inverse_psd(gram: Array) -> Array:
    """Compute the inverse of ``gram`` (p, p); the pseudo-inverse if it is singular."""
    factor = cholesky(gram)
    if factor is not None:
        lower = scipy.linalg.lapack.dpotri(factor, lower=1)[0]  # leaves the zeros above the diagonal
        inverse = lower + lower.T
        np.fill_diagonal(inverse, lower.diagonal())
        return np.asarray(inverse)
    values, vectors = _significant(gram)
    return np.asarray((vectors / values) @ vectors.T)


def covariance_with_priors(information: Array, sds: Array) -> Array:
    """Compute the covariance (p, p) from ``information`` (p, p) and standard deviations (p,) of priors, inf without."""
    unit = np.where(np.isfinite(sds), sds, 1.0)  # scales the entries to comparable size
    precision = (information + np.diag(sds**-2.0)) * unit * unit[:, None]
    return inverse_psd(precision) * unit * unit[:, None]


def inverse_diagonal(gram: Array) -> Array:
    """Compute the diagonal (p,) of the inverse of ``gram`` (p, p)."""
    factor = cholesky(gram)
    inverse = inverse_psd(gram) if factor is None else scipy.linalg.lapack.dpotri(factor, lower=1)[0]
    return np.asarray(inverse.diagonal())


def orthonormal_basis(rows: Array, precision: Array | None = None, gram: Array | None = None) -> Array:
    """Compute ``Q`` (d, k) with ``Q Q^T = X (X^T X + P)^-1 X^T``; its columns are orthonormal without priors.

    Parameters
    ----------
    rows : array, shape (p, d)
        Columns X as rows.
    precision : array, shape (p,), optional
        Diagonal of P: inverse prior variances, zero without a prior.
    gram : array, shape (p, p), optional
        X^T X, if known.
    """
    gram = rows @ rows.T if gram is None else gram
    scale = 1.0 / np.maximum(np.sqrt(gram.diagonal()), _SMALLEST)
    gram = gram * (scale[:, None] * scale)
    if precision is not None:
        gram.flat[:: len(gram) + 1] += precision * scale**2
    factor, scaled = cholesky(gram), (rows * scale[:, None]).T
    if factor is not None:  # X is in the memory order of LAPACK: no copy
        solve = scipy.linalg.blas.dtrsm
        return np.asarray(solve(1.0, factor, scaled, side=1, lower=1, trans_a=1, overwrite_b=1))
    values, vectors = _significant(gram)
    return np.asarray(scaled @ (vectors / np.sqrt(values)))


def _significant(gram: Array) -> tuple[Array, Array]:
    """Compute the eigenvalues (k,) that do not count as zero, and their vectors (p, k)."""
    values, vectors = np.linalg.eigh(gram)
    kept = values > EIGENVALUE * values[-1]
    return values[kept], vectors[:, kept]


# -- Nonlinear least squares: Gauss-Newton steps, damped after a step that made the fit worse -------------------------
#
# Undamped steps converge fast if the residuals are small or the data determine all parameters. Along a direction that
# they hardly determine, residuals of unmodelled physics can bend the objective as much as the Jacobian does. Steps
# then shrink slowly, and the secant of the last two replaces the missing second derivatives (Anderson, J. ACM 12
# (1965) 547, with one step of memory). Levenberg-Marquardt damping is added only after a step that raises the
# objective, and removed again after steps that succeed. Source: Marquardt, J. SIAM 11 (1963) 431.

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


def damped_step(A: Array, b: Array, damping: float, limits: Array | None = None) -> Array:
    """Solve ``(A + damping diag(A)) step = b``; return the solution of least norm if ``A`` (k, k) is singular.

    Within ``limits`` (2, k), some of the step is held at them, and the rest is the best beside that.
    """
    H = A + damping * np.diag(np.diag(A)) if damping > 0.0 else A
    step = solve_psd(H, b)
    if limits is None or bool(np.all((limits[0] <= step) & (step <= limits[1]))):
        return step
    values, vectors = _significant(H)
    root = np.sqrt(values)
    found = scipy.optimize.lsq_linear(root[:, None] * vectors.T, vectors.T @ b / root, limits, method="bvls")
    return np.asarray(found.x)


# -- Weights of readings ----------------------------------------------------------------------------------------------


RobustName = Literal["none", "huber", "tukey"]

_HUBER = 2.5003
"""Norm beyond which Huber's weight falls: root of the 90 % quantile of chi-square with 3 degrees of freedom."""
_TUKEY = 6.0
"""Norm beyond which Tukey's weight is zero: about four times the median norm of a good point."""
MEDIAN_NORM = 1.5382
"""Median of the norm of three independent standard normal variables."""
NORMAL_95 = 1.959964
"""Half width of the 95 % interval of a normal distribution, in standard deviations: its quantile 0.975."""
_CHANCE = 3.0
"""Standard deviations by which chi-square must exceed its degrees of freedom for the scatter to count as excess."""
_SETTLED, _MOST_STEPS = 1e-6, 100
"""Relative step at which an added variance is found, after three steps or so; steps below the root end there in any
case."""


def whitener(sigma: Array) -> Array:
    """Compute factors that convert errors of points into units of their standard uncertainty.

    Standard uncertainties (n,) [m] give (n,) [1/m]. Covariances (n, 3, 3) [m^2] give lower triangular (3, 3, n) [1/m].
    """
    if sigma.ndim == 1:
        return np.asarray(1.0 / sigma)
    return np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(sigma)).transpose(1, 2, 0))


def usual_scatter(norm: Array, least: float) -> float:
    """Return the standard deviation of a coordinate, at least ``least``, by the median of the norms (n,) of residuals.

    A few gross errors do not move it: each rule for these is a multiple of it.
    """
    return max(float(np.median(norm)) / MEDIAN_NORM, least) if len(norm) else least


def robust_weights(norm: Array, robust: Literal["huber", "tukey"]) -> Array:
    """Compute robust weights (n,) of whole points from the norms (n,) of their residuals, scaled by the median norm.

    Source: Huber, Robust Statistics (1981); Beaton, Tukey, Technometrics 16 (1974) 147 (biweight).
    """
    u = norm / usual_scatter(norm, _SMALLEST)
    if robust == "huber":
        return np.asarray(np.minimum(1.0, _HUBER / np.maximum(u, 1e-12)))
    return np.asarray(np.where(u < _TUKEY, (1.0 - (np.minimum(u, _TUKEY) / _TUKEY) ** 2) ** 2, 0.0))


def excess_variance(residuals: Array, sigma: Array, degrees_of_freedom: float) -> float:
    """Compute the variance [m^2] per coordinate that must be added to the stated one to explain the scatter.

    It is the root tau^2 of ``sum_i r_i^T (S_i + tau^2 I)^-1 r_i = degrees of freedom``, after DerSimonian, Laird,
    Control. Clin. Trials 7 (1986) 177; zero if the scatter is not larger than chance allows.

    Parameters
    ----------
    residuals : array, shape (n, 3)
        [m]
    sigma : array, shape (n,) [m] or (n, 3, 3) [m^2]
    degrees_of_freedom : float
    """
    if sigma.ndim == 1:
        variance, squares = sigma[:, None] ** 2, residuals**2
    else:
        variance, axes = np.linalg.eigh(sigma)
        squares = np.einsum("nab,na->nb", axes, residuals) ** 2

    chance = _CHANCE * math.sqrt(2.0 * degrees_of_freedom)  # chi-square has variance 2 f
    if float(np.sum(squares / variance)) - degrees_of_freedom <= chance:
        return 0.0
    return _added_variance(squares, variance, degrees_of_freedom)


def _added_variance(squares: Array, variance: Array, degrees_of_freedom: float) -> float:
    """Find v [m^2] with ``sum(squares / (variance + v)) = degrees_of_freedom``, at least 0.

    One over that sum is concave in v and nearly linear: Newton's steps for it from below end below the root.
    """
    v = 0.0
    for _ in range(_MOST_STEPS):
        inverse = 1.0 / (variance + v)
        total = float(np.sum(squares * inverse))
        if total <= degrees_of_freedom:
            break
        step = (total / degrees_of_freedom - 1.0) * total / float(np.sum(squares * inverse**2))
        v += step
        if step <= _SETTLED * v:
            break
    return v


def excess_of_kinds(
    residuals: Array, sigma: Array, degrees_of_freedom: float, angular: NDArray[np.bool_] | None, of_rotations: float
) -> tuple[float, float]:
    """Compute ``excess_variance`` of positions [m^2] and of orientations [rad^2], each from its own scatter.

    ``of_rotations`` are the degrees of freedom of the orientations, masked by ``angular`` (n,), a part of all.
    """
    if angular is None:
        return excess_variance(residuals, sigma, degrees_of_freedom), 0.0
    freedom = (max(degrees_of_freedom - of_rotations, 1.0), max(of_rotations, 1.0))
    found = [
        excess_variance(residuals[rows], sigma[rows], its)
        for rows, its in zip((~angular, angular), freedom, strict=True)
        if rows.any()
    ]
    return found[0], found[-1]


def with_excess(
    sigma: Array, tau_squared: float, angular: NDArray[np.bool_] | None = None, of_rotations: float = 0.0
) -> Array:
    """Add an excess variance [m^2] per coordinate to the stated uncertainty, in the shape and unit of ``sigma``.

    ``of_rotations`` [rad^2] is the excess variance of orientations, masked by ``angular`` (n,).
    """
    added = tau_squared if angular is None else np.where(angular, of_rotations, tau_squared)
    if sigma.ndim == 1:
        return np.sqrt(sigma**2 + added)
    return np.asarray(sigma + np.multiply.outer(added, np.eye(3)))


# -- Noise of positions and of orientations, from the uncertainties that weigh the readings ---------------------------

_ALIKE_AXES = 0.01
"""Relative spread of an orientation's noise over its axes from which it is stated axis by axis."""


def readings_noise(sigma: Array, angular: NDArray[np.bool_] | None, scale: float = 1.0) -> ReadingsNoise:
    """Compute the rms noise, times ``scale``, of readings with uncertainties ``sigma`` (n,) or covariances (n, 3, 3);
    ``angular`` (n,) masks orientations."""
    if angular is None:
        return ReadingsNoise(math.sqrt(mean_variance(sigma)) * scale)
    m, rad = (math.sqrt(mean_variance(own)) * scale for own in (sigma[~angular], sigma[angular]))
    if sigma.ndim == 1:
        return ReadingsNoise(m, rad)
    axes_rad = np.sqrt(np.linalg.eigvalsh(sigma[angular]).mean(axis=0)) * scale
    return ReadingsNoise(m, rad, None if np.ptp(axes_rad) <= _ALIKE_AXES * axes_rad[-1] else axes_rad)


def mean_variance(sigma: Array) -> float:
    """Compute the mean variance of a coordinate [m^2] from standard uncertainties (n,) or covariances (n, 3, 3)."""
    if sigma.ndim == 1:
        return float(np.mean(sigma**2))
    return float(np.mean(np.trace(sigma, axis1=1, axis2=2))) / 3.0
