"""Identification of one arm's geometry from SMR positions: weighted, iterated least squares with analytic derivatives.

    minimise  sum_i w_i |W_i (P_i - f(q_i; g))|^2 + sum_j ((g_j - g_j,nominal) / prior_j)^2

by Gauss-Newton steps on scaled normal equations, damped only after a step that made things worse (Levenberg-Marquardt).
Rows are taken in chunks, so that memory does not grow with the number of configurations. Linear effects of the joint
positions and of the SMR (see ``EffectColumns``) are identified jointly with the geometry.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.optimize import brentq

from cellapp.calibration.parameters import (
    ParameterSet,
    candidate_columns,
    full_set,
    gram_matrix,
    identifiable_set,
    paper_set,
)
from cellapp.kinematics.chain import (
    Geometry,
    Turns,
    jacobian,
    joint_jacobian,
    parameter_names,
    smr_positions,
)
from cellapp.kinematics.transforms import Array, register

SetName = Literal["auto", "paper", "full"]
RobustName = Literal["none", "huber", "tukey"]

_CHUNK = 2048
_HUBER = 2.5003  # sqrt of the 90 % quantile of chi-square with 3 degrees of freedom: the norm of a good point
_TUKEY = 6.0  # no weight beyond about four times the median norm of a good point
_EXCESS_ROUNDS = 6
_MEDIAN_NORM = 1.5382  # median of the norm of three independent standard normal numbers


class TooFewReadings(ValueError):
    """Fewer measured coordinates than parameters."""


@dataclass(frozen=True)
class EffectColumns:
    """Effects that are linear in their parameters: columns that turn a joint, then columns that shift the SMR.

    Attributes
    ----------
    names, units : tuple of str, length m
    joints : array, shape (k,), k <= m
        Which joint each of the first k columns turns, from 0.
    offsets : array, shape (k, n)
        By how much per unit [rad].
    shifts_M : array, shape (m - k, 3, n)
        Shift of the SMR per unit of the other columns [m] in the tracker frame.
    prior_sd : array, shape (m,), optional
        Standard deviation of a prior about zero in each parameter's unit, infinite where there is none. It is believed
        as it stands: the readings' own scatter is then taken as stated.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    joints: NDArray[np.intp]
    offsets: Array
    shifts_M: Array
    prior_sd: Array | None = None

    def take(self, rows: NDArray[np.intp]) -> EffectColumns:
        """Those of some configurations."""
        return replace(self, offsets=self.offsets[:, rows], shifts_M=self.shifts_M[:, :, rows])


@dataclass(frozen=True)
class Identification:
    """What was identified, and how well.

    Attributes
    ----------
    geometry : Geometry
        With the identified values; parameters outside the set keep their nominal values.
    parameter_set : ParameterSet
        Which parameters, and which were merged.
    names, units : tuple of str, length k
        Of the identified parameters, geometry first, then effects.
    values, standard_errors : array, shape (k,)
        Standard errors are scaled by the scatter of the residuals (``scale``).
    covariance : array, shape (k, k)
        Likewise; in the order of ``names``.
    effect_values : array, shape (m,)
        The last m of ``values``.
    iterations : int
        Steps taken.
    converged : bool
    message : str
        Why it ended, in words.
    scale : float
        Root of chi-square per degree of freedom: 1 when the scatter is what the stated sigma says; without a stated
        sigma it is the scatter itself [m].
    degrees_of_freedom : int
    residuals : array, shape (n, 3)
        Measured minus computed position in the tracker frame [m].
    weights : array, shape (n,)
        Robust weights, 1 without.
    steps : tuple of float
        Largest scaled step of each iteration.
    gram : array, shape (k, k)
        Scaled normal matrix without priors, per configuration (angles at arm's length, see ``observability``).
    """

    geometry: Geometry
    parameter_set: ParameterSet
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    standard_errors: Array
    covariance: Array
    effect_values: Array
    iterations: int
    converged: bool
    message: str
    scale: float
    degrees_of_freedom: int
    residuals: Array = field(repr=False)
    weights: Array = field(repr=False)
    steps: tuple[float, ...]
    gram: Array = field(repr=False)
    configurations: int

    @cached_property
    def singular_values(self) -> Array:
        """Singular values of the scaled Jacobian per root configuration, falling, shape (k,)."""
        result: Array = np.sqrt(np.clip(np.linalg.eigvalsh(self.gram)[::-1], 0.0, None))
        return result

    @property
    def condition(self) -> float:
        """Condition number of the scaled Jacobian."""
        s = self.singular_values
        return float(s[0] / s[-1]) if s[-1] > 0.0 else math.inf

    @property
    def observability(self) -> dict[str, float]:
        """Observability indices O1 ... O5 of the scaled Jacobian.

        O1 root of the product of singular values (D), O2 inverse condition number, O3 the least singular value (E),
        O4 noise amplification s_min^2 / s_max, O5 inverse sum of inverse singular values (A).
        Source: Sun, Hollerbach, ICRA 2008, 831-836; here on the Jacobian scaled to metres and divided by root n.
        """
        s = self.singular_values
        if s[-1] <= 0.0:
            return {f"O{i}": 0.0 for i in range(1, 6)}
        return {
            "O1": float(np.exp(np.mean(np.log(s)))),
            "O2": float(s[-1] / s[0]),
            "O3": float(s[-1]),
            "O4": float(s[-1] ** 2 / s[0]),
            "O5": float(1.0 / np.sum(1.0 / s)),
        }


@dataclass(frozen=True)
class _Rows:
    """The readings, laid out for the walk: whitened by ``white`` (3, 3, n), or (n,) for one sigma a point, or not."""

    turns: Turns
    q: Array
    measured: Array
    white: Array | None
    effects: EffectColumns | None

    @property
    def count(self) -> int:
        return self.turns.count

    def chunks(self) -> Iterator[tuple[int, int]]:
        for first in range(0, self.count, _CHUNK):
            yield first, min(first + _CHUNK, self.count)

    def turns_at(self, beta: Array, first: int, last: int) -> Turns:
        if self.effects is None or not len(self.effects.joints):
            return self.turns.part(first, last)
        turned = self.q[first:last].copy()
        k = len(self.effects.joints)
        for joint in np.unique(self.effects.joints):
            chosen = np.flatnonzero(self.effects.joints == joint)
            turned[:, joint] += beta[:k][chosen] @ self.effects.offsets[chosen, first:last]
        return Turns.of(turned)

    def shift_at(self, beta: Array, first: int, last: int) -> Array | None:
        """What the effects that turn no joint add to the SMR positions, (3, last - first) [m]."""
        if self.effects is None or not len(self.effects.shifts_M):
            return None
        shifts = self.effects.shifts_M[:, :, first:last]
        return np.asarray(np.tensordot(beta[len(self.effects.joints) :], shifts, axes=1))

    def whiten(self, vectors: Array, first: int, last: int) -> Array:
        """Vectors (3, ..., n) in units of their standard uncertainty."""
        if self.white is None:
            return vectors
        white = self.white[..., first:last]
        if white.ndim == 1:
            return vectors * white
        out = np.empty_like(vectors)
        for row in range(3):  # white is lower triangular
            np.multiply(white[row, 0], vectors[0], out=out[row])
            for column in range(1, row + 1):
                out[row] += white[row, column] * vectors[column]
        return out


def start_from_nominal(nominal: Geometry, q: Array, p_M: Array, *, tool_unknown: bool) -> Geometry:
    """A geometry to start from: the nominal chain standing where the measured points want it.

    Parameters
    ----------
    nominal : Geometry
        Its base does not matter.
    q : array, shape (n, N) [rad]
    p_M : array, shape (n, 3) [m]
    tool_unknown : bool
        Whether the tool is to be found too; then base and tool are improved in turns until both rest.
    """
    at_origin = nominal.with_T_M_B(np.eye(4))
    if not tool_unknown:
        return nominal.with_T_M_B(register(p_M, smr_positions(at_origin, q)))
    tool = np.zeros(3)
    names = parameter_names(nominal.joints)
    columns = (*range(3, 6), *range(3), *range(len(names) - 3, len(names)))
    geometry = at_origin.with_vector(np.concatenate([at_origin.vector()[:-3], tool]))
    geometry = geometry.with_T_M_B(register(p_M, smr_positions(geometry, q)))
    chosen = ParameterSet("base and tool", nominal.joints, columns)
    return identify(geometry, q, p_M, parameter_set=chosen, max_iterations=200).geometry


def identify(
    start: Geometry,
    q: Array,
    p_M: Array,
    *,
    sigma: Array | None = None,
    parameter_set: SetName | ParameterSet = "auto",
    prior_sigma: Mapping[str, float] | None = None,
    prior_mean: Geometry | None = None,
    robust: RobustName = "none",
    effects: EffectColumns | None = None,
    tolerance: float = 1e-8,
    max_iterations: int = 50,
) -> Identification:
    """Identify the geometry of one arm.

    Parameters
    ----------
    start : Geometry
        Where to start: nominal chain, base near the truth (``start_from_nominal``).
    q : array, shape (n, N)
        Joint positions [rad].
    p_M : array, shape (n, 3)
        Measured SMR positions in the tracker frame [m].
    sigma : array, shape (n,) or (n, 3, 3), optional
        Standard uncertainty of each point [m], or its covariance [m^2]. Without, all points count alike.
    parameter_set : str or ParameterSet
        ``auto`` (identifiable set found once, at the start), ``paper``, ``full``, or a set found before.
    prior_sigma : mapping, optional
        Parameter name -> standard deviation about ``prior_mean``; parameters without an entry are free.
    prior_mean : Geometry, optional
        Where the priors have their mean; the start if not given.
    robust : str
        ``huber`` or ``tukey`` weights on whole points, on a scale taken from the residuals themselves.
    effects : EffectColumns, optional
        Identified jointly.
    tolerance : float
        Largest scaled step (metres at arm's length) at which the iteration ends.
    max_iterations : int

    Raises
    ------
    TooFewReadings
        If there are fewer coordinates than parameters and no priors that replace them.
    """
    n = len(q)
    rows = _Rows(
        turns=Turns.of(q),
        q=q,
        measured=np.ascontiguousarray(p_M.T),
        white=None if sigma is None else whitener(sigma),
        effects=effects,
    )
    chosen, ready = _choose(parameter_set, start, rows)
    names, units = chosen.names, chosen.units
    extra = 0 if effects is None else len(effects.names)
    k = len(names) + extra
    precision, mean = _priors(names, effects, chosen.columns, prior_sigma or {}, prior_mean or start)
    believing = bool(precision.any())
    curves = effects is not None and effects.prior_sd is not None  # their priors come with a noise, which is sigma
    if 3 * n + np.count_nonzero(precision) < k or (3 * n <= k and not believing):
        raise TooFewReadings(
            f"{n} readings give {3 * n} coordinates for {k} parameters; measure at least {k // 3 + 1} configurations"
        )

    free = np.concatenate([start.vector()[list(chosen.columns)], np.zeros(extra)])
    weights: Array | None = None
    best = _evaluate(start, rows, chosen, free, weights, ready)
    steps: list[float] = []
    damping, message, converged = 0.0, f"not converged after {max_iterations} iterations", False
    for _ in range(max_iterations):
        if robust != "none":
            weights = _robust_weights(rows, best, robust)
            best = _evaluate(start, rows, chosen, free, weights)
        # Beliefs weigh against what the readings scatter now, not against what the tracker alone would: far from the
        # solution they hold, near it they only keep what the data cannot tell.
        variance = _variance(best.cost, _used(weights, n), k, precision) if believing and not curves else 1.0
        step = _step(best, variance, precision, mean - free, damping)
        size = float(np.max(np.abs(step) * best.lever))
        if size <= tolerance:  # the step is not taken, so that all that is reported belongs to one place
            message, converged = f"converged: the next step is below {tolerance:g}", True
            steps.append(size)
            break
        trial = _evaluate(start, rows, chosen, free + step, weights)
        before = best.cost / variance + precision @ (free - mean) ** 2
        after = trial.cost / variance + precision @ (free + step - mean) ** 2
        steps.append(size)
        if after > before * (1.0 + 1e-9) and size > 1e-7:
            damping = max(1e-4, 10.0 * damping)
            if damping > 1e8:
                message = "no step improves the fit any more"
                break
            continue
        damping = 0.0 if damping < 1e-6 else damping / 10.0
        free, best = free + step, trial

    geometry, beta = _place(start, chosen, free)
    covariance, scale, freedom = _covariance(best, _used(weights, n), precision, k, rescaled=not curves)
    return Identification(
        geometry=geometry,
        parameter_set=chosen,
        names=names + (() if effects is None else effects.names),
        units=units + (() if effects is None else effects.units),
        values=free,
        standard_errors=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        effect_values=beta,
        iterations=len(steps),
        converged=converged,
        message=message,
        scale=scale,
        degrees_of_freedom=freedom,
        residuals=best.residuals.T,
        weights=np.ones(n) if weights is None else weights,
        steps=tuple(steps),
        gram=best.plain / (best.lever * best.lever[:, None]) / n,
        configurations=n,
    )


def excess_variance(residuals: Array, sigma: Array, degrees_of_freedom: int) -> float:
    """Variance [m^2] that, added to every coordinate, makes the scatter what the stated uncertainty says.

    The root of ``sum_i r_i^T (S_i + tau^2 I)^-1 r_i = degrees of freedom`` (the idea of DerSimonian, Laird, Control.
    Clin. Trials 7 (1986) 177); zero where the scatter is not larger than chance allows.

    Parameters
    ----------
    residuals : array, shape (n, 3) [m]
    sigma : array, shape (n,) [m] or (n, 3, 3) [m^2]
    degrees_of_freedom : int
    """
    if sigma.ndim == 1:
        variance, squares = sigma[:, None] ** 2, residuals**2
    else:
        variance, axes = np.linalg.eigh(sigma)
        squares = np.einsum("nab,na->nb", axes, residuals) ** 2

    def too_much(tau_squared: float) -> float:
        return float(np.sum(squares / (variance + tau_squared))) - degrees_of_freedom

    if too_much(0.0) <= 3.0 * math.sqrt(2.0 * degrees_of_freedom):
        return 0.0
    return float(brentq(too_much, 0.0, float(squares.sum()) / degrees_of_freedom, xtol=1e-18, rtol=1e-6))


def with_excess(sigma: Array, tau_squared: float) -> Array:
    """The stated uncertainty and an excess variance [m^2] together, in the shape of ``sigma``."""
    if sigma.ndim == 1:
        return np.sqrt(sigma**2 + tau_squared)
    return np.asarray(sigma + tau_squared * np.eye(3))


def identify_with_excess(
    start: Geometry, q: Array, p_M: Array, *, sigma: Array | None, **settings: Any
) -> tuple[Identification, float]:
    """``identify``, and where the readings scatter more than they state, again with that scatter in the weights.

    A model that lacks physics leaves errors far above the tracker's; weighing by the tracker's alone would then let few
    readings decide. Returns the identification (iterations and steps of all rounds) and the excess standard
    deviation [m] of a coordinate.
    """
    settings = {"prior_mean": start, **settings}
    found = identify(start, q, p_M, sigma=sigma, **settings)
    if sigma is None:
        return found, 0.0
    tau_squared = 0.0
    settings["parameter_set"] = found.parameter_set
    for _ in range(_EXCESS_ROUNDS):
        before = tau_squared
        tau_squared = excess_variance(found.residuals, sigma, found.degrees_of_freedom)
        if abs(tau_squared - before) <= 0.01 * tau_squared:
            break
        earlier = found
        found = identify(earlier.geometry, q, p_M, sigma=with_excess(sigma, tau_squared), **settings)
        found = replace(found, iterations=earlier.iterations + found.iterations, steps=(*earlier.steps, *found.steps))
    return found, math.sqrt(tau_squared)


@dataclass(frozen=True)
class _Linear:
    """Positions (3, n), their Jacobian (3, k, n) and its Gram matrix (k, k) at one place, in metres."""

    P: Array
    J: Array
    gram: Array


@dataclass(frozen=True)
class _Normal:
    """Normal equations at one place.

    ``A = sum J^T J`` and ``b = sum J^T r`` of whitened and weighted rows, ``plain`` the first without either, ``cost``
    the sum of squares, ``lever`` the rms displacement per unit of each parameter (one value for all rotations).
    """

    A: Array
    b: Array
    plain: Array
    cost: float
    lever: Array
    residuals: Array


def _choose(wanted: SetName | ParameterSet, start: Geometry, rows: _Rows) -> tuple[ParameterSet, _Linear | None]:
    """The parameter set and, where it was evaluated on the way, positions and Jacobian at the start."""
    if isinstance(wanted, ParameterSet):
        return wanted, None
    if wanted == "paper":
        return paper_set(start), None
    if wanted == "full":
        return full_set(start), None
    candidates = candidate_columns(start)
    # structure shows in any two thousand poses; more would only cost memory
    stride = max(1, rows.count // _CHUNK)
    some = rows.turns if stride == 1 else Turns(rows.turns.cosines[:, ::stride], rows.turns.sines[:, ::stride])
    P, J = jacobian(start, some, candidates)
    gram = gram_matrix(J)
    chosen = identifiable_set(start, gram)
    if rows.count > _CHUNK or rows.effects is not None:
        return chosen, None
    wanted_columns = set(chosen.columns)
    places = [place for place, c in enumerate(candidates) if c in wanted_columns]
    return chosen, _Linear(P, J[:, places], gram[places][:, places])


def _priors(
    names: Sequence[str],
    effects: EffectColumns | None,
    columns: tuple[int, ...],
    sigma: Mapping[str, float],
    mean: Geometry,
) -> tuple[Array, Array]:
    """Precision of each prior (0 where there is none) and the means, shape (k,)."""
    precision = np.array([1.0 / sigma[name] ** 2 if name in sigma else 0.0 for name in names])
    extra = np.zeros(0 if effects is None else len(effects.names))
    if effects is not None and effects.prior_sd is not None:
        extra = 1.0 / effects.prior_sd**2
    return np.concatenate([precision, extra]), np.concatenate([mean.vector()[list(columns)], np.zeros(len(extra))])


def _place(start: Geometry, chosen: ParameterSet, free: Array) -> tuple[Geometry, Array]:
    vector = start.vector()
    size = len(chosen.columns)
    vector[list(chosen.columns)] = free[:size]
    return start.with_vector(vector), free[size:]


def _evaluate(
    start: Geometry,
    rows: _Rows,
    chosen: ParameterSet,
    free: Array,
    weights: Array | None,
    ready: _Linear | None = None,
) -> _Normal:
    """Normal equations at ``free``; ``ready`` are positions and Jacobian there where they are known already."""
    geometry, beta = _place(start, chosen, free)
    k, size = len(free), len(chosen.columns)
    A, b, plain, cost = np.zeros((k, k)), np.zeros(k), np.zeros((k, k)), 0.0
    residuals = np.empty((3, rows.count))
    plainly = rows.white is None and weights is None
    for first, last in rows.chunks():
        turns = rows.turns_at(beta, first, last)
        here = ready or _linearise(geometry, turns, chosen, rows, first, last)
        J = here.J
        r = np.subtract(rows.measured[:, first:last], here.P, out=residuals[:, first:last])
        shift = rows.shift_at(beta, first, last)
        if shift is not None:
            r -= shift
        plain += here.gram
        if not plainly:
            J, r = rows.whiten(J, first, last), rows.whiten(r, first, last)
            if weights is not None:
                root = np.sqrt(weights[first:last])
                J, r = J * root, r * root
            A += gram_matrix(J)
        b += (J @ r[:, :, None]).sum(axis=0)[:, 0]
        cost += float(np.vdot(r, r))
    moved = np.diag(plain) / rows.count
    rotations = chosen.rotations
    lever = np.ones(k)
    if rotations:
        lever[:rotations] = math.sqrt(max(float(moved[:rotations].mean()), 1e-30))
    lever[size:] = np.sqrt(np.maximum(moved[size:], 1e-30))
    return _Normal(plain if plainly else A, b, plain, cost, lever, residuals)


def _linearise(geometry: Geometry, turns: Turns, chosen: ParameterSet, rows: _Rows, first: int, last: int) -> _Linear:
    P, J = jacobian(geometry, turns, chosen.columns)
    effects = rows.effects
    if effects is not None:
        _, by_joint = joint_jacobian(geometry, turns)
        turned = effects.offsets[None, :, first:last] * by_joint[:, effects.joints]
        J = np.concatenate([J, turned, effects.shifts_M[:, :, first:last].swapaxes(0, 1)], axis=1)
    return _Linear(P, J, gram_matrix(J))


def _variance(cost: float, used: int, k: int, precision: Array) -> float:
    """Scatter of the weighted residuals of ``used`` points, squared, against the stated sigma (or in m^2 without)."""
    return max(cost / _freedom(used, k, precision), 1e-300)


def _freedom(used: int, k: int, precision: Array) -> int:
    return max(1, 3 * used - k + int(np.count_nonzero(precision)))


def _used(weights: Array | None, n: int) -> int:
    """How many points have a say."""
    return n if weights is None else int(np.count_nonzero(weights > 1e-3))


def _step(normal: _Normal, variance: float, precision: Array, to_mean: Array, damping: float) -> Array:
    """The Gauss-Newton step; the shortest one (scaled) where the normal matrix is singular."""
    A = normal.A / variance + np.diag(precision)
    b = normal.b / variance + precision * to_mean
    scale = 1.0 / normal.lever
    A *= scale * scale[:, None]
    if damping > 0.0:
        A += damping * np.diag(np.diag(A))
    factor, solution, failed = lapack.dposv(A, scale * b, lower=1)
    diagonal = np.diag(factor)
    if failed == 0 and diagonal.min() > 1e-6 * diagonal.max():
        return np.asarray(scale * solution)
    # singular: the redundant model, or data that cannot tell
    return np.asarray(scale * (_pseudo_inverse(A) @ (scale * b)))


def _pseudo_inverse(A: Array) -> Array:
    """Of a symmetric, positive semi-definite matrix (k, k)."""
    values, vectors = np.linalg.eigh(A)
    inverse = np.where(values > 1e-12 * values[-1], 1.0 / np.maximum(values, 1e-300), 0.0)
    return np.asarray((vectors * inverse) @ vectors.T)


def _robust_weights(rows: _Rows, normal: _Normal, robust: RobustName) -> Array:
    norm = np.linalg.norm(rows.whiten(normal.residuals, 0, rows.count), axis=0)
    u = norm / max(float(np.median(norm)) / _MEDIAN_NORM, 1e-300)
    if robust == "huber":
        return np.asarray(np.minimum(1.0, _HUBER / np.maximum(u, 1e-12)))
    return np.asarray(np.where(u < _TUKEY, (1.0 - (np.minimum(u, _TUKEY) / _TUKEY) ** 2) ** 2, 0.0))


def _covariance(normal: _Normal, used: int, precision: Array, k: int, *, rescaled: bool) -> tuple[Array, float, int]:
    """Covariance (k, k), the scatter against the stated sigma, and the degrees of freedom.

    Priors are beliefs and are not scaled by the scatter; the readings' part is, where it is to be ``rescaled``.
    """
    freedom = _freedom(used, k, precision)
    variance = _variance(normal.cost, used, k, precision)
    inner = 1.0 / normal.lever
    A = (normal.A / (variance if rescaled else 1.0) + np.diag(precision)) * inner * inner[:, None]
    factor, failed = lapack.dpotrf(A, lower=1)
    if failed == 0 and np.diag(factor).min() > 1e-6 * np.diag(factor).max():
        lower = np.tril(lapack.dpotri(factor, lower=1)[0])
        inverse = lower + np.tril(lower, -1).T
    else:
        inverse = _pseudo_inverse(A)
    return inverse * inner * inner[:, None], math.sqrt(variance), freedom


def whitener(sigma: Array) -> Array:
    """What turns errors of points into units of their standard uncertainty.

    Of sigmas (n,) [m]: (n,) [1/m]; of covariances (n, 3, 3) [m^2]: lower triangular (3, 3, n) [1/m].
    """
    if sigma.ndim == 1:
        return np.asarray(1.0 / sigma)
    return np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(sigma)).transpose(1, 2, 0))
