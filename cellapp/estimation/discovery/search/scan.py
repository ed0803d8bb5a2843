"""Scan of all candidate laws: the score of each on the residual in the complement of the model's parameters.

A law is a group of columns in blocks. Its score is

    score = -f ln(1 - R^2) - k ln f - 2 ln T,

where f are the coordinates less the model's parameters, k the visible columns and T the number of laws tried. It is the
gain of the Bayesian information criterion (see ``estimation.discovery.joint_fit``) less the price of choosing
among T onsets or time constants (a uniform prior over them, on the scale of twice the log likelihood).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.design.information import (
    SMALLEST,
    VISIBLE,
    Behind,
    NuisanceProjector,
    detectable_size,
    visible_root,
    visible_squares,
)
from cellapp.estimation.discovery.arm_data import Block, CandidateLaw, LawScore
from cellapp.estimation.discovery.joint_fit import MOST_SHARE, ProjectedResidual, bic_gain
from cellapp.ground.grouping import grouped
from cellapp.robot.effects import Law
from cellapp.robot.kinematics.transforms import Array

_MOST_LAWS = 10
"""Number of laws of one effect, ranked by their best single block, whose blocks are selected in full. A selection costs
a hundred times as much, and among dozens of onsets neighbours differ little."""
_SLACK = 1.0
"""Score by which a selection may exceed the bound, as barely visible directions are cut: far below what decides."""
NO_DISPLACEMENT = 1e-9
"""Whitened norm below which a column does not move the SMR: far below the standard uncertainty, which is 1."""
_GRAMS_AT_ONCE = 256
"""Batch size for Gram matrices of blocks: it bounds the memory for copies of their rows."""


def choice_price(law: Law) -> float:
    """Return the price of choosing a law among T tried ones, subtracted from its score: 2 ln T."""
    return 2.0 * math.log(max(law.tried, 1))


@dataclass(frozen=True, eq=False)
class _BlockGroup:
    """Blocks of one size k: candidate index (b,), column indices (b, k), information root (b, k, k) and rank (b,)."""

    candidate: NDArray[np.intp]
    places: NDArray[np.intp]
    root: Array
    rank: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class LawScan:
    """Candidate laws in the complement of a model's parameters.

    Attributes
    ----------
    candidates : tuple of CandidateLaw
    behind : Behind
        All columns of all candidates.
    first : array, shape (candidates,)
        First row of each candidate.
    visible_share : array, shape (total m,)
        Share of each column's norm that the model's parameters cannot explain.
    groups : tuple of _BlockGroup
        Blocks of equal size together, without those that only refine others.
    freedom : float
        Number of coordinates less the model's parameters that they determine, f.
    """

    candidates: tuple[CandidateLaw, ...]
    behind: Behind
    first: NDArray[np.intp]
    visible_share: Array
    groups: tuple[_BlockGroup, ...]
    freedom: float

    @classmethod
    def of(cls, candidates: Sequence[CandidateLaw], projector: NuisanceProjector) -> LawScan:
        """Project all columns of the candidates onto the complement of the model's parameters."""
        first = np.concatenate([[0], np.cumsum([len(one.columns) for one in candidates])]).astype(np.intp)
        rows = np.empty((int(first[-1]), len(projector.basis)))
        # candidates become views of one array; their own arrays are freed as they are copied
        own = list(candidates)
        del candidates
        for number, (begin, end) in enumerate(pairwise(first.tolist())):
            rows[begin:end] = own[number].rows
            own[number] = replace(own[number], rows=rows[begin:end])
        return cls._of_rows(tuple(own), first[:-1], projector.behind(rows), projector.freedom)

    def behind_of(self, projector: NuisanceProjector) -> LawScan:
        """Return the same laws in the complement of another model's parameters; the rows are shared."""
        return self._of_rows(self.candidates, self.first, projector.behind(self.behind.rows), projector.freedom)

    @classmethod
    def _of_rows(
        cls, candidates: tuple[CandidateLaw, ...], first: NDArray[np.intp], behind: Behind, freedom: float
    ) -> LawScan:
        rows = behind.rows
        norms = np.maximum(np.sqrt(np.einsum("md,md->m", rows, rows)), SMALLEST)  # no array of all squares
        by_size = grouped(
            (len(block), (number, block))
            for number, one in enumerate(candidates)
            for block in one.blocks
            if not one.refines(block)
        )
        groups = []
        for entries in by_size.values():
            owner = np.array([number for number, _ in entries], dtype=np.intp)
            places = np.array([block for _, block in entries], dtype=np.intp)
            groups.append(_block_group(behind, norms, first, owner, places))
        return cls(candidates, behind, first, np.sqrt(behind.squares) / norms, tuple(groups), freedom)

    def place(self, number: int) -> slice:
        """Return the slice of a candidate's columns in ``behind`` and ``visible_share``."""
        begin = int(self.first[number])
        return slice(begin, begin + len(self.candidates[number].columns))

    def best_block_scores(self, projected: Array, squares: Array) -> Array:
        """Return scores (candidates, s) by the best single block of each, for residuals M y (d, s) and y^T M y (s,)."""
        best = np.full((len(self.candidates), projected.shape[1]), -np.inf)
        moments = self.behind.rows @ projected
        price = np.array([choice_price(one.law) for one in self.candidates])
        for group in self.groups:
            rows = self.first[group.candidate][:, None] + group.places
            u = np.swapaxes(group.root, 1, 2) @ moments[rows]
            share = np.minimum(np.einsum("bks,bks->bs", u, u) / squares, MOST_SHARE)
            paid = group.rank * math.log(self.freedom) + price[group.candidate]
            value = -self.freedom * np.log1p(-share) - paid[:, None]
            value[group.rank == 0] = -np.inf
            np.maximum.at(best, group.candidate, value)
        return best

    def ranked(
        self, residual: ProjectedResidual, *, with_refinements: bool = False, least: float = -math.inf
    ) -> list[LawScore]:
        """Score the candidates, best first; omit those that no selection of blocks lifts above ``least``.

        Blocks that only refine others are used if ``with_refinements``: an effect is named for its main blocks. For
        each effect only the laws with the best single blocks are selected in full.
        """
        numbers = self._ahead(residual)
        found = [self.score(number, residual, with_refinements=with_refinements, least=least) for number in numbers]
        return sorted((one for one in found if one is not None), key=lambda score: -score.value)

    def best_of_each_effect(self, residual: ProjectedResidual, least: float = -math.inf) -> list[LawScore]:
        """Return the best law of each effect, as ``ranked``; skip laws that cannot beat an earlier one."""
        best: dict[str, LawScore] = {}
        for number in self._ahead(residual):
            slug = self.candidates[number].slug
            known = best.get(slug)
            one = self.score(number, residual, with_refinements=False, least=least if known is None else known.value)
            if one is not None and (known is None or one.value > known.value):
                best[slug] = one
        return sorted(best.values(), key=lambda score: -score.value)

    def _ahead(self, residual: ProjectedResidual) -> list[int]:
        """Return indices of the laws of each effect with the best single blocks, best first."""
        ahead = self.best_block_scores(residual.projected[:, None], np.array([residual.square]))[:, 0]
        by_slug = grouped(
            (self.candidates[number].slug, number)
            for number in np.argsort(-ahead, kind="stable").tolist()
            if np.isfinite(ahead[number])
        )
        return [number for of_effect in by_slug.values() for number in of_effect[:_MOST_LAWS]]

    def score(
        self, number: int, residual: ProjectedResidual, *, with_refinements: bool = True, least: float = -math.inf
    ) -> LawScore | None:
        """Score one candidate with the blocks that it needs.

        None if no block is visible, or if a bound from all its columns is below ``least``.
        """
        one, place = self.candidates[number], self.place(number)
        selection = BlockSelection.of(
            one, self.behind.take(place), self.visible_share[place], residual, with_refinements=with_refinements
        )
        if selection is None:
            return None
        price = choice_price(one.law)
        if least > -math.inf and selection.most() - price < least - _SLACK:
            return None
        chosen, value = selection.select(price)
        return LawScore(one, value - price, tuple(sorted(chosen)), selection.score(chosen)[1])


def _block_group(
    behind: Behind, norms: Array, first: NDArray[np.intp], owner: NDArray[np.intp], places: NDArray[np.intp]
) -> _BlockGroup:
    """Build a group of blocks ``places`` (b, k) of candidates ``owner`` (b,), with the roots of their information."""
    chosen = first[owner][:, None] + places
    size = places.shape[1]
    gram = np.empty((len(chosen), size, size))
    for begin in range(0, len(chosen), _GRAMS_AT_ONCE):
        gram[begin : begin + _GRAMS_AT_ONCE] = behind.take(chosen[begin : begin + _GRAMS_AT_ONCE]).gram()
    root, rank = visible_root(gram, norms[chosen])
    moves = norms[chosen].max(axis=1) > NO_DISPLACEMENT
    return _BlockGroup(owner, places, root * moves[:, None, None], np.where(moves, rank, 0))


# -- Selection of the blocks (joints, lines) of one law that a residual needs: forward, and backward from all ---------
#
# Forward selection adds the best block while the score grows by more than ``NEXT_BLOCK``. If an effect is spread evenly
# over many joints, no single block may gain enough; backward elimination from all blocks is then tried as well (Draper,
# Smith, Applied Regression Analysis, 3rd ed., chapter 15).


NEXT_BLOCK = 10.0
"""Gain of the score at which another block joins: very strong evidence (Kass, Raftery, J. Am. Stat. Ass. 90 (1995)
773), as the residual of a law at one joint often looks a little like another joint's share."""
_MOST_TOGETHER = 24
"""Most columns from which backward elimination starts: six joints with up to four columns each. More at once, as
hundreds of lines, would fit noise."""
_MOST_TRIED = 40
"""Most blocks that forward selection tries in full at each step; of more, the most promising by their own columns."""
_MOST_AT_ONCE = 128
"""Most columns whose information is computed at once; for more, as for hundreds of lines, only as needed."""
_PSEUDO_INVERSE = 1e-10
"""Relative cut-off of singular values where only a ranking depends on it; far above rounding."""


@dataclass(frozen=True, eq=False)
class BlockSelection:
    """The visible blocks of a candidate law and a residual to be explained.

    ``behind`` are the law's rows in the complement of the model's parameters, ``norms`` (m,) those of the original
    rows, ``moments`` (m,) = B M y.
    """

    candidate: CandidateLaw
    behind: Behind
    norms: Array
    moments: Array
    residual: ProjectedResidual
    blocks: tuple[Block, ...]

    @classmethod
    def of(
        cls,
        candidate: CandidateLaw,
        behind: Behind,
        visible_share: Array,
        residual: ProjectedResidual,
        *,
        with_refinements: bool,
    ) -> BlockSelection | None:
        """Take the visible blocks; None if all of these only refine others."""
        wanted = [block for block in candidate.blocks if with_refinements or not candidate.refines(block)]
        trimmed = (tuple(place for place in block if visible_share[place] > VISIBLE) for block in wanted)
        blocks = tuple(block for block in trimmed if block)
        if all(candidate.refines(block) for block in blocks):
            return None
        norms = np.maximum(np.sqrt(np.einsum("md,md->m", candidate.rows, candidate.rows)), SMALLEST)
        return cls(candidate, behind, norms, candidate.rows @ residual.projected, residual, blocks)

    def select(self, price: float) -> tuple[Block, float]:
        """Choose columns; return them and their score. ``price`` is that of the law, paid for each further line."""
        line_price = price if len(self.candidate.blocks) > _MOST_TRIED else 0.0
        chosen, best = self._forward(line_price)
        if len(self.blocks) > 1 and sum(map(len, self.blocks)) <= _MOST_TOGETHER:
            together, value = self._backward()
            if value > best + NEXT_BLOCK:
                return together, value
        return chosen, best

    def score(self, columns: Sequence[int]) -> tuple[float, float]:
        """Return the BIC gain of some columns, without the price of choosing the law, and R^2."""
        return self._scores([tuple(columns)])[0]

    @cached_property
    def _gram(self) -> Array:
        """Information (m, m) of all columns."""
        return self.behind.gram()

    def most(self) -> float:
        """Return an upper bound of any selection's score, without the law's price; infinite for very many columns."""
        if len(self.norms) > _MOST_AT_ONCE:
            return math.inf
        every = tuple(place for block in self.blocks for place in block)
        share = self._scores([every])[0][1]
        return bic_gain(share, self.residual.freedom, 1)

    def _scores(self, sets: Sequence[Block]) -> list[tuple[float, float]]:
        """Return ``score`` of several sets of columns; sets of equal size are computed together."""
        shares, ranks = np.zeros(len(sets)), np.zeros(len(sets), dtype=np.intp)
        sizes = np.array([len(one) for one in sets])
        place = np.concatenate(sets).astype(np.intp)
        used: slice | NDArray[np.intp] = slice(None)
        if len(self.norms) > _MOST_AT_ONCE:
            used, place = np.unique(place, return_inverse=True)
        gram = self._gram if isinstance(used, slice) else self.behind.take(used).gram()
        norms, moments = self.norms[used], self.moments[used]
        first = np.cumsum(sizes) - sizes
        for size in np.unique(sizes).tolist():
            numbers = np.flatnonzero(sizes == size)
            places = place[first[numbers, None] + np.arange(size)]
            of_sets = gram[places[:, :, None], places[:, None, :]]
            explained, ranks[numbers] = visible_squares(of_sets, norms[places], moments[places])
            shares[numbers] = explained / self.residual.square
        found = zip(shares.tolist(), ranks.tolist(), strict=True)
        return [(bic_gain(share, self.residual.freedom, rank), share) for share, rank in found]

    def _best(self, sets: Sequence[Block]) -> tuple[float, int]:
        """Return the best score among sets of columns, and the index of that set."""
        values = [value for value, _ in self._scores(sets)]
        number = max(range(len(sets)), key=lambda k: (values[k], sets[k]))
        return values[number], number

    def _forward(self, line_price: float) -> tuple[Block, float]:
        """Add the best block while the score grows; a block that only refines others cannot be the first."""
        main = [block for block in self.blocks if not self.candidate.refines(block)]
        main = self._promising(main, ())
        best, number = self._best(main)
        chosen = main[number]
        remaining = [block for block in self.blocks if block != chosen]
        while remaining and best > 0.0:
            remaining = self._promising(remaining, chosen)
            top, number = self._best([(*chosen, *block) for block in remaining])
            block = remaining[number]
            if top - line_price <= best + NEXT_BLOCK:
                break
            best, chosen = top - line_price, (*chosen, *block)
            remaining = [other for other in remaining if other != block]
        return chosen, best

    def _backward(self) -> tuple[Block, float]:
        """Start from all blocks and drop the least needed one while that costs less than ``NEXT_BLOCK``."""
        together: Block = tuple(place for block in self.blocks for place in block)
        value = self.score(together)[0]
        while len(together) > 1:
            fewer = []
            for block in self.blocks:
                rest = tuple(place for place in together if place not in block)
                if len(rest) < len(together) and any(not self.candidate.refines((place,)) for place in rest):
                    fewer.append(rest)
            if not fewer:
                break
            top, number = self._best(fewer)
            if top <= value - NEXT_BLOCK:
                break
            together, value = fewer[number], top
        return together, value

    def _promising(self, blocks: list[Block], chosen: Block) -> list[Block]:
        """Return at most ``_MOST_TRIED`` blocks that explain most beside the chosen columns, column by column."""
        if len(blocks) <= _MOST_TRIED:
            return blocks
        moments, information = self.moments, self.behind.squares
        if chosen:
            kept = np.array(chosen, dtype=np.intp)
            cross = self.behind.gram(self.behind.take(kept))
            inverse = np.linalg.pinv(cross[kept], rcond=_PSEUDO_INVERSE, hermitian=True)
            moments = moments - cross @ (inverse @ self.moments[kept])
            information = information - np.einsum("mk,kl,ml->m", cross, inverse, cross)
        floor = 1e-12 * max(float(information.max()), SMALLEST)
        gain = moments**2 / np.maximum(information, floor)
        return sorted(blocks, key=lambda block: -float(gain[list(block)].sum()))[:_MOST_TRIED]


# -- Significance of scores over the whole scan: threshold, p-values, and smallest detectable sizes -------------------
#
# The threshold is a high quantile of the largest score over all laws scanned, in simulated data without effects.
# Searching over many laws therefore does not raise the false-alarm rate (max-T: Westfall, Young, Resampling-Based
# Multiple Testing, 1993).


_TAIL = 0.15
"""Share of the highest null maxima whose excess is modelled as exponential (peaks over threshold): 60 of the default
400 simulations, enough to estimate its mean to 13 %."""

_AT_ONCE = 100
"""Batch size of simulations: bounds the memory."""


def simulate_null_maxima(scan: LawScan, projector: NuisanceProjector, simulations: int, seed: tuple[int, ...]) -> Array:
    """Return the largest score over all candidates in each of ``simulations`` residuals of pure noise, sorted.

    Only single blocks are tried: as a second block must gain more, high quantiles stay the same.
    """
    y = np.random.default_rng(seed).standard_normal((len(projector.basis), simulations))
    if not scan.candidates:
        return np.full(simulations, -math.inf)
    maxima = []
    for first in range(0, simulations, _AT_ONCE):
        some = y[:, first : first + _AT_ONCE]
        projected = projector.project(some.T).T
        maxima.append(scan.best_block_scores(projected, np.einsum("ds,ds->s", some, projected)).max(axis=0))
    return np.sort(np.concatenate(maxima))


def score_threshold(null_maxima: Array, false_alarm: float) -> float:
    """Return the score that noise alone exceeds with probability ``false_alarm``; never below zero.

    In the highest ``_TAIL`` the distribution is modelled as exponential, which steadies quantiles of few simulations.
    """
    if not len(null_maxima) or not np.isfinite(null_maxima).any():
        return 0.0
    start = float(np.quantile(null_maxima, 1.0 - _TAIL))
    if false_alarm >= _TAIL or not math.isfinite(start):
        return max(0.0, float(np.quantile(null_maxima, 1.0 - false_alarm)))
    beyond = null_maxima[null_maxima > start]
    mean_excess = float(np.mean(beyond - start)) if len(beyond) else 0.0
    return max(0.0, start + mean_excess * math.log(_TAIL / false_alarm))


def corrected_p_value(null_maxima: Array, score: float) -> float:
    """Return the share of null maxima at or above ``score``; the data count as one more, so it is never zero."""
    return (1.0 + float(np.count_nonzero(null_maxima >= score))) / (len(null_maxima) + 1.0)


def smallest_detectable(scan: LawScan, number: int, threshold: float) -> Mapping[str, float]:
    """Return the smallest size of each column of a candidate that would pass ``threshold``; infinite if invisible."""
    one, place = scan.candidates[number], scan.place(number)
    norms = np.sqrt(scan.behind.squares[place])
    needed = threshold + math.log(scan.freedom) + choice_price(one.law)
    return {
        column.name: detectable_size(norm, needed) if share > VISIBLE else math.inf
        for column, norm, share in zip(one.columns, norms.tolist(), scan.visible_share[place].tolist(), strict=True)
    }
