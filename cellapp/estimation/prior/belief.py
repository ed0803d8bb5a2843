"""Prior knowledge of an arm from an earlier calibration: a normal distribution of the arm's own parameters.

The arm's own parameters are the D-H rows and the effects that declare themselves ``arm_bound``. Base, tool and other
effects are integrated out. What the earlier readings cannot distinguish from a pose of the base or of the SMR (the
zeros of the first and of the last joint) then keeps its original priors.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import excess_of_kinds, inverse_psd, shortened, solve_psd, with_excess
from cellapp.estimation.calibration.parameters import ParameterSet, candidate_columns, typical_spreads
from cellapp.estimation.calibration.quantities import NOT_STATED, Quantities
from cellapp.estimation.calibration.records import SignaturePart
from cellapp.estimation.discovery.arm_data import whitening
from cellapp.estimation.discovery.joint_fit import LinearModel, NormalMatrix
from cellapp.ground.errors import NotConverged
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, EffectColumn, EffectTerm
from cellapp.robot.effects.effect import ordered_columns
from cellapp.robot.kinematics.chain import Geometry, all_names, parameter_names
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import prior_sigmas

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
    scatter = (0.0, 0.0) if weighed else (_FIRST_SCATTER_M, _FIRST_SCATTER_RAD)
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
        if moved < _SETTLED and settled:
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


_TYPICAL_COUNT = 2.0
"""Number of parameters of typical size added to those of the arm in the estimate of their spread."""
_LEAST_SD = 1e-12
"""Least standard deviation, which keeps a precision finite [m, rad or the effect's unit]."""
_RIDGE = 1e-8
"""Added to the diagonal of correlations before inversion: it raises a standard deviation by at most a hundredth of a
per cent, and keeps directions that were known to rounding."""


@dataclass(frozen=True, eq=False)
class Belief:
    """Normal distribution of an arm's own parameters.

    Attributes
    ----------
    nominal : Geometry
        Reference arm; geometric parameters are deviations from its D-H rows.
    columns : tuple of int, length K
        Indices of the geometric parameters.
    terms : tuple of EffectTerm
        Effects, with their mean values.
    mean : array, shape (p,)
        Deviations of the K geometric parameters, then values of the effects.
    covariance : array, shape (p, p)
    size : array, shape (p,)
        Standard deviation of each parameter before any calibration.
    is_forgotten : bool
        Whether it contains nothing of a calibration.
    """

    nominal: Geometry
    columns: tuple[int, ...]
    terms: tuple[EffectTerm, ...]
    mean: Array
    covariance: Array
    size: Array
    is_forgotten: bool = False

    @classmethod
    def of(cls, found: Posterior, size: Array) -> Belief:
        """Take the arm's own part of a posterior; ``size`` (q,) is that of all its parameters."""
        own = own_places(found.prior.columns, found.model)
        joints = found.model.geometry.joints
        columns = tuple(column for column in found.prior.columns if is_own(column, joints))
        return cls(
            nominal=found.prior.reference,
            columns=columns,
            terms=tuple(term for term in found.model.effects if EFFECTS[term.slug].arm_bound),
            mean=found.values[own],
            covariance=found.covariance[np.ix_(own, own)],
            size=size[own],
        )

    @cached_property
    def parts(self) -> tuple[SignaturePart, ...]:
        """Part to which each parameter (p,) belongs."""
        found: list[SignaturePart] = ["geometry"] * len(self.columns)
        for term in self.terms:
            part: SignaturePart = "curves" if is_smooth(term) else "effects"
            found += [part] * len(term.names)
        return tuple(found)

    def places(self, part: SignaturePart) -> NDArray[np.intp]:
        """Return the indices of the parameters of a part."""
        return np.flatnonzero([one == part for one in self.parts]).astype(np.intp)

    @cached_property
    def jump_sd(self) -> Array:
        """Standard deviation (p,) of a change with a cause of its own: as large as the parameter may be at all."""
        return np.where(np.isfinite(self.size), self.size, np.maximum(np.abs(self.mean), self._sd))

    @property
    def _sd(self) -> Array:
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), _LEAST_SD**2)))

    def widened(self, variance: Array) -> Belief:
        """Return the belief after changes of each parameter with ``variance`` (p,)."""
        return replace(self, covariance=self.covariance + np.diag(variance))

    def forgotten(self) -> Belief:
        """Return the knowledge of the geometry before any calibration, without effects."""
        size = self.jump_sd[: len(self.columns)]
        return replace(
            self, terms=(), mean=np.zeros_like(size), covariance=np.diag(size**2), size=size, is_forgotten=True
        )

    def geometry(self, start: Geometry) -> Geometry:
        """Return the mean geometry with base and tool of ``start``."""
        vector, columns = start.vector(), list(self.columns)
        vector[columns] = self.nominal.vector()[columns] + self.mean[: len(columns)]
        return start.with_vector(vector)

    def sigma(self) -> dict[str, float]:
        """Return geometric parameter -> standard deviation [m, rad]."""
        names = parameter_names(self.nominal.joints)
        return {names[column]: float(sd) for column, sd in zip(self.columns, self._sd, strict=False)}

    def prior(self, reference: Geometry, day_terms: Array) -> Prior:
        """Return the prior of a fit whose effects are those of the belief, then others with prior standard deviations
        ``day_terms`` (r,), infinite without a prior; deviations are from ``reference``."""
        columns = candidate_columns(reference)
        count = len(columns) + len(self.mean) - len(self.columns)
        own = own_columns(columns, reference.joints)
        own = np.concatenate([own, np.arange(len(columns), count)]).astype(np.intp)
        mean, precision = np.zeros(count + len(day_terms)), np.zeros((count + len(day_terms),) * 2)
        places = list(self.columns)
        shift = self.nominal.vector()[places] - reference.vector()[places]
        mean[own] = self.mean + np.concatenate([shift, np.zeros(len(self.mean) - len(shift))])
        precision[np.ix_(own, own)] = self._precision()
        of_day = np.arange(count, count + len(day_terms))
        precision[of_day, of_day] = 1.0 / np.maximum(day_terms, _LEAST_SD) ** 2
        return Prior(columns, reference, mean, precision)

    def _precision(self) -> Array:
        sd = self._sd
        correlation = self.covariance / sd / sd[:, None] + _RIDGE * np.eye(len(sd))
        factor = np.linalg.inv(np.linalg.cholesky(correlation))
        return np.asarray((factor.T @ factor) / sd / sd[:, None])


def is_own(column: int, joints: int) -> bool:
    """Return whether a geometric parameter belongs to the D-H rows, not to base or tool."""
    return 6 <= column < 6 + 5 * joints


def own_columns(columns: tuple[int, ...], joints: int) -> NDArray[np.intp]:
    """Return the indices of the D-H rows among geometric parameters."""
    return np.array([place for place, column in enumerate(columns) if is_own(column, joints)], dtype=np.intp)


def own_places(columns: tuple[int, ...], model: ArmModel) -> NDArray[np.intp]:
    """Return the indices of the arm's own parameters among geometric parameters and the values of a model's effects."""
    of_terms = np.array([EFFECTS[term.slug].arm_bound for term in model.effects for _ in term.names], dtype=bool)
    own = own_columns(columns, model.geometry.joints)
    return np.concatenate([own, len(columns) + np.flatnonzero(of_terms)]).astype(np.intp)


def is_smooth(term: EffectTerm) -> bool:
    """Return whether the values of a term have a prior, as those of a free function."""
    return term.law.form.is_smooth


def sizes(profile: Profile, model: ArmModel, measured: Quantities) -> Array:
    """Return the standard deviations (p,) of all parameters of a model before any reading, infinite without a prior."""
    columns = candidate_columns(model.geometry)
    of_geometry = geometry_sizes(profile, model, columns)
    if not model.effects:
        return of_geometry
    of_terms = np.array([column.prior_sd for column in term_columns(model, measured.take(np.arange(1)))])
    first = 0
    for term in model.effects:
        last = first + len(term.names)
        if term.modulations:  # the prior of a discrepancy term is not stored: its own size replaces it
            free = slice(last - len(term.modulations), last)
            of_terms[free] = math.sqrt(float(np.mean(term.values[len(term.law_names) :] ** 2))) + _LEAST_SD
        first = last
    return np.concatenate([of_geometry, of_terms])


def geometry_sizes(profile: Profile, model: ArmModel, columns: tuple[int, ...]) -> Array:
    """Return standard deviations (K,) of geometric parameters about nominal: from the profile, else their spread."""
    joints = model.geometry.joints
    stated, typical = prior_sigmas(model.nominal, profile.calibration.priors), typical_spreads(joints)
    deviation = values_of(model.geometry, (), columns, model.nominal)
    names = [all_names(joints)[column] for column in columns]
    found = np.array([stated.get(name, math.inf) for name in names])
    for unit_size in set(typical.values()):
        places = [k for k, name in enumerate(names) if typical.get(name) == unit_size and name not in stated]
        if places:
            square = float(np.sum(deviation[places] ** 2)) + _TYPICAL_COUNT * unit_size**2
            found[places] = math.sqrt(square / (len(places) + _TYPICAL_COUNT))
    return found
