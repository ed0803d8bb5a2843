"""Fit of the terms of a search to all readings, if only some of them were searched.

Of smooth terms the Gram matrix of all columns is accumulated over chunks of readings, so memory does not grow with
their number. From it follow the hyperparameters of the structured process (more readings show more components), then
all values and their covariance, by Gauss-Newton steps from the fit to the searched readings. Each step has the matrix
of its own point: that of hundreds of columns is so ill-conditioned that the matrix of a nearby point leads elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from cellapp.estimation.discovery.arm_data import ArmData, Excess, ModelTerm, ModelTerms, smoothness_of
from cellapp.estimation.discovery.joint_fit import (
    JointFit,
    fit_terms,
    refit,
    samples_of,
    uncertainty_with_scatter,
    with_posterior,
)
from cellapp.estimation.discovery.prior_fit import Prior, normal_matrix, posterior
from cellapp.estimation.discovery.process import Component, StructuredProcess, components, process_terms
from cellapp.estimation.discovery.search.state import Review, SearchResult
from cellapp.estimation.discovery.search.unnamed_term import without_name
from cellapp.ground.errors import NotConverged
from cellapp.robot.effects import EffectColumn
from cellapp.robot.effects.effect import is_unnamed, lent_effect
from cellapp.robot.kinematics.chain import AT_BOUND
from cellapp.robot.model import ArmModel

_SAMPLE_SEED = 0xA117
"""Combined with the profile's seed, so that these samples are independent of all other samples."""


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
    more, was = math.sqrt(process.noise), smooth.scatter
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
    possible = (one if one.slug in had else one.coarse() for one in components(found.data, base))
    chosen = [_begun(one, had.get(one.slug)) for one in possible]
    normal = normal_matrix(base.model, data, _prior(base), partial(_columns, chosen))
    gram = normal.behind(base.layout.total, base.precision)
    return StructuredProcess(tuple(chosen), 1.0, gram).most_evident().without_idle().without_weak(needed)


def _begun(component: Component, term: ModelTerm | None) -> Component:
    """Return a component at the hyperparameters from the searched readings, else at small amplitudes."""
    known = {} if term is None else term.law.constants
    amplitudes = np.array([known.get(key, 0.1 * component.start) for key in component.amplitude_keys])
    length = next((known[key] for key in component.length_keys if key in known), component.length)
    return replace(component, amplitudes=amplitudes, length=length)


def _columns(chosen: Sequence[Component], data: ArmData) -> list[EffectColumn]:
    """Return the columns of components at some readings."""
    found: list[EffectColumn] = []
    for one in chosen:
        found += data.columns(one.slug, one.law, [column.name for column in one.columns])
    return found


def _prior(fit: JointFit) -> Prior:
    """Return the priors of a fit: about nominal, or about the bounds at which parameters are held."""
    estimated = fit.identification.estimated
    reference = estimated.moved(fit.model.nominal, fit.geometry_mean)
    return Prior(estimated.columns, reference, np.zeros(fit.layout.total), np.diag(fit.precision), estimated.tied)


def _fitted(data: ArmData, fit: JointFit, spread: float) -> ArmModel:
    """Return the model with values and uncertainty, ``spread`` times as wide, from all readings.

    Raises ``NotConverged``.
    """
    estimated = fit.identification.estimated
    found = posterior(fit.model, data, _prior(fit), weighed=True)
    limits = estimated.limits(fit.model.nominal, len(estimated.columns))
    values = found.model.geometry.vector()[list(estimated.columns)]
    if limits is not None and np.any(np.abs(np.clip(values, *limits) - values) > AT_BOUND):
        raise NotConverged.of("fit of geometry and effects to all readings", "a parameter left its bounds")
    return replace(found.model, posterior=samples_of(data, fit, found.covariance, 1.0, spread, _SAMPLE_SEED))
