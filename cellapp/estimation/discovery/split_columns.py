"""Whitened columns of many readings, with those of joint offsets kept as scalar functions of the reading.

Such a column moves the SMR by f(i) u_j(i), where u_j (3, n) is the motion by joint j. In products of two of them the
three coordinates reduce to one factor,

    sum_i f(i) g(i) u_j(i) . u_k(i),

so these products take a third of the time, and the full columns are never formed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.discovery.candidates import whitened_displacements
from cellapp.estimation.discovery.joint_fit import LinearModel
from cellapp.ground.grouping import grouped
from cellapp.robot.effects import EffectColumn
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, eq=False)
class _Offsets:
    """Columns that offset one joint: their indices, functions (m, n) and the whitened motion (3, n)."""

    places: NDArray[np.intp]
    functions: Array
    motion: Array


@dataclass(frozen=True, eq=False)
class SplitColumns:
    """Whitened columns of n readings: ``rows`` (r, 3, n) at the indices ``places``, and those that offset joints.

    ``total`` is the number of all columns.
    """

    places: NDArray[np.intp]
    rows: Array
    offsets: tuple[_Offsets, ...]
    total: int

    @classmethod
    def of(cls, geometric: LinearModel, effects: Sequence[EffectColumn], white: Array) -> SplitColumns:
        """Arrange the rows of ``geometric``, then the columns of effects, whitened by ``white`` (3, 3, n)."""
        n, first = white.shape[2], len(geometric.rows)
        by_joint = grouped((one.joint, place) for place, one in enumerate(effects))
        shifts = by_joint.pop(None, [])
        moved = whitened_displacements([effects[place] for place in shifts], geometric.by_joint, white)
        offsets = tuple(
            _Offsets(
                first + np.array(of_joint, dtype=np.intp),
                np.array([effects[place].offset for place in of_joint]),
                geometric.by_joint[:, joint],
            )
            for joint, of_joint in by_joint.items()
            if joint is not None
        )
        places = np.concatenate([np.arange(first), first + np.array(shifts, dtype=np.intp)])
        rows = np.concatenate([geometric.rows, moved]).reshape(len(places), 3, n)
        return cls(places, rows, offsets, first + len(effects))

    def gram(self) -> Array:
        """Return X^T X (total, total)."""
        found = np.empty((self.total, self.total))
        whole = self.rows.reshape(len(self.rows), -1)
        found[np.ix_(self.places, self.places)] = whole @ whole.T
        for number, one in enumerate(self.offsets):
            beside = one.functions @ np.einsum("ran,an->rn", self.rows, one.motion).T
            _set(found, one.places, self.places, beside)
            for other in self.offsets[: number + 1]:
                together = np.einsum("an,an->n", one.motion, other.motion)
                _set(found, one.places, other.places, (one.functions * together) @ other.functions.T)
        return found

    def moment(self, left: Array) -> Array:
        """Return X^T y (total,) of whitened residuals y (3, n)."""
        found = np.empty(self.total)
        found[self.places] = self.rows.reshape(len(self.rows), -1) @ left.ravel()
        for one in self.offsets:
            found[one.places] = one.functions @ np.einsum("an,an->n", one.motion, left)
        return found


def _set(gram: Array, first: NDArray[np.intp], second: NDArray[np.intp], block: Array) -> None:
    """Set both blocks of a symmetric matrix (p, p) that columns ``first`` and ``second`` share."""
    gram[np.ix_(first, second)] = block
    gram[np.ix_(second, first)] = block.T
