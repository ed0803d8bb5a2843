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
from functools import partial
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
)
from cellapp.estimation.calibration.parameters import PriorSpread
from cellapp.estimation.motion.laws import JointLaw, JointTerm, Masses
from cellapp.estimation.motion.residuals import (
    Bands,
    Layout,
    Model,
    Modelled,
    NoiseModel,
    Stops,
    Sums,
    averages_of,
    bands_of,
    noise_model,
    residuals,
    sums_of,
)
from cellapp.estimation.motion.tracks import Track
from cellapp.ground.errors import NotConverged
from cellapp.ground.progress import Told, ignore_words
from cellapp.robot.kinematics.chain import Geometry
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
class Fittings:
    """Fitting problem: tracks, stops, and priors about the start."""

    start: Geometry
    layout: Layout
    tracks: tuple[Track, ...]
    stops: Stops | None
    mean: Array = field(repr=False)
    precision: Array = field(repr=False)
    spreads: tuple[PriorSpread, ...]
    stop_rows: NDArray[np.intp]
    """The stops in use; the others are held out."""
    masses: Masses | None = None
    whitening: tuple[Array, ...] | None = None

    def with_terms(self, added: tuple[JointTerm, ...]) -> Fittings:
        """Return the problem with further terms."""
        layout, at = replace(self.layout, terms=self.layout.terms + added), self.layout.arm
        precisions = [1.0 / term.prior_sd**2 for term in added]
        return replace(
            self,
            layout=layout,
            mean=np.insert(self.mean, at, [term.prior_mean for term in added]),
            precision=np.insert(self.precision, at, precisions),
        )

    def with_shapes(self, terms: tuple[JointTerm, ...]) -> Fittings:
        """Return the problem with its terms linearised at other shapes."""
        mean, precision = self.mean.copy(), self.precision.copy()
        for place, term in enumerate(terms, start=self.layout.geometric):
            if term.shape:
                mean[place], precision[place] = term.prior_mean, 1.0 / term.prior_sd**2
        return replace(self, layout=replace(self.layout, terms=terms), mean=mean, precision=precision)

    def without_terms(self) -> Fittings:
        """Return the problem with geometry and clocks alone."""
        kept = np.delete(np.arange(self.layout.size), np.arange(self.layout.geometric, self.layout.arm))
        return replace(
            self, layout=replace(self.layout, terms=()), mean=self.mean[kept], precision=self.precision[kept]
        )

    @property
    def holders(self) -> tuple[Track | Stops, ...]:
        """The recordings, and last the stops if there are any."""
        return self.tracks if self.stops is None else (*self.tracks, self.stops)

    @property
    def learnt(self) -> list[NDArray[np.intp]]:
        """Rows of every source that the fit may use."""
        rows = [np.flatnonzero(track.learnt) for track in self.tracks]
        return rows if self.stops is None else [*rows, self.stop_rows]

    @property
    def translation(self) -> int:
        """Index of a parameter that moves all points alike."""
        return self.layout.parameters.names.index("x0")

    def model(self, values: Array) -> Model:
        """Return the arm and its clocks at ``values``."""
        return Model(self.start, self.layout, values, self.masses)


@dataclass(frozen=True, eq=False)
class Solution:
    """The minimum: values, noise model, sources with their weights and used points, and the steps taken."""

    values: Array
    noise: NoiseModel
    information: Array = field(repr=False)
    precision: Array = field(repr=False)
    sources: tuple[Source, ...]
    steps: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Source:
    """Rows in use of one recording, or of the stops; standard deviation of a coordinate [m]; ``worth``, the weight of
    one point in units of ``1 / sigma^2``; and relative uncertainties (n,), or None."""

    rows: NDArray[np.intp] = field(repr=False)
    sigma_m: float
    worth: float = 1.0
    relative: Array | None = field(default=None, repr=False)

    def root(self, robust: Array | None = None) -> Array:
        """Return the square roots of the weights (n,) [1/m]."""
        root = np.full(len(self.rows), np.sqrt(self.worth) / self.sigma_m)
        if self.relative is not None:
            root = root / self.relative
        return root if robust is None else root * np.sqrt(robust)


def thinned(rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """Return at most ``count`` of the rows, evenly spread."""
    if len(rows) <= count:
        return rows
    return rows[np.linspace(0, len(rows) - 1, count).astype(np.intp)]


def solve(
    problem: Fittings, start: Array | None = None, told: Told = ignore_words, *, to_its_end: bool = False
) -> Solution:
    """Fit a subset with robust weights, then all points without gross errors; with ``start``, skip the subset.

    ``to_its_end``: iterate until weights and parameters are consistent with each other, which small effects need;
    clocks and geometry settle before. A step that displaces the points by more than ``_LAST_M`` does not raise the
    sum of squares, priors included. Raise ``NotConverged`` if the steps do not end.
    """
    values, steps = _first_fit(problem, told) if start is None else (start, [])
    for number in range(_STEPS):
        told(f"step {number + 1} with all points")
        found, size = _stepped(problem, values, _all_points(problem, problem.model(values)), None)
        values, steps = found.values, [*steps, size]
        if size < (_END_M if to_its_end else _LAST_M):
            return replace(found, steps=tuple(steps))
    raise NotConverged.of(_FIT, f"{_STEPS} steps were not enough; the last moved the points by {steps[-1]:.1e} m")


def _first_fit(problem: Fittings, told: Told) -> tuple[Array, list[float]]:
    """Fit a subset robustly; return the values and the sizes of the steps. It is a start: it need not end."""
    share = max(_FIRST_POINTS // max(len(problem.tracks), 1), 200)
    rows = problem.learnt
    rows[: len(problem.tracks)] = [thinned(its, share) for its in rows[: len(problem.tracks)]]
    values, steps = problem.mean.copy(), list[float]()
    for number in range(_FIRST_STEPS):
        told(f"step {number + 1} with some of the points")
        found, size = _stepped(problem, values, *_with_robust_weights(problem, problem.model(values), rows))
        values, steps = found.values, [*steps, size]
        if size < _SETTLED_M:
            break
    return values, steps


def _stepped(
    problem: Fittings, values: Array, sources: Sequence[Source], robust: Sequence[Array] | None
) -> tuple[Solution, float]:
    """Return the solution after a step from ``values``, and the rms displacement of the points by the step [m]."""
    sums, most = _sums(problem, problem.model(values), sources, robust), _seconds_per_worth(problem, sources)
    step, noise, worths, information, precision = _weighed_step(problem, values, sums, most)
    size = _size(step, information, problem.translation)
    weighed = tuple(replace(one, worth=worth) for one, worth in zip(sources, worths, strict=True))
    if not size < _LAST_M:
        step = shortened(_FIT, step, partial(_loss, problem, values, weighed, precision, robust))
    return Solution(values + step, noise, information, precision, weighed), size


def _loss(
    problem: Fittings,
    values: Array,
    sources: Sequence[Source],
    precision: Array,
    robust: Sequence[Array] | None,
    step: Array,
) -> float:
    """Compute the weighted sum of squares, priors included, a ``step`` beyond ``values``."""
    from scipy.signal import lfilter  # as in ``sums_of``

    model = problem.model(values + step)
    total = float(precision @ (values + step - problem.mean) ** 2)
    residuals = _residuals(problem, model, [one.rows for one in sources])
    for number, (source, residual) in enumerate(zip(sources, residuals, strict=True)):
        white = residual.T * source.root(None if robust is None else robust[number])
        if number < len(problem.tracks) and problem.whitening is not None and robust is None:
            white = lfilter(problem.whitening[number], [1.0], white)
        total += float(np.vdot(white, white))
    return total


def normal_equations(problem: Fittings, values: Array, sources: Sequence[Source]) -> tuple[Array, Array]:
    """Return ``X^T X`` and ``X^T r`` of all sources at ``values``, weighted as in a solution, without the priors."""
    sums = _sums(problem, problem.model(values), sources, None)
    return _normal(problem, sums, [1.0] * len(sums))


def _weighed_step(
    problem: Fittings, values: Array, sums: Sequence[Sums], most: Array | None
) -> tuple[Array, NoiseModel, list[float], Array, Array]:
    """Compute a Gauss-Newton step with source weights and estimated prior spreads; return step, noise model, worths,
    information and precision of the priors. ``most`` bounds the worths, see ``_bounded``."""
    worths, precision = _bounded([1.0] * len(sums), most), problem.precision
    for _ in range(_ROUNDS):
        A, b = _normal(problem, sums, worths)
        precision = _with_spreads(problem, values, A, precision)
        unit = 1.0 / np.sqrt(np.diag(A) + precision + 1e-300)
        H = A * unit * unit[:, None] + np.diag(precision * unit**2)
        step = unit * solve_psd(H, unit * (b + precision * (problem.mean - values)))
        noise = noise_model([one.bands for one in sums], worths, step, precision, A)
        levels = noise.level
        if max(abs(level - 1.0) for level in levels) < _REWEIGHTED:
            break
        worths = _bounded([min(worth / level, _MOST_WORTH) for worth, level in zip(worths, levels, strict=True)], most)
    return step, noise, worths, A, precision


def _seconds_per_worth(problem: Fittings, sources: Sequence[Source]) -> Array | None:
    """Return the time of each recording over the sum of its weights at worth one (n,) [m^2 s]; None for fewer than
    three recordings, of which none is typical, or if each has its own whitening filter."""
    if len(problem.tracks) < 3 or problem.whitening is not None:
        return None
    times = [np.count_nonzero(track.learnt) * track.stamps.period_s for track in problem.tracks]
    return np.array([t * s.sigma_m**2 / max(len(s.rows), 1) for t, s in zip(times, sources)])


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


def _normal(problem: Fittings, sums: Sequence[Sums], worths: Sequence[float]) -> tuple[Array, Array]:
    """Sum the normal equations of all sources over all parameters."""
    A, b = np.zeros((problem.layout.size,) * 2), np.zeros(problem.layout.size)
    for one, worth in zip(sums, worths, strict=True):
        places = one.bands.columns
        A[places[:, None], places] += worth * one.A
        b[places] += worth * one.b
    return A, b


def _with_spreads(problem: Fittings, values: Array, A: Array, precision: Array) -> Array:
    """Return the precision of the priors, with unstated standard deviations estimated from the present values."""
    if not problem.spreads:
        return precision
    unit = 1.0 / np.sqrt(np.diag(A) + precision + 1e-300)
    H = A * unit * unit[:, None] + np.diag(precision * unit**2)
    by_priors = precision * unit**2 * inverse_diagonal(H)
    precision = precision.copy()
    for spread in problem.spreads:
        deviations = values[spread.places] - problem.mean[spread.places]
        if deviations.any():
            precision[spread.places] = 1.0 / spread.square(deviations, float(by_priors[spread.places].sum()))
    return precision


def _size(step: Array, information: Array, translation: int) -> float:
    """Return the rms displacement of the points by a step [m]; parameter ``translation`` moves all points alike."""
    return float(np.sqrt(max(step @ information @ step, 0.0) / max(information[translation, translation], 1e-300)))


def _sums(problem: Fittings, model: Model, sources: Sequence[Source], robust: Sequence[Array] | None) -> list[Sums]:
    """Return the normal equations of every source at worth one."""
    found = []
    for number, (holder, source) in enumerate(zip(problem.holders, sources, strict=True)):
        root, filters = source.root(None if robust is None else robust[number]), problem.whitening or ()
        whitening = filters[number] if robust is None and number < len(filters) else None
        found.append(sums_of(model, holder, number, source.rows, root, whitening))
    return found


def _residuals(problem: Fittings, model: Model, rows: Sequence[NDArray[np.intp]]) -> list[Array]:
    """Return the residuals (n, 3) [m] of the rows of every source."""
    return [residuals(model, one, n, its) for n, (one, its) in enumerate(zip(problem.holders, rows, strict=True))]


def _source(problem: Fittings, number: int, rows: NDArray[np.intp], norm: Array) -> Source:
    """Build a source; its variance follows from the median of the residuals' norms (n,) [m]."""
    stated = problem.holders[number].sigma_m
    sigma = max(float(np.median(norm)) / MEDIAN_NORM, _TRACKER_M)
    relative = None
    if stated is not None and np.isfinite(stated[rows]).all() and (stated[rows] > 0.0).all():
        squares = stated[rows] ** 2
        excess = max(sigma**2 - float(np.median(squares)), 0.0)
        relative = np.sqrt((squares + excess) / np.mean(squares + excess))
    return Source(rows, sigma, relative=relative)


def _with_robust_weights(
    problem: Fittings, model: Model, rows: Sequence[NDArray[np.intp]]
) -> tuple[list[Source], list[Array]]:
    norms = [np.linalg.norm(one, axis=1) for one in _residuals(problem, model, rows)]
    usual, sources, weights = _usual(norms[: len(problem.tracks)]), [], []
    for number, (norm, its) in enumerate(zip(norms, rows, strict=True)):
        sources.append(_source(problem, number, its, norm))
        if number < len(problem.tracks):
            norm = np.maximum(norm, usual)
            norm = norm * np.minimum(1.0, np.median(norm) / _nearby(problem.tracks[number], norm))
        weights.append(robust_weights(np.maximum(norm, _TRACKER_M), "tukey"))
    return sources, weights


def _nearby(track: Track, norm: Array) -> Array:
    """Return the median norm (n,) [m] of the residuals near the same time, for rows in order of time.

    An elastic joint may move all points of some seconds by far more than usual. These are no gross errors; without them
    only the rest of the motion would be fitted.
    """
    seconds = np.count_nonzero(track.learnt) * track.stamps.period_s
    count = max(math.ceil(_NEARBY_S * len(norm) / max(seconds, _NEARBY_S)), _FEWEST_NEARBY)
    blocks = max(len(norm) // count, 1)
    medians = [np.full(len(part), np.median(part)) for part in np.array_split(norm, blocks)]
    return np.maximum(np.concatenate(medians), _TRACKER_M)


def _usual(norms: Sequence[Array]) -> float:
    """Return the residual norm [m] of the median recording: a recording that fits better does not have more gross
    errors."""
    return max(median_low([float(np.median(norm)) for norm in norms]), _TRACKER_M)


def _all_points(problem: Fittings, model: Model) -> tuple[Source, ...]:
    """Return all points of every source without gross errors."""
    rows = problem.learnt
    norms = [np.linalg.norm(one, axis=1) for one in _residuals(problem, model, rows)]
    usual, found = _usual(norms[: len(problem.tracks)]), []
    for number, (norm, its) in enumerate(zip(norms, rows, strict=True)):
        scale: float | Array = max(float(np.median(norm)) / MEDIAN_NORM, _TRACKER_M)
        if number < len(problem.tracks):
            nearby = _nearby(problem.tracks[number], norm)
            scale = np.maximum(max(scale, usual / MEDIAN_NORM), nearby / MEDIAN_NORM)
        good = norm < GROSS * scale
        found.append(_source(problem, number, its[good], norm[good]))
    return tuple(found)


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


def allow_for_missing(problem: Fittings, solution: Solution, *, with_clocks: bool = True) -> Solution:
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


def _seen(problem: Fittings, solution: Solution) -> _Seen:
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


def _laws(problem: Fittings) -> tuple[JointTerm, ...]:
    """Return the laws of joints that an arm may have and the fit lacks."""
    joints = range(problem.layout.parameters.joints)
    own = {
        replace(term, law=JointLaw.LINE) if term.law is JointLaw.ONE_CYCLE else term for term in problem.layout.terms
    }
    lines = [JointTerm(JointLaw.LINE, joint, c, sine) for c in _CYCLES for joint in joints for sine in (False, True)]
    elastic = [JointTerm(JointLaw.COMPLIANCE, joint) for joint in joints if problem.masses is not None]
    lost = [JointTerm(JointLaw.PLAY, joint) for joint in joints]  # lags the motion, like a delay
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
