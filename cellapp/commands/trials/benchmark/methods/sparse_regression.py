"""The method ``sparse-regression``: sequentially thresholded least squares of pysindy, joint by joint.

Brunton, Proctor, Kutz, PNAS 113 (2016) 3932. The residuals are projected to joints and regressed on named features;
each joint's threshold minimizes the Bayesian information criterion.
"""

from __future__ import annotations

import math
import warnings

import numpy as np

from cellapp.commands.trials.benchmark.features import JointRule, regressed_by_joint
from cellapp.commands.trials.benchmark.methods.forward_selection import even_odds
from cellapp.commands.trials.benchmark.problem import Answer, Problem
from cellapp.robot.kinematics.transforms import Array

_THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Thresholds of coefficients that are tried, in standard deviations of a joint's offsets."""


def sparse_regression(problem: Problem) -> Answer:
    """Name the effects of the features that remain."""
    return regressed_by_joint(problem, _sparse)


def _sparse(table: Array, offset: Array) -> tuple[JointRule, dict[int, float]]:
    """Return the rule of the remaining features, each with the probability of the rule."""
    mean, scale = offset.mean(), float(offset.std()) or 1.0
    coefficients, gain = _thresholded(table, (offset - mean) / scale)
    kept = dict.fromkeys(np.flatnonzero(coefficients).tolist(), even_odds(gain))
    return lambda asked: scale * (asked @ coefficients) + mean, kept


def _thresholded(table: Array, y: Array) -> tuple[Array, float]:
    """Return the coefficients (m,) of the best threshold, and the gain of the criterion over none."""
    from pysindy.optimizers import STLSQ

    none = len(y) * math.log(float(np.mean(y**2)))
    best, least = np.zeros(table.shape[1]), none
    for threshold in _THRESHOLDS:
        optimizer = STLSQ(threshold=threshold, alpha=1e-6)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a threshold removes everything: then it is not chosen
            optimizer.fit(table, y[:, None])
        found = np.asarray(optimizer.coef_)[0]
        left = float(np.mean((y - table @ found) ** 2))
        criterion = len(y) * math.log(max(left, 1e-300)) + np.count_nonzero(found) * math.log(len(y))
        if criterion < least:
            best, least = found, criterion
    return best, none - least
