"""Accepted effects: reviewed terms of the final model with their evidence, as stored in results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cellapp.estimation.discovery.describe import describe
from cellapp.estimation.discovery.held_out import HeldOut
from cellapp.estimation.discovery.joint_fit import JointFit, fitted_model
from cellapp.estimation.discovery.movement import term_movements
from cellapp.estimation.discovery.pictures.cycles import dominant_cycles
from cellapp.estimation.discovery.records import (
    AcceptedEffect,
    BeforeAfter,
    Contradiction,
    Correlation,
    CycleBand,
    EffectMeaning,
    Evidence,
    LawRecord,
    Place,
    RunnerUp,
)
from cellapp.estimation.discovery.search.state import Posteriors, SearchResult
from cellapp.estimation.discovery.terms import TRANSMISSION_ERROR, UNKNOWN, without_term
from cellapp.ground.errors import NotConverged
from cellapp.ground.results import Estimate
from cellapp.robot.effects import EFFECTS, EffectTerm, place_in_words, term_to_json
from cellapp.robot.effects.contradiction import contradicted_effect, is_contradiction
from cellapp.robot.model import ArmModel


def accepted_effects(
    found: SearchResult, model: ArmModel, held_out: HeldOut, after_mm: float, probable: Posteriors
) -> tuple[tuple[EffectTerm, ...], tuple[AcceptedEffect, ...]]:
    """Return the reviewed terms of the final model, in order, and their evidence with the held-out error without each.

    ``after_mm`` is the held-out rms error with all of them. Terms of data-driven effects carry their description.
    """
    fit, terms, accepted = found.fit, [], []
    for number, review in enumerate(found.reviews):
        term, columns = model.effects[number], fit.term_columns(number)
        described = describe(found.data, fit, number) if term.slug == UNKNOWN else None
        if described is not None:
            term = replace(term, note=described.sentence)
        evidence = Evidence(
            statistic=review.score,
            corrected_p=review.p_value,
            heldout_mm=BeforeAfter(before=_error_without(found, number, held_out), after=after_mm),
        )
        where = Place(
            joints=tuple(sorted({column.joint + 1 for column in columns if column.joint is not None})),
            acts_on=tuple(dict.fromkeys(column.where for column in columns)),
            channel=None if described is None else described.channel,
            variables=None if described is None else described.variables,
        )
        terms.append(term)
        accepted.append(
            accepted_effect(
                term,
                where,
                evidence,
                probable.terms[number],
                runners_up=review.rivals,
                correlated_with=_most_correlated(fit, number),
                cycles=_cycles(fit, number, term) if term.slug == TRANSMISSION_ERROR else None,
                movements=term_movements(fit, number) or None,
                description=described,
            )
        )
    return tuple(terms), tuple(accepted)


def _error_without(found: SearchResult, number: int, held_out: HeldOut) -> float:
    """Return the held-out rms error [mm] without a term, the others fitted again; NaN if that fit does not converge."""
    try:
        return held_out.rms_mm(fitted_model(found.data, without_term(found.fit.terms, number)))
    except NotConverged:
        return math.nan


def accepted_effect(
    term: EffectTerm,
    where: Place,
    evidence: Evidence,
    posterior: float,
    *,
    runners_up: tuple[RunnerUp, ...] = (),
    correlated_with: Correlation | None = None,
    **details: Any,
) -> AcceptedEffect:
    """Build an accepted effect from a term and its evidence; ``details`` are further fields of ``AcceptedEffect``.

    ``posterior`` is NaN if it was not computed.
    """
    effect, shared = EFFECTS[term.slug], term_to_json(term)
    indistinguishable = (rival.effect for rival in runners_up if not rival.distinguishable)
    meaning = effect.meaning_of(term.law).at(place_in_words(where.acts_on))
    return AcceptedEffect(
        effect=term.slug,
        title=effect.title,
        law=LawRecord(name=shared["law"], constants=shared["constants"]),
        where=where,
        parameters={name: Estimate.model_validate(shared["parameters"][name]) for name in term.law_names},
        evidence=evidence,
        answer_set=(term.slug, *indistinguishable),
        runners_up=runners_up,
        correlated_with=correlated_with,
        posterior=posterior if math.isfinite(posterior) else None,
        law_misfit=term.law_misfit if term.modulations else None,
        meaning=EffectMeaning.model_validate(meaning, from_attributes=True),
        **details,
    )


def contradictions(terms: Sequence[EffectTerm], accepted: Sequence[AcceptedEffect]) -> tuple[Contradiction, ...]:
    """Return the accepted effects that look like an effect of the library with impossible values."""
    return tuple(
        Contradiction(
            effect=contradicted_effect(term.law).slug,
            joints=effect.where.joints,
            size_um=math.nan if effect.description is None else effect.description.size_um,
            sentence=term.note,
        )
        for term, effect in zip(terms, accepted, strict=True)
        if is_contradiction(term.law)
    )


def _cycles(fit: JointFit, number: int, term: EffectTerm) -> dict[str, CycleBand]:
    """Return the dominant cycles per revolution of a periodic term, by the values of the final model."""
    here = fit.layout.parameters(number)
    return dominant_cycles(fit.term_columns(number), term.values, fit.identification.covariance[here, here])


def _most_correlated(fit: JointFit, number: int) -> Correlation | None:
    """Find the geometric parameter most correlated with a term's values, and the correlation; None for smooth terms."""
    if fit.terms[number].smooth is not None:
        return None
    covariance, size = fit.identification.covariance, len(fit.identification.parameter_set.columns)
    here = fit.layout.parameters(number)
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance[:size, here] / sd[:size, None] / sd[here]
    row, column = np.unravel_index(int(np.argmax(np.abs(correlation))), correlation.shape)
    return Correlation(parameter=fit.identification.names[int(row)], correlation=float(correlation[row, column]))
