"""Significance of scores over the whole scan: threshold, p-values, and smallest detectable sizes.

The threshold is a high quantile of the largest score over all laws scanned, in simulated data without effects.
Searching over many laws therefore does not raise the false-alarm rate (max-T: Westfall, Young, Resampling-Based
Multiple Testing, 1993).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from cellapp.estimation.design.information import VISIBLE, NuisanceProjector, detectable_size
from cellapp.estimation.discovery.search.scan import LawScan, choice_price
from cellapp.robot.kinematics.transforms import Array

_TAIL = 0.15
"""Share of the highest null maxima whose excess is modelled as exponential (peaks over threshold): 60 of the default
400 simulations, enough to estimate its mean to 13 %."""

_AT_ONCE = 100
"""Batch size of simulations: bounds the memory."""


def simulate_null_maxima(scan: LawScan, projector: NuisanceProjector, simulations: int, seed: tuple[int, ...]) -> Array:
    """Return the largest score over all candidates in each of ``simulations`` residuals of pure noise, sorted.

    Only single blocks are tried: as a second block must gain more, high quantiles stay the same.
    """
    y = np.random.default_rng(seed).standard_normal((len(projector.basis), simulations))
    if not scan.candidates:
        return np.full(simulations, -math.inf)
    maxima = []
    for first in range(0, simulations, _AT_ONCE):
        some = y[:, first : first + _AT_ONCE]
        projected = projector.project(some.T).T
        maxima.append(scan.best_block_scores(projected, np.einsum("ds,ds->s", some, projected)).max(axis=0))
    return np.sort(np.concatenate(maxima))


def score_threshold(null_maxima: Array, false_alarm: float) -> float:
    """Return the score that noise alone exceeds with probability ``false_alarm``; never below zero.

    In the highest ``_TAIL`` the distribution is modelled as exponential, which steadies quantiles of few simulations.
    """
    if not len(null_maxima) or not np.isfinite(null_maxima).any():
        return 0.0
    start = float(np.quantile(null_maxima, 1.0 - _TAIL))
    if false_alarm >= _TAIL or not math.isfinite(start):
        return max(0.0, float(np.quantile(null_maxima, 1.0 - false_alarm)))
    beyond = null_maxima[null_maxima > start]
    mean_excess = float(np.mean(beyond - start)) if len(beyond) else 0.0
    return max(0.0, start + mean_excess * math.log(_TAIL / false_alarm))


def corrected_p_value(null_maxima: Array, score: float) -> float:
    """Return the share of null maxima at or above ``score``; the data count as one more, so it is never zero."""
    return (1.0 + float(np.count_nonzero(null_maxima >= score))) / (len(null_maxima) + 1.0)


def smallest_detectable(scan: LawScan, number: int, threshold: float) -> Mapping[str, float]:
    """Return the smallest size of each column of a candidate that would pass ``threshold``; infinite if invisible."""
    one, place = scan.candidates[number], scan.place(number)
    norms = np.sqrt(scan.behind.squares[place])
    needed = threshold + math.log(scan.freedom) + choice_price(one.law)
    return {
        column.name: detectable_size(norm, needed) if share > VISIBLE else math.inf
        for column, norm, share in zip(one.columns, norms.tolist(), scan.visible_share[place].tolist(), strict=True)
    }
