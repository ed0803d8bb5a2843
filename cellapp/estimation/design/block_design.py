"""Choice of n of m candidates (blocks of three rows each): optimal for parameters and predictions, nearly minimax.

With whitened rows x_i (3, p) of each candidate and prior information P, a design D has the covariance
C = (P + sum_{i in D} x_i^T x_i)^-1. It is judged by

    J(C) = a ln mean_k (s_k / r_k) + b ln mean_j u_j + c ln (mean_j u_j^h)^(1/h),

with s_k the standard errors of the wanted parameters and r_k those of a random design of the same size, and u_j the
standard uncertainties of predictions at points of the workspace; the high power h approximates the worst point. At a
given design dJ = tr(W dC) with W positive semidefinite: an L-criterion, which greedy choice and exchange reduce
(Fedorov, Theory of Optimal Experiments, 1972, chapter 2). Adding a candidate x changes it by

    tr(C W) - tr(C' W) = tr((I + V)^-1 U),    V = x C x^T,    U = x C W C x^T    (both 3 by 3),

removing one by -tr((I - V)^-1 U). After every change of the design by k candidates, C, C W C, and V and U of some
hundred candidates are updated by matrices of rank 3 k (Woodbury). From time to time all are computed anew, with a new
W.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import inverse_psd
from cellapp.ground.progress import UNTOLD, JobSteps
from cellapp.robot.kinematics.transforms import Array

WORST_POWER = 12.0
"""h: with it the largest of some hundred uncertainties dominates, and those within a few per cent of it count too."""
SHARES = (1.5, 1.0, 3.0)
"""Exponents a, b, c of the three errors in the criterion. A larger share improves the worst point while the two others
hardly lose: at 1 a design of 100 stops is worth 205 random ones there, at 3 or more 245, with the parameters at 142
throughout. With 1.5 for the parameters, these gain what a choice near the best stops would lose."""
_ROWS_AT_ONCE = 6000
"""Batch size of rows for conversion of precision and products."""
_ROWS_CHANGED = 300
"""Number of changed rows after which the matrices are computed anew from them."""
Rows = NDArray[np.intp]
"""Indices of candidates."""


@dataclass(frozen=True, eq=False)
class Criterion:
    """Criterion for the quality of a design.

    Attributes
    ----------
    reference : array, shape (k,)
        Standard errors of the first k of p parameters with a random design; the others are nuisance parameters.
    points : array, shape (s, 3, p)
        Derivatives of predictions with respect to the parameters.
    """

    reference: Array
    points: Array

    def value(self, covariance: Array) -> float:
        """Return J; the difference between two designs does not depend on units."""
        ratios, points = self.parts(covariance)
        largest = points.max()
        worst = math.log(largest) + math.log(np.mean((points / largest) ** WORST_POWER)) / WORST_POWER
        terms = (math.log(np.mean(ratios)), math.log(np.mean(points)), worst)
        return sum(share * term for share, term in zip(SHARES, terms, strict=True))

    def weights(self, covariance: Array) -> Array:
        """Return W = dJ / dC (p, p)."""
        by_parameters, by_mean, by_worst = SHARES
        ratios, points = self.parts(covariance)
        high = (points / points.max()) ** (WORST_POWER - 1.0)
        # ds = dC_kk / (2 s) of a standard error, du = tr(F dC F^T) / (2 u) of a prediction
        by_point = (by_mean / points.sum() + by_worst * high / (high @ points)) / (2.0 * points)
        rows = self.points.reshape(-1, len(covariance))
        W = (rows * np.repeat(by_point, 3)[:, None]).T @ rows
        wanted = np.arange(len(self.reference))
        W[wanted, wanted] += by_parameters / (2.0 * ratios.sum() * ratios * self.reference**2)
        return np.asarray(W)

    def parts(self, covariance: Array) -> tuple[Array, Array]:
        """Return ratios (k,) of standard errors and uncertainties (s,) of predictions."""
        ratios = np.sqrt(np.diag(covariance)[: len(self.reference)]) / self.reference
        rows = self.points.reshape(-1, len(covariance))
        squares = np.einsum("rp,rp->r", rows @ covariance, rows)
        return ratios, np.sqrt(squares.reshape(-1, 3).sum(axis=1))


def information_of(rows: Array) -> Array:
    """Return the information matrix (p, p) of blocks of rows (n, 3, p), in double precision."""
    flat = rows.reshape(-1, rows.shape[2])
    total = np.zeros((rows.shape[2], rows.shape[2]))
    for first in range(0, len(flat), _ROWS_AT_ONCE):
        part = flat[first : first + _ROWS_AT_ONCE].astype(np.float64, copy=False)
        total += part.T @ part
    return total


def reference_errors(mean_information: Array, count: int, prior: Array, wanted: int) -> Array:
    """Return standard errors (wanted,) of a design of ``count`` random candidates with a mean information (p, p)."""
    covariance = inverse_psd(prior + mean_information * count)
    return np.asarray(np.sqrt(np.diag(covariance)[:wanted]))


class BlockDesign:
    """Design that changes by a few candidates at a time.

    Parameters
    ----------
    information : array, shape (p, p)
        Prior information with that of the candidates in the design; positive definite.
    weights : array, shape (p, p)
        W.
    """

    def __init__(self, information: Array, weights: Array) -> None:
        self._C = inverse_psd(information)
        self._CWC = self._C @ weights @ self._C
        self._steps, self._changed = np.empty((3, _ROWS_CHANGED, len(weights))), 0
        """Rows A, S, B of the latest changes: the present ones are C - A^T S and CWC - S^T B - B^T S."""
        self.track(np.empty((0, 3, len(weights))))

    @property
    def covariance(self) -> Array:
        """C (p, p) of the present design."""
        self._update()
        return self._C

    def _update(self) -> None:
        if self._changed:
            A, S, B = self._steps[:, : self._changed]
            half = S.T @ B
            self._C, self._CWC, self._changed = self._C - A.T @ S, self._CWC - (half + half.T), 0

    def screened(self, rows: Array, count: int) -> Rows:
        """Return the indices of the ``count`` largest tr(U) among candidates ``rows`` (s, 3, p), the largest first.

        This is the gain to first order, in the precision of the rows: to rank the best candidates, track them.
        """
        _, S, B = self._steps[:, : self._changed].astype(rows.dtype)
        CWC, squares = self._CWC.astype(rows.dtype), [np.empty(0)]
        flat = rows.reshape(-1, rows.shape[2])
        for first in range(0, len(flat), _ROWS_AT_ONCE):
            part = flat[first : first + _ROWS_AT_ONCE]
            square = np.einsum("rp,rp->r", part @ CWC, part)
            squares.append(square - 2.0 * np.einsum("rk,rk->r", part @ S.T, part @ B.T) if self._changed else square)
        return np.argsort(-np.concatenate(squares).reshape(-1, 3).sum(axis=1), kind="stable")[:count]

    def track(self, rows: Array) -> None:
        """Track the gains of candidates ``rows`` (s, 3, p) from now on, instead of the previous ones.

        Comparisons use double precision: in single precision the last digits of the processor's BLAS decide between
        nearly equal candidates, and the same seed gives other plans on other processors.
        """
        self._update()
        self._rows = rows.astype(np.float64).reshape(-1, rows.shape[2])
        self._V, self._U = (_products(self._rows @ matrix, self._rows) for matrix in (self._C, self._CWC))

    def gains(self, sign: float = 1.0) -> Array:
        """Return the decrease of tr(C W) by adding each tracked candidate (s,), with ``sign`` -1 the increase by
        removing it; valid for those in the design."""
        return trace_of_solution(self._V, self._U, sign)

    def change(self, rows: Array, signs: Array | float = 1.0) -> None:
        """Add candidates by their ``rows`` (3 k, p), or remove those whose rows have ``signs`` -1."""
        if self._changed + len(rows) > _ROWS_CHANGED:
            self._update()
        rows, end = rows.astype(np.float64), self._changed
        A, S, B = self._steps[:, :end]
        Cx = rows @ self._C - (rows @ A.T) @ S
        H = rows @ self._CWC - (rows @ S.T) @ B - (rows @ B.T) @ S
        G = np.linalg.solve(np.diag(np.broadcast_to(signs, len(rows))) + Cx @ rows.T, Cx)
        self._changed = end + len(rows)
        new = self._steps[:, end : self._changed]
        new[:] = Cx, G, H - 0.5 * (H @ rows.T) @ G
        by_Cx, by_G, by_B = np.split(self._rows @ new.reshape(-1, new.shape[2]).T, 3, axis=1)
        self._V = self._V - _products(by_Cx, by_G)
        half = _products(by_G, by_B)
        self._U = self._U - (half + half.transpose(0, 2, 1))

    def change_best(self, count: int, together: int, sign: float = 1.0) -> Rows:
        """Add the ``count`` best tracked candidates, ``together`` at a time, or remove those with ``sign`` -1 that can
        best be missed; return their indices in this order."""
        best, outside = list[int](), np.zeros(len(self._V))
        rows = self._rows.reshape(len(self._V), 3, len(self._C))
        while len(best) < count:
            some = np.argsort(outside - sign * self.gains(sign), kind="stable")[: min(together, count - len(best))]
            outside[some] = np.inf
            best += some.tolist()
            self.change(rows[some].reshape(-1, len(self._C)), sign)
        return np.array(best, dtype=np.intp)


def _products(first: Array, second: Array) -> Array:
    """Return the products (s, 3, 3) of blocks of three rows (3 s, k) of each of two arrays."""
    return first.reshape(-1, 3, first.shape[1]) @ second.reshape(-1, 3, second.shape[1]).transpose(0, 2, 1)


def trace_of_solution(V: Array, U: Array, sign: float) -> Array:
    """Return tr((I + sign V)^-1 U) (s,) of matrices (s, 3, 3)."""
    return np.asarray(np.trace(np.linalg.solve(np.eye(3) + sign * V, U), axis1=1, axis2=2))


# -- Greedy choice of stops with exchange, in random subsets of the candidates; order of the chosen stops -------------
#
# Sources: Fedorov, Theory of Optimal Experiments (1972), chapter 3 (exchange); Mirzasoleiman et al., Lazier than lazy
# greedy, AAAI 2015 (random subsets lose little).
#
# Candidates are screened to first order; the best of them are updated in double precision after each change.

SUBSET = 600
"""Number of candidates looked at for each batch of the first choice."""
PASSES = 2
"""Largest number of passes of exchanges, each with new weights W: as with the subset, the result improves slowly."""
_BATCHES = 6
"""Number of batches of the first choice; each draws a new subset."""
_SMALLEST_BATCH = 20
"""Smallest batch of the first choice: with fewer stops the new subset costs more than the choice."""
_FIRST_BATCH = 5
"""Batch size at the very beginning: the first stops reduce the variance of base and SMR a thousandfold each, and
updates lose as many digits."""
_SAMPLED = 4000
"""Least number of candidates for the mean information: its errors are then about a percent."""
_TOGETHER = 100
"""Stops of a design for which one candidate is added, or removed, at a time: the gains hardly change by that."""
_FOLLOWED = 50
"""Number of tracked candidates, or two for each stop of a batch: with fewer, the best for a later one may be missing.
"""
_EXCHANGED_AT_ONCE = 40
"""Number of stops that are taken away at once: one update, where one by one took as many as there are stops."""
_PROMISING = 400
"""Most promising candidates of a pass of exchanges, in addition to the number of chosen ones."""
_NEXT = 4
"""Of the candidates, so many times as many are looked at by the next pass."""
_LEAST_NEW = 0.2
"""A pass ends where a smaller share of the stops is exchanged for others: those that follow tell more."""
_MISSED = 0.3
"""Share of the stops that is ordered: spare ones, reserves, and those in whose place others are repeated."""
_LIKELY_MISSED = 2
"""For each of these, number of stops that are compared: those that can best be missed before any is."""
_MOST_EXCHANGED = 420
"""Most exchanges of a pass; the stops of least information come first."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates: whitened ``rows`` (m, 3, p), and the prior information (p, p)."""

    rows: Array
    prior: Array

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def mean_information(self) -> Array:
        """Mean information (p, p) of a candidate, from a sample if there are many."""
        some = self.rows[:: max(1, len(self.rows) // _SAMPLED)]
        return information_of(some) / max(len(some), 1)

    def information(self, chosen: Rows) -> Array:
        """Return the information (p, p) of a design."""
        return self.prior + information_of(self.rows[chosen])

    def covariance(self, chosen: Rows) -> Array:
        """Return the covariance (p, p) of a design."""
        return inverse_psd(self.information(chosen))

    def design(self, chosen: Rows, criterion: Criterion) -> BlockDesign:
        """Return the design of the ``chosen`` candidates, which it tracks, with the weights W there."""
        design = BlockDesign(self.information(chosen), criterion.weights(self.covariance(chosen)))
        design.track(self.rows[chosen])
        return design


def choose_blocks(
    candidates: Candidates,
    count: int,
    criterion: Criterion,
    rng: np.random.Generator,
    steps: JobSteps = UNTOLD,
    grown: Callable[[Rows, int], Candidates] | None = None,
) -> Rows:
    """Choose ``count`` candidates by greedy selection and exchange; return their indices, all if there are no more.

    Given the present choice and the number of a pass of exchanges, ``grown`` appends candidates for it.
    ``steps`` are told how many were chosen so far, then ``count`` more for those whose exchange was tried.
    """
    if count >= len(candidates):
        return np.arange(len(candidates))
    random = candidates.prior + candidates.mean_information * count
    chosen = _greedy(candidates, count, criterion.weights(inverse_psd(random)), rng, steps)
    best, among = criterion.value(candidates.covariance(chosen)), np.arange(len(candidates))
    for number in range(PASSES):
        if grown is not None:
            before, candidates = len(candidates), grown(chosen, number)
            among = np.append(among, np.arange(before, len(candidates)))
        exchanged, among = _exchanged(candidates, chosen, among, criterion, steps)
        value = criterion.value(candidates.covariance(exchanged))
        if value >= best:  # only the linear criterion improved
            break
        chosen, best = exchanged, value
    return chosen


def least_informative_last(candidates: Candidates, chosen: Rows, criterion: Criterion) -> Rows:
    """Move the stops that can best be missed to the end, the best one last."""
    design, missed = candidates.design(chosen, criterion), round(_MISSED * len(chosen))
    likely = np.sort(np.argsort(design.gains(-1.0), kind="stable")[: _LIKELY_MISSED * missed])
    design.track(candidates.rows[chosen[likely]])
    last = design.change_best(missed, _together(len(chosen)), -1.0)
    return np.concatenate([np.delete(chosen, likely[last]), chosen[likely[last[::-1]]]])


def _together(stops: int) -> int:
    """Return how many candidates are added to a design of ``stops``, or removed, at a time."""
    return max(1, min(stops // _TOGETHER, _ROWS_CHANGED // 3))


def _greedy(candidates: Candidates, count: int, W: Array, rng: np.random.Generator, steps: JobSteps) -> Rows:
    """Choose the largest gains in subsets, few stops at a time."""
    free = np.ones(len(candidates), dtype=bool)
    size = max(_SMALLEST_BATCH, -(-count // _BATCHES))
    information, before = candidates.prior, 0
    while before < count:
        steps.check()
        design = BlockDesign(information, W)
        among = rng.permutation(np.flatnonzero(free))[: max(SUBSET, 2 * size)]
        among = among[design.screened(candidates.rows[among], max(_FOLLOWED, 2 * size))]
        design.track(candidates.rows[among])
        # smaller batches at the beginning, where gains change most
        come = among[design.change_best(min(size, max(_FIRST_BATCH, before), count - before), _together(before))]
        free[come] = False
        before += len(come)
        steps(before, "choice")
        information = information + information_of(candidates.rows[come])
    return np.flatnonzero(~free)


def _exchanged(
    candidates: Candidates, chosen: Rows, among: Rows, criterion: Criterion, steps: JobSteps
) -> tuple[Rows, Rows]:
    """Take the chosen stops away, some at a time, and add the best of these and of the other candidates instead.

    Those of least information come first.

    Return the new choice and the most promising ``among`` the candidates, for the next pass.
    """
    design = candidates.design(chosen, criterion)
    queue = chosen[np.argsort(design.gains(-1.0), kind="stable")][:_MOST_EXCHANGED]
    free = np.ones(len(candidates), dtype=bool)
    free[chosen] = False
    most = _PROMISING + len(chosen)
    among = among[design.screened(candidates.rows[among], _NEXT * most)]
    promising = among[:most]
    for first in range(0, len(queue), _EXCHANGED_AT_ONCE):
        steps.check()
        steps(len(chosen) + first, "exchange")
        leaving = queue[first : first + _EXCHANGED_AT_ONCE]
        coming = promising[free[promising]]
        coming = coming[design.screened(candidates.rows[coming], _FOLLOWED)]
        looked_at = np.concatenate([leaving, coming])
        design.track(candidates.rows[looked_at])
        design.change(candidates.rows[leaving].reshape(-1, candidates.rows.shape[2]), -1.0)
        come = design.change_best(len(leaving), _together(len(chosen)))
        free[leaving], free[looked_at[come]] = True, False
        if np.sum(come >= len(leaving)) < _LEAST_NEW * len(leaving):
            break
    return np.flatnonzero(~free), among


# ---------------------------------------------------------------------------------------------------------------------
# Phase coverage: close gaps without stops in a joint's range that exceed a limit, at the least loss of information.
#
# An error with many periods a turn shows only if stops fall on all of its phases. Gaps measure this coverage; the
# information matrix does not.


GAP_OF_EVEN_STOPS = 4.0
"""Default limit of a gap, in units of the gap of evenly spread stops. With random stops the largest gap is about the
natural logarithm of their number: 4.6 for 100, 6 for 400."""
_EMPTY_SHARE = 0.02
"""Share of a joint's range above which a part without any candidate counts as unreachable."""
_EMPTY_SPACINGS = 10.0
"""The same limit for few candidates, in mean distances between them: longer gaps do not occur by chance."""
_IMMOVABLE = 1e-12
"""Replacement of a zero limit, for a joint that does not move [rad]."""
_MOST_LOOKED_AT = 100
"""Most candidates examined for one gap: more of them differ little."""


def largest_gaps(q: Array) -> Array:
    """Return the largest gap between stops of each joint (N,), for configurations ``q`` (n, N) [rad]."""
    return np.asarray(np.diff(np.sort(q, axis=0), axis=0).max(axis=0, initial=0.0))


def without_turns(q: Array, candidates: Array) -> Array:
    """Subtract from ``q`` (n, N) [rad] the whole turns between it and the middle of the ``candidates`` (m, N).

    A plan may reach a candidate with joints turned once more: the phase of an error with a period of one turn or less
    is the same.
    """
    middle = 0.5 * (candidates.min(axis=0) + candidates.max(axis=0))
    turn = 2.0 * np.pi
    return np.asarray(q - turn * np.round((q - middle) / turn))


def gap_limits(q: Array, count: int, asked: float | None) -> Array:
    """Return the limit of each joint's gaps (N,) [rad]: ``asked``, else from ``count`` stops and ``q`` (m, N)."""
    if asked is not None:
        return np.full(q.shape[1], asked)
    steps = np.diff(np.sort(q, axis=0), axis=0)
    empty = max(_EMPTY_SHARE, _EMPTY_SPACINGS / len(q)) * steps.sum(axis=0)
    reached = np.where(steps <= empty, steps, 0.0).sum(axis=0)
    return np.asarray(GAP_OF_EVEN_STOPS * reached / max(count, 1))


def close_gaps(
    candidates: Candidates,
    q: Array,
    chosen: Rows,
    criterion: Criterion,
    limits: Array,
    kept: Array,
    rng: np.random.Generator,
    steps: JobSteps,
) -> Rows:
    """Exchange stops until no candidate can close another gap.

    Parameters
    ----------
    candidates : Candidates
    q : array, shape (m, N)
        Their joint positions [rad].
    chosen : array, shape (n,)
    criterion : Criterion
        The candidate with the largest gain among those that close a gap is added; the stop with the least loss among
        those not needed for any gap is removed.
    limits : array, shape (N,)
        [rad]
    kept : array, shape (k, N)
        Further stops of the plan [rad].
    """
    design = candidates.design(chosen, criterion)
    staying, added = np.ones(len(chosen), dtype=bool), list[int]()
    hopeless = set[tuple[int, float]]()
    ends = np.stack([q.min(axis=0), q.max(axis=0)])
    for _ in range(len(chosen)):
        steps.check()
        stops = np.concatenate([q[chosen[staying]], q[added], kept])
        inside = _closing(q, np.concatenate([stops, ends]), limits, hopeless)
        if inside is None:
            break
        inside = rng.permutation(np.setdiff1d(inside, chosen[staying]))[:_MOST_LOOKED_AT]
        best = int(inside[design.screened(candidates.rows[inside].astype(np.float64), 1)[0]])
        free = staying & _dispensable(np.concatenate([stops, q[[best]]]), limits, staying)
        if not free.any():
            break
        leaving = int(np.argmin(np.where(free, design.gains(-1.0), np.inf)))
        design.change(candidates.rows[[best, chosen[leaving]]].reshape(6, -1), np.repeat([1.0, -1.0], 3))
        staying[leaving] = False
        added.append(best)
    return np.concatenate([chosen[staying], np.array(added, dtype=np.intp)])


def _closing(q: Array, stops: Array, limits: Array, hopeless: set[tuple[int, float]]) -> Rows | None:
    """Return the candidates that close the longest gap of ``stops`` (ends included), or a good part of it; None if none
    can.

    ``hopeless`` gaps (joint, beginning) have no candidate; those found are added.
    """
    ends = np.sort(stops, axis=0)
    ratio = np.diff(ends, axis=0) / np.maximum(limits, _IMMOVABLE)
    rows, joints = np.nonzero(ratio > 1.0)
    longest = np.argsort(-ratio[rows, joints], kind="stable")
    for row, joint in zip(rows[longest].tolist(), joints[longest].tolist(), strict=True):
        low, high, limit = ends[row, joint], ends[row + 1, joint], limits[joint]
        if (joint, float(low)) in hopeless:
            continue
        margin = limit / 2.0 if high - low >= 2.0 * limit else high - low - limit
        inside = np.flatnonzero((q[:, joint] >= low + margin) & (q[:, joint] <= high - margin))
        if len(inside):
            return inside
        hopeless.add((joint, float(low)))
    return None


def _dispensable(stops: Array, limits: Array, staying: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the first stops (those ``staying``) whose removal opens no gap beyond any limit."""
    order = np.argsort(stops, axis=0)
    ordered = np.take_along_axis(stops, order, axis=0)
    without = np.zeros_like(ordered, dtype=bool)
    without[1:-1] = ordered[2:] - ordered[:-2] <= limits[None]
    spare = np.empty_like(without)
    np.put_along_axis(spare, order, without, axis=0)
    found = np.zeros(len(staying), dtype=bool)
    found[staying] = np.logical_and.reduce(spare, axis=1)[: int(staying.sum())]
    return found
