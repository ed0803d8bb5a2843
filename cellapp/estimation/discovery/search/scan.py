"""Scan of all candidate laws: the score of each on the residual in the complement of the model's parameters.

A law is a group of columns in blocks. Its score is

    score = -f ln(1 - R^2) - k ln f - 2 ln T,

where f are the coordinates less the model's parameters, k the visible columns and T the number of laws tried. It is the
gain of the Bayesian information criterion (see ``estimation.discovery.projected_residual``) less the price of choosing
among T onsets or time constants (a uniform prior over them, on the scale of twice the log likelihood).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.design.information import SMALLEST, Behind, NuisanceProjector, visible_root
from cellapp.estimation.discovery.candidates import CandidateLaw, LawScore
from cellapp.estimation.discovery.projected_residual import MOST_SHARE, ProjectedResidual
from cellapp.estimation.discovery.search.block_selection import BlockSelection
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
        self,
        number: int,
        residual: ProjectedResidual,
        *,
        with_refinements: bool = True,
        least: float = -math.inf,
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
    behind: Behind,
    norms: Array,
    first: NDArray[np.intp],
    owner: NDArray[np.intp],
    places: NDArray[np.intp],
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
