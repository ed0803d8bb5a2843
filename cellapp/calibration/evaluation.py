"""How good a model is on readings it has not seen: absolute, distance and cooperative errors."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from cellapp.kinematics.transforms import Array

_SAMPLES = 400


@dataclass(frozen=True)
class Summary:
    """Errors in mm, for eyes.

    Mean, root mean square, standard deviation, maximum, 50th and 95th percentile, a bootstrap 95 % interval of the
    mean, and how many.
    """

    mean: float
    rms: float
    std: float
    max: float
    p50: float
    p95: float
    mean_ci95: tuple[float, float]
    n: int

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**asdict(self), "mean_ci95": list(self.mean_ci95)}


def summarise(errors: Array, means: Array | None = None) -> Summary:
    """Of errors (n,) [m]; ``means`` are bootstrapped means [m] where the errors are not independent."""
    mm = np.abs(errors) * 1e3
    if means is None:
        weights = _resampled(len(mm))
        means = weights @ np.abs(errors) / len(mm)
    low, high = np.quantile(means, [0.025, 0.975]) * 1e3
    p50, p95 = np.quantile(mm, [0.5, 0.95])
    return Summary(
        mean=float(mm.mean()),
        rms=float(np.sqrt(np.mean(mm**2))),
        std=float(mm.std(ddof=1)) if len(mm) > 1 else 0.0,
        max=float(mm.max()),
        p50=float(p50),
        p95=float(p95),
        mean_ci95=(float(low), float(high)),
        n=len(mm),
    )


def _resampled(n: int) -> Array:
    """How often each of n is drawn in each bootstrap sample, shape (samples, n)."""
    return np.random.default_rng(n).multinomial(n, np.full(n, 1.0 / n), size=_SAMPLES).astype(np.float64)


def position_errors(measured: Array, computed: Array) -> Array:
    """Absolute error of each point, ``|P_M - P_C|``, shape (n,) [m]."""
    return np.asarray(np.linalg.norm(measured - computed, axis=1))


def distance_errors(measured: Array, computed: Array) -> Array:
    """ISO 9283 distance error of all pairs of points of one arm, ``|d_M - d_C|``, shape (n (n - 1) / 2,) [m]."""
    return np.asarray(_all_distances(measured, computed)[np.triu_indices(len(measured), 1)])


def _all_distances(measured: Array, computed: Array) -> Array:
    """Distance errors of every point to every other, shape (n, n) [m]."""
    return np.asarray(np.abs(cdist(measured, measured) - cdist(computed, computed)))


def distance_summary(measured: Array, computed: Array) -> Summary:
    """Of the distance errors of all pairs; points are resampled, not pairs, as pairs share points."""
    errors = _all_distances(measured, computed)
    n = len(measured)
    weights = _resampled(n)
    total = np.einsum("sn,sn->s", weights @ errors, weights)
    different = n * n - np.einsum("sn,sn->s", weights, weights)
    means = total / np.maximum(different, 1.0)
    return summarise(errors[np.triu_indices(n, 1)], means)


def repeatability(q: Array, p_M: Array) -> dict[str, float | int] | None:
    """Position repeatability where stops repeat (same joints to 0.1 mrad), or None where none does.

    ISO 9283: mean distance from the barycentre plus three standard deviations, here over all groups of repeats.
    """
    _, group = np.unique(np.round(q / 1e-4).astype(np.int64), axis=0, return_inverse=True)
    group = group.ravel()
    sizes = np.bincount(group)
    repeated = sizes[group] > 1
    if not repeated.any():
        return None
    centers = np.stack([np.bincount(group, p_M[:, k]) / sizes for k in range(3)], axis=1)
    off = np.linalg.norm(p_M - centers[group], axis=1)[repeated] * 1e3
    return {"mean": float(off.mean()), "rp": float(off.mean() + 3.0 * off.std(ddof=1)), "n": len(off)}


def evaluate(measured: Array, computed: Array) -> dict[str, dict[str, Any]]:
    """``position_mm`` and ``distance_mm`` of one stage, for JSON; no distances from a single point."""
    result = {"position_mm": summarise(position_errors(measured, computed)).as_dict()}
    if len(measured) > 1:
        result["distance_mm"] = distance_summary(measured, computed).as_dict()
    return result
