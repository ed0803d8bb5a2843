"""Identification from recordings of motion: geometry, lost motion and clocks of all recordings in one fit.

    minimise  sum_s w_s sum_i c_i |p_i - P(q(u_i) - h d_i; g)|^2 + priors

over the recordings (and the stops) s. The weight w_s of a source is the information in one of its points: the inverse
of the residuals' variance at the frequencies at which the parameters move the points (``residuals``). So 100 000 points
that are worth a thousand independent ones weigh as a thousand beside stops and priors. c_i is one, or zero for gross
errors. A first fit of a subset with robust weights comes so close that one or two steps with all points suffice.

Elastic joints and uneven gears are functions of posture. A path passes the same postures again and again: such errors
do not average out as noise does, and resemble geometry and delays. Here they are random effects: the residuals are

    r = X b + Z u + B a + n

with the fit's columns X and parameters b. Z are laws of joints that the fit lacks (one to three cycles a turn, play,
compliance if masses are known), u_g ~ N(0, s_g) for each law. B are functions of posture, orthonormal along the path,
a_k ~ N(0, s S_k^2 + s_0) with the singular values S_k of a table of functions, smooth ones first. n is noise in bands
of frequency, orthogonal to B. The variances maximise the restricted likelihood (Patterson, Thompson, Biometrika 58
(1971) 545) under wide priors of their logarithms, as one run contains little information on what its geometry has
absorbed. If nothing is missing, s_g and s are zero. The evidence of both cases (Laplace) gives their probabilities, and
the variances are averaged over both.

The clocks are the generalised least squares estimate under this covariance. The arm stays the least squares estimate,
which predicts best; its covariance is that under the same residuals ("sandwich").
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import combinations
from statistics import median_high, median_low

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import (
    MEDIAN_NORM,
    inverse_diagonal,
    robust_weights,
    shortened,
    solve_psd,
    usual_scatter,
)
from cellapp.estimation.motion.laws import JointLaw, JointTerm, line, of_all_joints
from cellapp.estimation.motion.residuals import (
    Bands,
    Modelled,
    MotionProblem,
    Sums,
    averages_of,
    bands_of,
    noise_model,
    residuals,
    sums_of,
    with_priors,
)
from cellapp.ground.errors import NotConverged
from cellapp.ground.progress import Told, ignore_words
from cellapp.robot.kinematics.transforms import Array

_FIT = "fit of recordings of motion"
_FIRST_POINTS = 5000
"""Number of points of the first fit."""
_FIRST_STEPS = 40
_STEPS = 20
"""Largest number of steps with all points: one to three are usual, nine in fits to full convergence."""
_SETTLED_M = 1e-6
"""Step size [rms, m] that ends the first fit."""
_LAST_M = 5e-5
"""Step size that ends a fit with all points: the remaining error is about its square over the arm's length."""
_END_M = 5e-7
"""Step size that ends a fit to full convergence: weights by residuals settle more slowly than the geometry."""
GROSS = 6.0
"""Norm, in standard deviations of a coordinate, beyond which a point is a gross error: chance never reaches it."""
_NEARBY_S = 2.0
"""Time within which points share the model errors of the arm; a gross error stands out from them."""
_FEWEST_NEARBY = 9
_TRACKER_M = 1e-5
"""Least standard deviation of a coordinate [m]: keeps weights finite if there is no noise."""
_MOST_WORTH = 1e6
"""Largest worth: points cannot be a thousand times better than stated, though those of a few seconds may look so."""
_REWEIGHTED = 0.02
"""Relative change of a weight at which weights have converged."""
_ALIKE = 4.0
"""Ratio of variances up to which recordings of one arm get the same weight per second."""
_ROUNDS = 4
"""Most rounds of step and weights: weights settle to a percent in two or three."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The minimum: values and their covariance, sources with their weights and used points, and the steps taken."""

    values: Array
    covariance: Array = field(repr=False)
    information: Array = field(repr=False)
    precision: Array = field(repr=False)
    sources: tuple[Source, ...]
    steps: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Source:
    """Rows in use of one recording, or of the stops; standard deviation of a coordinate [m]; relative uncertainties
    (n,); and ``worth``, the weight of one point in units of ``1 / sigma^2``."""

    rows: NDArray[np.intp] = field(repr=False)
    sigma_m: float
    relative: Array = field(repr=False)
    worth: float = 1.0

    def root(self) -> Array:
        """Return the square roots of the weights (n,) [1/m]."""
        return np.asarray(np.sqrt(self.worth) / self.sigma_m / self.relative)


def with_lags_in_clocks(problem: MotionProblem, solution: Solution) -> tuple[Array, Array]:
    """Return values and covariance with the mean of the joints' lags counted to the offsets of the clocks: only their
    sum is known."""
    of_lag = np.array([term.law is JointLaw.LAG for term in problem.terms], dtype=np.bool_)
    lags, apart = problem.geometric + np.flatnonzero(of_lag), np.eye(len(solution.values))
    if len(lags):
        offsets = np.concatenate([problem.clock(number)[:-1] for number in range(len(problem.tracks))])
        apart[np.ix_(lags, lags)] -= 1.0 / len(lags)
        apart[np.ix_(offsets, lags)] += 1.0 / len(lags)
    return apart @ solution.values, apart @ solution.covariance @ apart.T


def thinned(rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """Return at most ``count`` of the rows, evenly spread."""
    if len(rows) <= count:
        return rows
    return rows[np.linspace(0, len(rows) - 1, count).astype(np.intp)]


def solve(
    problem: MotionProblem, start: Array | None = None, told: Told = ignore_words, *, to_its_end: bool = False
) -> Solution:
    """Fit a subset with robust weights, then all points without gross errors; with ``start``, skip the subset.

    ``to_its_end``: iterate until weights and parameters are consistent with each other, which small effects need;
    clocks and geometry settle before. A step that displaces the points by more than ``_LAST_M`` does not raise the
    sum of squares, priors included. Raise ``NotConverged`` if the steps with all points do not end.
    """
    values, steps, size = problem.mean if start is None else start, list[float](), math.inf
    stages = [("all points", problem.learnt, _without_gross_errors, _STEPS, _END_M if to_its_end else _LAST_M)]
    if start is None:
        stages.insert(0, ("some of the points", _some_rows(problem), _with_robust_weights, _FIRST_STEPS, _SETTLED_M))
    for words, rows, weighed, most, least in stages:
        for number in range(most):
            told(f"step {number + 1} with {words}")
            found, size = _stepped(problem, values, weighed(problem, values, rows))
            values, steps = found.values, [*steps, size]
            if size < least:
                break
    if not size < least:
        raise NotConverged.of(_FIT, f"{_STEPS} steps were not enough; the last moved the points by {size:.1e} m")
    return replace(found, steps=tuple(steps))


def _some_rows(problem: MotionProblem) -> list[NDArray[np.intp]]:
    """Return a part of the rows of the recordings, and those of the stops."""
    recordings = len(problem.tracks)
    share = max(_FIRST_POINTS // recordings, 200)
    return [thinned(its, share) if n < recordings else its for n, its in enumerate(problem.learnt)]


def _stepped(problem: MotionProblem, values: Array, sources: Sequence[Source]) -> tuple[Solution, float]:
    """Return the solution after a step from ``values``, and the rms displacement of the points by the step [m]."""
    sums, most = _sums(problem, values, sources), _seconds_per_worth(problem, sources)
    step, covariance, worths, information, precision = _weighed_step(problem, values, sums, most)
    moves_all = information[(problem.parameters.names.index("x0"),) * 2]
    size = math.sqrt(max(float(step @ information @ step), 0.0) / max(float(moves_all), 1e-300))
    weighed = tuple(replace(one, worth=worth) for one, worth in zip(sources, worths, strict=True))
    if not size < _LAST_M:
        step = shortened(_FIT, step, partial(_loss, problem, values, weighed, precision))
    return Solution(values + step, covariance, information, precision, weighed), size


def _loss(problem: MotionProblem, values: Array, sources: Sequence[Source], precision: Array, step: Array) -> float:
    """Compute the weighted sum of squares, priors included, a ``step`` beyond ``values``."""
    from scipy.signal import lfilter  # as in ``sums_of``

    total = float(precision @ (values + step - problem.mean) ** 2)
    for number, source in enumerate(sources):
        white = residuals(problem, values + step, number, source.rows).T * source.root()
        whitening = problem.filter_of(number)
        if whitening is not None:
            white = lfilter(whitening, [1.0], white)
        total += float(np.vdot(white, white))
    return total


def normal_equations(problem: MotionProblem, values: Array, sources: Sequence[Source]) -> tuple[Array, Array]:
    """Return ``X^T X`` and ``X^T r`` of all sources at ``values``, weighted as in a solution, without the priors."""
    return _normal(problem, _sums(problem, values, sources), [1.0] * len(sources))


def _weighed_step(
    problem: MotionProblem, values: Array, sums: Sequence[Sums], most: Array | None
) -> tuple[Array, Array, list[float], Array, Array]:
    """Compute a Gauss-Newton step with source weights and estimated prior spreads; return step, covariance, worths,
    information and precision of the priors. ``most`` bounds the worths, see ``_bounded``."""
    worths, precision = _bounded([1.0] * len(sums), most), problem.precision
    for _ in range(_ROUNDS):
        A, b = _normal(problem, sums, worths)
        precision = _with_spreads(problem, values, A, precision)
        unit, H = with_priors(A, precision)
        step = unit * solve_psd(H, unit * (b + precision * (problem.mean - values)))
        covariance, levels = noise_model([bands for *_, bands in sums], worths, step, precision, A)
        if max(abs(level - 1.0) for level in levels) < _REWEIGHTED:
            break
        worths = _bounded([min(worth / level, _MOST_WORTH) for worth, level in zip(worths, levels, strict=True)], most)
    return step, covariance, worths, A, precision


def _seconds_per_worth(problem: MotionProblem, sources: Sequence[Source]) -> Array | None:
    """Return the time of each recording over the sum of its weights at worth one (n,) [m^2 s]; None for fewer than
    three recordings, of which none is typical, or if each has its own whitening filter."""
    if len(problem.tracks) < 3 or problem.whitening is not None:
        return None
    return np.array([t.learnt_s * s.sigma_m**2 / max(len(s.rows), 1) for t, s in zip(problem.tracks, sources)])


def _bounded(worths: list[float], seconds_per_worth: Array | None) -> list[float]:
    """Limit the worths: no second of a recording weighs more than one of the median recording.

    Model errors of the arm are the same for all recordings. A recording of a few seconds has too few residuals to
    estimate its noise: a fit that follows it would raise its weight, and then follow it even more. A recording that is
    worse than others weighs less, without limit.
    """
    if seconds_per_worth is None:
        return worths
    recordings = len(seconds_per_worth)
    a_second = np.asarray(worths[:recordings]) / seconds_per_worth
    bounded = np.minimum(_ALIKE * a_second, median_high(a_second.tolist())) * seconds_per_worth
    return [*bounded.tolist(), *worths[recordings:]]


def _normal(problem: MotionProblem, sums: Sequence[Sums], worths: Sequence[float]) -> tuple[Array, Array]:
    """Sum the normal equations of all sources over all parameters."""
    k = len(problem.mean)
    A, b = np.zeros((k, k)), np.zeros(k)
    for (own_A, own_b, bands), worth in zip(sums, worths, strict=True):
        A[bands.columns[:, None], bands.columns] += worth * own_A
        b[bands.columns] += worth * own_b
    return A, b


def _with_spreads(problem: MotionProblem, values: Array, A: Array, precision: Array) -> Array:
    """Return the precision of the priors, with unstated standard deviations estimated from the present values."""
    if not problem.spreads:
        return precision
    unit, H = with_priors(A, precision)
    by_priors = precision * unit**2 * inverse_diagonal(H)
    precision = precision.copy()
    for spread in problem.spreads:
        deviations = values[spread.places] - problem.mean[spread.places]
        if deviations.any():
            precision[spread.places] = 1.0 / spread.square(deviations, float(by_priors[spread.places].sum()))
    return precision


def _sums(problem: MotionProblem, values: Array, sources: Sequence[Source]) -> list[Sums]:
    """Return the normal equations of every source at worth one."""
    return [
        sums_of(problem, values, number, source.rows, source.root(), problem.filter_of(number))
        for number, source in enumerate(sources)
    ]


def _norms(problem: MotionProblem, values: Array, rows: Sequence[NDArray[np.intp]]) -> tuple[list[Array], float]:
    """Return the norms of the residuals (n,) [m] of every source, and their median in the median recording: one that
    fits better does not have more gross errors."""
    norms = [np.linalg.norm(residuals(problem, values, number, its), axis=1) for number, its in enumerate(rows)]
    return norms, median_low([float(np.median(norm)) for norm in norms[: len(problem.tracks)]])


def _with_robust_weights(problem: MotionProblem, values: Array, rows: Sequence[NDArray[np.intp]]) -> tuple[Source, ...]:
    """Return the sources of these rows with robust weights."""
    (norms, usual), found = _norms(problem, values, rows), []
    for number, (norm, its) in enumerate(zip(norms, rows, strict=True)):
        source = _source(its, norm, problem.holders[number].sigma_m)
        if number < len(problem.tracks):
            norm = np.maximum(norm, usual)
            norm = norm * np.minimum(1.0, np.median(norm) / _nearby(problem.tracks[number].learnt_s, norm))
        with np.errstate(divide="ignore"):  # a gross error has no weight
            of_weights = robust_weights(np.maximum(norm, _TRACKER_M), "tukey") ** -0.5
        found.append(replace(source, relative=source.relative * of_weights))
    return tuple(found)


def _without_gross_errors(
    problem: MotionProblem, values: Array, rows: Sequence[NDArray[np.intp]]
) -> tuple[Source, ...]:
    """Return the sources of these rows without gross errors."""
    (norms, usual), found = _norms(problem, values, rows), []
    for number, (norm, its) in enumerate(zip(norms, rows, strict=True)):
        scale: float | Array = usual_scatter(norm, _TRACKER_M)
        if number < len(problem.tracks):
            nearby = _nearby(problem.tracks[number].learnt_s, norm)
            scale = np.maximum(scale, np.maximum(nearby, usual) / MEDIAN_NORM)
        good = norm < GROSS * scale
        found.append(_source(its[good], norm[good], problem.holders[number].sigma_m))
    return tuple(found)


def _nearby(seconds: float, norm: Array) -> Array:
    """Return the median norm (n,) [m] of the residuals near the same time, for rows in order of time.

    An elastic joint may move all points of some seconds by far more than usual. These are no gross errors; without them
    only the rest of the motion would be fitted.
    """
    count = max(math.ceil(_NEARBY_S * len(norm) / max(seconds, _NEARBY_S)), _FEWEST_NEARBY)
    parts = np.array_split(norm, max(len(norm) // count, 1))
    medians = np.repeat([float(np.median(part)) for part in parts], [len(part) for part in parts])
    return np.asarray(np.maximum(medians, _TRACKER_M))


def _source(rows: NDArray[np.intp], norm: Array, stated: Array | None) -> Source:
    """Build a source; its variance follows from the median of the residuals' norms (n,) [m]."""
    sigma, squares = usual_scatter(norm, _TRACKER_M), np.ones(len(rows))
    if stated is not None and np.isfinite(stated[rows]).all() and (stated[rows] > 0.0).all():
        squares = stated[rows] ** 2
        squares = squares + max(sigma**2 - float(np.median(squares)), 0.0)
    return Source(rows, sigma, np.sqrt(squares / np.mean(squares)))


# -- Discrepancy of the model -----------------------------------------------------------------------------------------


_CYCLES = (1, 2, 3)
"""Cycles a turn of the lines that an arm may have: faster ones do not resemble geometry."""
_USUAL = 0.15
"""Centre of the prior of a law's size, in standard deviations of its term: some 45 urad for lines."""
_LOG_SD = 3.0
"""Prior standard deviation of the log of a variance: a factor of 4.5 in size."""
_MOST_ROWS = 8000
_SAME = 1e-4
"""Ratio of a singular value to the largest, below which functions of posture are the same along a path."""
_MOST_TRIED = 400
_LOG_STEP = 0.2
"""Step of the log variance for the curvature of the likelihood."""
_USUALLY = 0.75
"""Prior probability that a model lacks something: most arms have an effect or two. With it, intervals hold as often as
stated both for arms with effects and for arms without."""
_NOTHING = 1e8
"""Precision of a law that is absent, in units of the inverse square of the standard deviation of its term."""


_Sizes = tuple[Array, Array]
"""Sizes of a discrepancy: variances (3 f,) of the functions of posture, and precisions (L,) of the laws."""


@dataclass(frozen=True, eq=False)
class _Seen:
    """All sources at the solution, in the columns (K) of all parameters and of the laws that the fit lacks.

    ``X`` (3 f, K) and ``r`` (3 f,) are projected on the functions of posture, with singular values ``size`` (3 f,)
    relative to the largest; ``rest`` are the bands of each source without these functions, ``level`` its noise.
    ``laws`` (K,) masks the laws, ``law`` and ``sd`` (L,) are their index and the standard deviation of their terms.
    ``precision`` and ``pull`` (K,) are the priors of the fit: precision, and its product with the way to the mean.
    """

    laws: NDArray[np.bool_]
    law: NDArray[np.intp]
    sd: Array
    X: Array
    r: Array
    size: Array
    rest: tuple[Bands, ...]
    level: tuple[float, ...]
    precision: Array
    pull: Array

    @cached_property
    def _rest(self) -> Array:
        """Products of columns and residuals (K + 1, K + 1) of the rest, divided by each source's level."""
        return np.asarray(sum(bands.normal() / its for bands, its in zip(self.rest, self.level, strict=True)))

    @cached_property
    def centre(self) -> Array:
        """Centre of the prior of all log variances: of noise in the functions, of these, and of each law."""
        noise, laws = math.log(float(np.mean(self.level))), self.law.max(initial=-1) + 1
        return np.array([noise, noise, *[2.0 * math.log(_USUAL)] * laws])

    def equations(self, missing: _Sizes) -> tuple[Array, Array, Array]:
        """Return products of columns and residuals (K + 1, K + 1) for a discrepancy, those of the functions of posture
        alone, and the precision of all columns (K,)."""
        both = np.column_stack([self.X, self.r])
        variance, of_laws = missing
        of_posture, own = (both / variance[:, None]).T @ both, self.precision.copy()
        own[self.laws] = of_laws
        return of_posture + self._rest, of_posture, own

    def sizes(self, logs: Array) -> _Sizes:
        """Return the sizes from log variances: of smooth functions, of all functions, of each law; with only the first,
        there is no discrepancy."""
        smooth = math.exp(logs[1]) * self.size**2 if len(logs) > 1 else 0.0
        laws = np.exp(-logs[2:][self.law]) if len(logs) > 1 else np.full(len(self.sd), _NOTHING)
        return smooth + np.full(len(self.r), math.exp(logs[0])), laws / self.sd**2

    def cost(self, logs: Array) -> float:
        """Return minus the log of the restricted likelihood times the prior."""
        variance, precision = self.sizes(logs)
        normal, _, own = self.equations((variance, precision))
        unit, H = with_priors(normal[:-1, :-1], own)
        L = np.linalg.cholesky(H + 1e-11 * np.eye(len(H)))
        y = scipy.linalg.solve_triangular(L, unit * (normal[:-1, -1] + self.pull), lower=True)
        logarithms = np.log(variance).sum() - np.log(precision).sum()
        logarithms += 2.0 * (np.log(np.diag(L)).sum() - np.log(unit).sum())
        by_prior = np.sum((logs - self.centre[: len(logs)]) ** 2) / _LOG_SD**2
        return float(logarithms + normal[-1, -1] - y @ y + by_prior) / 2.0

    def best(self, count: int) -> tuple[Array, float]:
        """Return the most probable logs of the first ``count`` variances, and the log evidence (Laplace) up to a common
        constant."""
        options = {"xatol": 0.05, "fatol": 0.05, "maxfev": _MOST_TRIED}
        found = scipy.optimize.minimize(self.cost, self.centre[:count], method="Nelder-Mead", options=options)
        bent = [
            (self.cost(found.x + step) + self.cost(found.x - step) - 2.0 * found.fun) / _LOG_STEP**2
            for step in _LOG_STEP * np.eye(count)
        ]
        narrower = np.log(np.maximum(bent, 1.0 / _LOG_SD**2) * _LOG_SD**2)
        return found.x, -float(found.fun) - 0.5 * float(narrower.sum())

    def missing(self) -> _Sizes:
        """Estimate the sizes of the discrepancy by restricted maximum likelihood, averaged over absence and
        presence."""
        (nothing, alone), (some, beside) = (self.best(count) for count in (1, len(self.centre)))
        share = float(scipy.special.expit(beside - alone + math.log(_USUALLY / (1.0 - _USUALLY))))
        without, lacking = self.sizes(nothing), self.sizes(some)
        variance = share * lacking[0] + (1.0 - share) * without[0]
        return variance, 1.0 / (share / lacking[1] + (1.0 - share) / without[1])


def allow_for_missing(problem: MotionProblem, solution: Solution, *, with_clocks: bool = True) -> Solution:
    """Return the solution with clocks corrected for the model discrepancy, the matching arm, and a covariance that
    includes the discrepancy; without ``with_clocks`` only the covariance changes."""
    seen = _seen(problem, solution)
    missing = seen.missing()
    covariance, _ = _noise_of_fit(seen.rest, ~seen.laws, solution, _as_fitted(seen, missing))
    if not with_clocks:
        return replace(solution, covariance=covariance)
    step, of_clocks = _weighed(seen, missing)
    clocks, of_arm = np.arange(problem.arm, len(problem.mean)), np.arange(problem.arm)
    theirs = np.flatnonzero(~seen.laws)[clocks]
    values, change = solution.values.copy(), step[theirs]
    values[clocks] += change
    normal = solution.information + np.diag(solution.precision)
    values[of_arm] -= solve_psd(normal[np.ix_(of_arm, of_arm)], normal[np.ix_(of_arm, clocks)] @ change)
    covariance[clocks] = covariance[:, clocks] = 0.0
    covariance[np.ix_(clocks, clocks)] = of_clocks[np.ix_(theirs, theirs)]
    return replace(solution, values=values, covariance=covariance)


def _noise_of_fit(
    rest: Sequence[Bands], fitted: NDArray[np.bool_], solution: Solution, modelled: Modelled | None = None
) -> tuple[Array, tuple[float, ...]]:
    """Return the noise model of the fit's columns in bands of all columns."""
    still = np.zeros(len(solution.values))
    bands = [one.of(fitted) for one in rest]
    return noise_model(bands, [1.0] * len(bands), still, solution.precision, solution.information, modelled)


def _seen(problem: MotionProblem, solution: Solution) -> _Seen:
    laws = _laws(problem)
    wide = problem.with_terms((*problem.terms, *laws))
    k, values = len(wide.mean), np.insert(solution.values, problem.arm, np.zeros(len(laws)))
    most = max(_MOST_ROWS // len(problem.tracks), 200)
    averages = [
        averages_of(wide, values, number, source.rows, source.root(), most)
        for number, source in enumerate(solution.sources)
        if len(source.rows)
    ]
    r, q = (np.concatenate([one[place] for one in averages]) for place in (1, 2))
    X, parts, end = np.zeros((len(r), 3, k)), list[slice](), 0
    for number, (own_X, _, _) in enumerate(averages):
        parts.append(slice(end, end + len(own_X)))
        X[parts[-1], :, wide.columns_of(number)] = own_X
        end += len(own_X)
    basis, size = _functions_of_posture(q)
    own_X, own_r = np.tensordot(basis, X, (0, 0)), basis.T @ r
    X -= np.tensordot(basis, own_X, (1, 0))
    r -= basis @ own_r
    marked = np.zeros(k, dtype=bool)
    marked[problem.arm : wide.arm] = True
    rest = tuple(
        _rest(X[part], r[part], basis[part], in_time=number < len(problem.tracks)) for number, part in enumerate(parts)
    )
    precision, pull = np.zeros(k), np.zeros(k)
    precision[~marked], pull[~marked] = solution.precision, solution.precision * (problem.mean - solution.values)
    kinds = {kind: n for n, kind in enumerate(dict.fromkeys((term.law, term.cycles) for term in laws))}
    return _Seen(
        marked,
        np.array([kinds[term.law, term.cycles] for term in laws], dtype=np.intp),
        np.array([term.prior_sd for term in laws]),
        own_X.reshape(-1, k),
        own_r.ravel(),
        np.repeat(size, 3),
        rest,
        _noise_of_fit(rest, ~marked, solution)[1],
        precision,
        pull,
    )


def _laws(problem: MotionProblem) -> tuple[JointTerm, ...]:
    """Return the laws of joints that an arm may have and the fit lacks."""
    joints = problem.parameters.joints
    own = {replace(term, law=JointLaw.LINE) if term.law is JointLaw.ONE_CYCLE else term for term in problem.terms}
    lines = [term for cycles in _CYCLES for joint in range(joints) for term in line(joint, cycles)]
    elastic = () if problem.masses is None else of_all_joints(JointLaw.COMPLIANCE, joints)
    lost = of_all_joints(JointLaw.PLAY, joints)  # lags the motion, like a delay
    return tuple(term for term in (*lines, *elastic, *lost) if term not in own)


def _functions_of_posture(q: Array) -> tuple[Array, Array]:
    """Return orthonormal functions of posture (n, f), smooth ones first, and their sizes relative to the largest: one
    and two cycles of each joint, of sums and differences of any two, and of sums along the arm. Gravity and gear errors
    are mostly among them."""
    joints = range(q.shape[1])
    angles = [factor * q[:, joint] for joint in joints for factor in (1, 2)]
    angles += [q[:, i] + sign * q[:, k] for i, k in combinations(joints, 2) for sign in (1, -1)]
    angles += [q[:, first:last].sum(axis=1) for first in joints for last in range(first + 3, q.shape[1] + 1)]
    table = np.stack(angles, axis=1)
    table = np.concatenate([np.ones((len(q), 1)), np.sin(table), np.cos(table)], axis=1)
    vectors, sizes, _ = np.linalg.svd(table, full_matrices=False)
    kept = np.flatnonzero(sizes > _SAME * sizes[0])[: max(len(q) // 4, 1)]
    return vectors[:, kept], sizes[kept] / sizes[0]


def _rest(X: Array, r: Array, basis: Array, *, in_time: bool) -> Bands:
    """Return the bands of one source without the functions of posture, with reduced degrees of freedom."""
    bands = bands_of(X, np.arange(X.shape[2]), r, in_time=in_time)
    taken = bands_of(basis[:, None, :], np.arange(basis.shape[1]), np.zeros((len(r), 1)), in_time=in_time)
    return replace(bands, count=np.maximum(bands.count - 3.0 * taken.gram.trace(axis1=1, axis2=2), 1.0))


def _as_fitted(seen: _Seen, missing: _Sizes) -> Modelled:
    """Return the discrepancy as it enters the fit: the covariance of ``X^T r`` for the columns of the fit."""
    variance, precision = missing
    fitted, X = ~seen.laws, seen.X[:, ~seen.laws]
    everywhere = seen.X.T @ seen.X + sum(bands.gram.sum(axis=0) for bands in seen.rest)
    by_law = everywhere[np.ix_(seen.laws, fitted)]
    spread = (X * variance[:, None]).T @ X + (by_law / precision[:, None]).T @ by_law
    return Modelled(X.T @ X, spread)


def _weighed(seen: _Seen, missing: _Sizes) -> tuple[Array, Array]:
    """Return the generalised least squares step of all columns from the solution, and its covariance."""
    normal, of_posture, own = seen.equations(missing)
    A, known = normal[:-1, :-1], Modelled(of_posture[:-1, :-1], of_posture[:-1, :-1])
    unit, H = with_priors(A, own)
    step = unit * solve_psd(H, unit * (normal[:-1, -1] + seen.pull))
    covariance, _ = noise_model(seen.rest, [1.0 / its for its in seen.level], step, own, A, known)
    return step, covariance
