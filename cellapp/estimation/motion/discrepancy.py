"""Model discrepancy of an arm, and its effect on clocks and intervals.

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
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import solve_psd
from cellapp.estimation.motion.fit import Problem, Solution
from cellapp.estimation.motion.observe import Bands, Modelled, NoiseModel, averages_of, bands_of, noise_model
from cellapp.estimation.motion.terms import JointTerm, Law
from cellapp.robot.kinematics.transforms import Array

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
_FEWEST_FREE = 4.0
"""Least degrees of freedom of the variances of the discrepancy."""


@dataclass(frozen=True, eq=False)
class _Seen:
    """All sources at the solution, in the columns (K) of all parameters and of the laws that the fit lacks.

    ``X`` (3 f, K) and ``r`` (3 f,) are projected on the functions of posture, with singular values ``size`` (3 f,)
    relative to the largest; ``rest`` are the bands of each source without these functions. ``laws`` (K,) masks the
    laws, ``law`` and ``sd`` (L,) are their index and the standard deviation of their terms.
    """

    laws: NDArray[np.bool_]
    law: NDArray[np.intp]
    sd: Array
    X: Array
    r: Array
    size: Array
    rest: tuple[Bands, ...]

    @property
    def freedom(self) -> float:
        """Degrees of freedom left in the functions of posture by the parameters."""
        return max(len(self.r) - float(np.count_nonzero(~self.laws)), _FEWEST_FREE)

    def normal(self, level: tuple[float, ...]) -> Array:
        """Return the products of columns and residuals (K + 1, K + 1) of the rest, divided by each source's level."""
        parts = [bands.normal() / its for bands, its in zip(self.rest, level, strict=True)]
        return np.asarray(np.sum(parts, axis=0))


@dataclass(frozen=True, eq=False)
class _Missing:
    """Sizes of the discrepancy: variances (3 f,) of the functions of posture and precisions (L,) of the laws."""

    variance: Array
    precision: Array


def allow_for_missing(problem: Problem, solution: Solution, *, with_clocks: bool = True) -> Solution:
    """Return the solution with clocks corrected for the model discrepancy, the matching arm, and a covariance that
    includes the discrepancy; without ``with_clocks`` only the covariance changes."""
    seen, layout = _seen(problem, solution), problem.layout
    fitted = ~seen.laws
    fit_bands = [bands.of(fitted) for bands in seen.rest]
    still, ones = np.zeros(layout.size), [1.0] * len(fit_bands)
    level = noise_model(fit_bands, ones, still, solution.precision, solution.information).level
    towards_prior = solution.precision * (problem.mean - solution.values)
    missing = _missing(seen, level, solution.precision, towards_prior)
    arm = noise_model(fit_bands, ones, still, solution.precision, solution.information, _as_fitted(seen, missing))
    if not with_clocks:
        return replace(solution, noise=arm)
    step, of_clocks = _weighed(seen, missing, level, solution.precision, towards_prior)
    clocks = np.concatenate([layout.clock(number) for number in range(len(problem.tracks))])
    values, change, of_arm = solution.values.copy(), step[fitted][clocks], np.arange(layout.arm)
    values[clocks] += change
    normal = solution.information + np.diag(solution.precision)
    values[of_arm] -= solve_psd(normal[np.ix_(of_arm, of_arm)], normal[np.ix_(of_arm, clocks)] @ change)
    return replace(solution, values=values, noise=_with_clocks(arm, of_clocks, clocks, np.flatnonzero(fitted)[clocks]))


def _with_clocks(
    noise: NoiseModel, of_clocks: NoiseModel, places: NDArray[np.intp], theirs: NDArray[np.intp]
) -> NoiseModel:
    """Replace the variances of the clocks in a noise model by those of another one, with indices ``theirs`` there."""
    covariance, freedom = noise.covariance.copy(), noise.freedom.copy()
    covariance[places] = covariance[:, places] = 0.0
    covariance[np.ix_(places, places)] = of_clocks.covariance[np.ix_(theirs, theirs)]
    freedom[places] = of_clocks.freedom[theirs]
    return replace(noise, covariance=covariance, freedom=freedom)


def _seen(problem: Problem, solution: Solution) -> _Seen:
    layout = problem.layout
    laws = _laws(problem)
    wide = problem.with_terms(laws)
    model = wide.model(np.insert(solution.values, layout.arm, np.zeros(len(laws))))
    most = max(_MOST_ROWS // len(problem.tracks), 200)
    averages = [
        averages_of(model, holder, number, source.rows, source.root(), most)
        for number, (holder, source) in enumerate(zip(problem.holders, solution.sources, strict=True))
        if len(source.rows)
    ]
    ends = np.cumsum([len(one.r) for one in averages])
    X, r = np.zeros((ends[-1], 3, wide.layout.size)), np.concatenate([one.r for one in averages])
    parts = [slice(end - len(one.r), end) for one, end in zip(averages, ends.tolist())]
    for one, part in zip(averages, parts):
        X[part, :, one.columns] = one.X
    basis, size = _functions_of_posture(np.concatenate([one.q for one in averages]))
    own_X, own_r = np.tensordot(basis, X, (0, 0)), basis.T @ r
    X -= np.tensordot(basis, own_X, (1, 0))
    r -= basis @ own_r
    marked = np.zeros(wide.layout.size, dtype=bool)
    marked[layout.arm : layout.arm + len(laws)] = True
    kinds = {kind: n for n, kind in enumerate(dict.fromkeys((term.law, term.cycles) for term in laws))}
    return _Seen(
        marked,
        np.array([kinds[term.law, term.cycles] for term in laws], dtype=np.intp),
        np.array([term.prior_sd for term in laws]),
        own_X.reshape(-1, wide.layout.size),
        own_r.ravel(),
        np.repeat(size, 3),
        tuple(
            _rest(X[part], r[part], basis[part], in_time=number < len(problem.tracks))
            for number, part in enumerate(parts)
        ),
    )


def _laws(problem: Problem) -> tuple[JointTerm, ...]:
    """Return the laws of joints that an arm may have and the fit lacks."""
    joints = range(problem.layout.parameters.joints)
    own = {replace(term, law=Law.LINE) if term.law is Law.ONE_CYCLE else term for term in problem.layout.terms}
    lines = [JointTerm(Law.LINE, joint, c, sine) for c in _CYCLES for joint in joints for sine in (False, True)]
    elastic = [JointTerm(Law.COMPLIANCE, joint) for joint in joints if problem.masses is not None]
    lost = [JointTerm(Law.PLAY, joint) for joint in joints]  # lags the motion, like a delay
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


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """Restricted likelihood of the discrepancy: products of columns and residuals in the functions of posture and in
    the rest, the priors of the fit, and the centre of the prior of all log variances."""

    seen: _Seen
    both: Array
    rest: Array
    own: Array
    pull: Array
    centre: Array

    @classmethod
    def of(cls, seen: _Seen, level: tuple[float, ...], precision: Array, towards_prior: Array) -> _Likelihood:
        own, pull = np.zeros(len(seen.laws)), np.zeros(len(seen.laws))
        own[~seen.laws], pull[~seen.laws] = precision, towards_prior
        noise = math.log(float(np.mean(level)))
        usual = np.full(seen.law.max(initial=-1) + 1, 2.0 * math.log(_USUAL))
        return cls(
            seen, np.column_stack([seen.X, seen.r]), seen.normal(level), own, pull, np.array([noise, noise, *usual])
        )

    def sizes(self, logs: Array) -> _Missing:
        """Return the sizes from log variances: of smooth functions, of all functions, of each law; with only the first,
        there is no discrepancy."""
        smooth = math.exp(logs[1]) * self.seen.size**2 if len(logs) > 1 else 0.0
        laws = np.exp(-logs[2:][self.seen.law]) if len(logs) > 1 else np.full(len(self.seen.sd), _NOTHING)
        return _Missing(smooth + np.full(len(self.seen.r), math.exp(logs[0])), laws / self.seen.sd**2)

    def cost(self, logs: Array) -> float:
        """Return minus the log of likelihood times prior."""
        found, own = self.sizes(logs), self.own.copy()
        normal = self.rest + (self.both / found.variance[:, None]).T @ self.both
        own[self.seen.laws] = found.precision
        unit = 1.0 / np.sqrt(np.diag(normal)[:-1] + own + 1e-300)
        H = normal[:-1, :-1] * unit * unit[:, None] + np.diag(own * unit**2 + 1e-11)
        L = np.linalg.cholesky(H)
        y = scipy.linalg.solve_triangular(L, unit * (normal[:-1, -1] + self.pull), lower=True)
        logarithms = np.log(found.variance).sum() - np.log(found.precision).sum()
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


def _missing(seen: _Seen, level: tuple[float, ...], precision: Array, towards_prior: Array) -> _Missing:
    """Estimate the sizes of the discrepancy by restricted maximum likelihood, averaged over absence and presence."""
    likelihood = _Likelihood.of(seen, level, precision, towards_prior)
    (nothing, alone), (some, beside) = (likelihood.best(count) for count in (1, len(likelihood.centre)))
    share = float(scipy.special.expit(beside - alone + math.log(_USUALLY / (1.0 - _USUALLY))))
    without, lacking = likelihood.sizes(nothing), likelihood.sizes(some)
    variance = share * lacking.variance + (1.0 - share) * without.variance
    return _Missing(variance, 1.0 / (share / lacking.precision + (1.0 - share) / without.precision))


def _as_fitted(seen: _Seen, missing: _Missing) -> Modelled:
    """Return the discrepancy as it enters the fit: the covariance of ``X^T r`` for the columns of the fit."""
    fitted, X = ~seen.laws, seen.X[:, ~seen.laws]
    everywhere = seen.X.T @ seen.X + sum(bands.gram.sum(axis=0) for bands in seen.rest)
    by_law = everywhere[np.ix_(seen.laws, fitted)]
    spread = (X * missing.variance[:, None]).T @ X + (by_law / missing.precision[:, None]).T @ by_law
    return Modelled(X.T @ X, spread, seen.freedom)


def _weighed(
    seen: _Seen, missing: _Missing, level: tuple[float, ...], precision: Array, towards_prior: Array
) -> tuple[Array, NoiseModel]:
    """Return the generalised least squares step of all columns from the solution, and its noise model."""
    own, pull = np.zeros(len(seen.laws)), np.zeros(len(seen.laws))
    own[~seen.laws], own[seen.laws], pull[~seen.laws] = precision, missing.precision, towards_prior
    weighed = seen.X / missing.variance[:, None]
    known = Modelled(weighed.T @ seen.X, weighed.T @ seen.X, seen.freedom)
    rest = seen.normal(level)
    A, b = known.information + rest[:-1, :-1], weighed.T @ seen.r + rest[:-1, -1] + pull
    unit = 1.0 / np.sqrt(np.diag(A) + own + 1e-300)
    step = unit * solve_psd(A * unit * unit[:, None] + np.diag(own * unit**2), unit * b)
    return step, noise_model(seen.rest, [1.0 / its for its in level], step, own, A, known)
