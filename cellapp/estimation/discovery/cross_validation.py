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

_FEWEST_PLACEMENTS = 4
"""Placements from which one can be left out and the arm still be determined by the others."""


def cross_validated_gain(data: ArmData, fit: JointFit, new_rows: Array) -> float:
    """Decrease of the whitened sum of squares of left-out readings when columns (m, 3 n) join a fit.

    Of a ball in sockets whole placements are left out, and what counts is the scatter within each point: nothing says
    where a point is that was not learnt from, and a place where the arm was is no test of a place where it was not.
    """
    if data.points is not None:
        return float(placement_gains(data, fit, new_rows).sum())
    folds = data.profile.discovery.folds
    generator = np.random.default_rng([data.profile.seed, _FOLD_SEED])
    readings = len(data) if data.reading is None else int(data.reading.max()) + 1
    fold = generator.permutation(readings) % folds
    fold = np.tile(fold if data.reading is None else fold[data.reading], 3)
    gain = 0.0
    for rows, sign in ((fit.rows, 1.0), (np.concatenate([fit.rows, new_rows]), -1.0)):
        precision = np.concatenate([fit.precision, np.zeros(len(rows) - len(fit.rows))])
        for out, solution in _fold_solutions(rows, precision, fit.target, fold, folds):
            gain += sign * float(np.sum((fit.target[out] - solution @ rows[:, out]) ** 2))
    return gain


def may_leave_placements_out(data: ArmData) -> bool:
    """Whether a ball rested at so many placements that an arm is determined without one of them."""
    points = data.points
    return points is not None and int(points.contacts.placements(points.at).max()) + 1 >= _FEWEST_PLACEMENTS


def placement_gains(data: ArmData, fit: JointFit, new_rows: Array) -> Array:
    """Decrease of the whitened sum of squares (m,) at each left-out placement of sockets when columns join a fit.

    With few placements it is at each left-out point.
    """
    points = data.points
    assert points is not None
    contacts = points.contacts
    whole = contacts.placements(points.at) if may_leave_placements_out(data) else np.arange(len(contacts.names))
    fold, folds = np.tile(whole[contacts.index], 3), int(whole.max()) + 1
    gains = np.zeros(folds)
    for rows, sign in ((fit.rows, 1.0), (np.concatenate([fit.rows, new_rows]), -1.0)):
        precision = np.concatenate([fit.precision, np.zeros(len(rows) - len(fit.rows))])
        for number, (out, solution) in enumerate(_fold_solutions(rows, precision, fit.target, fold, folds)):
            left = fit.target[out] - solution @ rows[:, out]
            gains[number] += sign * float(np.sum(_within_points(contacts.index[out[: len(data)]], left) ** 2))
    return gains


def _within_points(point: NDArray[np.intp], left: Array) -> Array:
    """Residuals (3 k,) of k readings less the mean of each coordinate over the readings of the same point."""
    _, point, counts = np.unique(point, return_inverse=True, return_counts=True)
    axes = left.reshape(3, -1)
    means = np.stack([np.bincount(point, axis) / counts for axis in axes])
    return np.asarray((axes - means[:, point]).ravel())


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
