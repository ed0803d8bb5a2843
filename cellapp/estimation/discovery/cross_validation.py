"""K-fold cross-validation of a new term, linear about a joint fit.

Each fold is predicted by the least-squares solution of the other folds (with priors),

    beta = (X_in X_in^T + P)^-1 X_in y_in,

from the normal matrix of all readings less that of the fold. The hat matrix of the fit would save these solutions, but
I - H is nearly singular if few readings are left: a direction that they do not determine would then count as predicted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import PIVOT, cholesky
from cellapp.estimation.design.information import SMALLEST
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.normal_matrix import Factored, NormalMatrix
from cellapp.robot.kinematics.transforms import Array

_FOLD_SEED = 0xF01D
"""Combined with the profile's seed, so that the folds are independent of all other draws."""


def cross_validated_gain(data: ArmData, fit: JointFit, new_rows: Array) -> float:
    """Return the decrease of the whitened sum of squares of left-out readings when columns (m, 3 n) join a fit."""
    folds = data.profile.discovery.folds
    generator = np.random.default_rng([data.profile.seed, _FOLD_SEED])
    readings = len(data) if data.reading is None else int(data.reading.max()) + 1
    fold = generator.permutation(readings) % folds
    fold = np.tile(fold if data.reading is None else fold[data.reading], 3)
    return float(sum(np.sum(before**2) - np.sum(after**2) for before, after in _left_out(fit, new_rows, fold)))


def _left_out(fit: JointFit, new_rows: Array, fold: NDArray[np.intp]) -> Iterator[tuple[Array, Array]]:
    """Yield for each fold the residuals of the left-out coordinates without and with the new columns."""
    scale = 1.0 / np.maximum(np.linalg.norm(new_rows, axis=1), SMALLEST)
    new, target = new_rows * scale[:, None], fit.target
    for one in _folds(fit, fold):
        learnt = ~one.out
        B = new[:, learnt]
        cross, gram = fit.rows[:, learnt] @ B.T, B @ B.T
        taken = one.learnt.solve(cross)
        factor = cholesky(gram - cross.T @ taken)
        if factor is None or not (factor.diagonal() > PIVOT * np.sqrt(gram.diagonal())).all():
            # the new columns are not independent of each other or of the fit
            rows = np.concatenate([fit.rows, new])
            precision = np.concatenate([fit.precision, np.zeros(len(new))])
            of_all = np.concatenate([fit.normal.scale, np.ones(len(new))])
            solution = NormalMatrix.of(rows[:, learnt], target[learnt]).with_priors(precision, of_all).solution
            yield one.left, target[one.out] - solution @ rows[:, one.out]
            continue
        moment = B @ target[learnt] - taken.T @ one.moment
        values = scipy.linalg.lapack.dpotrs(factor, moment, lower=1)[0]
        yield one.left, one.left - values @ (new[:, one.out] - taken.T @ fit.rows[:, one.out])


@dataclass(frozen=True, eq=False)
class _Fold:
    """A fit without the readings of one fold: the mask ``out`` (3 n,) of these, and their residuals ``left``.

    ``learnt`` and ``moment`` are its factored equations: one matrix a fold, not three.
    """

    out: NDArray[np.bool_]
    learnt: Factored
    moment: Array
    left: Array


def _folds(fit: JointFit, fold: NDArray[np.intp]) -> list[_Fold]:
    """Return the fits without each fold, cached in the whole fit: many columns are tried beside it."""
    key = fold.tobytes()
    if key not in fit.derived:
        rows, target, found = fit.rows, fit.target, []
        whole = fit.normal
        for number in range(int(fold.max()) + 1):
            out = fold == number
            solver = (whole - NormalMatrix.of(rows[:, out], target[out])).with_priors(fit.precision, whole.scale)
            left = target[out] - solver.solution @ rows[:, out]
            found.append(_Fold(out, solver.factored, solver.normal.moment, left))
        fit.derived[key] = found
    kept: list[_Fold] = fit.derived[key]
    return kept
