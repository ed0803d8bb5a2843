"""Greedy choice of stops with exchange, in random subsets of the candidates; order of the chosen stops.

Sources: Fedorov, Theory of Optimal Experiments (1972), chapter 3 (exchange); Mirzasoleiman et al., Lazier than lazy
greedy, AAAI 2015 (random subsets lose little).

All candidates are screened in single precision and to first order only, a few hundred of them exactly. The best of
these are updated in double precision after each change, as gains change slowly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.linear import inverse_psd
from cellapp.estimation.design.block_design import BlockDesign, Criterion, Rows, information_of
from cellapp.ground.progress import CancelToken
from cellapp.robot.kinematics.transforms import Array

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
) -> Rows:
    """Choose ``count`` candidates by greedy selection and exchange; return their indices, all if there are no more."""
    cancel = cancel or CancelToken()
    if count >= len(candidates):
        return np.arange(len(candidates))
    random = candidates.prior + candidates.mean_information * count
    chosen = _greedy(candidates, count, criterion.weights(inverse_psd(random)), rng, effort, cancel)
    best = criterion.value(candidates.covariance(chosen))
    for _ in range(min(effort.passes, -(-effort.exchanges // max(count, 1)))):
        exchanged = _exchanged(candidates, chosen, criterion, effort, cancel)
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
    candidates: Candidates, count: int, W: Array, rng: np.random.Generator, effort: Effort, cancel: CancelToken
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
        information = information + information_of(candidates.rows[come])
    return np.flatnonzero(~free)


def _exchanged(candidates: Candidates, chosen: Rows, criterion: Criterion, effort: Effort, cancel: CancelToken) -> Rows:
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
