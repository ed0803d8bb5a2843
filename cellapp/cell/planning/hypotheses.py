"""Hypotheses for further stops to decide between: one effect or another, or an effect or none.

Each is judged by T-optimality (see ``estimation.design.information``). The true model has the effect with its fitted
values. The alternative model has geometry, the other accepted effects and, if there is an alternative effect, this by
any of its laws.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from cellapp.estimation.design.information import VISIBLE, TwoModels, detectable_size, unit_columns
from cellapp.estimation.discovery.arm_data import (
    UNKNOWN,
    ArmData,
    Excess,
    ModelTerm,
    Smoothness,
    named_columns,
    whitened_displacements,
    whitening,
    with_term,
)
from cellapp.estimation.discovery.joint_fit import JointFit, LinearModel, ProjectedResidual, fit_terms, refit
from cellapp.estimation.discovery.outcome import ArmFound
from cellapp.estimation.discovery.search.scan import LawScan, choice_price
from cellapp.robot.effects import EFFECTS, EffectColumn, EffectContext, InputVariable, Law, MeasurementConditions
from cellapp.robot.effects.effect import is_unnamed, lent_effect, lent_law
from cellapp.robot.kinematics.transforms import Array

AlternativeLaw = tuple[Law, tuple[str, ...]]
"""A law of the alternative effect with those of its columns that may imitate the first effect."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An effect, against another one or (``against`` empty) against none.

    Attributes
    ----------
    effect, against : str
        Slugs.
    needed : float
        Non-centrality lambda from which the data decide.
    data, fit
        The model that the values are taken from.
    term : int, optional
        The effect's term in ``fit``; None where it is no part of it.
    law : Law
    names : tuple of str, length c
        Columns of the effect.
    values : array, shape (k, c)
        Values of these columns: k signals, whose mean lambda counts.
    alternatives : tuple of AlternativeLaw
        Laws of the other effect, each of which may stand for it.
    """

    effect: str
    against: str
    needed: float
    data: ArmData
    fit: JointFit
    term: int | None
    law: Law
    names: tuple[str, ...]
    values: Array
    alternatives: tuple[AlternativeLaw, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """The one or two effects that are compared."""
        return (self.effect, self.against) if self.against else (self.effect,)

    @property
    def variables(self) -> frozenset[InputVariable]:
        """All variables that either model depends on."""
        slugs = [*self.effects, *(term.slug for term in self.fit.terms)]
        return frozenset().union(*(EFFECTS[slug].variables for slug in slugs))

    @property
    def columns_a_candidate(self) -> int:
        """Number of columns that all its discriminations hold for each candidate."""
        columns = len(self.fit.rows) + sum(len(names) for _, names in self.alternatives)
        return columns * max(len(self.alternatives), 1)

    def discriminations(self, design: CandidateDesign) -> list[TwoModels]:
        """Set up one discrimination for each law of the alternative, over candidate stops."""
        data, fit = self.data, self.fit
        others = [term for number, term in enumerate(fit.terms) if number != self.term]
        further = [design.geometric, *(design.rows(term.slug, term.law, term.names) for term in others)]
        kept = np.ones(len(fit.rows), dtype=bool) if self.term is None else fit.layout.all_but(self.term)
        own = fit.displacements(data.columns(self.effect, self.law, self.names))
        signals = self.values @ own
        candidate_signals = design.by_stop(self.values @ design.rows(self.effect, self.law, self.names))
        found = []
        for law, names in self.alternatives or ((self.law, ()),):
            columns = data.columns(self.against, law, names) if names else []
            more = [design.rows(self.against, law, names)] if names else []
            scaled = unit_columns(
                np.concatenate([fit.rows[kept], fit.displacements(columns)]),
                np.concatenate([fit.precision[kept], [_bound_precision(column) for column in columns]]),
                design.by_stop(np.concatenate([*further, *more])),
            )
            found.append(TwoModels(*scaled, signals, candidate_signals))
        return found


def _bound_precision(column: EffectColumn) -> float:
    """Return the precision of a weak prior: the parameter is within its physical bounds."""
    bound = max(abs(column.lower), abs(column.upper))
    return 1.0 / bound**2 if math.isfinite(bound) and bound > 0.0 else 0.0


def refitted_discovery(data: ArmData, discovery: ArmFound) -> tuple[ArmData, JointFit]:
    """Repeat the final fit of a discovery: the accepted terms with the weights of its search."""
    smooth = Smoothness(0.0, 0, Excess(discovery.scatter_m))  # its scatter scales smooth priors; no discrepancy term
    terms = (
        ModelTerm(one.slug, one.law, one.law_names, smooth if one.law.form.is_smooth else None, note=one.note)
        for one in discovery.terms
    )
    return refit(data, tuple(terms))


# -- Further stops as a fitted model predicts them: columns of its parameters there, and the expected uncertainty -----


_MOST_JOINED = 200
"""Number of further stops, evenly spread, that are joined to the run: enough to show which factors vary among them."""


@dataclass(frozen=True, eq=False)
class CandidateDesign:
    """Candidate stops (m of them) for one fitted model.

    Attributes
    ----------
    context : EffectContext
        What effects may depend on there.
    white : array, shape (3, 3, m)
        Whitening of the expected uncertainty.
    by_joint : array, shape (3, N, m)
        Whitened derivatives of the SMR position by the joints.
    geometric : array, shape (p, 3 m)
        Whitened derivatives by the fitted geometric parameters.
    """

    context: EffectContext
    white: Array
    by_joint: Array
    geometric: Array

    @classmethod
    def of(cls, data: ArmData, fit: JointFit, q: Array, conditions: MeasurementConditions) -> CandidateDesign:
        """Set up at configurations ``q`` (m, N) [rad] under ``conditions``."""
        model, found = fit.model, fit.identification
        true_q = model.true_joints(q, conditions=conditions) if model.effects else None
        context = replace(model.context(q, conditions=conditions), q_actual=true_q)
        white = whitening(_expected_sigma(data, context))
        linear = LinearModel.of(found.geometry, q, white, found.parameter_set)
        return cls(context, white, linear.by_joint, linear.rows)

    def rows(self, slug: str, law: Law, names: Sequence[str]) -> Array:
        """Compute the whitened columns (k, 3 m) of a law."""
        return whitened_displacements(named_columns(self.context, slug, law, names), self.by_joint, self.white)

    @staticmethod
    def by_stop(rows: Array) -> Array:
        """Reshape rows (p, 3 m), ordered by coordinate and then by stop, to (p, m, 3)."""
        return rows.reshape(len(rows), 3, -1).transpose(0, 2, 1)


def _expected_sigma(data: ArmData, context: EffectContext) -> Array:
    """Predict the uncertainty of further readings: the run's mean variances along their beams and across them.

    Further stops count as positions alone, also where the run has orientations.
    """
    points = data.points
    sigma = data.sigma[points]
    if sigma.ndim == 1:
        return np.full(len(context), float(np.sqrt(np.mean(sigma**2))))
    frame = _beam_frame(data.context)[points]
    variances = np.mean(np.einsum("nac,nab,nbc->nc", frame, sigma, frame), axis=0)
    frame = _beam_frame(context)
    return np.asarray(np.einsum("nac,c,nbc->nab", frame, variances, frame))


def _beam_frame(context: EffectContext) -> Array:
    """Return unit vectors along the beam, horizontally across it and upward across it as columns, (n, 3, 3)."""
    _, beam = context.beam
    _, _, horizontal, upward = context.across
    return np.stack([beam, horizontal, upward], axis=2)


def joined_context(data: ArmData, q: Array, conditions: MeasurementConditions) -> EffectContext:
    """Join the run and some of the further stops (configurations, conditions) in one context."""
    rows = np.arange(len(q))[:: max(1, len(q) // _MOST_JOINED)]
    joined = _joined_conditions(data.conditions, len(data), conditions.take(rows), len(rows))
    return data.model.context(np.concatenate([data.readings.q, q[rows]]), conditions=joined)


def _joined_conditions(
    first: MeasurementConditions, n: int, second: MeasurementConditions, m: int
) -> MeasurementConditions:
    """Join the conditions of n stops and of m further ones; NaN in the rows of those that lack a quantity."""
    joined: dict[str, Any] = {"record": first.record}
    for entry in fields(MeasurementConditions):
        values = [getattr(first, entry.name), getattr(second, entry.name)]
        stated = [value for value in values if value is not None]
        if entry.name == "record" or not stated:
            continue
        rest = stated[0].shape[1:]
        joined[entry.name] = np.concatenate(
            [
                np.full((size, *rest), np.nan) if value is None else np.asarray(value, dtype=np.float64)
                for value, size in zip(values, (n, m), strict=True)
            ]
        )
    return MeasurementConditions(**joined)


# -- Hypotheses that a discovery leaves open in the data of one arm: those most worth deciding ------------------------


_MOST_COLUMNS = 40
"""Most columns of an alternative's law, the best imitating ones: with hundreds of lines the rest only costs time."""
_MOST_LAWS = 4
"""Upper limit of the laws of an alternative, the best imitating ones: each is a discrimination of its own."""
_MOST_FAINT = 3
"""Number of effects whose visibility is to be raised where nothing is ambiguous; with more, none would gain much."""
_VARIABLE_CONDITIONS = frozenset(
    {InputVariable.APPROACH, InputVariable.STEP, InputVariable.DWELL, InputVariable.OTHER_ARM}
)
"""Variables that the conditions of further stops can vary where those of a run did not."""
_MOVES_NOTHING = 1e-12
"""Lower limit of divisors: the information about a parameter, or the motion by it, may be zero."""


def open_hypotheses(data: ArmData, fit: JointFit, discovery: ArmFound, joined: EffectContext) -> list[Hypothesis]:
    """Find hypotheses for further stops to decide; ``joined`` is the context of the run and some of these stops.

    First, accepted effects against those that the data cannot distinguish from them. If there are none, against the
    effects declared as confounded with them, as the parts of the unnamed term, each for the effect that it looks like.
    If there are none either, the effects that are hardest to see.
    """
    least = discovery.result.threshold
    found: list[Hypothesis] = []
    named = [number for number, term in enumerate(fit.terms) if not is_unnamed(term.law)]
    fit = replace(fit, terms=tuple(_as_its_cause(term) for term in fit.terms))
    for number, effect in zip(named, discovery.result.accepted, strict=False):
        for slug in effect.indistinguishable:
            found += _hypotheses_against(data, fit, number, slug, least, joined)
            found += _swapped_hypotheses(data, fit, number, slug, least, joined)
    if not found:
        taken = {term.slug for term in fit.terms}
        for number, term in enumerate(fit.terms):
            for slug in EFFECTS[term.slug].confounded:
                if slug not in taken and slug in EFFECTS:  # a plug-in may name effects that are not installed
                    found += _hypotheses_against(data, fit, number, slug, least, joined)
    return found or _faint_effects(data, fit, discovery, joined)


def _as_its_cause(term: ModelTerm) -> ModelTerm:
    """Return a part of the unnamed term under the name of the effect that it looks like."""
    if not is_unnamed(term.law) or lent_effect(term.law).slug == UNKNOWN:
        return term
    return replace(term, slug=lent_effect(term.law).slug, law=lent_law(term.law))


def _hypotheses_against(
    data: ArmData, fit: JointFit, number: int, alternative: str, least: float, joined: EffectContext
) -> list[Hypothesis]:
    """Test a term of a fit against another effect; no hypothesis if that has no columns."""
    term = fit.terms[number]
    signal = ProjectedResidual(fit.residual_without(number).projector, fit.signal(number))
    ranked = []
    for law in _laws(data, alternative, joined):
        columns = data.columns(alternative, law)
        moving = [k for k, column in enumerate(EFFECTS[alternative].columns(joined, law)) if _moves(column)]
        if not moving:
            continue
        rows = fit.displacements(columns)
        if len(moving) > _MOST_COLUMNS:
            projected = signal.projector.project(rows[moving])
            information = np.maximum(np.einsum("kd,kd->k", rows[moving], projected), _MOVES_NOTHING)
            gains = (rows[moving] @ signal.projected) ** 2 / information
            moving = sorted(moving[k] for k in np.argsort(-gains, kind="stable")[:_MOST_COLUMNS])
        names = tuple(columns[k].name for k in moving)
        ranked.append((signal.explained(rows[moving]), (law, names)))
    if not ranked:
        return []
    ranked.sort(key=lambda entry: -entry[0])
    needed = least + len(term.names) * math.log(3 * len(data))
    alternatives = tuple(one for _, one in ranked[:_MOST_LAWS])
    values = fit.term_values(number)[None]
    return [Hypothesis(term.slug, alternative, needed, data, fit, number, term.law, term.names, values, alternatives)]


def _swapped_hypotheses(
    data: ArmData, fit: JointFit, number: int, alternative: str, least: float, joined: EffectContext
) -> list[Hypothesis]:
    """Swap the roles: the alternative, fitted in place of a term, is true and the term's effect is the alternative."""
    residual = fit.residual_without(number)
    scores = LawScan.of(fit.candidates(data, [alternative]), residual.projector).ranked(residual)
    if not scores or not scores[0].names:
        return []
    instead = ModelTerm(alternative, scores[0].candidate.law, scores[0].names)
    if len(fit.rows) + len(instead.names) >= 3 * len(data):
        return []  # too few readings to fit it
    other = fit_terms(data, with_term(fit.terms, number, instead))
    return _hypotheses_against(data, other, number, fit.terms[number].slug, least, joined)


def _faint_effects(data: ArmData, fit: JointFit, discovery: ArmFound, joined: EffectContext) -> list[Hypothesis]:
    """Return the effects that this plan shows least, and those that it cannot show because a factor did not vary."""
    faint = sorted(discovery.result.not_found, key=lambda entry: entry.visible_share or 0.0)
    slugs = [entry.effect for entry in faint[:_MOST_FAINT]]
    for entry in discovery.result.invisible:
        effect = EFFECTS[entry.effect]
        if effect.variables & _VARIABLE_CONDITIONS and effect.missing_data(data.context):
            slugs.append(effect.slug)
    found = []
    for slug in slugs:
        laws = _laws(data, slug, joined)
        if slug == UNKNOWN or not laws:
            continue
        law = laws[0]
        further = {column.name: column for column in EFFECTS[slug].columns(joined, law) if _moves(column)}
        columns = [column for column in data.columns(slug, law) if column.name in further][:_MOST_COLUMNS]
        if not columns:
            continue
        needed = discovery.result.threshold + math.log(3 * len(data)) + choice_price(law)
        sizes = np.diag([_signal_size(fit, column, further[column.name], needed) for column in columns])
        names = tuple(column.name for column in columns)
        found.append(Hypothesis(slug, "", needed, data, fit, None, law, names, sizes))
    return found


def _signal_size(fit: JointFit, column: EffectColumn, further: EffectColumn, needed: float) -> float:
    """Return the smallest size of a parameter that the run would show, else one that moves the SMR by the noise."""
    rows = fit.displacements([column])
    visible, whole = float(np.sum(rows * fit.projector.project(rows))), float(np.sum(rows**2))
    if visible > VISIBLE**2 * whole and visible > 0.0:
        return detectable_size(math.sqrt(visible), needed)
    noise = float(1.0 / np.sqrt(np.mean(fit.white[0, 0, fit.identification.positions] ** 2)))
    if further.shift_M is not None:
        moved = float(np.sqrt(np.mean(further.shift_M**2)))
    else:
        assert further.offset is not None
        levers = np.sqrt(np.mean(np.sum((fit.by_joint[:, further.joint] * noise) ** 2, axis=0)))
        moved = float(levers * np.sqrt(np.mean(further.offset**2)))
    return min(noise / max(moved, _MOVES_NOTHING), max(abs(column.lower), abs(column.upper)))


def _laws(data: ArmData, slug: str, joined: EffectContext) -> list[Law]:
    """Return the laws that the run allows, and those that only the conditions of further stops allow."""
    effect = EFFECTS[slug]
    found = [] if effect.missing_data(data.context) else effect.laws(data.context)
    names = {law.name for law in found}
    if not effect.missing_data(joined):
        found += [law for law in effect.laws(joined) if law.name not in names]
    return found


def _moves(column: EffectColumn) -> bool:
    """Return whether a column moves the SMR at any stop."""
    moved = column.offset if column.joint is not None else column.shift_M
    return moved is not None and bool(np.any(moved))
