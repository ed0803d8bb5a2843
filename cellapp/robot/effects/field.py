"""A smooth vector field over the workspace: products of cosines with the spectrum of a Gaussian process.

On a box with sides L_a the functions

    f_k(x) = prod_a c cos(pi k_a (x_a - low_a) / L_a),   k_a = 0, 1, ...,   c = sqrt(2) where k_a > 0, else 1

are orthogonal with a mean square of one. With independent coefficients of variance

    a^2 w_k,   w_k proportional to (5 / l^2 + |omega_k|^2)^-4,   omega_a = pi k_a / L_a,   sum over k = 1

the mean square of the field over the box is a^2, and its spectrum that of the Matern-5/2 covariance of length scale l
in three dimensions (Hilbert-space features: Solin, Sarkka, Statistics and Computing 30 (2020) 419). The constant
function is left out: it is a shift of the base. The slope of such a sum across the faces of the box is zero, so that
the box is wider than the readings.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.effects.law import AMPLITUDE, FIXED, Constant
from cellapp.robot.kinematics.transforms import Array

FIELD_LENGTH = Constant("length", "m", FIXED, "correlated over {} m")
BOX = tuple(Constant(f"{end}_{axis}", "m", FIXED) for axis in "xyz" for end in ("low", "high"))
"""Least and largest coordinate of the readings along each axis."""
FIELD_CONSTANTS = (*BOX, AMPLITUDE, FIELD_LENGTH)
_WAVES = 80
"""Number of functions per component: in a box of 3 x 3 x 2 m they resolve periods down to 1 m. Shorter periods have 1 %
of the variance of a field with a length scale of 0.4 m."""
_MARGIN = 0.15
"""Share of each side by which the box exceeds the readings at either end."""
_LEAST_SIDE = 1e-3
"""Least margin of the box [m]: readings in a plane have no function across it."""
_MOST_WAVES_A_SIDE = 16
"""Number of half waves along a side that are considered; the ``_WAVES`` slowest of a usual box have at most 8."""


def box_of(position: Array) -> dict[str, float]:
    """Return the box around positions (n, 3) [m] as the constants ``BOX``."""
    ends = np.stack([position.min(axis=0), position.max(axis=0)], axis=1).ravel()
    return dict(zip((one.name for one in BOX), ends.tolist(), strict=True))


def field_functions(position: Array, constants: Mapping[str, float]) -> dict[str, Array]:
    """Evaluate the functions at positions (n, 3) [m], each (n,), by name; beyond the box as on its nearest face."""
    low, side = _extended_box(constants)
    counts, _ = _waves(tuple(side.tolist()))
    unit = np.clip((position - low) / side, 0.0, 1.0)
    orders = np.arange(counts.max() + 1)
    cosines = np.cos(np.pi * unit[:, :, None] * orders) * np.where(orders > 0, np.sqrt(2.0), 1.0)
    values = cosines[:, 0, counts[:, 0]] * cosines[:, 1, counts[:, 1]] * cosines[:, 2, counts[:, 2]]
    names = [f"cos({i},{j},{k})" for i, j, k in counts.tolist()]
    return dict(zip(names, np.ascontiguousarray(values.T), strict=True))


def field_frequencies(constants: Mapping[str, float]) -> Array:
    """Return the angular frequency |omega_k| [1/m] of each function."""
    _, side = _extended_box(constants)
    return _waves(tuple(side.tolist()))[1]


def field_variances(length: float, frequencies: Array) -> Array:
    """Compute relative prior variances w_k at a length scale [m]; their sum is 1."""
    spectrum = (5.0 / length**2 + frequencies**2) ** -4
    return np.asarray(spectrum / spectrum.sum())


def _extended_box(constants: Mapping[str, float]) -> tuple[Array, Array]:
    """Return lower corner and sides (3,) [m] of the box of the functions."""
    ends = np.array([constants[one.name] for one in BOX]).reshape(3, 2)
    margin = np.maximum(_MARGIN * (ends[:, 1] - ends[:, 0]), _LEAST_SIDE)
    return ends[:, 0] - margin, ends[:, 1] - ends[:, 0] + 2.0 * margin


@lru_cache(maxsize=64)
def _waves(side: tuple[float, float, float]) -> tuple[NDArray[np.intp], Array]:
    """Return half waves along each side (m, 3) and frequencies (m,) of the slowest functions, without the constant."""
    counts = np.indices((_MOST_WAVES_A_SIDE,) * 3).reshape(3, -1).T[1:]
    frequencies = np.linalg.norm(np.pi * counts / np.array(side), axis=1)
    slowest = np.argsort(frequencies, kind="stable")[:_WAVES]
    return counts[slowest].astype(np.intp), np.asarray(frequencies[slowest])
