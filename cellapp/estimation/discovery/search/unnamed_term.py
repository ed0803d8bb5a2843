"""The unnamed term: what the named effects leave, as a smooth process over what arms depend on.

Its parts are smooth laws of the library's effects without their names, so that it is a part of the model like any
effect: in predictions, uncertainty and commands. It is used where its evidence is better than none and left-out
readings are predicted better by more than the standard error of the difference. Smooth laws that are more probably
absent than present lose their names and belong to it.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from cellapp.estimation.calibration.least_squares import NORMAL_95
from cellapp.estimation.discovery.accepted import model_without, rms_of_whitened
from cellapp.estimation.discovery.arm_data import UNKNOWN, ModelTerm
from cellapp.estimation.discovery.joint_fit import JointFit, left_out, left_out_in_sd
from cellapp.estimation.discovery.outcome import HeldOut
from cellapp.estimation.discovery.records import BeforeAfter, HeldOutBeforeAfter, Unnamed
from cellapp.estimation.discovery.search.state import SearchProblem, SearchResult, SearchState
from cellapp.ground.grouping import grouped
from cellapp.robot.effects import EFFECTS
from cellapp.robot.effects.effect import borrowed, is_unnamed, lent_effect
from cellapp.robot.kinematics.transforms import Array

_MOSTLY = 0.5
"""Least rms, relative to the largest, of the places that the unnamed term mostly moves."""
_CAUSES = 3
"""Most causes that are stated as the likeliest."""


def without_name(term: ModelTerm) -> ModelTerm:
    """Return a smooth term as a part of the unnamed term."""
    if is_unnamed(term.law):
        return term
    law = borrowed("unnamed", EFFECTS[term.slug], term.law.form).law(term.law.constants, term.law.tried)
    return replace(term, slug=UNKNOWN, law=law)


def without_names(fit: JointFit, numbers: Collection[int]) -> JointFit:
    """Return a fit whose smooth terms ``numbers`` are parts of the unnamed term."""
    terms, effects = list(fit.terms), list(fit.model.effects)
    for number in numbers:
        terms[number] = without_name(terms[number])
        effects[number] = replace(effects[number], slug=UNKNOWN, law=terms[number].law)
    return replace(fit, terms=tuple(terms), model=replace(fit.model, effects=tuple(effects)))


def smooth_numbers(terms: Collection[ModelTerm]) -> list[int]:
    """Return the numbers of the smooth terms that are no part of the unnamed term."""
    return [number for number, term in enumerate(terms) if term.smooth is not None and not is_unnamed(term.law)]


def with_unnamed(problem: SearchProblem, found: SearchResult, extended: SearchState | None) -> SearchResult:
    """Return the model that predicts left-out readings best, with the smooth terms of ``extended`` as the unnamed term.

    The unnamed term must lower the mean error by more than its standard error, and the whole that of the geometry.
    ``extended`` is None if the residuals need none or the outcome has smooth terms already.
    """
    problem.job.check()
    whole = found
    if extended is not None:
        fit = without_names(extended.fit, [k for k in smooth_numbers(extended.fit.terms) if k >= len(found.fit.terms)])
        whole = replace(found.with_fit(extended.data, fit, found.reviews), steps=extended.steps)
    if parts := [number for number, term in enumerate(whole.fit.terms) if is_unnamed(term.law)]:
        before = _errors(found) if extended is not None else _errors(whole, whole.fit.without_columns(parts))
        after = _errors(whole)
        if (before - after).mean() <= (before - after).std() / math.sqrt(len(after)):
            whole = found if extended is not None else _without(problem, whole, parts)
        whole = replace(whole, unnamed_mm=(float(before.mean()) * 1e3, float(after.mean()) * 1e3))
    if whole.fit.terms and _errors(whole).mean() >= _errors(whole, whole.geometry_only).mean():
        whole = _without(problem, whole, range(len(whole.fit.terms)))
    if not any(term.smooth is not None for term in whole.fit.terms):
        return whole
    return replace(whole, spread=_spread(left_out_in_sd(whole.data, whole.fit)))


def _without(problem: SearchProblem, found: SearchResult, parts: Collection[int]) -> SearchResult:
    """Fit an outcome again without some of its terms."""
    kept = [number for number in range(len(found.fit.terms)) if number not in parts]
    near = SearchState(replace(found.data, sigma=problem.data.sigma), found.fit)
    rest = problem.state(tuple(found.fit.terms[number] for number in kept), near)
    dropped = (*found.dropped, *(found.fit.terms[number].slug for number in parts))
    return replace(
        found.with_fit(rest.data, rest.fit, tuple(found.reviews[number] for number in kept)), dropped=dropped
    )


def _errors(found: SearchResult, fit: JointFit | None = None) -> Array:
    """Return the position errors (n,) [m] of left-out readings by the outcome's fit or by another one."""
    residual = left_out(found.data, fit or found.fit)
    return np.asarray(np.linalg.norm(residual[found.data.points], axis=1))


def _spread(scaled: Array) -> float:
    """Return the factor by which 95 % of left-out coordinates are within their intervals, at least 1."""
    return max(float(np.quantile(np.abs(scaled), 0.95)) / NORMAL_95, 1.0)


def unnamed_record(found: SearchResult, held_out: HeldOut) -> Unnamed:
    """Return the size of the unnamed term beyond what geometry and named effects can explain, and where it acts."""
    fit = found.fit
    parts = [number for number, term in enumerate(fit.terms) if is_unnamed(term.law)]
    errors = None if found.unnamed_mm is None else BeforeAfter(before=found.unnamed_mm[0], after=found.unnamed_mm[1])
    if not parts:
        return Unnamed(rms_mm=0.0, in_force=False, left_out_mm=errors)
    kept = np.ones(fit.layout.total, dtype=np.bool_)
    signals: list[tuple[str, Array]] = []
    for number in parts:
        kept[fit.layout.parameters(number)] = False
        moved = fit.term_values(number)[:, None] * fit.term_rows(number)
        signals += [(column.where, one) for column, one in zip(fit.term_columns(number), moved, strict=True)]
    by_place = {where: np.sum(its, axis=0) for where, its in grouped(signals).items()}
    visible = fit.projector_of(kept).project(np.array([sum(by_place.values()), *by_place.values()]))
    total, *sizes = [rms_of_whitened(fit, one) * 1e3 for one in visible]
    order = np.argsort(sizes)[::-1]
    places = [list(by_place)[k] for k in order if sizes[k] >= _MOSTLY * max(sizes)]
    evidence = {number: smooth.evidence for number in parts if (smooth := fit.terms[number].smooth) is not None}
    causes = sorted(evidence, key=lambda number: -evidence[number])[:_CAUSES]
    return Unnamed(
        rms_mm=total,
        in_force=True,
        acts_on=tuple(sorted(places)),
        causes=tuple(lent_effect(fit.terms[number].law).slug for number in causes),
        left_out_mm=errors,
        heldout_position_mm=HeldOutBeforeAfter(
            before=held_out.position_mm(model_without(found, parts)), after=held_out.position_mm(fit.model)
        )
        if len(held_out)
        else None,
    )
