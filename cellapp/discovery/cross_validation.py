"""K-fold cross-validation of a new term on left-out readings, linear about a joint fit.

Each fold is predicted by the least-squares solution of the others (with priors). Its errors follow from the residual of
the fit to all readings, without another fit: with the hat matrix ``H = X (X^T X + P)^-1 X^T = Q Q^T`` and the
coordinates o that are left out,

    e_o = (I - H_oo)^-1 (y - H y)_o

(Cook, Weisberg, Residuals and Influence in Regression, 1982, section 2.2, for one reading at a time).
"""

from __future__ import annotations

import numpy as np

from cellapp.calibration.linear import solve_psd
from cellapp.design.information import visible_root
from cellapp.discovery.arm_data import ArmData
from cellapp.discovery.joint_fit import JointFit
from cellapp.kinematics.transforms import Array

_FOLD_SEED = 0xF01D
"""Beside the profile's seed: the folds are then independent of all other draws."""


def cross_validated_gain(data: ArmData, fit: JointFit, new_rows: Array) -> float:
    """Decrease of the whitened sum of squares of left-out readings when columns (m, 3 n) join a fit."""
    folds = data.profile.discovery.folds
    generator = np.random.default_rng([data.profile.seed, _FOLD_SEED])
    fold = np.tile(generator.permutation(len(data)) % folds, 3)
    basis, left = fit.projector.basis, fit.projector.project(fit.target)
    # with M = I - H the new columns B add M B^T (B M B^T)^-1 B M to the hat matrix
    behind = fit.projector.project(new_rows)
    root, _ = visible_root(new_rows @ behind.T, np.linalg.norm(new_rows, axis=1))
    further = behind.T @ root
    left_with = left - further @ (root.T @ (new_rows @ left))
    gain = 0.0
    for k in range(folds):
        out = fold == k
        complement = np.eye(int(np.count_nonzero(out))) - basis[out] @ basis[out].T
        gain += float(np.sum(solve_psd(complement, left[out]) ** 2))
        complement -= further[out] @ further[out].T
        gain -= float(np.sum(solve_psd(complement, left_with[out]) ** 2))
    return gain
