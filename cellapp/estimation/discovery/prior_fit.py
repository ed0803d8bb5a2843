"""Fit of an arm's geometry and effects to readings, with a normal prior of any correlations."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import TypeVar

import numpy as np

from cellapp.estimation.calibration.least_squares import excess_of_kinds, inverse_psd, shortened, solve_psd, with_excess
from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.calibration.quantities import NOT_STATED, Quantities
from cellapp.estimation.discovery.arm_data import whitening
from cellapp.estimation.discovery.joint_fit import LinearModel, NormalMatrix
from cellapp.ground.errors import NotConverged
from cellapp.robot.effects import EFFECTS, EffectColumn, EffectTerm
from cellapp.robot.effects.effect import ordered_columns
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

# -- Normal matrix of an arm's geometry and effects over its readings, accumulated over chunks ------------------------
#
# With W the whitening of a reading and J, A its derivatives by geometric parameters and by those of the effects, the
# rows are W [J, A]. Values are deviations from a reference: geometric parameters from those of ``reference``, effects
# from 0. Measured orientations are rows after the positions, see ``quantities``.

Vectors = TypeVar("Vectors", bound=Quantities)
_CHUNK = 512
"""Readings in a chunk: 1500 columns of them take 18 MB."""


def term_columns(model: ArmModel, measured: Quantities, true_q: Array | None = None) -> list[EffectColumn]:
    """Return the columns of all effects of a model, in the order of their values, at the true joint positions."""
    q, conditions = measured.readings.q, measured.conditions
    if true_q is None:
        true_q = model.true_joints(q, conditions=conditions)
    context = replace(model.context(q, conditions=conditions), q_actual=true_q)
    return [column for term in model.effects for column in ordered_columns(term, EFFECTS, context)]


def design(
    model: ArmModel,
    measured: Quantities,
    columns: tuple[int, ...],
    tied: tuple[tuple[int, int], ...] = (),
    further: Sequence[EffectColumn] = (),
) -> Array:
    """Return whitened derivatives (p, 3 n) by the geometric parameters ``columns``, those ``tied`` to them included,
    by the values of all effects, and by those of ``further`` columns."""
    conditions, parameters = measured.conditions, ParameterSet("", model.geometry.joints, columns, tied=tied)
    true_q = model.true_joints(measured.readings.q, conditions=conditions)
    effects, white = [*term_columns(model, measured, true_q), *further], whitening(measured.sigma)
    return LinearModel.of(model.geometry, true_q, white, parameters, effects, conditions.R_M_S).rows


def normal_matrix(
    model: ArmModel,
    measured: Vectors,
    prior: Prior,
    further: Callable[[Vectors], Sequence[EffectColumn]] = lambda _: (),
) -> NormalMatrix:
    """Accumulate the normal matrix over all readings, linearised at ``model``, with ``further`` columns of each part.

    y is measured less the prior's reference.
    """
    deviation = values_of(model.geometry, model.effects, prior.columns, prior.reference)

    def of_part(chunk: Vectors) -> NormalMatrix:
        rows = design(model, chunk, prior.columns, prior.tied, further(chunk))
        target = np.einsum("acn,nc->an", whitening(chunk.sigma), chunk.residuals(model)).ravel()
        return NormalMatrix.of(rows, target + deviation @ rows[: len(deviation)])

    return reduce(operator.add, map(of_part, measured.chunks(_CHUNK)))


def values_of(geometry: Geometry, terms: Sequence[EffectTerm], columns: tuple[int, ...], reference: Geometry) -> Array:
    """Return the deviations (p,) of geometric parameters from ``reference``, then the effects' values."""
    places = list(columns)
    of_geometry = geometry.vector()[places] - reference.vector()[places]
    return np.concatenate([of_geometry, *(term.values for term in terms)])


def with_values(model: ArmModel, prior: Prior, values: Array) -> ArmModel:
    """Return the model at ``values`` (p,); the reverse of ``values_of``."""
    parameters = ParameterSet("", model.geometry.joints, prior.columns, tied=prior.tied)
    counts = [len(prior.columns), *(len(term.values) for term in model.effects)]
    geometric, *of_terms = np.split(values, np.cumsum(counts)[:-1])
    geometry = parameters.moved(model.geometry, prior.reference.vector()[list(prior.columns)] + geometric)
    terms = (replace(term, values=own) for term, own in zip(model.effects, of_terms, strict=True))
    return replace(model, geometry=geometry, effects=tuple(terms))


# -- Normal posterior of an arm's geometry and effects, from readings and a normal prior with any correlations --------
#
# The readings are weighted by their stated uncertainty and the scatter beyond it about the model. The solution is by
# Gauss-Newton steps; near it, geometry and effects deviate from linear by a hundredth of a millimetre.

_FIT = "fit of geometry and effects to all readings"
_STEPS = 100
"""Most Gauss-Newton steps, each with the scatter of the one before; three to five are usual, 30 with few readings."""
_SETTLED = 1e-3
"""Change of the values in the last step, as a share of their standard errors."""
_SETTLED_WEIGHED = 0.1
"""The same where the weights stay: each step is then some thirty times as short as the last."""
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

    Rows and columns of the precision are zero for free parameters: base and tool. ``tied`` is as in ``ParameterSet``.
    """

    columns: tuple[int, ...]
    reference: Geometry
    mean: Array
    precision: Array
    tied: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True, eq=False)
class Posterior:
    """Values (p,), their covariance (p, p), the model at the values, and the weights of the readings.

    ``scatter_m`` is the standard deviation of a coordinate beyond the stated uncertainty, all of it if none is stated;
    ``scatter_rad`` that of a component of an orientation. ``residuals_M`` (n, 3) [m, rad] is measured less computed.
    """

    prior: Prior
    values: Array
    covariance: Array
    model: ArmModel
    measured: Quantities
    scatter_m: float
    residuals_M: Array
    scatter_rad: float = 0.0


def posterior(model: ArmModel, measured: Quantities, prior: Prior, *, weighed: bool = False) -> Posterior:
    """Compute the posterior from a start ``model``, whose effects the values have.

    The weights follow from the scatter about the model, unless the readings are ``weighed`` already. No step raises the
    sum of squares, priors included. Raise ``NotConverged`` if values and scatter do not settle.
    """
    scatter, enough = ((0.0, 0.0), _SETTLED_WEIGHED) if weighed else ((_FIRST_SCATTER_M, _FIRST_SCATTER_RAD), _SETTLED)
    values = values_of(model.geometry, model.effects, prior.columns, prior.reference)
    for _ in range(_STEPS):
        if not weighed:
            measured = replace(measured, sigma=_sigma(measured, *scatter))
        normal = normal_matrix(model, measured, prior)
        found, covariance = solution(normal, prior)
        errors = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        step = found - values
        moved = float(np.max(np.abs(step) / errors))
        if moved >= _SETTLED:
            step = shortened(_FIT, step, partial(_loss, model, measured, prior, values))
        values = values + step
        model = with_values(model, prior, values)
        residuals_M = measured.residuals(model)
        before = scatter
        if not weighed:
            scatter = _scatter(measured, residuals_M, float(np.sum(covariance * normal.gram)))
        settled = all(abs(now - then) <= _SCATTER_SETTLED * then for now, then in zip(scatter, before, strict=True))
        if moved < enough and settled:
            break
    else:
        raise NotConverged.of(_FIT, f"{_STEPS} steps were not enough; the last was {moved:.1e} standard errors long")
    of_rotations = 0.0 if measured.angular is None else before[1]
    return Posterior(prior, values, covariance, model, measured, before[0], residuals_M, of_rotations)


def _loss(model: ArmModel, measured: Quantities, prior: Prior, values: Array, step: Array) -> float:
    """Compute the sum of squares, priors included, a ``step`` (p,) beyond ``values``."""
    after = values + step
    residuals_M = measured.residuals(with_values(model, prior, after))
    white = np.einsum("acn,nc->an", whitening(measured.sigma), residuals_M)
    off = after - prior.mean
    return float(np.vdot(white, white) + off @ prior.precision @ off)


def _scatter(measured: Quantities, residuals_M: Array, fitted: float) -> tuple[float, float]:
    """Estimate the scatter of a coordinate [m] and of an orientation component [rad] about ``fitted`` parameters.

    The parameters are charged to both kinds in proportion to their numbers of readings.
    """
    stated = np.full(len(measured), NOT_STATED) if measured.stated is None else measured.stated
    freedom = max(3 * len(measured) - fitted, 1.0)
    of_rotations = freedom * float(np.mean(~measured.points))
    found = excess_of_kinds(residuals_M, stated, freedom, measured.angular, of_rotations)
    least = _LEAST_SCATTER_M if measured.stated is None else 0.0
    return max(math.sqrt(found[0]), least), math.sqrt(found[1])


def solution(normal: NormalMatrix, prior: Prior) -> tuple[Array, Array]:
    """Return mean (p,) and covariance (p, p) of the values."""
    A = normal.gram + prior.precision
    unit = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    A = A * unit * unit[:, None]
    b = unit * (normal.moment + prior.precision @ prior.mean)
    return solve_psd(A, b) * unit, inverse_psd(A) * unit * unit[:, None]


def _sigma(measured: Quantities, scatter_m: float, scatter_rad: float) -> Array:
    if measured.stated is None:
        return np.full(len(measured), scatter_m)
    return with_excess(measured.stated, scatter_m**2, measured.angular, scatter_rad**2)
