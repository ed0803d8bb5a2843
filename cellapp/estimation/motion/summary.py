"""Statistics of errors in motion."""

from __future__ import annotations

import numpy as np

from cellapp.ground.results import ErrorSummary
from cellapp.robot.kinematics.transforms import Array


def error_summary(mm: Array) -> ErrorSummary:
    """Return statistics of correlated errors [mm], without a confidence interval of their mean."""
    p50, p95 = np.quantile(mm, [0.5, 0.95]).tolist()
    std = float(mm.std(ddof=1)) if len(mm) > 1 else 0.0
    rms, mean, most = float(np.sqrt(np.mean(mm**2))), float(mm.mean()), float(mm.max())
    return ErrorSummary(mean=mean, rms=rms, std=std, max=most, p50=p50, p95=p95, n=len(mm))
