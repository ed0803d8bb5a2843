"""Candidate laws: an effect's law on the data at hand, with the whitened SMR displacement of each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.ground.grouping import grouped
from cellapp.robot.effects import EffectColumn, Law
from cellapp.robot.kinematics.transforms import Array

BOUND_ERRORS = 4.0
"""Standard errors by which a value may exceed its physical bound: by chance one in 30 000 does. The estimate of a joint
that an effect hardly loads is often negative."""

Block = tuple[int, ...]
"""Indices of the columns of one block, which enter a model together."""


@dataclass(frozen=True, eq=False)
class CandidateLaw:
    """A law of an effect: its columns and their whitened displacements ``rows`` (m, d)."""

    slug: str
    law: Law
    columns: tuple[EffectColumn, ...]
    rows: Array

    @cached_property
    def blocks(self) -> list[Block]:
        """Columns of each block."""
        found = grouped((column.block, place) for place, column in enumerate(self.columns))
        return [tuple(places) for places in found.values()]

    def refines(self, block: Sequence[int]) -> bool:
        """Return whether a block only refines others and is no effect alone."""
        return self.columns[block[0]].refines

    def keep(self, places: Sequence[int]) -> CandidateLaw:
        """Return the law with some of its columns only."""
        chosen = list(places)
        return CandidateLaw(self.slug, self.law, tuple(self.columns[k] for k in chosen), self.rows[chosen])


@dataclass(frozen=True)
class LawScore:
    """Score of a law on a residual.

    Attributes
    ----------
    candidate : CandidateLaw
    value : float
        Gain of the BIC less the price of choosing the law.
    chosen : tuple of int
        Indices of the needed columns.
    explained_share : float
        R^2.
    """

    candidate: CandidateLaw
    value: float
    chosen: tuple[int, ...]
    explained_share: float

    @property
    def slug(self) -> str:
        """The effect."""
        return self.candidate.slug

    @property
    def key(self) -> tuple[str, str]:
        """Effect and law."""
        return self.candidate.slug, self.candidate.law.name

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the needed columns."""
        return tuple(self.candidate.columns[place].name for place in self.chosen)

    @property
    def rows(self) -> Array:
        """Whitened displacements of the needed columns."""
        return self.candidate.rows[list(self.chosen)]


def blocks_beyond_bounds(columns: Sequence[EffectColumn], values: Array, errors: Array) -> set[str]:
    """Return the blocks with a value (m,) outside its column's bounds by more than its standard error (m,) allows."""
    return {
        column.block
        for column, value, error in zip(columns, values.tolist(), errors.tolist(), strict=True)
        if not column.lower - BOUND_ERRORS * error <= value <= column.upper + BOUND_ERRORS * error
    }


def whitened_displacements(columns: Sequence[EffectColumn], by_joint: Array, white: Array) -> Array:
    """Compute whitened SMR displacements (m, 3 n) per unit of each column's parameter.

    Parameters
    ----------
    columns : sequence of EffectColumn, length m
    by_joint : array, shape (3, N, n)
        Derivatives of the SMR position with respect to the joint angles, WHITENED [1/rad].
    white : array, shape (3, 3, n)
        Whitening of each point [1/m].
    """
    n = white.shape[2]
    offsets = np.array([one.offset for one in columns if one.offset is not None])
    joints: NDArray[np.intp] = np.array([one.index for one in columns if one.offset is not None], dtype=np.intp)
    of_joints = np.take(by_joint.swapaxes(0, 1), joints, axis=0)
    if len(joints):
        of_joints *= offsets[:, None]
    if len(joints) == len(columns):
        return np.asarray(of_joints.reshape(len(columns), 3 * n))
    rows = np.empty((len(columns), 3, n))
    offset = np.array([one.offset is not None for one in columns])
    rows[offset] = of_joints
    shifts = np.array([one.shift_M for one in columns if one.offset is None])
    rows[~offset] = np.einsum("acn,mnc->man", white, shifts)
    return rows.reshape(len(columns), 3 * n)
