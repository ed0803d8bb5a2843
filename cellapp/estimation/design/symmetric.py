"""Symmetric matrices (3, 3) of many candidates by their six distinct elements: faster than one call for each matrix."""

from __future__ import annotations

import numpy as np

from cellapp.robot.kinematics.transforms import Array

ROW, COLUMN = np.triu_indices(3)
"""Indices of the six distinct elements of a symmetric matrix (3, 3)."""
_COFACTORS = np.array([(3, 5, 4, 4), (2, 4, 1, 5), (1, 4, 2, 3), (0, 5, 2, 2), (1, 2, 0, 4), (0, 3, 1, 1)]).T
"""Elements whose two products give each of its cofactors: the first less the second."""
_TWICE = np.where(ROW == COLUMN, 1.0, 2.0)


def trace_of_solution(V: Array, U: Array, sign: float) -> Array:
    """Return tr((I + sign V)^-1 U) (s,) of symmetric matrices with elements (6, s), by cofactors."""
    A = sign * V
    A[_TWICE == 1.0] += 1.0
    first, second, third, fourth = A[_COFACTORS]
    cofactors = first * second - third * fourth
    determinant = np.einsum("es,es->s", A[:3], cofactors[:3])
    return np.asarray(np.einsum("e,es,es->s", _TWICE, cofactors, U) / determinant)
