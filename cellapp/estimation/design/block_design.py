"""Choice of n of m candidates (blocks of three rows each): optimal for parameters and predictions, nearly minimax.

With whitened rows x_i (3, p) of each candidate and prior information P, a design D has the covariance
C = (P + sum_{i in D} x_i^T x_i)^-1. It is judged by

    J(C) = a ln mean_k (s_k / r_k) + b ln mean_j u_j + c ln (mean_j u_j^h)^(1/h),

with s_k the standard errors of the wanted parameters and r_k those of a random design of the same size, and u_j the
standard uncertainties of predictions at points of the workspace; the high power h approximates the worst point. At a
given design dJ = tr(W dC) with W positive semidefinite: an L-criterion, which greedy choice and exchange reduce
(Fedorov, Theory of Optimal Experiments, 1972, chapter 2). Adding a candidate x changes it by

    tr(C W) - tr(C' W) = tr((I + V)^-1 U),    V = x C x^T,    U = x C W C x^T    (both 3 by 3),

removing one by -tr((I - V)^-1 U). After every change of the design, V and U of many candidates are updated by products
with matrices of rank three (Woodbury), O(p) for each. From time to time both are computed anew, with a new W.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import inverse_psd
from cellapp.ground.progress import CancelToken
from cellapp.robot.kinematics.transforms import Array

WORST_POWER = 12.0
"""h: with it the largest of some hundred uncertainties dominates, and those within a few per cent of it count too."""
_ROWS_AT_ONCE = 6000
"""Batch size of rows for conversion of precision and products."""
_LEFT_OUT = 0.02
"""Share of the trace of C W C that the screening of all candidates neglects."""
_FIRST_ORDER = 2
"""Candidates with the largest first-order gains that are computed exactly, for each one requested."""
_APART = 40
"""Number of changes after which C and C W C are updated: until then products with narrow matrices represent them."""
Rows = NDArray[np.intp]
"""Indices of candidates."""
Floats = NDArray[np.floating[Any]]
"""Array in single or double precision."""


class Shares(NamedTuple):
    """Exponents a, b, c of the three errors in the criterion.

    A larger share improves the worst point while the two others hardly lose: at 1 a design of 100 stops is worth 205
    random ones there, at 3 or more 245, with the parameters at 142 throughout.
    """

    parameters: float = 1.0
    mean: float = 1.0
    worst: float = 3.0


class DesignErrors(NamedTuple):
    """Mean ratio of standard errors to the reference ones; mean and largest uncertainty of a prediction."""

    parameters: float
    mean: float
    worst: float


@dataclass(frozen=True, eq=False)
class Criterion:
    """Criterion for the quality of a design.

    Attributes
    ----------
    reference : array, shape (k,)
        Standard errors of the first k of p parameters with a random design; the others are nuisance parameters.
    points : array, shape (s, 3, p)
        Derivatives of predictions with respect to the parameters.
    shares : Shares
    """

    reference: Array
    points: Array
    shares: Shares = field(default_factory=Shares)

    def errors(self, covariance: Array) -> DesignErrors:
        """Return the three errors of a design with a covariance (p, p)."""
        ratios, points = self._parts(covariance)
        return DesignErrors(float(np.mean(ratios)), float(np.mean(points)), float(points.max()))

    def value(self, covariance: Array) -> float:
        """Return J; the difference between two designs does not depend on units."""
        ratios, points = self._parts(covariance)
        largest = points.max()
        worst = math.log(largest) + math.log(np.mean((points / largest) ** WORST_POWER)) / WORST_POWER
        terms = (math.log(np.mean(ratios)), math.log(np.mean(points)), worst)
        return sum(share * term for share, term in zip(self.shares, terms, strict=True))

    def weights(self, covariance: Array) -> Array:
        """Return W = dJ / dC (p, p)."""
        ratios, points = self._parts(covariance)
        high = (points / points.max()) ** (WORST_POWER - 1.0)
        # ds = dC_kk / (2 s) of a standard error, du = tr(F dC F^T) / (2 u) of a prediction
        by_point = (self.shares.mean / points.sum() + self.shares.worst * high / (high @ points)) / (2.0 * points)
        rows = self.points.reshape(-1, len(covariance))
        W = (rows * np.repeat(by_point, 3)[:, None]).T @ rows
        wanted = np.arange(len(self.reference))
        W[wanted, wanted] += self.shares.parameters / (2.0 * ratios.sum() * ratios * self.reference**2)
        return np.asarray(W)

    def _parts(self, covariance: Array) -> tuple[Array, Array]:
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


class _Change(NamedTuple):
    """Change of C to C - sign G G^T, and of C W C to C W C - G B^T - B G^T: the three columns of G and of B (6, p)."""

    columns: Array
    sign: float


@dataclass(eq=False)
class _Tracked:
    """Candidates with the six elements (6, s) of V and of U, updated as the design changes; ``rows`` are (p, 3 s).

    Comparisons use double precision: in single precision the last digits of the processor's BLAS decide between nearly
    equal candidates, and the same seed gives other plans on other processors.
    """

    rows: Floats
    V: Array
    U: Array

    @classmethod
    def of(cls, rows: Floats, C: Floats, CWC: Floats) -> _Tracked:
        """Build from candidates (s, 3, p)."""
        flat = np.ascontiguousarray(rows.transpose(2, 1, 0)).reshape(rows.shape[2], -1)
        return cls(flat, *(_products(rows, _ahead(rows, matrix)) for matrix in (C, CWC)))

    def follow(self, changes: Sequence[_Change]) -> None:
        """Apply changes one after the other; the slow part, reading the rows, is done once for all of them."""
        if not changes or not self.rows.size:
            return
        products = np.concatenate([change.columns for change in changes]) @ self.rows
        for change, both in zip(changes, products.reshape(len(changes), 2, 3, 3, -1), strict=True):
            (G, B), (G_other, B_other) = both[:, :, ROW], both[:, :, COLUMN]
            self.V -= change.sign * np.einsum("cem,cem->em", G, G_other)
            self.U -= np.einsum("cem,cem->em", G, B_other)
            self.U -= np.einsum("cem,cem->em", B, G_other)

    def traces(self, sign: float) -> Array:
        """Return tr((I + sign V)^-1 U) (s,)."""
        return trace_of_solution(self.V, self.U, sign)


def _ahead(rows: Floats, matrix: Floats) -> Floats:
    """Return ``x C`` (s, 3, p) of candidates."""
    return np.asarray((rows.reshape(-1, rows.shape[2]) @ matrix).reshape(rows.shape))


def _products(rows: Floats, ahead: Floats) -> Array:
    """Return the elements (6, s) of ``x C x^T`` of candidates x, given ``x C``."""
    whole = np.einsum("sap,sbp->abs", ahead, rows)
    return np.asarray(whole[ROW, COLUMN])


def _inverse_root(matrix: Array) -> Array:
    """Return the inverse Cholesky factor of a matrix (3, 3), in scalar arithmetic: a tenth of the time of calls."""
    (a, _, _), (b, d, _), (c, e, f) = matrix.tolist()
    i = 1.0 / math.sqrt(a)
    b, c = b * i, c * i
    k = 1.0 / math.sqrt(d - b * b)
    e = (e - b * c) * k
    m = 1.0 / math.sqrt(f - c * c - e * e)
    return np.array([[i, 0.0, 0.0], [-b * i * k, k, 0.0], [(b * e * k - c) * i * m, -e * k * m, m]])


class BlockDesign:
    """Design that changes by one candidate at a time.

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
        self._tracked = _Tracked(np.empty((len(information), 0)), np.empty((6, 0)), np.empty((6, 0)))
        self._apart = np.empty((3, 3 * _APART, len(information)))
        self._columns = 0
        """G, G with the sign of the change, and B of changes not yet in the two matrices, as rows."""
        self._unfollowed: list[_Change] = []
        """Changes since the last request of gains or losses."""

    @property
    def covariance(self) -> Array:
        """C (p, p) of the present design."""
        return self._matrices()[0]

    def largest(self, rows: Array, count: int) -> Rows:
        """Return the indices of the ``count`` largest gains among candidates ``rows`` (s, 3, p), unsorted.

        In single precision: to rank the best candidates, track them.
        """
        if count >= len(rows):
            return np.arange(len(rows))
        C, CWC = (matrix.astype(np.float32) for matrix in self._matrices())
        ahead = _ahead(rows, CWC)
        first_order = np.einsum("sap,sap->s", ahead, rows)  # tr(U), the first-order gain: a third of the time
        looked_at = np.argpartition(-first_order, min(_FIRST_ORDER * count, len(rows) - 1))[: _FIRST_ORDER * count]
        near = rows[looked_at].astype(np.float32, copy=False)
        V, U = _products(near, _ahead(near, C)), _products(near, ahead[looked_at])
        return looked_at[np.argpartition(-trace_of_solution(V, U, 1.0), count)[:count]]

    def promising(self, rows: Array, count: int) -> Rows:
        """Return the indices of the ``count`` largest tr(U), the first-order gain, among candidates ``rows`` (s, 3, p).

        Only the largest eigenvalues of C W C are used, which hold all but a few per cent of its trace.
        """
        if count >= len(rows):
            return np.arange(len(rows))
        values, vectors = np.linalg.eigh(self._matrices()[1])
        needed = len(values) - int(np.searchsorted(np.cumsum(values), _LEFT_OUT * values.sum()))
        root = (vectors[:, -needed:] * np.sqrt(values[-needed:])).astype(np.float32)
        flat = rows.reshape(-1, rows.shape[2])
        squares = np.empty(len(flat), dtype=np.float32)
        for first in range(0, len(flat), _ROWS_AT_ONCE):
            part = slice(first, first + _ROWS_AT_ONCE)
            seen = flat[part].astype(np.float32, copy=False) @ root
            squares[part] = np.einsum("rk,rk->r", seen, seen)
        score = squares.reshape(-1, 3).sum(axis=1)
        return np.argpartition(-score, count)[:count]

    def track(self, rows: Array) -> None:
        """Track the gains and losses of candidates ``rows`` (s, 3, p) from now on, instead of the previous ones."""
        self._tracked, self._unfollowed = _Tracked.of(rows.astype(np.float64, copy=False), *self._matrices()), []

    def gains(self) -> Array:
        """Return the decrease of the criterion tr(C W) by adding each tracked candidate (s,)."""
        return self._followed().traces(1.0)

    def gains_of(self, rows: Array) -> Array:
        """Return ``gains`` of other candidates ``rows`` (s, 3, p)."""
        return _Tracked.of(rows.astype(np.float64, copy=False), *self._matrices()).traces(1.0)

    def losses(self) -> Array:
        """Return the increase by removing each tracked candidate (s,); valid for those in the design."""
        return self._followed().traces(-1.0)

    def add(self, row: Array) -> None:
        """Add a candidate ``row`` (3, p)."""
        self._change(row, 1.0)

    def remove(self, row: Array) -> None:
        """Remove a candidate ``row`` (3, p) of the design."""
        self._change(row, -1.0)

    def _followed(self) -> _Tracked:
        """Apply all pending changes to the tracked candidates and return them."""
        self._tracked.follow(self._unfollowed)
        self._unfollowed = []
        return self._tracked

    def _matrices(self) -> tuple[Array, Array]:
        """Return C and C W C of the present design."""
        G, signed, B = self._apart[:, : self._columns]
        self._C -= signed.T @ G
        half = G.T @ B
        self._CWC -= half + half.T
        self._columns = 0
        return self._C, self._CWC

    def _change(self, row: Array, sign: float) -> None:
        if self._columns == self._apart.shape[1]:
            self._matrices()
        row = row.astype(np.float64, copy=False)
        G_before, signed, B_before = self._apart[:, : self._columns]
        x_G = row @ G_before.T
        Cx = row @ self._C - x_G @ signed  # (3, p), as all that follows
        H = row @ self._CWC - (row @ B_before.T) @ G_before - x_G @ B_before
        root = _inverse_root(np.eye(3) + sign * (Cx @ row.T))
        G = root @ Cx
        B = sign * (root @ H) - 0.5 * (root @ (H @ row.T) @ root.T) @ G
        columns = np.concatenate([G, B])
        self._unfollowed.append(_Change(columns, sign))
        self._apart[:, self._columns : self._columns + 3] = G, sign * G, B
        self._columns += 3


# ---------------------------------------------------------------------------------------------------------------------
# Symmetric matrices (3, 3) of many candidates by their six distinct elements: faster than one call for each matrix.


ROW, COLUMN = np.triu_indices(3)
"""Indices of the six distinct elements of a symmetric matrix (3, 3)."""
_COFACTORS = np.array([(3, 5, 4, 4), (2, 4, 1, 5), (1, 4, 2, 3), (0, 5, 2, 2), (1, 2, 0, 4), (0, 3, 1, 1)]).T
"""Elements whose two products give each of its cofactors: the first less the second."""
_TWICE = np.where(ROW == COLUMN, 1.0, 2.0)


def trace_of_solution(V: Array, U: Array, sign: float) -> Array:
    """Return tr((I + sign V)^-1 U) (s,) of symmetric matrices with elements (6, s), by cofactors."""
    A = sign * V
    A[_TWICE == 1.0] += 1.0
    first, second, third, fourth = A[_COFACTORS]
    cofactors = first * second - third * fourth
    determinant = np.einsum("es,es->s", A[:3], cofactors[:3])
    return np.asarray(np.einsum("e,es,es->s", _TWICE, cofactors, U) / determinant)


# -- Greedy choice of stops with exchange, in random subsets of the candidates; order of the chosen stops -------------
#
# Sources: Fedorov, Theory of Optimal Experiments (1972), chapter 3 (exchange); Mirzasoleiman et al., Lazier than lazy
# greedy, AAAI 2015 (random subsets lose little).
#
# All candidates are screened in single precision and to first order only, a few hundred of them exactly. The best of
# these are updated in double precision after each change, as gains change slowly.

_SMALLEST_BATCH = 20
"""Smallest batch of the first choice: with fewer stops the new subset costs more than the choice."""
_FIRST_BATCH = 5
"""Batch size at the very beginning: the first stops reduce the variance of base and SMR a thousandfold each, and
updates lose as many digits."""
_SAMPLED = 4000
"""Least number of candidates for the mean information: its errors are then about a percent."""
_ORDERED_AT_ONCE = 100
"""Batch size of ordering, after which gains are computed anew."""
_FOLLOWED_IN_ORDER = 400
"""Number of candidates tracked during ordering: the first stops change all gains."""
_LEAST_FOLLOWED = 80
"""Least number of tracked candidates: with fewer, the best for a later stop of the batch may be missing."""


@dataclass(frozen=True)
class Effort:
    """Limits on the computing time of a choice; the result improves slowly with all of them.

    Attributes
    ----------
    subset : int
        Candidates in a subset; the first choice draws a new one for every batch.
    promising : int
        Most promising candidates of the whole pass in an exchange, in addition to the number of chosen ones.
    shortlist : int
        Best of these for each stop of a batch, tracked from change to change, 80 at least in total.
    batches : int
        Number of batches of the first choice, of at least 20 stops each.
    batch : int
        Number of exchanges with the same subset.
    exchanges : int
        Total number of exchanges, in one or more passes with new weights W before each; in a pass the stops of least
        information come first.
    passes : int
        Largest number of passes.
    ordered : int
        Number of stops at the beginning that are ordered.
    """

    subset: int = 1000
    promising: int = 400
    shortlist: int = 2
    batches: int = 20
    batch: int = 40
    exchanges: int = 840
    passes: int = 6
    ordered: int = 400


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


def choose_blocks(
    candidates: Candidates,
    count: int,
    criterion: Criterion,
    rng: np.random.Generator,
    effort: Effort = Effort(),
    cancel: CancelToken | None = None,
    told: Callable[[int], object] = int,
) -> Rows:
    """Choose ``count`` candidates by greedy selection and exchange; return their indices, all if there are no more.

    ``told`` is called with how many were chosen so far, then with ``count`` more for those whose exchange was tried.
    """
    cancel = cancel or CancelToken()
    if count >= len(candidates):
        return np.arange(len(candidates))
    random = candidates.prior + candidates.mean_information * count
    chosen = _greedy(candidates, count, criterion.weights(inverse_psd(random)), rng, effort, cancel, told)
    best = criterion.value(candidates.covariance(chosen))
    for _ in range(min(effort.passes, -(-effort.exchanges // max(count, 1)))):
        exchanged = _exchanged(candidates, chosen, criterion, effort, cancel, told)
        value = criterion.value(candidates.covariance(exchanged))
        if value >= best:  # only the linear criterion improved
            break
        chosen, best = exchanged, value
    return chosen


def most_informative_first(candidates: Candidates, chosen: Rows, criterion: Criterion) -> Rows:
    """Sort the chosen candidates in greedy order; after the first ``Effort.ordered`` leave them as they are."""
    effort = Effort()
    if len(chosen) < 2:
        return chosen
    early = candidates.prior + information_of(candidates.rows[chosen]) / 4.0
    weights = criterion.weights(inverse_psd(early))
    left = np.ones(len(candidates), dtype=bool)
    order = list[int]()
    while len(order) < min(effort.ordered, len(chosen)):
        number = min(_batch(_ORDERED_AT_ONCE, len(order)), effort.ordered - len(order))
        rest = chosen[left[chosen]]
        before = candidates.information(np.array(order, dtype=np.intp))
        order += _best(candidates, before, weights, rest, number, _FOLLOWED_IN_ORDER)
        left[order] = False
    return np.concatenate([np.array(order, dtype=np.intp), chosen[left[chosen]]])


def _batch(asked: int, chosen: int) -> int:
    """Return the batch size until gains are computed anew: smaller at the beginning, where gains change most."""
    return min(asked, max(_FIRST_BATCH, chosen))


def _best(candidates: Candidates, information: Array, W: Array, among: Rows, number: int, followed: int) -> list[int]:
    """Return the best candidates in greedy order, beside others with some information (p, p)."""
    design = BlockDesign(information, W)
    among = among[design.largest(candidates.rows[among], followed)]
    rows = candidates.rows[among].astype(np.float64, copy=False)
    design.track(rows)
    free = np.zeros(len(among))
    found = list[int]()
    for _ in range(min(number, len(among))):
        best = int(np.argmax(design.gains() + free))
        free[best] = -np.inf
        found.append(int(among[best]))
        design.add(rows[best])
    return found


def _greedy(
    candidates: Candidates,
    count: int,
    W: Array,
    rng: np.random.Generator,
    effort: Effort,
    cancel: CancelToken,
    told: Callable[[int], object],
) -> Rows:
    """Choose stop by stop the largest gain in a subset."""
    free = np.ones(len(candidates), dtype=bool)
    size = max(_SMALLEST_BATCH, -(-count // effort.batches))
    information, before = candidates.prior, 0
    while before < count:
        cancel.check()
        subset = np.asarray(rng.permutation(np.flatnonzero(free))[: max(effort.subset, 2 * size)])
        number = min(_batch(size, before), count - before)
        come = _best(candidates, information, W, subset, number, _followed(effort, number))
        free[come] = False
        before += len(come)
        told(before)
        information = information + information_of(candidates.rows[come])
    return np.flatnonzero(~free)


def _exchanged(
    candidates: Candidates,
    chosen: Rows,
    criterion: Criterion,
    effort: Effort,
    cancel: CancelToken,
    told: Callable[[int], object],
) -> Rows:
    """Exchange each chosen stop, that of least information first, for the best other candidate or itself."""
    information = candidates.information(chosen)
    W = criterion.weights(inverse_psd(information))
    design = BlockDesign(information, W)
    design.track(candidates.rows[chosen])
    queue = chosen[np.argsort(design.losses(), kind="stable")][: effort.exchanges]
    free = np.ones(len(candidates), dtype=bool)
    free[chosen] = False
    promising = np.sort(design.promising(candidates.rows, effort.promising + len(chosen)))
    for first in range(0, len(queue), effort.batch):
        cancel.check()
        told(len(chosen) + first)
        leaving = queue[first : first + effort.batch]
        coming = promising[free[promising]]
        coming = coming[design.largest(candidates.rows[coming], _followed(effort, effort.batch))]
        looked_at = np.concatenate([leaving, coming])
        rows = candidates.rows[looked_at].astype(np.float64, copy=False)
        design.track(rows)
        outside = np.where(free[looked_at], 0.0, -np.inf)
        for place in range(len(leaving)):
            if outside[place] == 0.0:
                continue
            design.remove(rows[place])
            outside[place] = 0.0
            best = int(np.argmax(design.gains() + outside))
            outside[best] = -np.inf
            design.add(rows[best])
        free[looked_at] = outside == 0.0
    return np.flatnonzero(~free)


def _followed(effort: Effort, batch: int) -> int:
    """Return the number of candidates to track while a batch of stops is chosen."""
    return max(effort.shortlist * batch, _LEAST_FOLLOWED)


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
_FOLLOWED = 200
"""Number of stops whose losses are tracked, those of least loss first."""
_COMPARED = 8
"""Number of the best of these that are compared in double precision."""


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
    cancel: CancelToken,
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
    design = BlockDesign(candidates.information(chosen), criterion.weights(candidates.covariance(chosen)))
    design.track(candidates.rows[chosen])
    easy = np.argsort(design.losses(), kind="stable")  # losses change slowly: only the first ones are tracked
    easy, later = easy[:_FOLLOWED], easy[_FOLLOWED:]
    design.track(candidates.rows[chosen[easy]])
    staying, added = np.ones(len(chosen), dtype=bool), list[int]()
    hopeless = set[tuple[int, float]]()
    ends = np.stack([q.min(axis=0), q.max(axis=0)])
    for _ in range(len(chosen)):
        cancel.check()
        stops = np.concatenate([q[chosen[staying]], q[added], kept])
        inside = _closing(q, np.concatenate([stops, ends]), limits, hopeless)
        if inside is None:
            break
        inside = rng.permutation(np.setdiff1d(inside, chosen[staying]))[:_MOST_LOOKED_AT]
        inside = inside[design.largest(candidates.rows[inside], _COMPARED)]
        best = int(inside[np.argmax(design.gains_of(candidates.rows[inside]))])
        free = staying & _dispensable(np.concatenate([stops, q[[best]]]), limits, staying)
        while not free[easy].any() and len(later):
            easy, later = later[:_FOLLOWED], later[_FOLLOWED:]
            design.track(candidates.rows[chosen[easy]])
        if not free[easy].any():
            break
        leaving = int(easy[np.argmin(np.where(free[easy], design.losses(), np.inf))])
        design.add(candidates.rows[best])
        design.remove(candidates.rows[chosen[leaving]])
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
