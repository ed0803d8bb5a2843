"""The method ``sparse-regression``: sequentially thresholded least squares of pysindy, joint by joint.

Brunton, Proctor, Kutz, PNAS 113 (2016) 3932. The residual is projected to joints and regressed on named features; the
threshold of each joint is that of the least Bayesian information criterion.
"""

from __future__ import annotations

import math
import warnings

import numpy as np

from cellapp.commands.trials.benchmark.features import Scaling, joint_features
from cellapp.commands.trials.benchmark.methods.forward_selection import even_odds
from cellapp.commands.trials.benchmark.problem import Answer, JointProjection, Problem
from cellapp.robot.kinematics.transforms import Array

_THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Of coefficients, in standard deviations of a joint's offsets."""


def sparse_regression(problem: Problem) -> Answer:
    """Name the effects of the features that are kept."""
    projection = JointProjection.of(problem)
    learn, held = projection.context(held_out=False), projection.context(held_out=True)
    predicted = np.zeros((len(held), held.joints))
    names: dict[str, float] = {}
    for joint in range(learn.joints):
        features = joint_features(learn, joint)
        scaling = Scaling.of(features)
        offset = projection.offsets[:, joint]
        scale = float(offset.std()) or 1.0
        coefficients, gain = _thresholded(scaling.table(features), (offset - offset.mean()) / scale)
        predicted[:, joint] = scale * (scaling.table(joint_features(held, joint)) @ coefficients) + offset.mean()
        for feature, value in zip(features, coefficients.tolist(), strict=True):
            if value:
                names[feature.slug] = max(even_odds(gain), names.get(feature.slug, 0.0))
    return Answer(projection.predicted(predicted), names)


def _thresholded(table: Array, y: Array) -> tuple[Array, float]:
    """Coefficients (m,) of the best threshold, and their gain of the criterion over none."""
    from pysindy.optimizers import STLSQ

    none = len(y) * math.log(float(np.mean(y**2)))
    best, least = np.zeros(table.shape[1]), none
    for threshold in _THRESHOLDS:
        optimizer = STLSQ(threshold=threshold, alpha=1e-6)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that a threshold leaves nothing: then it is not chosen
            optimizer.fit(table, y[:, None])
        found = np.asarray(optimizer.coef_)[0]
        left = float(np.mean((y - table @ found) ** 2))
        criterion = len(y) * math.log(max(left, 1e-300)) + np.count_nonzero(found) * math.log(len(y))
        if criterion < least:
            best, least = found, criterion
    return best, none - least
