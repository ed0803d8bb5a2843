"""Weighted linear regression of a figure over time, its confidence band, and when it reaches a limit.

y_i = a + b (t_i - t0) with weights w_i = 1 / u_i^2 and t0 the weighted mean time, so that the estimates of a and b are
uncorrelated (Draper and Smith, Applied Regression Analysis, 3rd ed., chapters 1 and 9):

    b = sum w_i (t_i - t0) y_i / S,    S = sum w_i (t_i - t0)^2,    var a = s^2 / sum w_i,    var b = s^2 / S

Where the u_i are known, s^2 is chi-square per degree of freedom, but at least 1 (Birge, Phys. Rev. 40, 207 (1932)):
runs may scatter more than their standard errors say, as they do with other targets or another plan. Where they are not,
all weights are equal and s^2 is the variance of the residuals. Limits use Student's t with n - 2 degrees of freedom.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

Array = NDArray[np.float64]

FEWEST_POINTS = 4
"""With three points and one degree of freedom, hardly any slope could be proven."""
CONFIDENCE = 0.95
_FLAT = 1e-12
"""Spread of the times, in units of their size, below which they are one time."""


@dataclass(frozen=True)
class Line:
    """A fitted line: value ``level`` at time ``origin`` and ``slope``, uncorrelated, with standard errors."""

    origin: float
    level: float
    slope: float
    level_standard_error: float
    slope_standard_error: float
    degrees_of_freedom: int

    @property
    def p_value(self) -> float:
        """Chance of a slope as large, of either sign, where there is none."""
        if self.slope_standard_error == 0.0:
            return 0.0 if self.slope else 1.0
        return float(2.0 * stdtr(self.degrees_of_freedom, -abs(self.slope / self.slope_standard_error)))

    def at(self, time: Array) -> Array:
        """Values of the line at times (n,)."""
        return self.level + self.slope * (time - self.origin)

    def half_width(self, time: Array, confidence: float = CONFIDENCE) -> Array:
        """Half widths (n,) of the confidence interval of the line at times (n,)."""
        spread = np.hypot(self.level_standard_error, self.slope_standard_error * (time - self.origin))
        return _quantile(self.degrees_of_freedom, confidence) * spread


def fit_line(time: Array, value: Array, standard_error: Array | None) -> Line | None:
    """The line through values (n,) at times (n,); None for fewer than four values, or all at one time."""
    n = len(time)
    if n < FEWEST_POINTS or not np.ptp(time) > _FLAT * max(1.0, float(np.abs(time).max())):
        return None
    known = standard_error is not None and bool(np.all(np.isfinite(standard_error) & (standard_error > 0.0)))
    weights = 1.0 / np.square(standard_error) if known and standard_error is not None else np.ones(n)
    origin = float(weights @ time / weights.sum())
    off = time - origin
    S = float(weights @ off**2)
    level, slope = float(weights @ value / weights.sum()), float((weights * off) @ value / S)
    residual = value - level - slope * off
    variance = float(weights @ residual**2) / (n - 2)
    scale = math.sqrt(max(1.0, variance) if known else variance)
    return Line(origin, level, slope, scale / math.sqrt(float(weights.sum())), scale / math.sqrt(S), n - 2)


def crossing(line: Line, limit: float, confidence: float = CONFIDENCE) -> tuple[float, float | None, float | None]:
    """When the line reaches ``limit``: the time, and the limits of its confidence set.

    The set holds every time t at which the limit lies within the confidence interval of the line (Fieller, J. R. Stat.
    Soc. B 16, 175 (1954)): (a + b x - limit)^2 <= q^2 (var a + x^2 var b), x = t - t0. None is a side without a limit:
    where the slope itself is not significant, the line may never get there. ``line.slope`` must not be zero.
    """
    q2 = _quantile(line.degrees_of_freedom, confidence) ** 2
    gap = limit - line.level
    time = line.origin + gap / line.slope
    a = line.slope**2 - q2 * line.slope_standard_error**2
    b = -2.0 * line.slope * gap
    c = gap**2 - q2 * line.level_standard_error**2
    if a <= 0.0:
        return time, None, None
    root = math.sqrt(max(b * b - 4.0 * a * c, 0.0))
    return time, line.origin + (-b - root) / (2.0 * a), line.origin + (-b + root) / (2.0 * a)


def _quantile(degrees_of_freedom: int, confidence: float) -> float:
    return float(stdtrit(degrees_of_freedom, 0.5 + confidence / 2.0))
