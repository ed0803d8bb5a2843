"""Selection of the blocks (joints, lines) of one law that a residual needs: forward, and backward from all.

Forward selection adds the best block while the score grows by more than ``NEXT_BLOCK``. If an effect is spread evenly
over many joints, no single block may gain enough; backward elimination from all blocks is then tried as well (Draper,
Smith, Applied Regression Analysis, 3rd ed., chapter 15).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.design.information import SMALLEST, VISIBLE, Behind, visible_squares
from cellapp.estimation.discovery.candidates import Block, CandidateLaw
from cellapp.estimation.discovery.projected_residual import ProjectedResidual, bic_gain
from cellapp.robot.kinematics.transforms import Array

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
        left = [block for block in self.blocks if block != chosen]
        while left and best > 0.0:
            left = self._promising(left, chosen)
            top, number = self._best([(*chosen, *block) for block in left])
            block = left[number]
            if top - line_price <= best + NEXT_BLOCK:
                break
            best, chosen = top - line_price, (*chosen, *block)
            left = [other for other in left if other != block]
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
