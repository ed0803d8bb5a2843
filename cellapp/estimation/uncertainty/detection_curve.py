"""Detection rate over size from few trials: a psychometric curve with its uncertainty, and the sizes to try next.

The share found at a size x is ``(1 - lapse) / (1 + exp(-(ln x - middle) / width))``: a logistic curve of the log size
(Kingdom, Prins, Psychophysics, 2nd ed., 2016, ch. 4) that ends below one if even the largest are sometimes missed. All
three parameters have a prior on a grid, so few trials give wide intervals instead of failed fits. The next sizes are
where the belief expects the curve to pass the wanted share (Watson, Pelli, Percept. Psychophys. 33 (1983) 113).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from cellapp.robot.kinematics.transforms import Array

_MIDDLES, _BEYOND = 80, 8.0
"""Number of values of the middle, from half the smallest size to ``_BEYOND`` times the largest one."""
_WIDTHS = np.geomspace(0.06, 0.8, 9)
"""Widths in natural logarithms of the size: simulated laws differ in how much of them geometry can follow."""
_LAPSES = np.array([0.0, 0.01, 0.03, 0.1, 0.3, 0.6])
_LAPSE_PRIOR = np.array([0.4, 0.3, 0.17, 0.07, 0.04, 0.02])
_NEXT = (0.25, 0.5, 0.75)
"""Quantiles of the belief about the wanted size to try next."""
_ABOVE = 1.8
"""Multiple of its median to try as well: a miss there is not due to small size."""


@dataclass(frozen=True, eq=False)
class NamingCurve:
    """Belief about the curve, on a grid.

    Attributes
    ----------
    low, high : float
        Smallest and largest size to try, in any unit.
    weights : array, shape (middles, widths, lapses)
        Probability of each curve of the grid.
    """

    low: float
    high: float
    weights: Array

    @classmethod
    def of(cls, low: float, high: float, sizes: Sequence[float] = (), found: Sequence[bool] = ()) -> NamingCurve:
        """Compute the belief after trials of some ``sizes``; without any, the prior."""
        prior = np.ones((_MIDDLES, len(_WIDTHS), 1)) * _LAPSE_PRIOR
        log_weights = np.log(prior)
        middles = _middles(low, high)
        for size, was_found in zip(sizes, found, strict=True):
            share = _share(np.log(size), middles)
            log_weights += np.log(np.clip(share if was_found else 1.0 - share, 1e-12, 1.0))
        weights = np.exp(log_weights - log_weights.max())
        return cls(low, high, weights / weights.sum())

    def size_at(self, share: float, quantiles: Sequence[float]) -> list[float]:
        """Return quantiles of the belief about the size of which ``share`` are found; infinite if it may not exist."""
        log_size = np.full(self.weights.shape, np.inf)
        reached = share / (1.0 - _LAPSES)
        able = reached < 1.0
        middles = _middles(self.low, self.high)[:, None, None]
        log_size[:, :, able] = middles + _WIDTHS[:, None] * np.log(reached[able] / (1.0 - reached[able]))
        order = np.argsort(log_size, axis=None)
        cumulated = np.cumsum(self.weights.ravel()[order])
        places = np.minimum(np.searchsorted(cumulated, np.array(quantiles) * cumulated[-1]), len(order) - 1)
        return [float(value) for value in np.exp(log_size.ravel()[order][places])]

    def next_sizes(self, share: float) -> list[float]:
        """Return the four most informative sizes for the size of which ``share`` are found."""
        wanted = self.size_at(share, _NEXT)
        return [min(max(size, self.low), self.high) for size in (*wanted, _ABOVE * wanted[len(_NEXT) // 2])]


def _middles(low: float, high: float) -> Array:
    return np.linspace(np.log(0.5 * low), np.log(_BEYOND * high), _MIDDLES)


def _share(log_size: float, middles: Array) -> Array:
    """Return the share found at a size by every curve of the grid."""
    curve = expit((log_size - middles[:, None]) / _WIDTHS)
    return np.asarray(curve[:, :, None] * (1.0 - _LAPSES))
