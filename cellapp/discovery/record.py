"""The result of ``discover`` from the objects of discovery."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from cellapp.calibration.record import pair_result
from cellapp.discovery import pictures
from cellapp.discovery.describe import Description
from cellapp.discovery.discover import CellDiscovery, Discovery, Finding
from cellapp.discovery.pictures import cycles
from cellapp.discovery.propose import Answer, ProposedStop
from cellapp.discovery.propose import Proposal as ProposedStops
from cellapp.effects import EFFECTS
from cellapp.results import (
    AbsentEffect,
    AcceptedEffect,
    ArmDiscoveryResult,
    BeforeAfter,
    Correlation,
    CurveRecord,
    CycleBand,
    DiscoverResult,
    Discrimination,
    Estimate,
    Evidence,
    GapStep,
    LawRecord,
    Picture,
    Place,
    PredictedUncertainty,
    Proposal,
    ProposalQuestion,
    RunnerUp,
    TermDescription,
)
from cellapp.results import ProposedStop as ProposedStopRow


def discover_result(found: CellDiscovery) -> DiscoverResult:
    """The object that ``discover --json`` writes and that the run file keeps."""
    return DiscoverResult(
        arms={name: arm_result(discovery) for name, discovery in found.arms.items()},
        pair={} if found.pair is None else {"effects": pair_result(found.pair)["effects"]},
    )


def arm_result(found: Discovery) -> ArmDiscoveryResult:
    """Discovery in the data of one arm."""
    uncertainty = found.uncertainty_mm
    return ArmDiscoveryResult(
        noise_floor_mm=_finite(found.noise_floor_mm),
        heldout_mm=BeforeAfter(before=found.before_mm, after=found.after_mm),
        steps=tuple(GapStep(what=step.what, effect=step.effect, heldout_mm=step.heldout_mm) for step in found.steps),
        threshold=found.threshold,
        omnibus_p=_finite(found.omnibus_p),
        scatter=_finite(found.scatter),
        accepted=tuple(_accepted(finding) for finding in found.findings),
        invisible=tuple(AbsentEffect.model_validate(entry) for entry in found.invisible),
        not_found=tuple(AbsentEffect.model_validate(entry) for entry in found.not_found),
        network_mm=None if found.network_mm is None else BeforeAfter.model_validate(found.network_mm),
        uncertainty_mm=None if uncertainty is None else PredictedUncertainty.model_validate(uncertainty),
        pictures=tuple(_picture(picture) for picture in found.pictures),
        validate_={"effects": found.stage} if found.findings else {},
        verdict=found.verdict,
        sentence=found.sentence,
    )


def proposal_result(proposed: ProposedStops, first: int | None, notes: Sequence[str]) -> Proposal:
    """Proposed stops; ``first`` is the number of the first of them in the run's plan, None where it has none."""
    arms: dict[str, list[ProposalQuestion]] = {}
    for answer in proposed.answers:
        arms.setdefault(answer.arm, []).append(_question(answer))
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


def _accepted(finding: Finding) -> AcceptedEffect:
    term, described = finding.term, finding.description
    estimates = zip(term.names, term.values.tolist(), term.standard_errors.tolist(), term.units, strict=True)
    return AcceptedEffect(
        effect=term.slug,
        title=EFFECTS[term.slug].title,
        law=LawRecord(name=term.law.name, constants=dict(term.law.constants)),
        where=Place(
            joints=finding.joints,
            acts_on=finding.acts_on,
            channel=None if described is None else described.channel,
            variables=None if described is None else described.variables,
        ),
        parameters={
            name: Estimate(value=value, standard_error=_finite(error), unit=unit)
            for name, value, error, unit in estimates
        },
        evidence=Evidence(
            statistic=finding.score,
            corrected_p=finding.p_value,
            heldout_mm=BeforeAfter(before=finding.heldout_before_mm, after=finding.heldout_after_mm),
        ),
        answer_set=finding.answer_set,
        runners_up=tuple(
            RunnerUp(effect=rival.slug, statistic=rival.score, told_apart=rival.told_apart) for rival in finding.rivals
        ),
        correlated_with=None
        if finding.correlated is None
        else Correlation(parameter=finding.correlated[0], correlation=finding.correlated[1]),
        cycles=_cycles(cycles(term.names, term.values)) if term.slug == "transmission_error" else None,
        description=None if described is None else _description(described),
    )


def _cycles(found: Mapping[str, Mapping[str, float]]) -> dict[str, CycleBand]:
    return {joint: CycleBand.model_validate(band) for joint, band in found.items()}


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


def _picture(found: pictures.Picture) -> Picture:
    curve = found.curve
    return Picture(
        title=found.title,
        effect=found.effect,
        x_label=found.x_label,
        y_label=found.y_label,
        x=found.x,
        measured=found.measured,
        computed=found.computed,
        band=found.band,
        curve=None if curve is None else CurveRecord(x=curve.x, value=curve.value, band=curve.band),
    )


def _question(answer: Answer) -> ProposalQuestion:
    return ProposalQuestion(
        effect=answer.effect,
        against=answer.against or None,
        needed=answer.needed,
        discrimination=Discrimination(now=answer.now, proposed=answer.proposed, random=answer.random),
        gain_over_random=answer.gain,
    )


def _stop_rows(number: int, stop: ProposedStop) -> list[ProposedStopRow]:
    rows = []
    for name, q in stop.q.items():
        factors = stop.factors.get(name)
        via = None if factors is None or factors.via is None else tuple(factors.via.tolist())
        dwell_s = None if factors is None or factors.dwell_s <= 0.0 else factors.dwell_s
        rows.append(ProposedStopRow(configuration=number, arm=name, q=tuple(q.tolist()), via=via, dwell_s=dwell_s))
    return rows


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
