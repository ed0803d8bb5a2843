"""Sets of identified parameters: those of the paper by name, or the identifiable ones from the Jacobian of the data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from cellapp.kinematics.chain import Geometry, JointAngles, jacobian, parallel_rows, parameter_names, parameter_unit
from cellapp.kinematics.transforms import Array

_PAPER_DROPS = {"theta1", "d1", "d2", "d4", "alpha5", "theta6", "d6", "a6", "alpha6"}
"""Parameters of a UR arm that Bai et al. (2023) do not identify."""
_INVISIBLE = 1e-3
"""A column of the Jacobian counts as dependent if its component orthogonal to the others is below this share of its
scale: an error of 1 mrad or 0.5 mm of such a parameter then moves the SMR by less than a micrometre."""


@dataclass(frozen=True)
class ParameterSet:
    """The identified parameters, and those that depend on them.

    Attributes
    ----------
    name : str
        ``auto``, ``paper``, ``full`` or a name given by the caller.
    joints : int
        Number of joints N.
    columns : tuple of int, length k
        Indices of the identified parameters in ``parameter_names``; rotations before translations.
    dropped : tuple of int, length l
        Indices of the candidates whose effect is a linear combination of the columns'.
    scaled_gram : array, shape (k + l, k + l), optional
        Gram matrix of the Jacobian's columns and dropped columns, in that order, each divided by its ``scale``.
    scale : array, shape (k + l,), optional
    """

    name: str
    joints: int
    columns: tuple[int, ...]
    dropped: tuple[int, ...] = ()
    scaled_gram: Array | None = None
    scale: Array | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the identified parameters."""
        return _names_of(self.columns, self.joints)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the identified parameters."""
        return _units_of(self.columns, self.joints)

    @property
    def rotations(self) -> int:
        """Number of rotations among the columns; they come first."""
        return self.units.count("rad")

    @cached_property
    def shares(self) -> Array:
        """Coefficients (k, l): a unit of dropped parameter l has the effect of these amounts of the kept ones."""
        k = len(self.columns)
        if self.scaled_gram is None or self.scale is None:
            return np.zeros((k, 0))
        shares = np.linalg.solve(self.scaled_gram[:k, :k], self.scaled_gram[:k, k:])
        return np.asarray(shares * self.scale[k:] / self.scale[:k, None])

    @cached_property
    def merged(self) -> dict[str, dict[str, float]]:
        """Dropped parameter -> {kept parameter: coefficient}; an empty entry has no effect on these data."""
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
    """Candidates with rotations first, their positions in order of preference, and the number of rotations."""
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
    """Parameters that can have an effect: base, tool and D-H rows, with beta between parallel axes, without alpha_N."""
    return _candidates(geometry.joints, parallel_rows(geometry))[0]


def full_set(geometry: Geometry) -> ParameterSet:
    """The redundant model of all candidates (34 for six joints with two parallel pairs), the start of the paper."""
    columns = candidate_columns(geometry)
    return ParameterSet("full", geometry.joints, columns)


def paper_set(geometry: Geometry) -> ParameterSet:
    """The 26 parameters of a UR arm in Bai et al. (2023); alpha5 is dropped too, though it is not redundant.

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
    """The identifiable set, from the Gram matrix ``J^T J`` (k, k) of the ``candidate_columns`` over all configurations.

    Columns are scaled to displacement at arm's length (rotations by their common rms lever) and put in order of
    preference: base, tool, then the rows from the first joint on. The diagonal of the Cholesky factor is then the norm
    of the part of each column that is orthogonal to those before it. The rank is checked by a Cholesky factorisation
    with complete pivoting (Higham, in: Reliable Numerical Computation (1990) 161).
    """
    candidates, order, rotations = _candidates(geometry.joints, parallel_rows(geometry))
    squares = np.diag(gram)
    scale = np.empty(len(candidates))
    scale[:rotations] = math.sqrt(float(squares[:rotations].mean()))
    scale[rotations:] = math.sqrt(float(squares[rotations:].mean()))
    scaled = gram / scale / scale[:, None]
    preferred = scaled[order][:, order]
    # The ridge lets the factorisation pass dependent columns, with pivots far below the threshold.
    preferred.flat[:: len(order) + 1] += 1e-13
    factor, failed = lapack.dpotrf(preferred, lower=1)
    chosen = np.sort(order[np.diag(factor) > _INVISIBLE])
    _, free_order, rank, _ = lapack.dpstrf(scaled, tol=_INVISIBLE**2, lower=1)
    if failed or len(chosen) > rank:  # a nearly dependent column was kept: use the pivoted order
        chosen = np.sort(free_order[:rank] - 1)
    kept = chosen.tolist()
    dropped = [j for j in range(len(candidates)) if j not in set(kept)]
    both = [*kept, *dropped]
    return ParameterSet(
        "auto",
        geometry.joints,
        columns=tuple(candidates[j] for j in kept),
        dropped=tuple(candidates[j] for j in dropped),
        scaled_gram=scaled[both][:, both],
        scale=scale[both],
    )


def auto_set(geometry: Geometry, q: Array) -> ParameterSet:
    """The identifiable set of a geometry at configurations ``q`` (n, N) [rad]; see ``identifiable_set``."""
    _, J = jacobian(geometry, JointAngles.of(q), candidate_columns(geometry))
    return identifiable_set(geometry, gram_matrix(J))


def gram_matrix(J: Array) -> Array:
    """``J^T J`` (k, k) of a Jacobian (3, k, n), summed over components and configurations."""
    return np.asarray((J @ J.transpose(0, 2, 1)).sum(axis=0))


def _rotations_first(columns: tuple[int, ...], joints: int) -> tuple[int, ...]:
    """Rotations, then translations, each in the order of the chain: the fastest order for the Jacobian."""
    names = parameter_names(joints)
    return tuple(sorted(columns, key=lambda c: (parameter_unit(names[c]) == "m", c)))
