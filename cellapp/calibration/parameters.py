"""Which parameters of a chain are identified: by name as in the paper, or found from the data's own Jacobian."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from cellapp.kinematics.chain import Geometry, Turns, jacobian, parallel_rows, parameter_names, parameter_unit
from cellapp.kinematics.transforms import Array

_PAPER_DROPS = {"theta1", "d1", "d2", "d4", "alpha5", "theta6", "d6", "a6", "alpha6"}
_INVISIBLE = 1e-3
"""A column is dependent when what is left of it moves the SMR by less than this share of what it moves at arm's length:
a milliradian or half a millimetre of error there stays below a micrometre, whether it is identified or not."""


@dataclass(frozen=True)
class ParameterSet:
    """What is identified, and what became of the rest.

    Attributes
    ----------
    name : str
        ``auto``, ``paper``, ``full`` or what the caller calls it.
    joints : int
        Of the arm.
    columns : tuple of int, length k
        Indices into ``parameter_names``; rotations before translations.
    dropped : tuple of int, length l
        Candidates that depend on the columns.
    scaled_gram, scale : arrays, shapes (k + l, k + l), (k + l,)
        Gram matrix of columns and dropped ones, in that order, at unit scale, and what it was divided by.
    """

    name: str
    joints: int
    columns: tuple[int, ...]
    dropped: tuple[int, ...] = ()
    scaled_gram: Array | None = None
    scale: Array | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return _names_of(self.columns, self.joints)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the columns."""
        return _units_of(self.columns, self.joints)

    @property
    def rotations(self) -> int:
        """How many of the columns are rotations; they stand first."""
        return self.units.count("rad")

    @cached_property
    def shares(self) -> Array:
        """A unit of a dropped parameter acts like these shares of the kept ones, shape (k, l)."""
        k = len(self.columns)
        if self.scaled_gram is None or self.scale is None:
            return np.zeros((k, 0))
        shares = np.linalg.solve(self.scaled_gram[:k, :k], self.scaled_gram[:k, k:])
        return np.asarray(shares * self.scale[k:] / self.scale[:k, None])

    @cached_property
    def merged(self) -> dict[str, dict[str, float]]:
        """Dropped parameter -> {kept parameter: share}; an empty entry has no effect on these data at all."""
        names = parameter_names(self.joints)
        return {
            names[column]: {
                kept: round(float(share), 9)
                for kept, share in zip(self.names, self.shares[:, place], strict=True)
                if abs(share) > _INVISIBLE
            }
            for place, column in enumerate(self.dropped)
        }


@lru_cache(maxsize=64)
def _names_of(columns: tuple[int, ...], joints: int) -> tuple[str, ...]:
    names = parameter_names(joints)
    return tuple(names[c] for c in columns)


@lru_cache(maxsize=64)
def _units_of(columns: tuple[int, ...], joints: int) -> tuple[str, ...]:
    return tuple(parameter_unit(name) for name in _names_of(columns, joints))


@lru_cache(maxsize=32)
def _candidates(joints: int, parallel: tuple[int, ...]) -> tuple[tuple[int, ...], NDArray[np.int64], int]:
    """Candidates with rotations first, their places in order of preference, and how many are rotations."""
    names = parameter_names(joints)
    betas = {f"beta{i + 1}" for i in parallel}
    rows = [
        c
        for c in range(6, 6 + 5 * joints)
        if names[c] != f"alpha{joints}" and (not names[c].startswith("beta") or names[c] in betas)
    ]
    preferred = [*range(6), *range(len(names) - 3, len(names)), *rows]
    columns = _rotations_first(tuple(preferred), joints)
    rotations = sum(parameter_unit(names[c]) == "rad" for c in columns)
    return columns, np.array([columns.index(c) for c in preferred], dtype=np.int64), rotations


def candidate_columns(geometry: Geometry) -> tuple[int, ...]:
    """All parameters that make sense: base, tool and the rows, with beta where axes are parallel and no alpha_N."""
    return _candidates(geometry.joints, parallel_rows(geometry))[0]


def full_set(geometry: Geometry) -> ParameterSet:
    """The redundant model: every candidate (34 for a 6-joint arm with two parallel pairs), as the paper starts."""
    columns = candidate_columns(geometry)
    return ParameterSet("full", geometry.joints, columns)


def paper_set(geometry: Geometry) -> ParameterSet:
    """The paper's 26 of a UR arm: Bai et al. (2023), with alpha5 dropped beside the truly redundant ones.

    Raises
    ------
    ValueError
        If the arm is not a UR: six joints, axes 2, 3 and 4 parallel.
    """
    if geometry.joints != 6 or parallel_rows(geometry) != (1, 2):
        raise ValueError("the paper's parameter set is for six joints with axes 2, 3 and 4 parallel; use 'auto'")
    names = parameter_names(6)
    columns = tuple(c for c in candidate_columns(geometry) if names[c] not in _PAPER_DROPS)
    return ParameterSet("paper", geometry.joints, columns)


def identifiable_set(geometry: Geometry, gram: Array) -> ParameterSet:
    """The identifiable set, from the Gram matrix ``J J^T`` (k, k) of the ``candidate_columns`` over all configurations.

    Columns are scaled to displacement at arm's length (angles by the rms lever of all rotations), then a Cholesky
    factorisation of their Gram matrix finds what each adds to those preferred to it: base, then tool, then the rows
    from the first joint on. The rank is checked against a factorisation with free pivoting.
    """
    candidates, order, rotations = _candidates(geometry.joints, parallel_rows(geometry))
    squares = np.diag(gram)
    scale = np.empty(len(candidates))
    scale[:rotations] = math.sqrt(float(squares[:rotations].mean()))
    scale[rotations:] = math.sqrt(float(squares[rotations:].mean()))
    scaled = gram / scale / scale[:, None]
    preferred = scaled[order][:, order]
    # a dependent column is let through with a pivot of the size of this ridge, far below the threshold
    preferred.flat[:: len(order) + 1] += 1e-13
    factor, failed = lapack.dpotrf(preferred, lower=1)
    chosen = np.sort(order[np.diag(factor) > _INVISIBLE])
    _, free_order, rank, _ = lapack.dpstrf(scaled, tol=_INVISIBLE**2, lower=1)
    if failed or len(chosen) > rank:  # the order of preference kept a nearly dependent column: pivot freely instead
        chosen = np.sort(free_order[:rank] - 1)
    kept = chosen.tolist()
    sorted_out = [*kept, *(j for j in range(len(candidates)) if j not in set(kept))]
    return ParameterSet(
        "auto",
        geometry.joints,
        tuple(candidates[j] for j in kept),
        tuple(candidates[j] for j in sorted_out[len(kept) :]),
        scaled[sorted_out][:, sorted_out],
        scale[sorted_out],
    )


def auto_set(geometry: Geometry, q: Array) -> ParameterSet:
    """The identifiable set of a geometry at configurations ``q`` (n, N): see ``identifiable_set``."""
    _, J = jacobian(geometry, Turns.of(q), candidate_columns(geometry))
    return identifiable_set(geometry, gram_matrix(J))


def gram_matrix(J: Array) -> Array:
    """``J J^T`` (k, k) over components and configurations of J (3, k, n)."""
    return np.asarray((J @ J.transpose(0, 2, 1)).sum(axis=0))


def _rotations_first(columns: tuple[int, ...], joints: int) -> tuple[int, ...]:
    """Rotations, then translations, each in the chain's order: the order the Jacobian is fastest in."""
    names = parameter_names(joints)
    return tuple(sorted(columns, key=lambda c: (parameter_unit(names[c]) == "m", c)))
