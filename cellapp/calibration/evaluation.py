"""How good a model is on readings it has not seen: absolute, distance and cooperative errors."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from cellapp.kinematics.transforms import Array

_PAIRS_AT_ONCE = 2_000_000


@dataclass(frozen=True)
class Summary:
    """Errors in mm, for eyes: mean, root mean square, standard deviation, maximum, and how many."""

    mean: float
    rms: float
    std: float
    max: float
    n: int

    def as_dict(self) -> dict[str, float | int]:
        """For JSON."""
        return asdict(self)


def summarise(errors: Array) -> Summary:
    """Of errors (n,) [m]."""
    mm = np.abs(errors) * 1e3
    return Summary(
        mean=float(mm.mean()),
        rms=float(np.sqrt(np.mean(mm**2))),
        std=float(mm.std(ddof=1)) if len(mm) > 1 else 0.0,
        max=float(mm.max()),
        n=len(mm),
    )


def position_errors(measured: Array, computed: Array) -> Array:
    """Absolute error of each point, ``|P_M - P_C|``, shape (n,) [m]."""
    return np.asarray(np.linalg.norm(measured - computed, axis=1))


def distance_errors(measured: Array, computed: Array) -> Array:
    """ISO 9283 distance error of all pairs of points of one arm, ``|d_M - d_C|``, shape (n (n - 1) / 2,) [m]."""
    n = len(measured)
    first, second = np.triu_indices(n, 1)
    result = np.empty(len(first))
    for start in range(0, len(first), _PAIRS_AT_ONCE):
        i, k = first[start : start + _PAIRS_AT_ONCE], second[start : start + _PAIRS_AT_ONCE]
        d_M = np.linalg.norm(measured[i] - measured[k], axis=1)
        d_C = np.linalg.norm(computed[i] - computed[k], axis=1)
        result[start : start + _PAIRS_AT_ONCE] = np.abs(d_M - d_C)
    return result


def evaluate(measured: Array, computed: Array) -> dict[str, dict[str, float | int]]:
    """``position_mm`` and ``distance_mm`` of one stage, for JSON; no distances from a single point."""
    result = {"position_mm": summarise(position_errors(measured, computed)).as_dict()}
    if len(measured) > 1:
        result["distance_mm"] = summarise(distance_errors(measured, computed)).as_dict()
    return result
