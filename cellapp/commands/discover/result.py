"""The result of ``discover`` from the objects of discovery."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cellapp.cell.planning.proposal.predictions import PredictedDiscrimination
from cellapp.cell.planning.proposal.propose import Proposal as ProposedStops
from cellapp.cell.planning.proposal.propose import ProposedStop
from cellapp.cell.planning.stop_conditions import StopConditions
from cellapp.commands.calibrate.result import pair_result
from cellapp.estimation.discovery import outcome
from cellapp.estimation.discovery.describe import Description
from cellapp.estimation.discovery.outcome import CellDiscovery, Discovery
from cellapp.estimation.discovery.records import (
    AcceptedEffect,
    ArmDiscoveryResult,
    BeforeAfter,
    Contradiction,
    Correlation,
    DiscoverResult,
    Discrimination,
    EffectMeaning,
    Evidence,
    GapStep,
    HeldOutBeforeAfter,
    LawRecord,
    Place,
    Proposal,
    ProposalQuestion,
    RunnerUp,
    TermDescription,
)
from cellapp.estimation.discovery.records import ProposedStop as ProposedStopRow
from cellapp.ground.results import Estimate
from cellapp.robot.effects import EFFECTS, Meaning, place_in_words, term_to_json
from cellapp.robot.effects.contradiction import contradicted_effect, is_contradiction


def discover_result(found: CellDiscovery) -> DiscoverResult:
    """The object that ``discover --json`` writes and that the run file keeps."""
    return DiscoverResult(
        arms={name: arm_result(discovery) for name, discovery in found.arms.items()},
        pair={} if found.pair is None else {"effects": pair_result(found.pair)["effects"]},
        notes=tuple(f"not searched for: {one.refusal}" for one in EFFECTS.plugins if one.problem) or None,
    )


def arm_result(found: Discovery) -> ArmDiscoveryResult:
    """Discovery in the data of one arm."""
    return ArmDiscoveryResult(
        noise_floor_mm=_finite(found.noise_floor_mm),
        noise_mm=found.noise_mm,
        heldout_mm=BeforeAfter(before=found.before.rms, after=found.after.rms),
        heldout_position_mm=HeldOutBeforeAfter(before=found.before, after=found.after),
        seconds=found.seconds,
        steps=tuple(GapStep(what=step.what, effect=step.effect, heldout_mm=step.heldout_mm) for step in found.steps),
        threshold=found.threshold,
        omnibus_p=_finite(found.omnibus_p),
        scatter=_finite(found.scatter),
        accepted=tuple(_accepted(effect) for effect in found.accepted),
        candidates=found.candidates,
        contradictions=tuple(_contradiction(effect) for effect in found.accepted if is_contradiction(effect.term.law)),
        structure=found.structure,
        invisible=found.invisible,
        not_found=found.not_found,
        network_mm=found.network_mm,
        uncertainty_mm=found.uncertainty_mm,
        pictures=found.pictures,
        validate_={"effects": found.stage} if found.accepted else {},
        left_out_configurations=found.left_out,
        verdict=found.verdict,
        sentence=found.sentence,
    )


def proposal_result(proposed: ProposedStops, first: int | None, notes: Sequence[str]) -> Proposal:
    """Proposed stops; ``first`` is the number of the first of them in the run's plan, None where it has none."""
    arms: dict[str, list[ProposalQuestion]] = {}
    for prediction in proposed.predictions:
        arms.setdefault(prediction.arm, []).append(_question(prediction))
    return Proposal(
        count=len(proposed.stops),
        written=first is not None,
        first_configuration=first,
        arms={name: tuple(questions) for name, questions in arms.items()},
        stops=tuple(
            row for number, stop in enumerate(proposed.stops, start=first or 0) for row in _stop_rows(number, stop)
        ),
        notes=tuple(notes),
        advice=proposed.advice,
    )


def _accepted(effect: outcome.AcceptedEffect) -> AcceptedEffect:
    term, described = effect.term, effect.description
    shared = term_to_json(term)
    return AcceptedEffect(
        effect=term.slug,
        title=EFFECTS[term.slug].title,
        law=LawRecord(name=shared["law"], constants=shared["constants"]),
        where=Place(
            joints=effect.joints,
            acts_on=effect.acts_on,
            channel=None if described is None else described.channel,
            variables=None if described is None else described.variables,
        ),
        parameters={name: Estimate.model_validate(shared["parameters"][name]) for name in term.law_names},
        evidence=Evidence(
            statistic=effect.score,
            corrected_p=effect.p_value,
            heldout_mm=BeforeAfter(before=effect.heldout_before_mm, after=effect.heldout_after_mm),
        ),
        answer_set=effect.answer_set,
        runners_up=tuple(
            RunnerUp(effect=rival.slug, statistic=rival.score, distinguishable=rival.distinguishable)
            for rival in effect.rivals
        ),
        correlated_with=None
        if effect.correlated is None
        else Correlation(parameter=effect.correlated[0], correlation=effect.correlated[1]),
        posterior=_finite(effect.posterior),
        law_misfit=effect.law_misfit,
        meaning=_meaning(EFFECTS[term.slug].meaning_of(term.law).at(place_in_words(effect.acts_on))),
        cycles=effect.cycles,
        movements=effect.movements or None,
        description=None if described is None else _description(described),
    )


def _contradiction(effect: outcome.AcceptedEffect) -> Contradiction:
    contradicted = contradicted_effect(effect.term.law)
    return Contradiction(
        effect=contradicted.slug,
        joints=effect.joints,
        size_um=math.nan if effect.description is None else effect.description.size_um,
        sentence=effect.term.note,
    )


def _meaning(meaning: Meaning) -> EffectMeaning:
    return EffectMeaning(
        cause=meaning.cause,
        size=meaning.size,
        size_source=meaning.size_source,
        check=meaning.check,
        settle=meaning.settle,
    )


def _description(found: Description) -> TermDescription:
    return TermDescription(
        channel=found.channel,
        variables=found.variables,
        size_um=found.size_um,
        formula=found.formula,
        gain_over_curve=found.gain,
        curve=found.curve,
        sentence=found.sentence,
    )


def _question(predicted: PredictedDiscrimination) -> ProposalQuestion:
    return ProposalQuestion(
        effect=predicted.effect,
        against=predicted.against or None,
        needed=predicted.needed,
        discrimination=Discrimination(now=predicted.now, proposed=predicted.proposed, random=predicted.random),
        gain_over_random=predicted.gain_over_random,
    )


def _stop_rows(number: int, stop: ProposedStop) -> list[ProposedStopRow]:
    rows = []
    for name, q in stop.q.items():
        conditions = stop.conditions.get(name, StopConditions())
        via = None if conditions.via is None else tuple(conditions.via.tolist())
        dwell_s = conditions.dwell_s if conditions.dwell_s > 0.0 else None
        rows.append(ProposedStopRow(configuration=number, arm=name, q=tuple(q.tolist()), via=via, dwell_s=dwell_s))
    return rows


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
