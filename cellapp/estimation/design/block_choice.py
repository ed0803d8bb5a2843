"""Greedy choice of stops with exchange, in random subsets of the candidates; the order of the chosen ones.

Sources: Fedorov, Theory of Optimal Experiments (1972), chapter 3 (exchange); Mirzasoleiman et al., Lazier than lazy
greedy, AAAI 2015 (random subsets lose little).

All candidates are looked at in single precision and to first order only, a few hundred of them exactly, and the best of
these are followed in double precision from change to change: gains change slowly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellapp.estimation.calibration.linear import inverse_psd
from cellapp.estimation.design.block_design import BlockDesign, Criterion, Rows, information_of
from cellapp.ground.progress import CancelToken
from cellapp.robot.kinematics.transforms import Array

_SMALLEST_BATCH = 20
"""Stops of a batch of the first choice: with fewer the fresh subset costs more than the choice."""
_FIRST_BATCH = 5
"""The same at the very beginning: the first stops reduce the variance of base and SMR a thousandfold each, and
updates lose as many digits."""
_SAMPLED = 4000
"""Candidates at least of which the mean information is taken: errors are then known to a percent."""
_ORDERED_AT_ONCE = 100
"""Stops that are put in order until gains are computed afresh."""
_FOLLOWED_IN_ORDER = 400
"""Candidates that are followed while they are put in order: the first stops change all gains."""
_LEAST_FOLLOWED = 80
"""Candidates that are followed at least: with fewer the best for a later stop of the batch may not be among them."""


@dataclass(frozen=True)
class Effort:
    """How long a choice may take; the result improves slowly with all of these.

    Attributes
    ----------
    subset : int
        Candidates that are looked at together: in the first choice drawn anew for every batch.
    promising : int
        In an exchange the candidates that promise most in the whole pass, beside as many as are chosen.
    shortlist : int
        Of these the best for each stop of a batch are followed from change to change, 80 at least in all.
    batches : int
        Batches in which the first choice is made, of at least 20 stops.
    batch : int
        Exchanges with the same subset.
    exchanges : int
        Exchanges in all, in one or more passes with new weights W before each; in a pass stops of the least
        information come first.
    passes : int
        Passes at most.
    ordered : int
        Stops at the beginning that are put in order.
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
    """What is chosen from: whitened ``rows`` (m, 3, p), and the information (p, p) that is there before."""

    rows: Array
    prior: Array

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def mean_information(self) -> Array:
        """Mean information (p, p) of a candidate, of many a sample."""
        some = self.rows[:: max(1, len(self.rows) // _SAMPLED)]
        return information_of(some) / max(len(some), 1)

    def information(self, chosen: Rows) -> Array:
        """Information (p, p) of a design."""
        return self.prior + information_of(self.rows[chosen])

    def covariance(self, chosen: Rows) -> Array:
        """Covariance (p, p) of a design."""
        return inverse_psd(self.information(chosen))


def choose_blocks(
    candidates: Candidates,
    count: int,
    criterion: Criterion,
    rng: np.random.Generator,
    effort: Effort = Effort(),
    cancel: CancelToken | None = None,
) -> Rows:
    """Numbers of ``count`` candidates that tell most; all of them where there are no more."""
    cancel = cancel or CancelToken()
    if count >= len(candidates):
        return np.arange(len(candidates))
    random = candidates.prior + candidates.mean_information * count
    chosen = _greedy(candidates, count, criterion.weights(inverse_psd(random)), rng, effort, cancel)
    best = criterion.value(candidates.covariance(chosen))
    for _ in range(min(effort.passes, -(-effort.exchanges // max(count, 1)))):
        exchanged = _exchanged(candidates, chosen, criterion, effort, cancel)
        value = criterion.value(candidates.covariance(exchanged))
        if value >= best:  # the linear criterion became better, the true one did not
            break
        chosen, best = exchanged, value
    return chosen


def most_informative_first(candidates: Candidates, chosen: Rows, criterion: Criterion) -> Rows:
    """The chosen candidates in greedy order from the first one on; behind ``Effort.ordered`` of them as they are."""
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
    """Stops until gains are computed afresh: fewer at the beginning, where each of them changes most of all gains."""
    return min(asked, max(_FIRST_BATCH, chosen))


def _best(candidates: Candidates, information: Array, W: Array, among: Rows, number: int, followed: int) -> list[int]:
    """The best of some candidates one after the other beside others of some information (p, p)."""
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
    """Stop after stop the largest gain among a subset."""
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
    """Each chosen stop, the one of the least information first, against the best of the others, or itself."""
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
    """Candidates that are followed while a batch of stops is chosen."""
    return max(effort.shortlist * batch, _LEAST_FOLLOWED)
