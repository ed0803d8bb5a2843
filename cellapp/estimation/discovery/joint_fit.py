"""Joint fit of geometry and effect terms, and its linearisation.

With W the whitening, the rows of the design are W [J, A]: derivatives of the SMR position by the geometric parameters
and by those of the terms. The residual y and these rows define the linear models of scan, review and proposals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.arm_identification import excess_of
from cellapp.estimation.calibration.identification import Identification, identify
from cellapp.estimation.calibration.linear import solve_psd
from cellapp.estimation.calibration.normal_equations import EffectColumns
from cellapp.estimation.calibration.readings_noise import readings_noise
from cellapp.estimation.calibration.socket_identification import OF_THE_TRACKER
from cellapp.estimation.calibration.weights import with_excess
from cellapp.estimation.design.information import NuisanceProjector
from cellapp.estimation.discovery.arm_data import LEAST_SCATTER_M, TOLERANCE, ArmData, whitening
from cellapp.estimation.discovery.candidates import CandidateLaw, blocks_beyond_bounds, whitened_displacements
from cellapp.estimation.discovery.normal_matrix import NormalMatrix
from cellapp.estimation.discovery.projected_residual import ProjectedResidual
from cellapp.estimation.discovery.terms import Excess, ModelTerms, TermLayout, prior_sd, smoothness_of
from cellapp.robot.effects import EFFECTS, EffectColumn, EffectTerm, Law
from cellapp.robot.kinematics.chain import Geometry, JointAngles, jacobian, joint_jacobian
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.posterior import PosteriorDraws, ReadingsNoise

_WEIGHING_ROUNDS = 3
"""Rounds of fitting and estimating the excess variance at most: the fit depends on its root only, and weakly."""
_EXCESS_CHANGE = 0.02
"""Relative change of the excess variance below which its estimate has converged: weights then change by 1 %."""
_SAME_COLUMNS = 1e-3
"""Steps of a fit [m at arm's length] up to which the effects' columns are kept: they change by about as
much, relatively, an effect of 0.3 mm by 0.3 µm."""
_DRAW_SEED = 0xD4A7
"""Beside the profile's seed: the draws of parameters are then independent of all other draws."""


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Whitened derivatives of the SMR positions of n readings at one geometry.

    Attributes
    ----------
    by_joint : array, shape (3, N, n)
        By the joints.
    rows : array, shape (p, 3 n)
        By geometric parameters, then by those of effect columns.
    """

    by_joint: Array
    rows: Array

    @classmethod
    def of(
        cls,
        geometry: Geometry,
        q: Array,
        white: Array,
        parameters: tuple[int, ...],
        effects: Sequence[EffectColumn] = (),
        R_M_S: Array | None = None,
    ) -> LinearModel:
        """At configurations ``q`` (n, N) [rad] with whitening ``white`` (3, 3, n), by some geometric parameters and the
        columns of effects; where an orientation ``R_M_S`` (n, 3, 3) was measured, of that."""
        angles = JointAngles.of(q, R_M_S)
        _, J = jacobian(geometry, angles, parameters)
        _, by_joint = joint_jacobian(geometry, angles)
        by_joint = np.einsum("acn,cjn->ajn", white, by_joint)
        geometric = np.einsum("acn,ckn->kan", white, J).reshape(len(parameters), -1)
        rows = np.concatenate([geometric, whitened_displacements(effects, by_joint, white)]) if effects else geometric
        return cls(by_joint, rows)


@dataclass(frozen=True, eq=False)
class JointFit:
    """Effect terms fitted together with the geometry.

    Attributes
    ----------
    terms : ModelTerms
    layout : TermLayout
        Where the parameters of each term stand.
    identification : Identification
        Geometric parameters first, then those of the terms in their order.
    columns : tuple of EffectColumn
        Columns of all terms in their order.
    model : ArmModel
        The fitted arm.
    white : array, shape (3, 3, n)
        Whitening of each point [1/m].
    by_joint : array, shape (3, N, n)
        Whitened derivatives of the SMR position by the joints.
    rows : array, shape (p, 3 n)
        Whitened derivatives with respect to all fitted parameters.
    precision : array, shape (p,)
        Prior precisions, zero without a prior.
    residual : array, shape (3 n,)
        Whitened.
    derived : dict
        What others computed from this fit and need again: folds of the cross-validation, the whole of a field.
    """

    terms: ModelTerms
    layout: TermLayout
    identification: Identification
    columns: tuple[EffectColumn, ...]
    model: ArmModel
    white: Array
    by_joint: Array
    rows: Array
    precision: Array
    residual: Array
    derived: dict[Any, Any] = field(default_factory=dict, repr=False)
    _behind: dict[int, ProjectedResidual] = field(default_factory=dict, repr=False)

    @property
    def positions(self) -> slice | NDArray[np.bool_]:
        """Readings of positions: all, unless orientations were measured too."""
        turned = self.identification.turned
        return slice(None) if turned is None else ~turned

    @cached_property
    def normal(self) -> NormalMatrix:
        """Normal matrix of all columns and ``target``: projectors, criterion and cross-validation share it."""
        return NormalMatrix.of(self.rows, self.target)

    @cached_property
    def projector(self) -> NuisanceProjector:
        """Projector onto the complement of all fitted parameters."""
        return NuisanceProjector.of(self.rows, self.precision, self.normal.gram)

    def projector_of(self, kept: NDArray[np.bool_]) -> NuisanceProjector:
        """Projector onto the complement of some of the fitted parameters."""
        return NuisanceProjector.of(self.rows[kept], self.precision[kept], self.normal.take(kept).gram)

    @cached_property
    def projected_residual(self) -> ProjectedResidual:
        """The residual in the complement of all that was fitted."""
        return ProjectedResidual(self.projector, self.residual)

    @cached_property
    def information_criterion(self) -> float:
        """Minus twice the log marginal likelihood, parameters with a smooth prior integrated out.

        The others cost ln f each, as in the Bayesian information criterion; f are the coordinates behind the geometry,
        which all models share: so many say how large the scatter is (restricted likelihood).
        """
        first = self.layout.geometric
        smooth = np.zeros(len(self.precision), dtype=bool)
        smooth[first:] = self.precision[first:] > 0.0
        values = self.identification.values
        square = float(self.residual @ self.residual) + float(self.precision[smooth] @ values[smooth] ** 2)
        log_variance = -2.0 * float(np.sum(np.log(np.einsum("aan->an", self.white))))
        flat = int(np.count_nonzero(~smooth))
        order = np.argsort(smooth, kind="stable")
        rest, determined = self.normal.take(order).behind(flat, self.precision[order[:flat]])
        of_geometry = self.normal.take(np.arange(first)).determined(self.precision[:first])
        freedom = max(len(self.residual) - of_geometry, 1.0)
        scatter = log_variance * freedom / len(self.residual)
        price = determined * math.log(freedom)
        return square + scatter + price + rest.log_occam(1.0 / self.precision[smooth])

    def residual_without(self, term: int) -> ProjectedResidual:
        """Residual of the model without one term, in the complement of that model's parameters."""
        if term not in self._behind:
            projector = self.projector_of(self.layout.all_but(term))
            self._behind[term] = ProjectedResidual(projector, self.residual + self.signal(term))
        return self._behind[term]

    def removed_square(self, term: int) -> float:
        """Sum of squares that only this term explains: its signal in the complement of all other parameters."""
        kept, signal = self.layout.all_but(term), self.signal(term)
        others = self.rows[kept]
        # one solution: a projector of hundreds of smooth columns costs ten times as much
        values = self.normal.take(kept).with_priors(self.precision[kept]).solve(others @ signal)
        return float(np.sum((signal - values @ others) ** 2))

    def term_rows(self, term: int) -> Array:
        """Whitened columns of a term (m, 3 n)."""
        return self.rows[self.layout.parameters(term)]

    def law_rows(self, term: int) -> Array:
        """Whitened columns of a term's law (m, 3 n), without those of its free part."""
        return self.term_rows(term)[: len(self.terms[term].names)]

    def law_misfit(self, term: int) -> float:
        """Rms displacement by a term's free part over that by its law."""
        values, size = self.term_values(term), len(self.terms[term].names)
        by_law = float(np.linalg.norm(values[:size] @ self.law_rows(term)))
        by_free_part = float(np.linalg.norm(values[size:] @ self.term_rows(term)[size:]))
        return by_free_part / by_law if by_law > 0.0 else 0.0

    def term_values(self, term: int) -> Array:
        """Fitted values of a term's parameters (m,)."""
        return self.identification.effect_values[self.layout.columns(term)]

    def term_columns(self, term: int) -> tuple[EffectColumn, ...]:
        """Columns of a term."""
        return self.columns[self.layout.columns(term)]

    def signal(self, term: int) -> Array:
        """Displacement that a term predicts, whitened (3 n,)."""
        return np.asarray(self.term_values(term) @ self.term_rows(term))

    @cached_property
    def target(self) -> Array:
        """Residual plus prediction of the terms with priors, whitened (3 n,): data of linear refits with priors."""
        first = self.layout.geometric
        penalised = np.flatnonzero(self.precision[first:] > 0.0)
        if not len(penalised):
            return self.residual
        held = self.identification.effect_values[penalised] @ self.rows[first + penalised]
        return np.asarray(self.residual + held)

    def candidate(self, data: ArmData, slug: str, law: Law) -> CandidateLaw:
        """A law as a candidate beside this model."""
        columns = data.columns(slug, law)
        return CandidateLaw(slug, law, tuple(columns), self.displacements(columns))

    def candidates(self, data: ArmData, slugs: Sequence[str]) -> list[CandidateLaw]:
        """All laws of some effects that the data allow to test."""
        blind = OF_THE_TRACKER if data.points is not None else frozenset()
        testable = [slug for slug in slugs if slug not in blind and not EFFECTS[slug].missing_data(data.context)]
        return [self.candidate(data, slug, law) for slug in testable for law in EFFECTS[slug].laws(data.context)]

    def displacements(self, columns: Sequence[EffectColumn]) -> Array:
        """Whitened SMR displacements (m, 3 n) of columns."""
        return whitened_displacements(columns, self.by_joint, self.white)

    def blocks_beyond_bounds(self, term: int) -> set[str]:
        """Blocks of a term with a value outside its physical bounds by more than chance allows."""
        errors = self.identification.standard_errors[self.layout.parameters(term)]
        return blocks_beyond_bounds(self.term_columns(term), self.term_values(term), errors)


def fit_terms(data: ArmData, terms: ModelTerms, near: Identification | None = None) -> JointFit:
    """Fit geometry and terms to all readings and linearise there; from ``near``, if a fit of these terms is known."""
    return _linearised(data, terms, *_identify(data, terms, near))


def fitted_model(data: ArmData, terms: ModelTerms, near: Identification) -> ArmModel:
    """The model of ``fit_terms`` alone."""
    found, _ = _identify(data, terms, near)
    return _fitted_model(data, found, terms, _layout(data, found, terms))


def _layout(data: ArmData, found: Identification, terms: ModelTerms) -> TermLayout:
    points = 0 if data.points is None else len(data.points)
    return TermLayout.of(len(found.parameter_set.columns) + points, [term.size for term in terms])


def _linearised(data: ArmData, terms: ModelTerms, found: Identification, columns: tuple[EffectColumn, ...]) -> JointFit:
    layout = _layout(data, found, terms)
    white = whitening(data.sigma)
    linear = LinearModel.of(
        found.geometry, data.readings.q, white, found.parameter_set.columns, columns, data.conditions.R_M_S
    )
    fit = JointFit(
        terms=terms,
        layout=layout,
        identification=found,
        columns=columns,
        model=_fitted_model(data, found, terms, layout),
        white=white,
        by_joint=linear.by_joint,
        rows=_with_points(data, linear.rows, white, len(found.parameter_set.columns)),
        precision=_precision(data, found, layout, columns),
        residual=np.einsum("acn,nc->an", white, found.residuals).ravel(),
    )
    return _with_misfits(fit) if any(term.modulations for term in terms) else fit


def _with_points(data: ArmData, rows: Array, white: Array, geometric: int) -> Array:
    """Rows (p, 3 n) with those of unknown points behind the geometric ones."""
    if data.points is None:
        return rows
    of_points = np.einsum("acn,kcn->kan", white, data.points.shifts).reshape(len(data.points), -1)
    return np.concatenate([rows[:geometric], of_points, rows[geometric:]])


def _with_misfits(fit: JointFit) -> JointFit:
    """The fit whose model states how far each law is off."""
    stated = [replace(effect, law_misfit=fit.law_misfit(number)) for number, effect in enumerate(fit.model.effects)]
    return replace(fit, model=replace(fit.model, effects=tuple(stated)))


def with_posterior(data: ArmData, fit: JointFit) -> ArmModel:
    """The fitted model with draws of its parameters, and the scatter of the readings."""
    found = fit.identification
    kept = [*range(len(found.estimated.columns)), *range(fit.layout.geometric, fit.layout.total)]
    draws = PosteriorDraws.of_covariance(
        columns=found.estimated.columns,
        sizes=[term.size for term in fit.terms],
        covariance=found.covariance[np.ix_(kept, kept)],
        noise=noise_of(data, max(found.scale, 1.0)),
        seed=(data.profile.seed, _DRAW_SEED),
    )
    return replace(fit.model, posterior=draws)


def noise_of(data: ArmData, scale: float = 1.0) -> ReadingsNoise:
    """The noise that weighs the readings, times a scale."""
    return readings_noise(data.sigma, data.turned, scale)


def refit(data: ArmData, terms: ModelTerms) -> tuple[ArmData, JointFit]:
    """Fit terms with weights of their own; effects are evaluated at the geometry that this finds, or very near it."""
    here, near = reweighted(data, terms)
    found, columns = _identify(here, terms, near)
    if sum(found.steps) > _SAME_COLUMNS:
        here = here.at(_fitted_model(here, found, terms, _layout(here, found, terms)))
        return here, fit_terms(here, terms, found)
    fit = _linearised(here, terms, found, columns)
    return here.beginning_at(fit.model), fit


def reweighted(data: ArmData, terms: ModelTerms) -> tuple[ArmData, Identification | None]:
    """Return the data with weights that include the scatter of a model with ``terms`` beyond the stated uncertainty.

    The estimate begins from the weights of the data. Where no uncertainty is stated, all of the scatter is estimated.
    With smooth terms the scatter is the one that maximised their evidence. Also the last fit that this took, if any.
    """
    smooth, found = smoothness_of(terms), None
    if smooth is not None:
        return replace(data, sigma=uncertainty_with_scatter(data, smooth.scatter)), None
    if data.stated is None:
        for _ in range(_WEIGHING_ROUNDS):
            found, _ = _identify(data, terms, found)
            data = replace(data, sigma=np.maximum(data.sigma * found.scale, LEAST_SCATTER_M))
            if abs(found.scale - 1.0) <= _EXCESS_CHANGE:
                break
        return data, found
    sigma, excess = data.sigma, (-1.0, -1.0)
    for _ in range(_WEIGHING_ROUNDS):
        found, _ = _identify(replace(data, sigma=sigma), terms, found)
        before, excess = excess, excess_of(found, data.stated)
        sigma = with_excess(data.stated, excess[0], data.turned, excess[1])
        if all(abs(now - then) <= _EXCESS_CHANGE * now for now, then in zip(excess, before, strict=True)):
            break
    return replace(data, sigma=sigma), found


def uncertainty_with_scatter(data: ArmData, scatter: Excess) -> Array:
    """Standard uncertainties (n,) [m] or covariances (n, 3, 3) [m^2]: the stated ones, with a scatter added."""
    if data.stated is None:
        return np.full(len(data), max(scatter.m, LEAST_SCATTER_M))
    return with_excess(data.stated, scatter.m**2, data.turned, scatter.rad**2)


def _identify(
    data: ArmData, terms: ModelTerms, near: Identification | None = None
) -> tuple[Identification, tuple[EffectColumn, ...]]:
    """Joint identification of geometry and terms, with effect parameters in the order of the terms' columns.

    ``near`` is one of the same terms, from whose values it begins.
    """
    columns = data.term_columns(terms)
    order = np.argsort([column.joint is None for column in columns], kind="stable").astype(np.intp)
    settings = data.profile.calibration
    start = _start_values(data, terms, columns) if near is None else near.effect_values[: len(columns)]
    effects = _effect_columns(columns, order, start, len(data)) if columns else None
    found = identify(
        data.model.geometry if near is None else near.geometry,
        data.readings.q,
        data.readings.p_M,
        R_M_S=data.conditions.R_M_S,
        sigma=data.sigma,
        parameter_set=data.parameter_set,
        prior_sigma=data.prior_sigma,
        prior_mean=data.model.nominal,
        robust=settings.robust,
        effects=effects if data.points is None else data.points.after(effects),
        tolerance=max(settings.tolerance, TOLERANCE),
        max_iterations=settings.max_iterations,
    )
    return _reordered(found, np.argsort(order)), columns


def _effect_columns(columns: Sequence[EffectColumn], order: NDArray[np.intp], start: Array, n: int) -> EffectColumns:
    """Columns at n readings as the identification takes them, joint offsets first, from values ``start`` (m,)."""
    of_joints = [columns[place] for place in order if columns[place].joint is not None]
    of_smr = [columns[place] for place in order if columns[place].joint is None]
    sd = prior_sd(columns)
    return EffectColumns(
        names=tuple(columns[place].name for place in order),
        units=tuple(columns[place].unit for place in order),
        joints=np.array([column.joint for column in of_joints], dtype=np.intp),
        offsets=np.array([column.offset for column in of_joints]).reshape(-1, n),
        shifts_M=np.array([column.shift_M for column in of_smr]).reshape(-1, n, 3).swapaxes(1, 2),
        prior_sd=None if sd is None else sd[order],
        start=start[order],
    )


def identification_without(fit: JointFit, term: int) -> Identification:
    """Where a fit without one term begins: the other values given that its are zero, by their covariance."""
    found, own = fit.identification, fit.layout.parameters(term)
    values = np.concatenate([found.values[: fit.layout.geometric], found.effect_values])
    of_term = solve_psd(found.covariance[own, own], values[own])
    values = values - found.covariance[:, own] @ of_term
    columns = list(found.estimated.columns)
    vector = found.geometry.vector()
    vector[columns] = values[: len(columns)]
    kept = np.delete(np.arange(len(values)), own)
    return replace(
        found, geometry=found.geometry.with_vector(vector), effect_values=values[kept][fit.layout.geometric :]
    )


def _start_values(data: ArmData, terms: ModelTerms, columns: Sequence[EffectColumn]) -> Array:
    """Values (m,) of an earlier fit; zero for columns that it had not."""
    slugs = (term.slug for term in terms for _ in range(term.size))
    pairs = zip(slugs, columns, strict=True)
    return np.array([data.start.get((slug, column.name), 0.0) for slug, column in pairs])


def _reordered(found: Identification, effects: NDArray[np.intp]) -> Identification:
    """The identification with its effect parameters at places ``effects``, behind those that are not among them."""
    size, count = len(found.parameter_set.columns), len(found.effect_values)
    others = np.arange(len(effects), count)  # unknown points
    place = np.concatenate([np.arange(size), size + others, size + effects]).astype(np.intp)
    return replace(
        found,
        names=tuple(found.names[i] for i in place),
        units=tuple(found.units[i] for i in place),
        values=found.values[place],
        standard_errors=found.standard_errors[place],
        covariance=found.covariance[np.ix_(place, place)],
        effect_values=found.effect_values[effects],
    )


def _precision(data: ArmData, found: Identification, layout: TermLayout, columns: Sequence[EffectColumn]) -> Array:
    """Prior precisions (p,) of all that was fitted, zero without a prior."""
    precision = np.zeros(layout.total)
    for row, name in enumerate(found.names[: layout.geometric]):
        if name in data.prior_sigma:
            precision[row] = 1.0 / data.prior_sigma[name] ** 2
    if data.points is not None:
        precision[layout.geometric - len(data.points) : layout.geometric] = data.points.prior_sd**-2.0
    sd = prior_sd(columns)
    if sd is not None:
        precision[layout.geometric :] = 1.0 / sd**2
    return precision


def _fitted_model(data: ArmData, found: Identification, terms: ModelTerms, layout: TermLayout) -> ArmModel:
    """The arm with the fitted terms; the covariance is kept without the many coefficients with priors."""
    fitted = []
    kept = list(range(len(found.parameter_set.columns)))
    for number, term in enumerate(terms):
        here = layout.parameters(number)
        if term.smooth is None:
            kept += range(here.start, here.start + len(term.names))
        fitted.append(
            EffectTerm(
                slug=term.slug,
                names=(*term.names, *(one.name for one in term.modulations)),
                values=found.values[here],
                standard_errors=found.standard_errors[here],
                units=found.units[here],
                law=term.law,
                note=term.note,
                modulations=term.modulations,
            )
        )
    return replace(
        data.model,
        geometry=found.geometry,
        effects=tuple(fitted),
        identified=tuple(found.names[i] for i in kept),
        covariance=found.covariance[np.ix_(kept, kept)],
    )
