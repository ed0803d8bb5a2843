"""Error statistics of a model on held-out readings: position errors, ISO 9283 distance errors, repeatability."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy

from cellapp.estimation.calibration.quantities import Quantities
from cellapp.estimation.calibration.records import Repeatability
from cellapp.ground.results import ErrorSummary, StageErrors
from cellapp.robot.kinematics.transforms import Array

_SAMPLES = 400
"""Number of bootstrap samples: they fix the ends of a 95 % interval to a few per cent of its width."""
_SAME_JOINTS_RAD = 1e-4
"""Joint difference below which two stops are the same: above a controller's repeatability, below any planned step."""


def summarise(errors: Array, means: Array | None = None) -> ErrorSummary:
    """Compute statistics in mm of errors (n,) [m], or in mrad of errors [rad].

    ``means`` (samples,) [m] are bootstrapped means, needed if the errors are not independent.
    """
    mm = np.abs(errors) * 1e3
    if means is None:
        weights = _resampled(len(mm))
        means = weights @ np.abs(errors) / len(mm)
    low, high = np.quantile(means, [0.025, 0.975]) * 1e3
    p50, p95 = np.quantile(mm, [0.5, 0.95])
    return ErrorSummary(
        mean=float(mm.mean()),
        rms=float(np.sqrt(np.mean(mm**2))),
        std=float(mm.std(ddof=1)) if len(mm) > 1 else 0.0,
        max=float(mm.max()),
        p50=float(p50),
        p95=float(p95),
        mean_ci95=(float(low), float(high)),
        n=len(mm),
    )


@lru_cache(maxsize=1)
def _resampled(n: int) -> Array:
    """Draw bootstrap weights (samples, n): how often each of n is drawn in each sample; kept for the next stage."""
    return np.random.default_rng(n).multinomial(n, np.full(n, 1.0 / n), size=_SAMPLES).astype(np.float64)


def position_errors(measured: Array, computed: Array) -> Array:
    """Compute the absolute error of each point, ``|P_M - P_C|``, shape (n,) [m]."""
    return np.asarray(np.linalg.norm(measured - computed, axis=1))


def distance_errors(measured: Array, computed: Array) -> Array:
    """Compute the ISO 9283 error ``|d_M - d_C|`` (n (n - 1) / 2,) [m] of every pair of points (n, 3) of one arm."""
    return np.asarray(np.abs(scipy.spatial.distance.pdist(measured) - scipy.spatial.distance.pdist(computed)))


def distance_summary(measured: Array, computed: Array, weights: Array | None = None) -> ErrorSummary:
    """Compute statistics of the distance errors of all pairs; the bootstrap resamples points, as pairs share points.

    ``weights`` are the bootstrap weights of the points; drawn if None.
    """
    errors = distance_errors(measured, computed)
    n = len(measured)
    weights = _resampled(n) if weights is None else weights
    # Single precision is enough for the ends of an interval from 400 samples.
    whole = scipy.spatial.distance.squareform(errors.astype(np.float32))
    total = np.einsum("sn,sn->s", weights.astype(np.float32) @ whole, weights)
    different = n * n - np.einsum("sn,sn->s", weights, weights)
    means = total / np.maximum(different, 1.0)
    return summarise(errors, means)


def repeatability(q: Array, p_M: Array) -> Repeatability | None:
    """Compute the position repeatability of repeated stops (same joints to 0.1 mrad); None if no stop was repeated.

    ISO 9283: mean distance from the barycentre plus three standard deviations, here over all groups of repeats.
    """
    _, group = np.unique(np.round(q / _SAME_JOINTS_RAD).astype(np.int64), axis=0, return_inverse=True)
    group = group.ravel()
    sizes = np.bincount(group)
    repeated = sizes[group] > 1
    if not repeated.any():
        return None
    centers = np.stack([np.bincount(group, p_M[:, k]) / sizes for k in range(3)], axis=1)
    off = np.linalg.norm(p_M - centers[group], axis=1)[repeated] * 1e3
    return Repeatability(mean=float(off.mean()), rp=float(off.mean() + 3.0 * off.std(ddof=1)), n=len(off))


def evaluate_quantities(measured: Quantities, computed: Array) -> StageErrors:
    """Compute the errors of one model, ``computed`` (m, 3), at positions [m] and orientations [rad]."""
    p_M, turned = measured.readings.p_M, measured.turned
    if turned is None:
        return evaluate(p_M, computed)
    errors = evaluate(p_M[~turned], computed[~turned])
    return errors.model_copy(update={"orientation_mrad": summarise(np.linalg.norm(computed[turned], axis=1))})


def evaluate(measured: Array, computed: Array) -> StageErrors:
    """Compute absolute and distance errors of one model at points (n, 3) [m]; a single point has no distance."""
    errors, weights = position_errors(measured, computed), _resampled(len(measured))
    return StageErrors(
        position_mm=summarise(errors, weights @ errors / len(errors)),
        distance_mm=distance_summary(measured, computed, weights) if len(measured) > 1 else None,
    )
