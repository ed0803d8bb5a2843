"""K-fold cross-validation of a new term on left-out readings, linear about a joint fit.

Each fold is predicted by the least-squares solution of the others (with priors),

    beta = (X_in X_in^T + P)^-1 X_in y_in,

from the normal matrix of all readings less that of the fold. The hat matrix of the fit would spare these solutions, but
I - H is nearly singular where few readings are left: a direction that they do not determine then counts as predicted.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.linear import solve_psd
from cellapp.estimation.design.information import SMALLEST
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.robot.kinematics.transforms import Array

_FOLD_SEED = 0xF01D
"""Beside the profile's seed: the folds are then independent of all other draws."""


def cross_validated_gain(data: ArmData, fit: JointFit, new_rows: Array) -> float:
    """Decrease of the whitened sum of squares of left-out readings when columns (m, 3 n) join a fit."""
    folds = data.profile.discovery.folds
    generator = np.random.default_rng([data.profile.seed, _FOLD_SEED])
    fold = np.tile(generator.permutation(len(data)) % folds, 3)
    gain = 0.0
    for rows, sign in ((fit.rows, 1.0), (np.concatenate([fit.rows, new_rows]), -1.0)):
        precision = np.concatenate([fit.precision, np.zeros(len(rows) - len(fit.rows))])
        for out, solution in _fold_solutions(rows, precision, fit.target, fold, folds):
            gain += sign * float(np.sum((fit.target[out] - solution @ rows[:, out]) ** 2))
    return gain


def _fold_solutions(
    rows: Array, precision: Array, target: Array, fold: NDArray[np.intp], folds: int
) -> Iterator[tuple[NDArray[np.bool_], Array]]:
    """For each fold the coordinates that are left out, and the parameters (p,) fitted to the others."""
    scale = 1.0 / np.maximum(np.linalg.norm(rows, axis=1), SMALLEST)
    X = rows * scale[:, None]
    gram, moment = X @ X.T + np.diag(precision * scale**2), X @ target
    for k in range(folds):
        out = fold == k
        left_out = X[:, out]
        solution = solve_psd(gram - left_out @ left_out.T, moment - left_out @ target[out])
        yield out, solution * scale
