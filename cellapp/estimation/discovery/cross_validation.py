"""K-fold cross-validation of a new term on left-out readings, linear about a joint fit.

Each fold is predicted by the least-squares solution of the others (with priors),

    beta = (X_in X_in^T + P)^-1 X_in y_in,

from the normal matrix of all readings less that of the fold. The hat matrix of the fit would spare these solutions, but
I - H is nearly singular where few readings are left: a direction that they do not determine then counts as predicted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from cellapp.estimation.calibration.linear import PIVOT, cholesky, solve_psd
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
    return float(sum(np.sum(before**2) - np.sum(after**2) for _, before, after in _left_out(fit, new_rows, fold)))


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
    fold = np.tile(whole[contacts.index], 3)
    gains = np.zeros(int(whole.max()) + 1)
    for number, (out, before, after) in enumerate(_left_out(fit, new_rows, fold)):
        point = contacts.index[out[: len(data)]]
        gains[number] = np.sum(_within_points(point, before) ** 2) - np.sum(_within_points(point, after) ** 2)
    return gains


def _within_points(point: NDArray[np.intp], left: Array) -> Array:
    """Residuals (3 k,) of k readings less the mean of each coordinate over the readings of the same point."""
    _, point, counts = np.unique(point, return_inverse=True, return_counts=True)
    axes = left.reshape(3, -1)
    means = np.stack([np.bincount(point, axis) / counts for axis in axes])
    return np.asarray((axes - means[:, point]).ravel())


def _left_out(
    fit: JointFit, new_rows: Array, fold: NDArray[np.intp]
) -> Iterator[tuple[NDArray[np.bool_], Array, Array]]:
    """For each fold the coordinates that are left out, and what the fit leaves of them without and with new columns."""
    scale = 1.0 / np.maximum(np.linalg.norm(new_rows, axis=1), SMALLEST)
    new = new_rows * scale[:, None]
    for one in _folds(fit, fold):
        learnt = ~one.out
        B, left = new[:, learnt], one.left
        cross = one.X[:, learnt] @ B.T
        taken = one.solve(cross)
        gram = B @ B.T
        behind = gram - cross.T @ taken
        factor = cholesky(behind)
        if factor is None or not (factor.diagonal() > PIVOT * np.sqrt(gram.diagonal())).all():
            yield one.out, left, one.left_with(new)
            continue
        moment = B @ one.target[learnt] - taken.T @ one.moment
        values = lapack.dpotrs(factor, moment, lower=1)[0]
        yield one.out, left, left - values @ (new[:, one.out] - taken.T @ one.X[:, one.out])


@dataclass(frozen=True, eq=False)
class _Fold:
    """A fit to all readings but those of one fold, which are left ``out`` (3 n,).

    ``X`` (p, 3 n) are its columns of unit norm, ``gram`` (p, p) and ``moment`` (p,) of what was learnt with the priors.
    """

    out: NDArray[np.bool_]
    X: Array
    target: Array
    gram: Array
    moment: Array

    @cached_property
    def _factor(self) -> Array | None:
        return cholesky(self.gram)

    def solve(self, rhs: Array) -> Array:
        """``gram^-1 rhs``."""
        if self._factor is None:
            return solve_psd(self.gram, rhs)
        return np.asarray(lapack.dpotrs(self._factor, rhs, lower=1)[0])

    @cached_property
    def left(self) -> Array:
        """What the fit leaves of the coordinates that are left out."""
        return np.asarray(self.target[self.out] - self.solve(self.moment) @ self.X[:, self.out])

    def left_with(self, new: Array) -> Array:
        """``left`` with further columns (m, 3 n), also where the fit determines some of them by others."""
        learnt, size = ~self.out, len(self.gram)
        every = np.concatenate([self.X, new])
        gram = every[:, learnt] @ every[:, learnt].T
        gram[:size, :size] = self.gram
        moment = np.concatenate([self.moment, new[:, learnt] @ self.target[learnt]])
        return np.asarray(self.target[self.out] - solve_psd(gram, moment) @ every[:, self.out])


def _folds(fit: JointFit, fold: NDArray[np.intp]) -> list[_Fold]:
    """The fits without each fold, kept with the whole fit: many columns are tried beside one."""
    key = fold.tobytes()
    if key not in fit.derived:
        scale = 1.0 / np.maximum(np.linalg.norm(fit.rows, axis=1), SMALLEST)
        X = fit.rows * scale[:, None]
        gram, moment = X @ X.T + np.diag(fit.precision * scale**2), X @ fit.target
        found = []
        for number in range(int(fold.max()) + 1):
            out = fold == number
            left_out = X[:, out]
            less = moment - left_out @ fit.target[out]
            found.append(_Fold(out, X, fit.target, gram - left_out @ left_out.T, less))
        fit.derived[key] = found
    kept: list[_Fold] = fit.derived[key]
    return kept
