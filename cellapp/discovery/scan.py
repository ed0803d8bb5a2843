"""The scan: how much of what a model leaves does each law of each effect explain, where the model cannot follow.

With W the whitening, X = W [J, A] what the model follows (geometric Jacobian, accepted effects, perhaps with priors)
and B a law's columns, everything is judged by

    M = I - X (X^T X + P)^-1 X^T,   P the precision of the priors,

which without priors projects on the orthogonal complement of X; regressing there is the joint refit of model and law
(Frisch, Waugh, Lovell). A law is a group of columns in blocks; blocks are added while

    score = -N ln(1 - R^2) - k ln N - 2 ln T,   N = 3 n coordinates, k visible columns, T laws of its kind tried,

grows by more than a margin: the Bayesian information criterion, with the price of choosing an onset or a time constant.
The threshold is a high quantile of the largest score over everything scanned in data with nothing missing, so that
searching over many laws does not raise the false-alarm rate (max-T: Westfall, Young 1993).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack, solve_triangular

from cellapp.effects import EffectColumn, Law
from cellapp.kinematics.transforms import Array

_NEXT_BLOCK = 10.0
"""Another joint joins a law only if it gains this much: very strong evidence (Kass, Raftery, J. Am. Stat. Ass. 90,
1995), as what a law leaves over of one joint often looks a little like another."""
VISIBLE = 1e-3
"""A direction of which the model takes all but this share (in norm) is invisible."""
_TAIL = 0.15
_MOST_TOGETHER = 24
_MOST_BLOCKS = 40
_MOST_LAWS = 10


@dataclass(frozen=True)
class Follower:
    """What a model follows in the data: M = I - Q Q^T with ``basis`` Q (d, p)."""

    basis: Array

    @classmethod
    def of(cls, design: Array, precision: Array | None = None) -> Follower:
        """From whitened columns (d, p) and their prior precisions (p,), none where not given."""
        scale = 1.0 / np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        scaled = design * scale
        gram = scaled.T @ scaled
        if precision is not None:
            gram = gram + np.diag(precision * scale**2)
        factor, failed = lapack.dpotrf(gram, lower=1)
        diagonal = np.diag(factor)
        if failed == 0 and diagonal.min() > 3e-5 * diagonal.max():
            return cls(np.ascontiguousarray(solve_triangular(factor, scaled.T, lower=True, check_finite=False).T))
        values, vectors = np.linalg.eigh(gram)
        kept = values > 1e-11 * values[-1]
        return cls(scaled @ (vectors[:, kept] / np.sqrt(values[kept])))

    def without(self, rows: Array) -> Array:
        """``rows`` (..., d) times M."""
        return np.asarray(rows - (rows @ self.basis) @ self.basis.T)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A law of an effect on the data at hand: its columns, and their whitened displacements ``B`` (m, d)."""

    slug: str
    law: Law
    columns: tuple[EffectColumn, ...]
    B: Array

    @property
    def blocks(self) -> list[tuple[int, ...]]:
        """Columns of each block."""
        found: dict[str, list[int]] = {}
        for place, column in enumerate(self.columns):
            found.setdefault(column.block, []).append(place)
        return [tuple(places) for places in found.values()]

    def refines(self, block: Sequence[int]) -> bool:
        """Whether a block only refines others."""
        return self.columns[block[0]].refines


def displacements(columns: Sequence[EffectColumn], by_joint: Array, white: Array) -> Array:
    """Whitened displacements (m, 3 n) of columns.

    Parameters
    ----------
    columns : sequence of EffectColumn, length m
    by_joint : array, shape (3, N, n)
        WHITENED derivatives of the SMR position by the joints [1/rad].
    white : array, shape (3, 3, n)
        Whitening of each point [1/m].
    """
    n = white.shape[2]
    B = np.empty((len(columns), 3, n))
    turning = [place for place, column in enumerate(columns) if column.joint is not None]
    shifting = [place for place, column in enumerate(columns) if column.joint is None]
    if turning:
        joints = np.array([columns[place].joint for place in turning], dtype=np.intp)
        offsets = np.array([columns[place].offset for place in turning])
        B[turning] = by_joint[:, joints].swapaxes(0, 1) * offsets[:, None]
    if shifting:
        shifts = np.array([columns[place].shift_M for place in shifting])
        B[shifting] = np.einsum("acn,mnc->man", white, shifts)
    return B.reshape(len(columns), 3 * n)


@dataclass(frozen=True)
class Score:
    """How well a law explains the residual: its score and the columns it needs (places in the candidate)."""

    candidate: Candidate
    value: float
    chosen: tuple[int, ...]
    explained: float

    @property
    def slug(self) -> str:
        return self.candidate.slug

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns it needs."""
        return tuple(self.candidate.columns[place].name for place in self.chosen)


@dataclass(frozen=True, eq=False)
class Seen:
    """Candidates where the model cannot follow: ``B`` and ``MB`` (total m, d) of all columns, and their blocks by size.

    ``first`` is each candidate's first row in both; ``fraction`` the visible share of each column. Blocks of one size
    are together: candidate (b,), places in the candidate (b, k), ``root`` (b, k, k) that makes their visible directions
    orthonormal, and how many of those there are (b,).
    """

    candidates: tuple[Candidate, ...]
    B: Array
    MB: Array
    first: NDArray[np.intp]
    fraction: Array
    groups: tuple[tuple[NDArray[np.intp], NDArray[np.intp], Array, NDArray[np.intp]], ...]

    @classmethod
    def of(cls, candidates: Sequence[Candidate], follower: Follower) -> Seen:
        """Look at candidates behind what the model follows."""
        first = np.concatenate([[0], np.cumsum([len(c.columns) for c in candidates])]).astype(np.intp)
        B = np.concatenate([c.B for c in candidates]) if candidates else np.zeros((0, len(follower.basis)))
        MB = follower.without(B)
        raw = np.maximum(np.linalg.norm(B, axis=1), 1e-300)
        # v^T M v is the visible part; with priors M is no projection and |M v|^2 would be too little
        fraction = np.sqrt(np.maximum(np.einsum("md,md->m", B, MB), 0.0)) / raw
        by_size: dict[int, list[tuple[int, tuple[int, ...]]]] = {}
        for number, one in enumerate(candidates):
            for block in one.blocks:
                if not one.refines(block):
                    by_size.setdefault(len(block), []).append((number, block))
        groups = []
        for size, entries in by_size.items():
            owner = np.array([number for number, _ in entries], dtype=np.intp)
            places = np.array([block for _, block in entries], dtype=np.intp).reshape(-1, size)
            rows = first[owner][:, None] + places
            gram = np.empty((len(rows), size, size))
            for begin in range(0, len(rows), 256):  # memory stays small
                part = rows[begin : begin + 256]
                gram[begin : begin + 256] = B[part] @ MB[part].swapaxes(1, 2)
            scale = 1.0 / raw[rows]
            values, vectors = np.linalg.eigh(gram * scale[:, :, None] * scale[:, None, :])
            seen = values > VISIBLE**2
            seen &= raw[rows].max(axis=1)[:, None] > 1e-9
            inverse = np.where(seen, 1.0 / np.sqrt(np.maximum(values, 1e-300)), 0.0)
            groups.append((owner, places, scale[:, :, None] * vectors * inverse[:, None, :], seen.sum(axis=1)))
        return cls(tuple(candidates), B, MB, first[:-1], fraction, tuple(groups))

    def part(self, number: int) -> tuple[Array, Array]:
        """A candidate's rows B and M B, (m, d) each."""
        begin = int(self.first[number])
        end = begin + len(self.candidates[number].columns)
        return self.B[begin:end], self.MB[begin:end]

    def block_scores(self, MY: Array, squares: Array) -> Array:
        """The best score (candidates, s) with one block of each, for residuals ``MY`` (d, s) with squares (s,)."""
        best = np.full((len(self.candidates), MY.shape[1]), -np.inf)
        projections = self.B @ MY
        N = len(MY)
        price = np.array([2.0 * math.log(max(one.law.tried, 1)) for one in self.candidates])
        for owner, places, root, visible in self.groups:
            rows = self.first[owner][:, None] + places
            u = np.swapaxes(root, 1, 2) @ projections[rows]
            share = np.minimum(np.einsum("bks,bks->bs", u, u) / squares, 1.0 - 1e-12)
            value = -N * np.log1p(-share) - (visible * math.log(N) + price[owner])[:, None]
            value[visible == 0] = -np.inf
            np.maximum.at(best, owner, value)
        return best

    def scores(self, MY: Array, square: float, *, refined: bool = False) -> list[Score]:
        """Scores of the candidates for one residual ``MY`` (d,) with ``square = y^T M y``, best first.

        With blocks that only refine where ``refined``: a name is given for what an effect plainly is.
        Of each effect only the laws are gone through whose best block alone is among its best.
        """
        ahead = self.block_scores(MY[:, None], np.array([square]))[:, 0]
        by_slug: dict[str, list[int]] = {}
        for number in np.argsort(-ahead, kind="stable").tolist():
            if np.isfinite(ahead[number]):
                by_slug.setdefault(self.candidates[number].slug, []).append(number)
        chosen = [number for numbers in by_slug.values() for number in numbers[:_MOST_LAWS]]
        found = [self.greedy(number, MY, square, refined=refined) for number in chosen]
        return sorted((one for one in found if one is not None), key=lambda s: -s.value)

    def greedy(self, number: int, MY: Array, square: float, *, refined: bool = True) -> Score | None:
        """Blocks of one candidate, the best first, while the score grows; or all of them at once, then fewer."""
        one = self.candidates[number]
        B, MB = self.part(number)
        raw = np.maximum(np.linalg.norm(B, axis=1), 1e-300)
        keep = self.fraction[int(self.first[number]) :][: len(B)] > VISIBLE
        wanted = [block for block in one.blocks if refined or not one.refines(block)]
        blocks = [visible for block in wanted if (visible := tuple(i for i in block if keep[i]))]
        if all(one.refines(block) for block in blocks):  # none, or nothing that they could refine
            return None
        N = len(MY)
        projection = B @ MY
        price = 2.0 * math.log(max(one.law.tried, 1))

        def value_of(columns: Sequence[int]) -> tuple[float, float]:
            """Score without the price of choosing, and the explained share of the square."""
            rows = list(columns)
            scale = 1.0 / raw[rows]
            gram = (B[rows] @ MB[rows].T) * scale[:, None] * scale
            values, vectors = np.linalg.eigh(gram)
            seen = values > VISIBLE**2
            u = (vectors[:, seen] / np.sqrt(values[seen])).T @ (projection[rows] * scale)
            share = min(float(u @ u) / square, 1.0 - 1e-12)
            return -N * math.log1p(-share) - int(seen.sum()) * math.log(N), share

        def forward(start: tuple[int, ...], base: float) -> tuple[tuple[int, ...], float]:
            picked, best = start, base
            left = [block for block in blocks if not set(block) & set(picked)]
            if not picked:  # what only refines cannot be first
                left = [block for block in left if not one.refines(block)]
            while left:
                if len(left) > _MOST_BLOCKS:  # of thousands only those that may matter, judged alone behind the chosen
                    left = self._promising(B, MB, projection, left, picked, square)
                trials = [(value_of([*picked, *block])[0], block) for block in left]
                top, block = max(trials)
                lines = price if picked and len(one.blocks) > _MOST_BLOCKS else 0.0
                if picked and top - lines <= best + _NEXT_BLOCK:
                    break
                if not picked:
                    left = list(blocks)
                best, picked = top - lines, (*picked, *block)
                left = [other for other in left if other != block]
                if best <= 0.0:
                    break
            return picked, best

        picked, best = forward((), 0.0)
        everything = tuple(i for block in blocks for i in block)
        if len(blocks) > 1 and len(everything) <= _MOST_TOGETHER:
            together, value = everything, value_of(everything)[0]
            while len(together) > 1:
                fewer = []
                for block in blocks:
                    rest = tuple(i for i in together if i not in block)
                    if len(rest) < len(together) and any(not one.refines((i,)) for i in rest):
                        fewer.append((value_of(rest)[0], rest))
                if not fewer:
                    break
                top, rest = max(fewer)
                if top <= value - _NEXT_BLOCK:
                    break
                together, value = rest, top
            if value > best + _NEXT_BLOCK:
                picked, best = together, value
        return Score(one, best - price, tuple(sorted(picked)), value_of(picked)[1])

    @staticmethod
    def _promising(
        B: Array,
        MB: Array,
        projection: Array,
        left: list[tuple[int, ...]],
        picked: tuple[int, ...],
        square: float,
    ) -> list[tuple[int, ...]]:
        """The blocks that would explain most beside the picked columns, each judged by its own columns."""
        rest, own = projection.copy(), np.einsum("md,md->m", B, MB)
        if picked:
            rows = list(picked)
            gram = B[rows] @ MB[rows].T
            factor = np.linalg.pinv(gram, rcond=1e-10, hermitian=True)
            cross = B @ MB[rows].T
            rest = projection - cross @ (factor @ projection[rows])
            own = own - np.einsum("mk,kl,ml->m", cross, factor, cross)
        gain = rest**2 / np.maximum(own, 1e-12 * np.maximum(own.max(), 1e-300))
        ranked = sorted(left, key=lambda block: -float(gain[list(block)].sum()))
        return ranked[:_MOST_BLOCKS]


def explained_by(rows: Array, follower: Follower, MY: Array) -> float:
    """How much of the square of a residual columns (m, d) explain behind what a follower follows."""
    MB = follower.without(rows)
    gram = rows @ MB.T
    scale = 1.0 / np.maximum(np.linalg.norm(rows, axis=1), 1e-300)
    values, vectors = np.linalg.eigh(gram * scale[:, None] * scale)
    kept = values > 1e-8
    u = (vectors[:, kept] / np.sqrt(values[kept])).T @ (scale * (rows @ MY))
    return float(u @ u)


def null_maxima(seen: Seen, follower: Follower, simulations: int, rng: np.random.Generator) -> Array:
    """Largest score over all candidates in each of ``simulations`` residuals of pure noise, sorted.

    One block of each candidate is tried: a second one must gain so much more that it does not move high quantiles.
    """
    y = rng.standard_normal((len(follower.basis), simulations))
    MY = follower.without(y.T).T
    squares = np.einsum("ds,ds->s", y, MY)
    if not seen.candidates:
        return np.full(simulations, -math.inf)
    return np.sort(seen.block_scores(MY, squares).max(axis=0))


def threshold(maxima: Array, false_alarm: float) -> float:
    """The score above which chance gets only with probability ``false_alarm``; never below zero.

    Beyond the highest 15 % the tail is taken as exponential, which steadies the quantile of few simulations.
    """
    if not len(maxima) or not np.isfinite(maxima).any():
        return 0.0
    start = float(np.quantile(maxima, 1.0 - _TAIL))
    if false_alarm >= _TAIL or not math.isfinite(start):
        return max(0.0, float(np.quantile(maxima, 1.0 - false_alarm)))
    mean_excess = float(np.mean(maxima[maxima > start] - start)) if np.any(maxima > start) else 0.0
    return max(0.0, start + mean_excess * math.log(_TAIL / false_alarm))


def corrected_p(maxima: Array, value: float) -> float:
    """Share of null maxima at or above ``value``, counted with the data themselves so that it is never zero."""
    return (1.0 + float(np.count_nonzero(maxima >= value))) / (len(maxima) + 1.0)


def smallest_seen(seen: Seen, number: int, least: float) -> Mapping[str, float]:
    """Smallest size of each single column of a candidate that would pass ``least``; infinite where invisible."""
    one = seen.candidates[number]
    B, MB = seen.part(number)
    squares = np.einsum("md,md->m", B, MB)
    N = B.shape[1]
    needed = least + math.log(N) + 2.0 * math.log(max(one.law.tried, 1))
    fraction = seen.fraction[int(seen.first[number]) :][: len(B)]
    return {
        column.name: math.sqrt(needed / square) if share > VISIBLE else math.inf
        for column, square, share in zip(one.columns, squares.tolist(), fraction.tolist(), strict=True)
    }
