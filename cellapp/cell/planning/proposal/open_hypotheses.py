"""Hypotheses that a discovery leaves open in the data of one arm: those most worth deciding."""

from __future__ import annotations

import math

import numpy as np

from cellapp.cell.planning.proposal.hypotheses import Hypothesis, RivalLaw
from cellapp.estimation.design.information import VISIBLE, detectable_size
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit, fit_terms
from cellapp.estimation.discovery.outcome import Discovery
from cellapp.estimation.discovery.projected_residual import ProjectedResidual
from cellapp.estimation.discovery.search.scan import LawScan, choice_price
from cellapp.estimation.discovery.terms import UNKNOWN, ModelTerm, with_term
from cellapp.robot.effects import EFFECTS, DriverVariable, EffectColumn, EffectContext, Law

_MOST_COLUMNS = 40
"""Most columns of a rival's law, the best imitating ones: with hundreds of lines the rest only costs time."""
_MOST_LAWS = 4
"""Upper limit of the laws of a rival, the best imitating ones: each is a discrimination of its own."""
_MOST_FAINT = 3
"""Number of effects whose visibility is to be raised where nothing is ambiguous; with more, none would gain much."""
_VARIABLE_CONDITIONS = frozenset(
    {DriverVariable.APPROACH, DriverVariable.STEP, DriverVariable.DWELL, DriverVariable.OTHER_ARM}
)
"""Variables that the conditions of further stops can vary where those of a run did not."""
_MOVES_NOTHING = 1e-12
"""Lower limit of divisors: the information about a parameter, or the motion by it, may be zero."""


def open_hypotheses(data: ArmData, fit: JointFit, discovery: Discovery, joined: EffectContext) -> list[Hypothesis]:
    """Find hypotheses for further stops to decide; ``joined`` is the context of the run and some of these stops.

    First, accepted effects against those that the data cannot distinguish from them. If there are none, against their
    declared look-alikes. If there are none either, the effects that are hardest to see.
    """
    least = discovery.result.threshold
    found: list[Hypothesis] = []
    for number, effect in enumerate(discovery.result.accepted):
        for slug in effect.answer_set[1:]:
            found += _hypotheses_against(data, fit, number, slug, least, joined)
            found += _swapped_hypotheses(data, fit, number, slug, least, joined)
    if not found:
        taken = {term.slug for term in fit.terms}
        for number, term in enumerate(fit.terms):
            for slug in EFFECTS[term.slug].look_alikes:
                if slug not in taken and slug in EFFECTS:  # a plug-in may name effects that are not installed
                    found += _hypotheses_against(data, fit, number, slug, least, joined)
    return found or _faint_effects(data, fit, discovery, joined)


def _hypotheses_against(
    data: ArmData, fit: JointFit, number: int, rival: str, least: float, joined: EffectContext
) -> list[Hypothesis]:
    """Test a term of a fit against another effect; no hypothesis if that has no columns."""
    term = fit.terms[number]
    signal = ProjectedResidual(fit.residual_without(number).projector, fit.signal(number))
    ranked = []
    for law in _laws(data, rival, joined):
        columns = data.columns(rival, law)
        moving = [k for k, column in enumerate(EFFECTS[rival].columns(joined, law)) if _moves(column)]
        if not moving:
            continue
        rows = fit.displacements(columns)
        if len(moving) > _MOST_COLUMNS:
            projected = signal.projector.project(rows[moving])
            information = np.maximum(np.einsum("kd,kd->k", rows[moving], projected), _MOVES_NOTHING)
            gains = (rows[moving] @ signal.projected) ** 2 / information
            moving = sorted(moving[k] for k in np.argsort(-gains, kind="stable")[:_MOST_COLUMNS])
        names = tuple(columns[k].name for k in moving)
        ranked.append((signal.explained(rows[moving]), RivalLaw(law, names)))
    if not ranked:
        return []
    ranked.sort(key=lambda entry: -entry[0])
    needed = least + len(term.names) * math.log(3 * len(data))
    rivals = tuple(one for _, one in ranked[:_MOST_LAWS])
    values = fit.term_values(number)[None]
    return [Hypothesis(term.slug, rival, needed, data, fit, number, term.law, term.names, values, rivals)]


def _swapped_hypotheses(
    data: ArmData, fit: JointFit, number: int, rival: str, least: float, joined: EffectContext
) -> list[Hypothesis]:
    """Swap the roles: the rival, fitted in place of a term, is true and the term's effect is the rival."""
    residual = fit.residual_without(number)
    scores = LawScan.of(fit.candidates(data, [rival]), residual.projector).ranked(residual)
    if not scores or not scores[0].names:
        return []
    instead = ModelTerm(rival, scores[0].candidate.law, scores[0].names)
    if len(fit.rows) + len(instead.names) >= 3 * len(data):
        return []  # too few readings to fit it
    other = fit_terms(data, with_term(fit.terms, number, instead))
    return _hypotheses_against(data, other, number, fit.terms[number].slug, least, joined)


def _faint_effects(data: ArmData, fit: JointFit, discovery: Discovery, joined: EffectContext) -> list[Hypothesis]:
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
    noise = float(1.0 / np.sqrt(np.mean(fit.white[0, 0, fit.positions] ** 2)))
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
