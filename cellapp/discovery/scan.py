"""The scan: how much of what geometry leaves does each named effect explain, judged where geometry cannot follow.

With W the whitening, J the geometric Jacobian and B an effect's columns, everything is projected on the orthogonal
complement of W J; regressing there is the joint refit of geometry and effect (Frisch, Waugh, Lovell). An effect is a
group of columns in blocks (a block is one joint); blocks are added while

    score = -N ln(1 - R^2) - k ln N,   N = 3 n coordinates, k columns,

grows by more than a margin. The threshold is the quantile of the largest score over all effects in simulated data with
nothing missing, so that searching over many effects does not raise the false-alarm rate (max-T: Westfall, Young 1993).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.effects import EffectColumn, joint_offsets
from cellapp.kinematics.transforms import Array

_NEXT_BLOCK = 10.0
"""Another joint joins an effect only if it gains this much: very strong evidence (Kass, Raftery 1995), as what a law
leaves over of one joint often looks a little like another."""
_VISIBLE = 1e-4
"""A column of which geometry takes all but this share (in norm) is invisible."""


@dataclass(frozen=True)
class Candidate:
    """An effect and its columns on the data at hand, unprojected: whitened displacements (3 n, m)."""

    slug: str
    columns: tuple[EffectColumn, ...]
    B: Array


@dataclass(frozen=True)
class Score:
    """How well an effect explains the residual: its score and the columns it needs (indices into the candidate)."""

    slug: str
    score: float
    chosen: tuple[int, ...]


@dataclass(frozen=True)
class Visible:
    """A candidate in the complement: Gram matrix and blocks of its visible columns."""

    slug: str
    B: Array
    gram: Array
    blocks: tuple[tuple[int, ...], ...]
    fraction: Array


def candidate(slug: str, columns: Sequence[EffectColumn], by_joint: Array, white: Array) -> Candidate:
    """Whitened displacements of an effect's columns.

    Parameters
    ----------
    columns : sequence of EffectColumn
    by_joint : array, shape (3, N, n)
        Derivatives of the SMR position by the joints [m/rad].
    white : array, shape (3, 3, n)
        Whitening of each point [1/m].
    """
    offsets = joint_offsets(columns, by_joint.shape[1])
    moved = np.einsum("mjn,cjn->cmn", offsets, by_joint)
    return Candidate(slug, tuple(columns), np.einsum("acn,cmn->anm", white, moved).reshape(-1, len(columns)))


def complement(basis: Array, vectors: Array) -> Array:
    """``vectors`` (d, ...) without their part in the span of the orthonormal ``basis`` (d, k)."""
    return np.asarray(vectors - basis @ (basis.T @ vectors))


def visible_part(effect: Candidate, basis: Array) -> Visible:
    """The candidate in the complement of ``basis`` (3 n, k); columns that vanish there leave its blocks."""
    B = complement(basis, effect.B)
    raw = np.linalg.norm(effect.B, axis=0)
    fraction = np.linalg.norm(B, axis=0) / np.maximum(raw, 1e-300)
    joints = sorted({column.joint for column in effect.columns})
    blocks = tuple(
        block
        for joint in joints
        if (
            block := tuple(
                i for i, column in enumerate(effect.columns) if column.joint == joint and fraction[i] > _VISIBLE
            )
        )
    )
    return Visible(effect.slug, B, B.T @ B, blocks, fraction)


def score(effect: Visible, projection: Array, square: float, coordinates: int) -> Score:
    """Greedy score of an effect for a residual with ``projection = B^T y`` and ``square = y^T y`` in the complement."""
    best, chosen = 0.0, tuple[int, ...]()
    left = list(effect.blocks)
    penalty = math.log(coordinates)
    while left:
        trials = []
        for block in left:
            columns = [*chosen, *block]
            part = effect.gram[np.ix_(columns, columns)]
            reduction = float(projection[columns] @ np.linalg.lstsq(part, projection[columns], rcond=1e-10)[0])
            share = min(reduction / square, 1.0 - 1e-12)
            trials.append((-coordinates * math.log1p(-share) - len(columns) * penalty, block))
        top, block = max(trials)
        if chosen and top <= best + _NEXT_BLOCK:
            break
        if not chosen and top <= 0.0:
            best = top  # reported as it is: the data speak against the effect
            chosen = block
            break
        best, chosen = top, (*chosen, *block)
        left.remove(block)
    return Score(effect.slug, best if chosen else -math.inf, tuple(sorted(chosen)))


def scan(effects: Sequence[Visible], residual: Array) -> list[Score]:
    """Scores of all effects for a whitened residual (3 n,) in the complement, best first."""
    square = float(residual @ residual)
    scores = [score(effect, effect.B.T @ residual, square, len(residual)) for effect in effects if effect.blocks]
    return sorted(scores, key=lambda s: -s.score)


def null_maxima(effects: Sequence[Visible], basis: Array, simulations: int, rng: np.random.Generator) -> Array:
    """Largest score over all effects in each of ``simulations`` residuals of pure noise, sorted."""
    y = complement(basis, rng.standard_normal((len(basis), simulations)))
    squares = np.einsum("ds,ds->s", y, y)
    seen = [effect for effect in effects if effect.blocks]
    projections = [effect.B.T @ y for effect in seen]
    maxima = [
        max((score(effect, c[:, s], float(squares[s]), len(basis)).score for effect, c in zip(seen, projections)))
        if seen
        else -math.inf
        for s in range(simulations)
    ]
    return np.sort(np.array(maxima))


def threshold(maxima: Array, false_alarm: float) -> float:
    """The score above which chance gets only with probability ``false_alarm``; never below zero."""
    return max(0.0, float(np.quantile(maxima, 1.0 - false_alarm)))


def corrected_p(maxima: Array, value: float) -> float:
    """Share of null maxima at or above ``value``, counted with the data themselves so that it is never zero."""
    return (1.0 + float(np.count_nonzero(maxima >= value))) / (len(maxima) + 1.0)


def smallest_seen(effect: Visible, least_score: float, coordinates: int) -> Mapping[int, float]:
    """Smallest size of each single column that would have passed ``least_score``; infinite where it is invisible."""
    needed = least_score + math.log(coordinates)
    squares = np.diag(effect.gram)
    return {
        i: math.sqrt(needed / square) if effect.fraction[i] > _VISIBLE else math.inf
        for i, square in enumerate(squares.tolist())
    }
