"""Identification of one arm's geometry from SMR positions by weighted nonlinear least squares.

    minimise  sum_i w_i |W_i (P_i - f(q_i; g))|^2 / v + sum_j ((g_j - m_j) / s_j)^2

over the geometry g, with whitening W_i, robust weights w_i, Gaussian priors (mean m_j, standard deviation s_j), and the
estimated variance v of the whitened residuals: ``v = sum_i w_i |W_i r_i|^2 / (3 n - gamma)``, where gamma is
the number of parameters that the data determine (MacKay, Neural Comput. 4 (1992) 415). All parameters that can have an
effect are estimated; those that the data do not determine stay near nominal. The table states the *determined* ones.
Their values give the same predictions with all other parameters at nominal.
Effects that are linear in their parameters (``EffectColumns``) are identified jointly with the geometry.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import (
    Minimum,
    RobustName,
    damped_step,
    excess_of_kinds,
    inverse_diagonal,
    inverse_psd,
    minimise,
    robust_weights,
    whitener,
    with_excess,
)
from cellapp.estimation.calibration.normal_equations import (
    EffectColumns,
    NormalEquations,
    Observations,
    normal_equations,
    parameter_scale,
    split_values,
)
from cellapp.estimation.calibration.parameters import (
    ParameterSet,
    PriorSpread,
    SetName,
    determined_set,
    estimated_parameters,
    prior_sds,
    prior_spreads,
    sds_of,
    sigma_by_name,
    unknown_offset,
)
from cellapp.estimation.calibration.quantities import Quantities, with_probe
from cellapp.ground.errors import InputError, NotConverged
from cellapp.ground.profile.schema import CalibrationSettings
from cellapp.robot.kinematics.chain import AT_BOUND, TOOL_NAMES, Geometry, JointAngles, parameter_names, smr_positions
from cellapp.robot.kinematics.transforms import Array, register, rotation_x
from cellapp.robot.model.nominal import FIXED_SD

_LEAST_WEIGHT = 1e-3
"""Robust weight below which a point does not count in the degrees of freedom."""
_SMALLEST = 1e-200
"""Lower bound that keeps a variance above zero."""
_TRACKER_M = 1e-5
"""Standard deviation of a coordinate from the tracker alone. If no uncertainty is stated, one coordinate with this
scatter is added to the estimate of v: with few readings, or without noise, the priors would lose all weight."""


class TooFewReadings(ValueError):
    """Fewer measured coordinates than parameters."""


@dataclass(frozen=True)
class Identification:
    """Identified parameters of one arm, their uncertainty and the residuals.

    Attributes
    ----------
    geometry : Geometry
        With all estimated values; parameters outside ``estimated`` keep those of the start.
    estimated : ParameterSet
        The parameters that were estimated.
    estimated_covariance : array, shape (K + m, K + m)
        Of the estimated parameters, then of the effects; gives the uncertainty of predictions.
    prior_sigma : mapping
        Parameter -> standard deviation of its prior, stated or estimated; only parameters that have a prior.
    parameter_set : ParameterSet
        For the table. If the set is ``auto``: the estimated parameters that the data determine, with the others merged
        into them. Otherwise all estimated parameters.
    names, units : tuple of str, length k
        Of the parameters in the table, geometry first, then effects.
    values : array, shape (k,)
        Values with the merged parameters at nominal and the same predictions.
    covariance : array, shape (k, k)
        Of the values, scaled by the scatter of the residuals (``scale``) unless effects have priors.
    mean, precision : array, shape (K + m,)
        Of the priors; a parameter that is held at a bound has its value there and ``FIXED_SD``.
    converged : bool
    message : str
        Why the iteration ended.
    scale : float
        Root of chi-square per degree of freedom: 1 if the scatter agrees with the stated uncertainty. Without a
        stated uncertainty, the standard deviation of a coordinate [m].
    degrees_of_freedom : int
    residuals : array, shape (n, 3)
        Measured minus computed position in the tracker frame [m].
    weights : array, shape (n,)
        Robust weights; 1 without robust estimation.
    steps : tuple of float
        Largest component of each step [m at arm's length].
    gram : array, shape (K, K)
        ``J^T J / n`` of the unweighted Jacobian by the geometric parameters in the table, scaled to metres at arm's
        length, without priors.
    configurations : int
        Number of readings n.
    angular : array, shape (n,), or None
        Mask of measured orientations, whose residuals are rotation vectors [rad]; None if there are none.
    freedom_of_rotations : float
        Degrees of freedom of the orientations, a part of all.
    excess_rad : float
        Standard deviation of a component of an orientation beyond the stated uncertainty [rad].
    """

    geometry: Geometry
    estimated: ParameterSet
    estimated_covariance: Array = field(repr=False)
    prior_sigma: Mapping[str, float] = field(repr=False)
    parameter_set: ParameterSet
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    covariance: Array
    mean: Array = field(repr=False)
    precision: Array = field(repr=False)
    converged: bool
    message: str
    scale: float
    degrees_of_freedom: int
    residuals: Array = field(repr=False)
    weights: Array = field(repr=False)
    steps: tuple[float, ...]
    gram: Array = field(repr=False)
    configurations: int
    angular: NDArray[np.bool_] | None = field(default=None, repr=False)
    freedom_of_rotations: float = 0.0
    excess_rad: float = 0.0

    def settled(self, fit: str) -> Identification:
        """Return this; raise ``NotConverged`` with the name of the ``fit`` if it did not converge."""
        if not self.converged:
            raise NotConverged.of(fit, self.message, "allow more steps (calibration.max_iterations), or report it")
        return self

    @cached_property
    def standard_errors(self) -> Array:
        """Standard errors (k,) of the values."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def iterations(self) -> int:
        """Number of steps computed."""
        return len(self.steps)

    @property
    def effect_values(self) -> Array:
        """The last m of ``values`` (m,)."""
        return self.values[len(self.parameter_set.columns) :]

    @property
    def positions(self) -> slice | NDArray[np.bool_]:
        """Mask of the rows that are positions; a full slice if no orientation was measured."""
        return slice(None) if self.angular is None else ~self.angular

    @property
    def condition(self) -> float:
        """Condition number of the scaled Jacobian."""
        squares = np.linalg.eigvalsh(self.gram)
        return float(np.sqrt(squares[-1] / squares[0])) if squares[0] > 0.0 else math.inf


def start_from_nominal(nominal: Geometry, q: Array, p_M: Array, *, tool_unknown: bool) -> Geometry:
    """Compute the initial geometry: the nominal chain with its base registered to the measured points.

    It is a start, and need not have converged: what is fitted from it must.

    Parameters
    ----------
    nominal : Geometry
        Its base is not used.
    q : array, shape (n, N)
        Joint positions [rad].
    p_M : array, shape (n, 3)
        Measured SMR positions in the tracker frame [m].
    tool_unknown : bool
        Whether to estimate the tool jointly with the base, starting from zero.
    """
    at_origin = nominal.with_T_M_B(np.eye(4))
    if not tool_unknown:
        return nominal.with_T_M_B(register(p_M, smr_positions(at_origin, q)))
    geometry = replace(at_origin, tool=np.zeros(3))
    geometry = geometry.with_T_M_B(register(p_M, smr_positions(geometry, q)))
    count = len(parameter_names(nominal.joints))
    columns = (*range(3, 6), *range(3), *range(count - 3, count))  # rotations and translations of the base, tool
    parameters = ParameterSet("base and tool", nominal.joints, columns)
    return identify(geometry, q, p_M, parameter_set=parameters, max_iterations=200).geometry


def identify(
    start: Geometry,
    q: Array,
    p_M: Array,
    *,
    R_M_S: Array | None = None,
    sigma: Array | None = None,
    parameter_set: SetName | ParameterSet = "auto",
    prior_sigma: Mapping[str, float] | None = None,
    prior_mean: Geometry | None = None,
    robust: RobustName = "none",
    effects: EffectColumns | None = None,
    tolerance: float = 1e-8,
    max_iterations: int = 200,
) -> Identification:
    """Identify the geometry of one arm; ``Identification.settled`` refuses a fit that did not converge.

    Parameters
    ----------
    start : Geometry
        Initial geometry: nominal chain, base near the truth (``start_from_nominal``).
    q : array, shape (n, N)
        Joint positions [rad].
    p_M : array, shape (n, 3)
        Measured SMR positions in the tracker frame [m]; zero where an orientation was measured.
    R_M_S : array, shape (n, 3, 3), optional
        Measured orientations of the probe of ``start``, NaN at positions. Without ``sigma`` a radian weighs as much as
        a metre.
    sigma : array, shape (n,) or (n, 3, 3), optional
        Standard uncertainty of each point [m], or its covariance [m^2]. Equal weights if not given.
    parameter_set : str or ParameterSet
        ``auto`` (all, with weak priors on those of the arm), ``paper``, ``full``, or a given set.
    prior_sigma : mapping, optional
        Parameter name -> standard deviation about ``prior_mean``. Parameters without an entry are free, unless the set
        is ``auto``.
    prior_mean : Geometry, optional
        Mean of the priors; the start if not given.
    robust : str
        ``none``, or ``huber`` or ``tukey`` weights of whole points, scaled by the residuals' median norm.
    effects : EffectColumns, optional
        Linear effects that are identified jointly with the geometry.
    tolerance : float
        Step size at which the iteration ends [m at arm's length].
    max_iterations : int

    Raises
    ------
    TooFewReadings
        If there are fewer coordinates than parameters and not enough priors.
    """
    observations = Observations(
        angles=JointAngles.of(q, R_M_S),
        q=q,
        p_M=np.ascontiguousarray(p_M.T),
        white=None if sigma is None else whitener(sigma),
        effects=effects,
    )
    parameters, priors = (
        (parameter_set, prior_sigma or {})
        if isinstance(parameter_set, ParameterSet)
        else estimated_parameters(parameter_set, start, prior_sigma or {})
    )
    precision, mean = _priors(parameters, effects, priors, prior_mean or start)
    _check_count(len(q), precision)
    free = set(priors) - set(prior_sigma or {})
    problem = _Problem(
        start,
        observations,
        parameters,
        precision,
        mean,
        robust,
        spreads=prior_spreads(parameters, free),
        tabulated=parameter_set == "auto",
        limits=parameters.limits(prior_mean or start, len(precision)),
    )
    return problem.result(minimise(problem, problem.at_start(), tolerance=tolerance, max_iterations=max_iterations))


def _priors(
    parameters: ParameterSet, effects: EffectColumns | None, sigma: Mapping[str, float], mean: Geometry
) -> tuple[Array, Array]:
    """Return the precisions of the priors, 0 without one, and their means, both (k,), in the parameters' units."""
    precision = 1.0 / prior_sds(parameters, sigma) ** 2
    of_effects = np.zeros(0 if effects is None else len(effects.names))
    means = np.concatenate([mean.vector()[list(parameters.columns)], of_effects])
    if effects is not None and effects.prior_sd is not None:
        of_effects = 1.0 / effects.prior_sd**2
    return np.concatenate([precision, of_effects]), means


def _check_count(n: int, precision: Array) -> None:
    k, priors = len(precision), np.count_nonzero(precision)
    if 3 * n + priors < k or (3 * n <= k and not priors):
        raise TooFewReadings(
            f"{n} readings give {3 * n} coordinates for {k} parameters; measure at least {k // 3 + 1} configurations"
        )


@dataclass(frozen=True)
class _Problem:
    """The least-squares problem of ``identify``, for ``least_squares``."""

    start: Geometry
    observations: Observations
    parameters: ParameterSet
    precision: Array
    """Precision of each prior (k,) at the start; zero without one."""
    mean: Array
    robust: RobustName
    spreads: tuple[PriorSpread, ...]
    """Priors whose standard deviations are estimated."""
    tabulated: bool
    """Whether the table states only what the data determine."""
    limits: Array | None
    """Least and largest values (2, k)."""

    @property
    def sigma_is_exact(self) -> bool:
        """Whether the stated uncertainty is taken as exact: priors of effects are given with that noise level."""
        effects = self.observations.effects
        return effects is not None and effects.prior_sd is not None

    def at_start(self) -> FitPoint:
        values = self.start.vector()[list(self.parameters.columns)]
        effects = self.observations.effects
        of_effects = np.zeros(0) if effects is None else effects.start
        return self._estimate(np.concatenate([values, of_effects]), None, self.precision)

    def _estimate(self, values: Array, weights: Array | None, precision: Array) -> FitPoint:
        if self.limits is not None:
            values = np.clip(values, *self.limits)
        normal = normal_equations(self.start, self.observations, self.parameters, values, weights)
        return FitPoint(values, normal, weights, precision)

    def reweighted(self, point: FitPoint) -> FitPoint:
        if self.robust != "none":
            whitened = self.observations.whiten(point.normal.residuals, 0, self.observations.count)
            weights = robust_weights(np.linalg.norm(whitened, axis=0), self.robust)
            point = replace(self._estimate(point.values, weights, point.precision), variance=point.variance)
        # Weigh the priors against the present scatter of the readings. Far from the solution, where the scatter is
        # large, the priors dominate; near it they only determine what the readings do not.
        if not point.precision.any() or (self.sigma_is_exact and not self.spreads):
            return point
        by_priors, precision = point.by_priors, point.precision.copy()
        for spread in self.spreads:
            places = spread.places
            deviations = point.values[places] - self.mean[places]
            if deviations.any():  # all are zero at the start
                precision[places] = 1.0 / spread.square(deviations, float(by_priors[places].sum()))
        if self.sigma_is_exact:
            return replace(point, precision=precision)
        expected = _TRACKER_M**2 if self.observations.white is None else 1.0
        freedom = self._degrees_of_freedom(point, by_priors)
        return replace(point, precision=precision, variance=(point.normal.cost + expected) / (freedom + 1.0))

    def _right(self, point: FitPoint) -> Array:
        return np.asarray(point.normal.b / point.variance + point.precision * (self.mean - point.values))

    def promise(self, point: FitPoint, step: Array) -> float:
        return float(step @ self._right(point))

    def step(self, point: FitPoint, damping: float) -> tuple[Array, Array]:
        unit = point.normal.unit
        limits = None if self.limits is None else (self.limits - point.values) / unit
        step = damped_step(point.posterior_precision(point.variance), unit * self._right(point), damping, limits)
        return unit * step, step

    def moved(self, point: FitPoint, step: Array) -> FitPoint:
        moved = self._estimate(point.values + step, point.weights, point.precision)
        return replace(moved, variance=point.variance)

    def objective(self, point: FitPoint) -> float:
        return point.normal.cost / point.variance + float(point.precision @ (point.values - self.mean) ** 2)

    def result(self, minimum: Minimum[FitPoint]) -> Identification:
        """Return the identification; parameters at their bounds are held there."""
        point, effects = minimum.point, self.observations.effects
        normal, n = point.normal, self.observations.count
        limits = np.full((2, 1), math.inf) if self.limits is None else self.limits
        held = np.any(np.abs(limits - point.values) < AT_BOUND, axis=0)
        prior_sigma = sigma_by_name(self.parameters.names, point.precision)
        mean = np.where(held, point.values, self.mean)
        precision, own = (np.where(held, FIXED_SD**-2, its) for its in (self.precision, point.precision))
        point = replace(point, precision=own)
        geometry, _ = split_values(self.start, self.parameters, point.values)
        covariance = point.covariance(1.0) if self.sigma_is_exact else None
        by_priors = point.by_priors if covariance is None else point.precision * np.diag(covariance)
        freedom = self._degrees_of_freedom(point, by_priors)
        variance = max(normal.cost / freedom, _SMALLEST)
        if covariance is None:
            covariance = point.covariance(variance)
        chosen, size = self.parameters, len(self.parameters.columns)
        if self.tabulated:
            chosen = determined_set(chosen, normal.A[:size, :size] / point.variance, sds_of(precision[:size]))
        to_table, kept = chosen.from_estimated(self.parameters)
        in_table = covariance if chosen is self.parameters else _in_table(_in_table(covariance, to_table).T, to_table)
        gram = normal.gram[kept[:, None], kept]
        scale = parameter_scale(np.diag(gram), n, chosen)
        angular = self.observations.angles.angular
        return Identification(
            geometry=geometry,
            estimated=self.parameters,
            estimated_covariance=covariance,
            prior_sigma=prior_sigma,
            parameter_set=chosen,
            names=chosen.names + (() if effects is None else effects.names),
            units=chosen.units + (() if effects is None else effects.units),
            values=_in_table(point.values - mean, to_table) + np.concatenate([mean[kept], mean[size:]]),
            covariance=in_table,
            mean=mean,
            precision=precision,
            converged=minimum.converged,
            message=minimum.message,
            scale=math.sqrt(variance),
            degrees_of_freedom=max(1, round(freedom)),
            residuals=normal.residuals.T,
            weights=np.ones(n) if point.weights is None else point.weights,
            steps=minimum.steps,
            gram=gram / (scale * scale[:, None]) / n,
            configurations=n,
            angular=angular,
            freedom_of_rotations=_freedom_of_rotations(point, angular),
        )

    def _degrees_of_freedom(self, point: FitPoint, by_priors: Array) -> float:
        """Compute the number of measured coordinates less the number of parameters that they determine."""
        n = self.observations.count if point.weights is None else int(np.count_nonzero(point.weights > _LEAST_WEIGHT))
        return max(1.0, 3 * n - len(by_priors) + float(by_priors.sum()))


def _in_table(values: Array, to_table: Array) -> Array:
    """Convert ``values`` (K + m, ...) of estimated parameters to those of a table (k + m, ...) by its matrix (k, K)."""
    size = to_table.shape[1]
    return np.concatenate([to_table @ values[:size], values[size:]])


def _freedom_of_rotations(point: FitPoint, angular: NDArray[np.bool_] | None) -> float:
    """Compute the degrees of freedom of the orientations: coordinates less the parameters that they determine."""
    if angular is None or point.normal.of_rotations is None:
        return 0.0
    some = angular if point.weights is None else angular & (point.weights > _LEAST_WEIGHT)
    unit = point.normal.unit
    information = point.normal.of_rotations * (unit * unit[:, None]) / point.variance
    determined = float(np.sum(inverse_psd(point.posterior_precision(point.variance)) * information))
    return max(1.0, 3.0 * np.count_nonzero(some) - determined)


@dataclass(frozen=True)
class FitPoint:
    """Parameter values (k,), the normal equations there, the weights used in them, precisions of priors (k,).

    ``variance`` scales the stated covariance of the readings when they are weighed against the priors.
    """

    values: Array
    normal: NormalEquations
    weights: Array | None
    precision: Array
    variance: float = 1.0

    @property
    def by_priors(self) -> Array:
        """Share (k,) of each parameter that its prior, and not the readings, determines."""
        if not self.precision.any():
            return self.precision
        variances = inverse_diagonal(self.posterior_precision(self.variance))
        return np.asarray(self.precision * self.normal.unit**2 * variances)

    def covariance(self, variance: float) -> Array:
        """Compute the covariance (k, k) of all values; ``variance`` scales the readings' part, not the priors."""
        unit = self.normal.unit
        return inverse_psd(self.posterior_precision(variance)) * (unit * unit[:, None])

    def posterior_precision(self, variance: float) -> Array:
        """Compute the posterior precision (k, k) of the parameters, each in its ``unit``."""
        H = self.normal.A * (self.normal.unit * self.normal.unit[:, None]) / variance
        H.flat[:: len(H) + 1] += self.precision * self.normal.unit**2
        return H


# -- Identification of an arm with weights that include unmodelled physics, and without a mirrored SMR offset ---------

_EXCESS_ROUNDS = 6
"""Maximum rounds of identification and excess variance; the variance settles to a percent in two or three."""
_EXCESS_SETTLED = 0.01
"""Relative change of the excess variance at which the rounds end: weights then change by less than 1 %."""
_WRIST_ERRORS = 20.0
"""Distance of the SMR's mirror image along the last axis, in standard errors, up to which it is tried. It is a second
minimum only within some 10, and the linear standard error understates the width of such a valley."""


@contextmanager
def refused_by_arm(name: str) -> Iterator[None]:
    """Name the arm of the profile in errors of an identification: an ``InputError``, or that it did not converge."""
    try:
        yield
    except TooFewReadings as error:
        raise InputError(f"arm '{name}': {error}") from None
    except NotConverged as error:
        raise NotConverged(f"arm '{name}': {error}") from None
    except ValueError as error:
        raise InputError(f"arm '{name}': calibration.parameter_set: {error}") from None


def robust_loss(settings: CalibrationSettings, *, robust: bool) -> RobustName:
    """Return the robust loss of the profile; Tukey's if it has none and ``robust`` asks for one."""
    return "tukey" if robust and settings.robust == "none" else settings.robust


class _FinalFit(Protocol):
    def __call__(
        self, start: Geometry, *, sigma: Array | None, parameter_set: SetName | ParameterSet
    ) -> Identification: ...


def identify_with_excess(
    start: Geometry,
    its: Quantities,
    *,
    parameter_set: SetName | ParameterSet = "auto",
    prior_sigma: Mapping[str, float] | None = None,
    robust: RobustName = "none",
    tool_unknown: bool = False,
    tolerance: float = 1e-8,
    max_iterations: int = 200,
) -> tuple[Identification, float]:
    """Identify one arm with weights that include the scatter beyond the stated uncertainty.

    Unmodelled physics leaves residuals far above the uncertainty of the tracker. Weights from that uncertainty alone
    would let the few readings with the smallest one dominate. The first round weighs all readings alike. The excess
    variance is then estimated from the residuals and added to the stated one, and the identification is repeated until
    it settles. Arguments are those of ``identify`` for ``its`` vectors; the mean of the priors
    is ``start``.

    If the flange hardly turned, its offset to the SMR acts like a shift of the base. One that is unknown
    (``tool_unknown``) then has a wide prior about the start, without which only unmodelled physics would decide it.

    If the last axis hardly turns in space, the SMR's position along it is known through small angles only. Its
    mirror image about the wrist, with the opposite angles, fits nearly as well and is a second minimum. Both are
    tried, and the better one is returned.

    Returns
    -------
    identification : Identification
        With the iterations and steps of all rounds.
        ``excess_rad`` is the excess standard deviation of an orientation.
    excess : float
        Excess standard deviation of a coordinate [m].

    Raises
    ------
    NotConverged
        If the last identification, of the better one, did not converge.
    """
    q, p_M = its.readings.q, its.readings.p_M
    fit: _FinalFit = partial(
        identify,
        q=q,
        p_M=p_M,
        R_M_S=its.R_M_S,
        prior_sigma={**(unknown_offset(start, q, its.R_M_S) if tool_unknown else {}), **(prior_sigma or {})},
        prior_mean=start,
        robust=robust,
        tolerance=tolerance,
        max_iterations=max_iterations,
    )
    found, excess = _rounds(fit, start, its.stated, parameter_set)
    tool = _mirrored_tool(found)
    if tool is None:
        return found.settled("identification"), excess
    at_origin = replace(start, tool=tool).with_T_M_B(np.eye(4))
    points = found.positions
    mirrored = at_origin.with_T_M_B(register(p_M[points], smr_positions(at_origin, q[points])))
    mirrored = with_probe(mirrored, q, its.R_M_S)
    other, its_excess = _rounds(fit, mirrored, its.stated, parameter_set)
    better = (other, its_excess) if _square(other) < _square(found) else (found, excess)
    return better[0].settled("identification"), better[1]


def _rounds(
    fit: _FinalFit, start: Geometry, sigma: Array | None, parameter_set: SetName | ParameterSet
) -> tuple[Identification, float]:
    """Iterate identification and excess variance from one start; return the identification and excess scatter [m]."""
    found = fit(start, sigma=None, parameter_set=parameter_set)
    if sigma is None:
        return found, 0.0
    excess = (math.inf, math.inf)
    for _ in range(_EXCESS_ROUNDS):
        before, excess = excess, excess_of(found, sigma)
        if all(abs(now - then) <= _EXCESS_SETTLED * now for now, then in zip(excess, before, strict=True)):
            break
        earlier, weighed = found, with_excess(sigma, excess[0], found.angular, excess[1])
        found = fit(earlier.geometry, sigma=weighed, parameter_set=parameter_set)
        found = replace(found, steps=(*earlier.steps, *found.steps))
    return replace(found, excess_rad=math.sqrt(excess[1])), math.sqrt(excess[0])


def excess_of(found: Identification, sigma: Array) -> tuple[float, float]:
    """Estimate the variances of positions [m^2] and of orientations [rad^2] beyond the stated uncertainty ``sigma``."""
    return excess_of_kinds(found.residuals, sigma, found.degrees_of_freedom, found.angular, found.freedom_of_rotations)


def _mirrored_tool(found: Identification) -> Array | None:
    """Mirror the SMR (3,) [m] along the last axis about the origin of the frame before; None if that is too far."""
    places = [found.estimated.names.index(name) for name in TOOL_NAMES if name in found.estimated.names]
    if len(places) < len(TOOL_NAMES) or {*TOOL_NAMES} & {*found.geometry.tied_to.values()}:
        return None
    _, d, a, alpha, _ = found.geometry.rows[-1].tolist()
    to_last = rotation_x(alpha).T
    axis, wrist = to_last[:, 2], -to_last @ np.array([a, 0.0, d])
    tool = found.geometry.tool
    shift = 2.0 * float((tool - wrist) @ axis)
    variance = float(axis @ found.estimated_covariance[np.ix_(places, places)] @ axis)
    return tool - shift * axis if abs(shift) < _WRIST_ERRORS * math.sqrt(variance) else None


def _square(found: Identification) -> float:
    """Compute the weighted sum of squared residuals [m^2]."""
    return float(found.weights @ np.sum(found.residuals**2, axis=1))
