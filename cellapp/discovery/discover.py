"""Discovery: which physical effects the model lacks; adds them and shows how the held-out error shrinks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellapp.calibration.calibrate import rms_length_mm
from cellapp.calibration.circumstances import circumstances
from cellapp.calibration.cooperative import PairCalibration, calibrate_pair
from cellapp.calibration.evaluation import evaluate, position_errors, summarise
from cellapp.calibration.residual import train_network
from cellapp.discovery.data import ArmData, Fit
from cellapp.discovery.describe import Description, describe
from cellapp.discovery.pictures import Picture, pictures
from cellapp.discovery.scan import VISIBLE, Seen, smallest_seen
from cellapp.discovery.search import UNKNOWN, Rival, Search, on_all, scatter, search
from cellapp.effects import EFFECTS, Circumstances, EffectTerm
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel, CellModel, ResidualNetwork
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.results import StageErrors, Verdict
from cellapp.run import Readings, stated_uncertainty

_FLOOR = 1.05
"""Held-out rms within this factor of the noise floor counts as explained."""
_CHANCE = 0.001
_UNSTRUCTURED = 1.5
"""Up to this factor on the stated uncertainty, scatter without any structure is called noise and not an effect."""
_MOST_SEARCHED = 600
"""Of more readings than these, so many are searched, drawn by the seed; what is found is then fitted to all."""
_BARELY_VISIBLE = 0.03
"""An effect of which geometry takes all but this share under this plan is called invisible."""


@dataclass(frozen=True)
class Finding:
    """An accepted effect with its evidence.

    ``correlated`` is the geometric parameter that its values are most correlated with, and how much.
    """

    term: EffectTerm
    joints: tuple[int, ...]
    acts_on: tuple[str, ...]
    score: float
    p_value: float
    heldout_before_mm: float
    heldout_after_mm: float
    rivals: tuple[Rival, ...]
    correlated: tuple[str, float] | None
    description: Description | None = None

    @property
    def answer_set(self) -> tuple[str, ...]:
        """The effect and all that these data cannot tell from it."""
        return (self.term.slug, *(rival.slug for rival in self.rivals if not rival.told_apart))


@dataclass(frozen=True)
class GapStep:
    """The held-out gap after one step of the search."""

    what: str
    effect: str
    heldout_mm: float


@dataclass(frozen=True)
class Discovery:
    """What was found in one arm's data."""

    findings: tuple[Finding, ...]
    noise_floor_mm: float
    before_mm: float
    after_mm: float
    steps: tuple[GapStep, ...]
    threshold: float
    omnibus_p: float
    scatter: float
    invisible: tuple[Mapping[str, Any], ...]
    not_found: tuple[Mapping[str, Any], ...]
    verdict: Verdict
    sentence: str
    model: ArmModel
    stage: StageErrors
    pictures: tuple[Picture, ...] = ()
    network_mm: Mapping[str, float] | None = None
    uncertainty_mm: Mapping[str, float] | None = None


@dataclass(frozen=True)
class CellDiscovery:
    """What was found in the data of every arm.

    ``model`` is the cell with the effects; ``pair`` the cooperative errors with them, None where no effect was found or
    there is no pair.
    """

    arms: Mapping[str, Discovery]
    model: CellModel
    pair: PairCalibration | None


def discover_cell(
    profile: Profile,
    model: CellModel,
    readings: Mapping[str, Readings],
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> CellDiscovery:
    """Search the readings of every arm for effects that the calibrated ``model`` lacks, and add them to it."""
    cancel = cancel or CancelToken()
    known = known_of_all(model, readings)
    found: dict[str, Discovery] = {}
    for done, name in enumerate(model.arms):
        listener(Progress("discover", done, len(model.arms), f"arm {name}"))
        cancel.check()
        found[name] = discover_arm(profile, name, model.arms[name], readings[name], cancel, known=known[name])
    if profile.network.kind == "mlp":
        listener(Progress("discover", len(model.arms), len(model.arms), "what a network still finds"))
        with ThreadPoolExecutor(max_workers=2) as pool:  # torch works outside the interpreter lock
            tasks = {
                name: pool.submit(
                    _with_network, profile, model.arms[name], discovery, readings[name], known[name], cancel
                )
                for name, discovery in found.items()
            }
            found = {name: task.result() for name, task in tasks.items()}
    pair = None
    if any(discovery.findings for discovery in found.values()):
        pair, _ = calibrate_pair(profile, readings, {name: _Found(d.model) for name, d in found.items()})
    arms = {name: discovery.model for name, discovery in found.items()}
    model = replace(model, arms=arms, T_R_L=model.T_R_L if pair is None else pair.T_R_L)
    listener(Progress("discover", len(arms), len(arms), "done"))
    return CellDiscovery(found, model, pair)


@dataclass(frozen=True)
class _Found:
    """An arm as the pair sees it after discovery."""

    model: ArmModel
    tracker_trained: None = None


def known_of_all(model: CellModel, readings: Mapping[str, Readings]) -> dict[str, Circumstances]:
    """What is known of the stops of every arm; each of two arms knows the other."""
    names = list(readings)
    known = {}
    for name in names:
        others = [other for other in names if other != name]
        other = (model.arms[others[0]], readings[others[0]]) if len(others) == 1 else None
        known[name] = circumstances(readings[name], other)
    return known


def discover_arm(
    profile: Profile,
    name: str,
    model: ArmModel,
    readings: Readings,
    cancel: CancelToken | None = None,
    *,
    known: Circumstances | None = None,
) -> Discovery:
    """Discover on everything but the validate split, confirm by folds of it, show the gap on the validate split.

    ``known`` is what is known of the stops beside the readings' own columns (the other arm).
    """
    cancel = cancel or CancelToken()
    known = known or circumstances(readings)
    rows = readings.in_split("validate")
    learn_rows = np.concatenate([readings.in_split("identify"), readings.in_split("train")])
    held_out, held_known = readings.take(rows), known.take(rows)
    slugs = [slug for slug in EFFECTS if slug != UNKNOWN]
    some = learn_rows
    if len(learn_rows) > _MOST_SEARCHED:
        some = np.sort(np.random.default_rng([profile.seed, 0x5EA]).permutation(learn_rows)[:_MOST_SEARCHED])
    found = search(ArmData.of(profile, model, readings.take(some), known.take(some)), slugs, cancel)
    if len(some) < len(learn_rows) and found.fit.choice:
        found = on_all(found, ArmData.of(profile, model, readings.take(learn_rows), known.take(learn_rows)))

    def gap(candidate: ArmModel) -> float:
        return _rms_mm(candidate, held_out, held_known)

    final = found.fit.model
    after, before = gap(final), gap(found.first.model)
    findings = _findings(found, gap)
    steps = (
        GapStep("geometry alone", "", before),
        *(GapStep(step.what, step.slug, gap(step.model)) for step in found.steps if step.model is not None),
    )
    if found.dropped:
        words = ", ".join(EFFECTS[slug].title if slug != UNKNOWN else "a data-driven term" for slug in found.dropped)
        steps = (*steps, GapStep(f"dropped in review: {words}", "", after))
    if len(some) < len(learn_rows) and found.fit.choice:
        steps = (*steps, GapStep(f"fitted to all {len(learn_rows)} readings", "", after))
    floor = _noise_floor_mm(held_out)
    spread = scatter(found.data, found.fit)
    verdict, sentence = _judge(findings, floor, after, held_out, spread)
    # with the notes of data-driven terms; what found nothing stays as it was calibrated
    final = replace(final, effects=tuple(finding.term for finding in findings)) if findings else model
    invisible, not_found = _unseen(found, {finding.term.slug for finding in findings})
    predicted = final.uncertainty(held_out.q)
    return Discovery(
        findings=findings,
        noise_floor_mm=floor,
        before_mm=before,
        after_mm=after,
        steps=steps,
        threshold=found.least,
        omnibus_p=math.nan if spread is None else spread[1],
        scatter=math.nan if spread is None else spread[0],
        invisible=invisible,
        not_found=not_found,
        verdict=verdict,
        sentence=f"arm {name}: {sentence}",
        model=final,
        stage=evaluate(held_out.p_M, final.predict(held_out.q, known=held_known)),
        pictures=pictures(found.data, found.fit),
        uncertainty_mm=None
        if not predicted.any()
        else {"median": float(np.median(predicted)) * 1e3, "largest": float(predicted.max()) * 1e3},
    )


def _findings(found: Search, gap: Callable[[ArmModel], float]) -> tuple[Finding, ...]:
    """The reviewed parts of the final choice as findings, in order, with the gap without and with each."""
    findings = []
    fit = found.fit
    after = gap(fit.model)
    for place, reviewed in enumerate(found.reviewed):
        term = fit.model.effects[place]
        rest = fit.choice[:place] + fit.choice[place + 1 :]
        without = gap(found.data.fit(rest).model)
        part = fit.choice[place]
        begin = sum(len(p.names) for p in fit.choice[:place])
        columns = fit.columns[begin : begin + len(part.names)]
        description = describe(found.data, fit, place) if part.slug == UNKNOWN else None
        if description is not None:
            term = replace(term, note=description.sentence)
        findings.append(
            Finding(
                term=term,
                joints=tuple(sorted({c.joint + 1 for c in columns if c.joint is not None})),
                acts_on=tuple(dict.fromkeys(column.where for column in columns)),
                score=reviewed.score,
                p_value=reviewed.p_value,
                heldout_before_mm=without,
                heldout_after_mm=after,
                rivals=reviewed.rivals,
                correlated=_correlated(fit, place),
                description=description,
            )
        )
    return tuple(findings)


def _correlated(fit: Fit, place: int) -> tuple[str, float] | None:
    """The geometric parameter most correlated with a part's values, and the correlation."""
    part = fit.choice[place]
    if part.curves is not None:
        return None
    covariance = fit.identification.covariance
    size = len(fit.identification.parameter_set.columns)
    begin = size + sum(len(p.names) for p in fit.choice[:place])
    here = slice(begin, begin + len(part.names))
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance[:size, here] / sd[:size, None] / sd[here]
    row, column = np.unravel_index(int(np.argmax(np.abs(correlation))), correlation.shape)
    return fit.identification.names[int(row)], float(correlation[row, column])


def _with_network(
    profile: Profile,
    before: ArmModel,
    discovery: Discovery,
    readings: Readings,
    known: Circumstances,
    cancel: CancelToken,
) -> Discovery:
    """What a network finds before and after the named effects; it joins the model only where something is unknown."""
    held_out = readings.take(readings.in_split("validate"))
    rows = np.concatenate([readings.in_split("identify"), readings.in_split("train")])
    network = discovery.model.network
    if discovery.findings:
        network = _network_for_the_rest(profile, discovery.model, readings.take(rows), known.take(rows), cancel)
    found = {
        "before": _correction_mm(before.network, held_out.q),
        "after": _correction_mm(network, held_out.q),
    }
    discovery = replace(discovery, network_mm=found)
    if not discovery.findings or discovery.verdict != "unknown effect" or network is None:
        return discovery
    model = replace(discovery.model, network=network)
    known_held = known.take(readings.in_split("validate"))
    after = _rms_mm(model, held_out, known_held)
    if after >= discovery.after_mm:
        return discovery
    return replace(
        discovery,
        model=model,
        after_mm=after,
        steps=(*discovery.steps, GapStep("a network for the rest", "", after)),
        stage=evaluate(held_out.p_M, model.predict(held_out.q, known=known_held)),
    )


def _network_for_the_rest(
    profile: Profile, model: ArmModel, learn: Readings, known: Circumstances, cancel: CancelToken
) -> ResidualNetwork | None:
    """A network for what the named effects leave, where it predicts readings it has not seen better than none."""
    if len(learn) < 2 * profile.network.folds:
        return None
    rest_M = learn.p_M - model.predict(learn.q, known=known)
    return train_network(
        learn.q,
        rest_M @ model.geometry.T_M_B()[:3, :3],
        seed=profile.seed,
        folds=profile.network.folds,
        iterations=profile.network.iterations,
        cancel=cancel,
    ).network


def _correction_mm(network: ResidualNetwork | None, q: Array) -> float:
    """Root mean square length of a network's corrections."""
    if network is None:
        return 0.0
    return float(np.sqrt(np.mean(np.sum(network.correct(q) ** 2, axis=1)))) * 1e3


def _rms_mm(model: ArmModel, held_out: Readings, known: Circumstances) -> float:
    return summarise(position_errors(held_out.p_M, model.predict(held_out.q, known=known))).rms


def _noise_floor_mm(readings: Readings) -> float:
    """Root mean square length of the stated noise; NaN where the readings state none."""
    sigma = stated_uncertainty(readings)
    return math.nan if sigma is None else rms_length_mm(sigma)


def _unseen(found: Search, named: set[str]) -> tuple[tuple[Mapping[str, Any], ...], tuple[Mapping[str, Any], ...]]:
    """What these data cannot show, and what they could have shown and did not, with the smallest size of each."""
    invisible: list[Mapping[str, Any]] = []
    absent: list[Mapping[str, Any]] = []
    context, seen, white = found.data.context, found.seen, found.first.white
    if found.fit.choice:
        left = [slug for slug in EFFECTS if slug not in named and slug != UNKNOWN]
        seen = Seen.of(found.data.candidates(found.fit, left), found.fit.follower)
        white = found.fit.white
    # whitened lengths in metres, by the mean weight of a coordinate
    noise_mm = 1e3 / math.sqrt(float(np.mean(np.einsum("aan->an", white) ** 2)))
    for slug, effect in EFFECTS.items():
        if slug in named or slug == UNKNOWN:
            continue
        if lacking := effect.untestable(context):
            invisible.append({"effect": slug, "reason": f"not testable: {lacking}", "smallest_seen": None})
            continue
        numbers = [i for i, candidate in enumerate(seen.candidates) if candidate.slug == slug]
        sizes: dict[str, dict[str, Any]] = {}
        share, smallest = 0.0, math.inf
        for number in numbers:
            candidate = seen.candidates[number]
            B, _ = seen.part(number)
            first = int(seen.first[number])
            fractions = seen.fraction[first : first + len(B)]
            share = max(share, float(fractions.max(initial=0.0)))
            from_size = smallest_seen(seen, number, found.least)
            lengths = np.linalg.norm(B, axis=1)
            for row, column in enumerate(candidate.columns):
                size = from_size[column.name]
                if not math.isfinite(size):
                    continue
                # whitened length per unit, in units of the mean noise: as millimetres at the SMR
                displaced = size * float(lengths[row]) / math.sqrt(B.shape[1])
                smallest = min(smallest, displaced)
                old = sizes.get(column.name)
                if (old is None or size < old["value"]) and len(sizes) < 40:
                    sizes[column.name] = {"value": size, "unit": column.unit}
        entry = {
            "effect": slug,
            "visible_share": share,
            "smallest_seen": sizes or None,
            "smallest_seen_rms_mm": None if not math.isfinite(smallest) else smallest * noise_mm * math.sqrt(3.0),
        }
        if share <= max(VISIBLE, _BARELY_VISIBLE):
            how_much = "all" if share <= VISIBLE else "nearly all"
            why = f"geometry can follow {how_much} of it under this plan"
            invisible.append({**entry, "reason": f"invisible: {why}"})
        else:
            absent.append({**entry, "reason": "not found; it could have been seen from these sizes on"})
    return tuple(invisible), tuple(absent)


def _judge(
    findings: Sequence[Finding], floor: float, after: float, held_out: Readings, spread: tuple[float, float] | None
) -> tuple[Verdict, str]:
    named = [finding for finding in findings if finding.term.slug != UNKNOWN]
    driven = [finding for finding in findings if finding.term.slug == UNKNOWN]
    names = " and ".join(EFFECTS[finding.term.slug].title for finding in named)
    described = "; ".join(finding.description.sentence for finding in driven if finding.description is not None)
    doubt = [finding for finding in named if any(not rival.told_apart for rival in finding.rivals)]
    if driven:
        also = f"{names}, and " if names else ""
        return "unknown effect", f"{also}something that the library does not have: {described}"
    if spread is None:
        left = "the readings state no uncertainty, so nothing can be said of what is left"
        if doubt:
            return "ambiguous", f"{names}, or {_others(doubt)}; {left}"
        return ("explained", f"{names}; {left}") if findings else ("nothing missing", f"nothing found; {left}")
    ratio, chance = spread
    # the held-out rms is itself a draw: a hundred stops scatter it by 4 %
    sampling = 1.0 + 2.5 / math.sqrt(6.0 * max(len(held_out), 1))
    at_floor = after <= floor * _FLOOR or chance > _CHANCE or (after <= floor * sampling and ratio < _FLOOR)
    gap = f"{after * 1e3:.0f} um rms held out against a noise floor of {floor * 1e3:.0f} um"
    if not at_floor and (findings or ratio > _UNSTRUCTURED):
        found = f"{names} found{' (or a look-alike)' if doubt else ''}, but " if findings else ""
        return "unknown effect", f"{found}more is missing than the library knows; {gap}"
    if not findings:
        if at_floor:
            return "nothing missing", gap
        return (
            "nothing missing",
            f"no effect found; readings scatter {ratio:.2f} times as stated but without structure in joints, time or"
            f" field: repeatability or noise, not something a model could follow; {gap}",
        )
    if doubt:
        return "ambiguous", f"{names}, or {_others(doubt)}: these data do not tell them apart; {gap}"
    return "explained", f"{names}; {gap}"


def _others(findings: Sequence[Finding]) -> str:
    slugs = dict.fromkeys(slug for finding in findings for slug in finding.answer_set[1:])
    return " or ".join(EFFECTS[slug].title for slug in slugs)
