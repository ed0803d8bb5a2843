"""Residuals and normal equations of recordings, in chunks: memory does not grow with the number of points.

A point with timestamp t was measured at controller time ``u = t - o - r (t - t_m)``, with offset o of its segment and
rate r of its recording. The model is ``P(q(u) + sum_k b_k o_k(u); g)``: geometry g, and joint offsets o_k (``terms``).
Its columns are those of the geometry; ``o_k dP/dq_j`` for b_k; ``-J qd`` for o and ``-(t - t_m) J qd`` for r.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.parameters import ParameterSet, PriorSpread
from cellapp.estimation.motion.laws import CHUNK, JointState, JointTerm, Masses, state_at_rest, state_in_motion
from cellapp.estimation.motion.tracks import Track
from cellapp.robot.kinematics.chain import Geometry, JointAngles, smr_positions
from cellapp.robot.kinematics.transforms import Array

# -- Information in correlated residuals: band spectra of the noise, and the covariance of the estimate ---------------
#
# Neighbouring residuals of a motion are correlated. Their covariance is modelled as stationary within a recording: in
# the basis of the discrete cosine transform along time it is nearly diagonal, with one variance s_b for each band b of
# frequencies and each recording. With orthonormal columns Q = X L^-T (``L L^T = X^T X + P``), band grams ``G_b = Q_b^T
# Q_b`` and band energies ``E_b = |r_b|^2`` of the residuals, least squares leaves
#
#     E[E_b] = sum_c K_bc s_c,   K_bc = delta_bc (n_b - 2 tr G_b) + tr(G_b G_c),
#
# which is solved for s (Rao, J. Multivar. Anal. 1 (1971) 257: minimum norm quadratic unbiased estimation), so that the
# part absorbed by the fit is restored. The covariance of the estimate is ``L^-T (sum_b s_b G_b + L^-1 P L^-T) L^-1``.

_PER_OCTAVE = 2
"""Bands of frequency per octave."""
_LEAST_FREEDOM = 24.0
"""Least degrees of freedom of a band after the fit; bands with fewer are joined to the next."""
_MEMORY_S = 0.2
"""Memory of a whitening filter, and its largest number of samples."""
_MOST_ORDER = 40
_LEAST_LEVEL = 1e-6
"""Least level: residuals a thousand times below the stated ones are those of a fit without degrees of freedom."""
_LEAST_SHARE = 0.3
"""Share of the plain variance of a band below which the solution is attributed to chance, and the plain one is used."""


@dataclass(frozen=True, eq=False)
class Bands:
    """Residuals and columns of one source in bands of frequency, the slowest first.

    Attributes
    ----------
    columns : array of int, shape (k,)
        Indices of the source's columns among all parameters.
    count : array, shape (B,)
        Coordinates in each band, less those removed from it.
    gram : array, shape (B, k, k)
        ``X^T X`` of each band.
    product : array, shape (B, k)
        ``X^T r``.
    square : array, shape (B,)
        ``r^T r``.
    uneven : array, shape (k,)
        Mean square of the products of columns and residuals, relative to that for residuals of uniform size: above 1 if
        points scatter most where, and in the direction in which, a parameter moves them, as by timestamp jitter.
    """

    columns: NDArray[np.intp] = field(repr=False)
    count: NDArray[np.intp] | Array = field(repr=False)
    gram: Array = field(repr=False)
    product: Array = field(repr=False)
    square: Array = field(repr=False)
    uneven: Array = field(repr=False)

    def energy(self, step: Array) -> Array:
        """Return the sum of squares of the residuals of each band (B,) after a step (K,) of all parameters."""
        own = step[self.columns]
        return np.asarray(self.square - 2.0 * self.product @ own + np.einsum("i,bij,j->b", own, self.gram, own))

    def of(self, chosen: NDArray[np.bool_]) -> Bands:
        """Return the bands for some of the columns, renumbered in order."""
        gram = self.gram[:, chosen][:, :, chosen]
        return Bands(
            np.arange(len(gram[0])), self.count, gram, self.product[:, chosen], self.square, self.uneven[chosen]
        )

    def normal(self) -> Array:
        """Return the products of columns and residuals with each other (k + 1, k + 1), summed over all bands."""
        product = self.product.sum(axis=0)
        return np.block([[self.gram.sum(axis=0), product[:, None]], [product, self.square.sum()]])


def bands_of(X: Array, columns: NDArray[np.intp], r: Array, *, in_time: bool) -> Bands:
    """Compute the bands of residuals ``r`` (m, 3) with columns ``X`` (m, 3, k), both times the root of their weight.

    Without ``in_time`` all rows are independent and form one band.
    """
    m = len(r)
    edges = [0, m]
    uneven = np.sum(np.einsum("mak,ma->mk", X, r) ** 2, axis=0) / np.maximum(
        np.mean(r**2) * np.sum(X**2, axis=(0, 1)), 1e-300
    )
    if in_time:
        X, r = scipy.fft.dct(X, axis=0, norm="ortho"), scipy.fft.dct(r, axis=0, norm="ortho")
        octaves = np.arange(0.0, np.log2(max(m, 2)), 1.0 / _PER_OCTAVE)
        edges = np.unique(np.concatenate([[0], np.round(2.0**octaves), [m]])).astype(np.intp).tolist()
    parts = [slice(first, last) for first, last in pairwise(edges)]
    flat = [(X[part].reshape(-1, X.shape[2]), r[part].ravel()) for part in parts]
    return Bands(
        columns,
        np.array([len(its_r) for _, its_r in flat]),
        np.stack([its_X.T @ its_X for its_X, _ in flat]),
        np.stack([its_X.T @ its_r for its_X, its_r in flat]),
        np.array([float(its_r @ its_r) for _, its_r in flat]),
        np.maximum(uneven, 1.0),
    )


@dataclass(frozen=True, eq=False)
class Modelled:
    """Residuals with a covariance from elsewhere, in no band: their ``X^T X`` (K, K), and the covariance of their ``X^T
    r`` (K, K)."""

    information: Array
    spread: Array


def with_priors(information: Array, precision: Array) -> tuple[Array, Array]:
    """Return units (K,) in which ``information`` (K, K) and the precision (K,) of priors have together a unit diagonal,
    and their sum (K, K) in these units."""
    unit = 1.0 / np.sqrt(np.diag(information) + precision + 1e-300)
    return unit, information * unit * unit[:, None] + np.diag(precision * unit**2)


def noise_model(
    sources: Sequence[Bands],
    worths: Sequence[float],
    step: Array,
    precision: Array,
    information: Array,
    modelled: Modelled | None = None,
) -> tuple[Array, tuple[float, ...]]:
    """Estimate the covariance (k, k) of an estimate from residuals after ``step``, which are correlated in time.

    Return also the level of each source: the variance of a weighted residual as it affects the parameters, the mean of
    the band variances weighted by the information in each band. It is 1 if weights are right.

    Parameters
    ----------
    sources : sequence of Bands
    worths : sequence of float
        Factor of the weights of each source.
    step : array, shape (K,)
    precision : array, shape (K,)
        Precision of the priors; zero without a prior.
    information : array, shape (K, K)
        ``X^T X`` with the weights and worths.
    modelled : Modelled, optional
        Residuals that are in no band.
    """
    unit, H = with_priors(information, precision)
    L = np.linalg.cholesky(H + 1e-12 * np.eye(len(H)))
    root = scipy.linalg.solve_triangular(L, np.diag(unit), lower=True)  # L^-1 in the parameters' units
    by_source = [_joined_bands(source, worth, step, root) for source, worth in zip(sources, worths, strict=True)]
    count, grams, energy = (np.concatenate(arrays) for arrays in zip(*by_source, strict=True))
    s = _variances(count, grams, energy)
    of_source = np.split(np.arange(len(s)), np.cumsum([len(its) for its, *_ in by_source])[:-1])
    # the part of the columns lost by averaging over neighbours is faster than all bands
    averaged_out = (root @ information) @ root.T - grams.sum(axis=0)
    if modelled is not None:
        averaged_out = averaged_out - (root @ modelled.information) @ root.T
    inner = np.einsum("b,bij->ij", s, grams) + max(s[own[-1]] for own in of_source) * averaged_out
    uneven = np.ones(len(H))
    for source in sources:
        uneven[source.columns] = np.maximum(uneven[source.columns], source.uneven)
    covariance = (root.T @ inner @ root) * np.sqrt(np.outer(uneven, uneven))
    covariance = covariance + root.T @ ((root * precision) @ root.T) @ root
    if modelled is not None:
        by_step = root.T @ root
        covariance = covariance + by_step @ modelled.spread @ by_step
    return covariance, tuple(_level(grams[own], s[own]) for own in of_source)


def whitening_filter(r: Array, period_s: float) -> Array:
    """Return filter coefficients (p + 1,), the first 1, that whiten residuals ``r`` (n, 3) in order of time: those of
    an autoregressive model by the Yule-Walker equations."""
    order = int(np.clip(_MEMORY_S / period_s, 2, _MOST_ORDER))
    size = scipy.fft.next_fast_len(len(r) + order, real=True)
    power = np.abs(scipy.fft.rfft(r, size, axis=0)) ** 2
    covariance = scipy.fft.irfft(power.sum(axis=1), size)[: order + 1]
    covariance[0] *= 1.0 + 1e-9
    return np.concatenate([[1.0], -scipy.linalg.solve_toeplitz(covariance[:-1], covariance[1:])])


def _joined_bands(source: Bands, worth: float, step: Array, root: Array) -> tuple[Array, Array, Array]:
    """Return coordinates (B,), grams of orthonormal columns (B, K, K) and energies (B,) of the bands of one source;
    those with few degrees of freedom are joined to the next faster one."""
    own = root[:, source.columns]
    grams = worth * (own @ source.gram @ own.T)
    energies = np.maximum(worth * source.energy(step), 0.0)  # rounding makes them negative if a fit leaves nothing
    starts, free = [0], 0.0
    for place, freedom in enumerate((source.count - grams.trace(axis1=1, axis2=2)).tolist(), start=1):
        free += freedom
        if free >= _LEAST_FREEDOM:
            starts, free = [*starts, place], 0.0
    if len(starts) > 1:
        starts.pop()  # what follows the last complete band, if anything, joins it
    count, grams, energies = (np.add.reduceat(one, starts) for one in (source.count, grams, energies))
    return count, grams, energies


def _variances(count: Array, grams: Array, energy: Array) -> Array:
    """Return the variance of each band."""
    absorbed, flat = grams.trace(axis1=1, axis2=2), grams.reshape(len(grams), -1)
    s = np.linalg.lstsq(np.diag(count - 2.0 * absorbed) + flat @ flat.T, energy, rcond=None)[0]
    plain = energy / np.maximum(count - absorbed, 1.0)
    return np.asarray(np.where(s > _LEAST_SHARE * plain, s, plain))


def _level(grams: Array, s: Array) -> float:
    tells = grams.trace(axis1=1, axis2=2)
    return max(float(tells @ s / tells.sum()), _LEAST_LEVEL) if tells.sum() > 0.0 else 1.0


_BLOCK_RATE = 25.0
"""Averaged residuals per second for estimating the noise: motion and its correlation are slower."""
_MOST_BLOCKS = 8000


@dataclass(frozen=True, eq=False)
class Stops:
    """Readings at rest: joint positions (n, N) [rad], points (n, 3) [m], their standard uncertainty (n,) [m], the sign
    of each joint's last motion (n, N), 0 if unknown, and that motion (n, N) [rad], NaN if unknown. ``learnt`` (n,)
    masks those that a fit may use."""

    q: Array
    p_M: Array
    sigma_m: Array | None
    approach: Array
    learnt: NDArray[np.bool_]
    step: Array | None = None


@dataclass(frozen=True, eq=False)
class MotionProblem:
    """Fitting problem of one arm: its recordings and stops, and priors about the start.

    Its parameters are those of the geometry, of the terms of joints, then the offsets and the rate of each recording.
    Its sources are the recordings, and last the stops if there are any.
    """

    start: Geometry
    parameters: ParameterSet
    terms: tuple[JointTerm, ...]
    tracks: tuple[Track, ...]
    stops: Stops | None
    mean: Array = field(repr=False)
    precision: Array = field(repr=False)
    spreads: tuple[PriorSpread, ...]
    masses: Masses | None = None
    whitening: tuple[Array, ...] | None = None

    @property
    def geometric(self) -> int:
        """Number of parameters of the geometry."""
        return len(self.parameters.columns)

    @property
    def arm(self) -> int:
        """Number of parameters of the arm: geometry and terms."""
        return self.geometric + len(self.terms)

    def clock(self, number: int) -> NDArray[np.intp]:
        """Return the indices of the offsets and the rate of one recording; none for the stops after these."""
        sizes = [len(track.clock_s) for track in self.tracks]
        first = self.arm + sum(sizes[:number])
        return np.arange(first, first + sum(sizes[number : number + 1]))

    def columns_of(self, number: int) -> NDArray[np.intp]:
        """Return the indices of the parameters that move the points of one source."""
        return np.concatenate([np.arange(self.arm), self.clock(number)])

    def filter_of(self, number: int) -> Array | None:
        """Return the filter in time that whitens the residuals of a source; None for the stops, or if there is none."""
        return self.whitening[number] if self.whitening is not None and number < len(self.tracks) else None

    def with_terms(self, terms: Sequence[JointTerm]) -> MotionProblem:
        """Return the problem with these terms; those that it has already keep their priors."""
        own = slice(self.geometric, self.arm)
        known = dict(zip(self.terms, zip(self.mean[own].tolist(), self.precision[own].tolist(), strict=True)))
        priors = [known.get(term, (term.prior_mean, 1.0 / term.prior_sd**2)) for term in terms]
        mean, precision = (
            np.concatenate([one[: own.start], its, one[own.stop :]])
            for one, its in ((self.mean, [m for m, _ in priors]), (self.precision, [p for _, p in priors]))
        )
        return replace(self, terms=tuple(terms), mean=mean, precision=precision)

    @property
    def holders(self) -> tuple[Track | Stops, ...]:
        """The recordings, and last the stops if there are any."""
        return self.tracks if self.stops is None else (*self.tracks, self.stops)

    @property
    def learnt(self) -> list[NDArray[np.intp]]:
        """Rows of every source that the fit may use."""
        return [np.flatnonzero(its.learnt) for its in self.holders]

    def geometry(self, values: Array) -> Geometry:
        """Return the geometry at values of the parameters."""
        return self.parameters.moved(self.start, values[: self.geometric])

    def joints(self, values: Array, number: int, rows: NDArray[np.intp]) -> JointState:
        """Return the state of the joints at some rows of one source."""
        holder = self.holders[number]
        masses = self.masses if any(term.law.needs_torques for term in self.terms) else None
        if isinstance(holder, Track):
            return state_in_motion(holder.path, holder.controller_times(rows, values[self.clock(number)]), masses)
        step = None if holder.step is None else holder.step[rows]
        return state_at_rest(holder.q[rows], holder.approach[rows], masses, step)


Sums = tuple[Array, Array, Bands]
"""Normal equations of one source in its own columns: ``X^T X`` and ``X^T r`` in total, and by frequency band."""


def residuals(problem: MotionProblem, values: Array, number: int, rows: NDArray[np.intp]) -> Array:
    """Return measured less computed points (n, 3) [m] of some rows of one source."""
    residual, geometry = np.empty((len(rows), 3)), problem.geometry(values)
    of_terms = values[problem.geometric : problem.arm]
    for first in range(0, len(rows), CHUNK):
        part = rows[first : first + CHUNK]
        state = problem.joints(values, number, part)
        q = state.q + state.offsets(problem.terms, of_terms)
        residual[first : first + CHUNK] = problem.holders[number].p_M[part] - smr_positions(geometry, q)
    return residual


def sums_of(
    problem: MotionProblem,
    values: Array,
    number: int,
    rows: NDArray[np.intp],
    root: Array,
    whitening: Array | None = None,
) -> Sums:
    """Sum over ``rows`` of one source, each weighted by the square of ``root`` (n,) [1/m].

    ``whitening`` is a filter in time, applied to columns and residuals.
    """
    from scipy.signal import lfilter  # it loads scipy.stats: commands without recordings need not wait for that

    holder, columns = problem.holders[number], problem.columns_of(number)
    k = len(columns)
    A, b = np.zeros((k, k)), np.zeros(k)
    past = 0 if whitening is None else len(whitening) - 1
    memory_X, memory_r = np.zeros((3, k, past)), np.zeros((3, past))
    parts, each = [], _block_length(holder, len(rows), _MOST_BLOCKS)
    for X, residual, weight, q in _chunks(problem, values, number, rows, root, each):
        if whitening is not None:
            X, memory_X = lfilter(whitening, [1.0], X, zi=memory_X)
            residual, memory_r = lfilter(whitening, [1.0], residual, zi=memory_r)
        flat = X.swapaxes(0, 1).reshape(k, -1)
        A += flat @ flat.T
        b += flat @ residual.ravel()
        parts.append(_averaged(X, residual, weight, q, each))
    X, residual, _ = _joined(parts)
    return A, b, bands_of(X, columns, residual, in_time=isinstance(holder, Track))


def averages_of(
    problem: MotionProblem, values: Array, number: int, rows: NDArray[np.intp], root: Array, most: int
) -> tuple[Array, Array, Array]:
    """Return weighted columns (m, 3, k), residuals (m, 3) and joint positions (m, N) of a source, averaged over
    neighbours so that sums are preserved: up to ``most`` averages of ``rows`` of a recording, or the stops without
    averaging, weighted by the square of ``root`` (n,) [1/m]."""
    each = _block_length(problem.holders[number], len(rows), most)
    return _joined([_averaged(*chunk, each) for chunk in _chunks(problem, values, number, rows, root, each)])


def _chunks(
    problem: MotionProblem, values: Array, number: int, rows: NDArray[np.intp], root: Array, each: int
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Yield weighted columns (3, k, n) and residuals (3, n), weights (n,) and joint positions (n, N), in chunks of
    whole averages of ``each`` points."""
    holder, k, arm = problem.holders[number], len(problem.columns_of(number)), problem.arm
    geometry = problem.geometry(values)
    step = max(1, CHUNK // each) * each
    for first in range(0, len(rows), step):
        part, weight = rows[first : first + step], root[first : first + step]
        state = problem.joints(values, number, part)
        X = np.empty((3, k, len(part)))
        P, by_joint = _arm_columns(problem, values, geometry, state, X[:, :arm])
        if isinstance(holder, Track):
            moved = np.einsum("ajn,nj->an", by_joint, state.qd)
            segment = holder.segment[part]
            for place in range(k - arm - 1):
                np.multiply(moved, -(segment == place).astype(np.float64), out=X[:, arm + place])
            np.multiply(moved, holder.middle_s - holder.time_s[part], out=X[:, -1])
        X *= weight
        yield X, (holder.p_M[part].T - P) * weight, weight, state.q


def _averaged(X: Array, residual: Array, weight: Array, q: Array, each: int) -> tuple[Array, Array, Array]:
    """Average one chunk over ``each`` neighbours."""
    starts = np.arange(0, len(weight), each)
    total = np.sqrt(np.maximum(np.add.reduceat(weight**2, starts), 1e-300))
    share = weight / total.repeat(each)[: len(weight)]
    return (
        np.add.reduceat(X * share, starts, axis=2).transpose(2, 0, 1),
        np.add.reduceat(residual * share, starts, axis=1).T,
        q[starts],
    )


def _joined(parts: Sequence[tuple[Array, Array, Array]]) -> tuple[Array, Array, Array]:
    X, r, q = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return X, r, q


def _arm_columns(
    problem: MotionProblem, values: Array, geometry: Geometry, state: JointState, out: Array
) -> tuple[Array, Array]:
    """Return computed points (3, n) and derivatives by the joints (3, N, n); write those by parameters to ``out``."""
    size, parameters = problem.geometric, problem.parameters
    units = [term.offset(state) for term in problem.terms]
    angles = JointAngles.of(state.q + state.offsets(problem.terms, values[size : problem.arm], units))
    thetas = tuple(6 + 5 * joint for joint in range(parameters.joints))
    plain = set(parameters.columns).difference(first for _, first in parameters.tied)
    added = tuple(theta for theta in thetas if theta not in plain)
    P, J = parameters.jacobian(geometry, angles, added)
    out[:, :size] = J[:, len(added) :]
    every = added + parameters.columns
    by_joint = J[:, [every.index(theta) for theta in thetas]]
    for number, (term, unit) in enumerate(zip(problem.terms, units, strict=True)):
        np.multiply(by_joint[:, term.joint], unit, out=out[:, size + number])
    return P, by_joint


def _block_length(holder: Track | Stops, count: int, most: int) -> int:
    """Return the number of neighbours to average for the noise estimate, in at most ``most`` blocks; one for stops."""
    if not isinstance(holder, Track):
        return 1
    return min(max(round(1.0 / holder.stamps.period_s / _BLOCK_RATE), -(-count // most), 1), CHUNK)
