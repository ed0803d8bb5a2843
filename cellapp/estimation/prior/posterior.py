"""Normal posterior of an arm's geometry and effects, from readings and a normal prior with any correlations.

The readings are weighted by their stated uncertainty and the scatter beyond it about the model. The solution is by
Gauss-Newton steps; near it, geometry and effects deviate from linear by a hundredth of a millimetre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cellapp.estimation.calibration.least_squares import inverse_psd, shortened, solve_psd
from cellapp.estimation.calibration.quantities import states_nothing
from cellapp.estimation.calibration.weights import excess_variance, with_excess
from cellapp.estimation.discovery.arm_data import whitening
from cellapp.estimation.discovery.joint_fit import NormalMatrix
from cellapp.estimation.prior.linear_model import Measured, normal_matrix, values_of, with_values
from cellapp.ground.errors import NotConverged
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

_FIT = "fit of an arm with an earlier calibration or belief"
_STEPS = 100
"""Most Gauss-Newton steps, each with the scatter of the one before; three to five are usual, 30 with few readings."""
_SETTLED = 1e-3
"""Change of the values in the last step, as a share of their standard errors."""
_SCATTER_SETTLED = 0.01
"""Relative change of the scatter in the last step."""
_LEAST_SCATTER_M = 1e-6
"""Least scatter of a coordinate if the readings state no uncertainty, needed if the model leaves no residuals [m]."""
_FIRST_SCATTER_M = 1e-4
"""Start value of the scatter of a coordinate [m]."""
_FIRST_SCATTER_RAD = 2e-4
"""Start value of the scatter of a component of an orientation [rad]."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Mean (p,) and precision (p, p) of deviations from ``reference`` and of effects, see ``values_of``.

    Rows and columns of the precision are zero for free parameters: base and tool.
    """

    columns: tuple[int, ...]
    reference: Geometry
    mean: Array
    precision: Array


@dataclass(frozen=True, eq=False)
class Posterior:
    """Values (p,), their covariance (p, p), the model at the values, and the weights of the readings.

    ``scatter_m`` is the standard deviation of a coordinate beyond the stated uncertainty, all of it if none is stated;
    ``scatter_rad`` that of a component of an orientation. ``left_M`` (n, 3) [m, rad] is measured less computed.
    """

    prior: Prior
    values: Array
    covariance: Array
    model: ArmModel
    measured: Measured
    scatter_m: float
    left_M: Array
    scatter_rad: float = 0.0


def posterior(model: ArmModel, measured: Measured, prior: Prior, scatter_m: float | None = None) -> Posterior:
    """Compute the posterior from a start ``model``, whose effects the values have; a given ``scatter_m`` is fixed.

    No step raises the sum of squares, priors included. Raise ``NotConverged`` if values and scatter do not settle.
    """
    scatter = (_FIRST_SCATTER_M if scatter_m is None else scatter_m, _FIRST_SCATTER_RAD)
    values = values_of(model.geometry, model.effects, prior.columns, prior.reference)
    for _ in range(_STEPS):
        measured = replace(measured, sigma=_sigma(measured, *scatter))
        normal = normal_matrix(model, measured, prior.columns, prior.reference)
        found, covariance = solution(normal, prior)
        errors = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        step = found - values
        moved = float(np.max(np.abs(step) / errors))
        if moved >= _SETTLED:
            step = shortened(_FIT, step, partial(_loss, model, measured, prior, values))
        values = values + step
        model = with_values(model, prior.columns, prior.reference, values)
        left_M = measured.left(model)
        before = scatter
        if scatter_m is None:
            scatter = _scatter(measured, left_M, float(np.sum(covariance * normal.gram)))
        settled = all(abs(now - then) <= _SCATTER_SETTLED * then for now, then in zip(scatter, before, strict=True))
        if moved < _SETTLED and settled:
            break
    else:
        raise NotConverged.of(_FIT, f"{_STEPS} steps were not enough; the last was {moved:.1e} standard errors long")
    of_turns = 0.0 if measured.turned is None else before[1]
    return Posterior(prior, values, covariance, model, measured, before[0], left_M, of_turns)


def _loss(model: ArmModel, measured: Measured, prior: Prior, values: Array, step: Array) -> float:
    """Compute the sum of squares, priors included, a ``step`` (p,) beyond ``values``."""
    after = values + step
    left_M = measured.left(with_values(model, prior.columns, prior.reference, after))
    white = np.einsum("acn,nc->an", whitening(measured.sigma), left_M)
    off = after - prior.mean
    return float(np.vdot(white, white) + off @ prior.precision @ off)


def _scatter(measured: Measured, left_M: Array, fitted: float) -> tuple[float, float]:
    """Estimate the scatter of a coordinate [m] and of an orientation component [rad] about ``fitted`` parameters.

    The parameters are charged to both kinds in proportion to their numbers of readings.
    """
    turned, stated = measured.turned, measured.stated
    if turned is None:
        return scatter_of(left_M, stated, 3 * len(measured) - fitted), _FIRST_SCATTER_RAD
    assert stated is not None
    kinds = [
        scatter_of(
            left_M[rows],
            None if states_nothing(stated[rows]) else stated[rows],
            3.0 * int(rows.sum()) - fitted * float(rows.mean()),
        )
        for rows in (~turned, turned)
    ]
    return kinds[0], kinds[1]


def solution(normal: NormalMatrix, prior: Prior) -> tuple[Array, Array]:
    """Return mean (p,) and covariance (p, p) of the values."""
    A = normal.gram + prior.precision
    unit = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    A = A * unit * unit[:, None]
    b = unit * (normal.moment + prior.precision @ prior.mean)
    return solve_psd(A, b) * unit, inverse_psd(A) * unit * unit[:, None]


def scatter_of(left_M: Array, stated: Array | None, freedom: float) -> float:
    """Return the standard deviation of a coordinate [m] beyond the stated uncertainty, all of it if none is stated."""
    degrees = max(1, round(freedom))
    if stated is None:
        return max(math.sqrt(float(np.sum(left_M**2)) / degrees), _LEAST_SCATTER_M)
    return math.sqrt(excess_variance(left_M, stated, degrees))


def _sigma(measured: Measured, scatter_m: float, scatter_rad: float) -> Array:
    if measured.stated is None:
        return np.full(len(measured), scatter_m)
    return with_excess(measured.stated, scatter_m**2, measured.turned, scatter_rad**2)
