"""Fit of the terms of a search to all readings, if only some of them were searched.

Of smooth terms the Gram matrix of all columns is accumulated over chunks of readings, so memory does not grow with
their number. From it follow the hyperparameters of the structured process (more readings show more components), then
all values and their covariance, by Gauss-Newton steps from the fit to the searched readings. Each step has the matrix
of its own point: that of hundreds of columns is so ill-conditioned that the matrix of a nearby point leads elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.estimation.calibration.least_squares import minimise
from cellapp.estimation.discovery.arm_data import ArmData, Excess, ModelTerm, ModelTerms, smoothness_of, whitening
from cellapp.estimation.discovery.joint_fit import (
    JointFit,
    LinearModel,
    NormalMatrix,
    fit_terms,
    noise_of,
    refit,
    uncertainty_with_scatter,
    with_posterior,
)
from cellapp.estimation.discovery.process import (
    Component,
    Hyperparameters,
    ProcessData,
    StructuredProcess,
    components,
    most_evident,
    needed_components,
    process_terms,
)
from cellapp.estimation.discovery.search.state import Review, SearchResult
from cellapp.estimation.discovery.search.unnamed_term import without_name
from cellapp.ground.errors import NotConverged
from cellapp.robot.effects import EffectColumn, displacement_by
from cellapp.robot.effects.effect import is_unnamed, lent_effect
from cellapp.robot.kinematics.chain import AT_BOUND, smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.model import PosteriorSamples

_CHUNK = 1024
"""Readings in a chunk: 2000 columns of them take 50 MB."""
_MOST_STEPS = 20
"""Most Gauss-Newton steps, rejected ones included: usually four suffice."""
_TOLERANCE = 0.1
"""Step at which the fit ends, in standard errors of any combination of parameters."""
_SAMPLE_SEED = 0xA117
"""Combined with the profile's seed, so that these draws are independent of all other draws."""


def fit_to_all(found: SearchResult, data: ArmData, needed: float) -> tuple[SearchResult, ArmModel]:
    """Fit the terms of a search on some readings to all of them; return the outcome and the model fitted to all.

    ``data`` are all readings; ``needed`` is the gain of the score at which a component of the smooth terms is kept.

    Raises
    ------
    NotConverged
        If the fit does not reach a minimum.
    """
    smooth = smoothness_of(found.fit.terms)
    if smooth is None:
        return fit_terms_to_all(found, data, found.fit.terms, found.reviews)
    named = tuple(term for term in found.fit.terms if term.smooth is None)
    weighed = replace(data, sigma=uncertainty_with_scatter(data, smooth.scatter)).at(found.fit.model)
    process = _process(found, weighed, named, needed)
    more, was = math.sqrt(process.values.noise), smooth.scatter
    joints = tuple(more * one for one in was.joints)
    scatter = Excess(was.m * more, was.rad * more, joints, min(was.claim * more, 1.0))
    names = {term.slug for term in found.fit.terms if term.smooth is not None and not is_unnamed(term.law)}
    free = process_terms(process, scatter)
    terms = (*named, *(term if term.slug in names else without_name(term) for term in free))
    chance = min(review.p_value for review in found.reviews)
    of_named = [review for review in found.reviews if review.term.smooth is None]
    smooth_terms = [(term, term.smooth) for term in terms if term.smooth is not None]
    of_smooth = [Review(term, smooth.evidence, chance, ()) for term, smooth in smooth_terms]
    return fit_terms_to_all(found, data, terms, (*of_named, *of_smooth))


def fit_terms_to_all(
    found: SearchResult, data: ArmData, terms: ModelTerms, reviews: tuple[Review, ...]
) -> tuple[SearchResult, ArmModel]:
    """Fit terms, each with its review, to all readings ``data``; return the outcome and the model fitted to all.

    With smooth terms the outcome keeps the searched readings, for pictures and reviews. Raises ``NotConverged``.
    """
    smooth = smoothness_of(terms)
    if smooth is None or len(found.data) == len(data):
        here, fit = refit(data.at(found.fit.model), terms)
        return found.with_fit(here, fit, reviews), with_posterior(here, fit, found.spread)
    weighed = replace(data, sigma=uncertainty_with_scatter(data, smooth.scatter)).at(found.fit.model)
    some = replace(found.data, sigma=uncertainty_with_scatter(found.data, smooth.scatter))
    here, fit = refit(some.at(found.fit.model), terms)
    return found.with_fit(here, fit, reviews), _fitted(weighed, fit, found.spread)


def _process(found: SearchResult, data: ArmData, named: ModelTerms, needed: float) -> StructuredProcess:
    """Fit the structured process to all readings beside the named terms."""
    base = fit_terms(found.data.at(found.fit.model), named)
    smooth = [term for term in found.fit.terms if term.smooth is not None]
    had = {lent_effect(term.law).slug if is_unnamed(term.law) else term.slug: term for term in smooth}
    chosen = [one if one.slug in had else one.coarse() for one in components(found.data, base)]
    columns = list(base.identification.estimated.columns)
    deviation = base.model.geometry.vector()[columns] - base.geometry_mean
    values = np.concatenate([deviation, base.identification.effect_values])
    normal = _gathered(data, base, chosen).about(np.pad(values, (0, sum(len(one.columns) for one in chosen))))
    gram = ProcessData.behind(normal, base.layout.total, base.precision, 3 * len(data))
    start = Hyperparameters(
        tuple(_amplitudes(one, had.get(one.slug)) for one in chosen),
        tuple(_length(one, had.get(one.slug)) for one in chosen),
        1.0,
    )
    process = StructuredProcess(tuple(chosen), most_evident(chosen, gram, start), gram)
    return needed_components(process.without_idle(), needed)


def _amplitudes(component: Component, term: ModelTerm | None) -> Array:
    """Return start values of the amplitudes: those from the searched readings, else small ones."""
    known = {} if term is None else term.law.constants
    return np.array([known.get(key, 0.1 * component.start) for key in component.amplitude_keys])


def _length(component: Component, term: ModelTerm | None) -> float:
    if component.lengths is None:
        return 1.0
    known = {} if term is None else term.law.constants
    return next((known[key] for key in component.length_keys if key in known), component.lengths.start)


def _columns(data: ArmData, chosen: Sequence[Component]) -> list[EffectColumn]:
    """Return the columns of components at some readings."""
    found: list[EffectColumn] = []
    for one in chosen:
        law = one.law(np.ones(len(one.amplitude_keys)), 1.0 if one.lengths is None else one.lengths.start)
        found += data.columns(one.slug, law, [column.name for column in one.columns])
    return found


def _gathered(data: ArmData, fit: JointFit, further: Sequence[Component] = ()) -> NormalMatrix:
    """Accumulate X^T X, X^T r and r^T r of a fit and of further components over all readings, linearised there.

    r are the residuals of ``fit.model``; what it predicts is not added to them.
    """
    total = fit.layout.total + sum(len(one.columns) for one in further)
    found = NormalMatrix(np.zeros((total, total)), np.zeros(total), 0.0)
    for chunk in _chunks(data):
        q, R_M_S, white = chunk.readings.q, chunk.conditions.R_M_S, whitening(chunk.sigma)
        of_terms = chunk.term_columns(fit.terms)
        columns = [*of_terms, *_columns(chunk, further)]
        moved = displacement_by(of_terms, fit.identification.effect_values.tolist(), *q.shape)
        q = q + moved.joints
        estimated = fit.identification.estimated
        linear = LinearModel.of(fit.model.geometry, q, white, estimated, columns, R_M_S)
        predicted = smr_positions(fit.model.geometry, q, R_M_S) + moved.shift_M
        residual = np.einsum("acn,nc->an", white, chunk.readings.p_M - predicted)
        found += NormalMatrix.of(linear.rows, residual.ravel())
    return found


def _chunks(data: ArmData) -> Iterator[ArmData]:
    """Split the readings into chunks."""
    for first in range(0, len(data), _CHUNK):
        yield data.take(np.arange(first, min(first + _CHUNK, len(data)), dtype=np.intp))


@dataclass(frozen=True, eq=False)
class _Point:
    """A fit, its residuals and normal equations linearised there; ``values`` (p,) are deviations from nominal."""

    fit: JointFit
    data: ArmData
    values: Array
    normal: NormalMatrix


@dataclass(frozen=True, eq=False)
class _AllReadings:
    """Least squares over all readings with priors, for ``least_squares``: a step is in standard errors."""

    nominal: Array
    start: JointFit
    data: ArmData

    def at_start(self) -> _Point:
        found = self.start.identification
        columns = list(found.estimated.columns)
        deviation = self.start.model.geometry.vector()[columns] - self.nominal
        return self._at(np.concatenate([deviation, found.effect_values]))

    def _at(self, values: Array) -> _Point:
        """Linearise at some values: the columns of the effects, too, are those at this model."""
        fit = self.start
        flat = fit.layout.geometric
        geometry = fit.identification.estimated.moved(fit.model.geometry, self.nominal + values[:flat])
        effects = tuple(
            replace(term, values=values[fit.layout.parameters(number)]) for number, term in enumerate(fit.model.effects)
        )
        model = replace(fit.model, geometry=geometry, effects=effects)
        fit = replace(fit, model=model, identification=replace(fit.identification, effect_values=values[flat:]))
        data = self.data.at(model)
        return _Point(fit, data, values, _gathered(data, fit))

    def reweighted(self, point: _Point) -> _Point:
        return point

    def step(self, point: _Point, damping: float) -> tuple[Array, Array]:
        gram = point.normal.gram
        solver = point.normal.with_priors(self.start.precision + damping * np.diag(gram))
        step = solver.solve(point.normal.moment - self.start.precision * point.values)
        return step, solver.in_standard_errors(step)

    def promise(self, point: _Point, step: Array) -> float:
        return float(step @ (point.normal.moment - self.start.precision * point.values))

    def moved(self, point: _Point, step: Array) -> _Point:
        return self._at(point.values + step)

    def objective(self, point: _Point) -> float:
        return point.normal.square + float(self.start.precision @ point.values**2)


def _fitted(data: ArmData, fit: JointFit, spread: float) -> ArmModel:
    """Return the model with values and uncertainty, ``spread`` times as wide, from all readings.

    Raises ``NotConverged``.
    """
    estimated = fit.identification.estimated
    problem = _AllReadings(fit.geometry_mean, fit, data)
    found = minimise(problem, problem.at_start(), tolerance=_TOLERANCE, max_iterations=_MOST_STEPS)
    if not found.converged:
        raise NotConverged.of("effects to all readings", found.message)
    limits = estimated.limits(fit.model.nominal, len(estimated.columns))
    values = found.point.values[: fit.layout.geometric] + problem.nominal
    if limits is not None and np.any(np.abs(np.clip(values, *limits) - values) > AT_BOUND):
        raise NotConverged.of("effects to all readings", "a parameter left its bounds")
    samples = PosteriorSamples.of_covariance(
        columns=estimated.columns,
        sizes=[term.size for term in fit.terms],
        covariance=found.point.normal.with_priors(fit.precision).covariance * spread**2,
        noise=noise_of(data, spread, smoothness_of(fit.terms)),
        seed=(data.profile.seed, _SAMPLE_SEED),
        tied=estimated.tied,
    )
    return replace(found.point.fit.model, posterior=samples)
