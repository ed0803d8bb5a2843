"""A discovery in words: lines for a terminal, sentences for the page."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from itertools import pairwise

from cellapp.commands.discover.proposal_view import proposal_lines
from cellapp.commands.discover.tables import gap_steps, noise_floor, noise_floor_words, size_tables
from cellapp.commands.record import Request, View
from cellapp.commands.view.words import place_words, probability_words, ranges, short_reason
from cellapp.estimation.discovery.records import (
    AcceptedEffect,
    ArmDiscoveryResult,
    CurveRecord,
    CycleBand,
    DiscoverResult,
    EffectMeaning,
    Picture,
)

WIDTH = 80
"""Columns of a terminal."""
_TURN = 360.0
_UNEVEN = 2.0
"""Ratio of the largest to the smallest standard deviation of a curve from which both are named."""
_NOTICEABLE_MISFIT = 0.1
"""Displacement beside a law over that by it from which the law is called not quite as expected: below a tenth it is
hidden by the uncertainty of the masses alone."""
_NOT_IMPROBABLE = 0.05
"""Probability from which an effect that was not accepted is mentioned."""
_GAP_DEG = 10.0
"""The widest range of a joint without readings is named from here on: narrower ones are plain sampling."""


def view(result: DiscoverResult, request: Request | None = None) -> View:
    """What was found, the sizes of the effects, what they mean, and the stops that were proposed."""
    proposed = () if result.proposal is None else ("", *proposal_lines(result.proposal))
    return View((*discovery_lines(result), *size_tables(result), "", *meaning_lines(result), *proposed))


def verdict_sentence(name: str, arm: ArmDiscoveryResult) -> str:
    """The sentence of the verdict without the arm's name."""
    return arm.sentence.removeprefix(f"arm {name}: ")


# -- lines for a terminal ---------------------------------------------------------------------------------------------


def discovery_lines(result: DiscoverResult, width: int = WIDTH) -> list[str]:
    """Held-out error by step, accepted effects, alternatives, invisible effects and verdict of each arm."""
    lines: list[str] = []
    for name, arm in result.arms.items():
        lines += [f"Arm {name}", "  held-out rms [mm] after each step"]
        for what, gap in [*gap_steps(arm), (noise_floor_words(arm), noise_floor(arm))]:
            if gap is not None:
                lines += _hanging(f"  {gap:9.4f}  ", what, width)
        lines += _accepted_lines(arm.accepted, width)
        for found in arm.accepted:
            if found.indistinguishable:
                words = f"of {found.effect}: {' or '.join(found.indistinguishable)}: these data cannot distinguish them"
                lines += _hanging("  or instead   ", words, width)
        possible = also_possible(arm)
        if possible:
            lines += _hanging("  possible too ", possible, width)
        for place, entry in enumerate(arm.invisible):
            line = f"{entry.effect}: {short_reason(entry.reason)}"
            lines.append(_cut(f"  {'' if place else 'not visible':11}  {line}", width))
        for errors in arm.validate_.values():
            if (gauge := errors.gauge_mm) is not None:
                words = f"{gauge.mean:.4f} mm mean error, {gauge.max:.4f} largest, of {gauge.n} held out"
                lines += _hanging("  distances    ", words, width)
        if arm.structure is not None:
            lines += _hanging("  remainder    ", arm.structure.sentence, width)
        lines += _hanging("  verdict      ", f"{arm.verdict}: {verdict_sentence(name, arm)}", width)
        lines.append("")
    for note in result.notes or ():
        lines += _hanging("Note  ", note, width)
    return lines


def _accepted_lines(accepted: Sequence[AcceptedEffect], width: int) -> list[str]:
    """One line for each accepted effect; below it the cycles of a periodic error, or the description of a term."""
    if not accepted:
        return []
    lines = [f"  {'accepted':23} {'where':16} {'prob.':>6} {'corr. p':>8}  without -> with [mm]"]
    for found in accepted:
        gap = found.evidence.heldout_mm
        place, p = place_words(found.where), f"{found.evidence.corrected_p:.2g}"
        probable = probability_words(found.posterior)
        numbers = f"{probable:>6} {p:>8}  {gap.before:7.4f} -> {gap.after:.4f}"
        lines.append(_cut(f"  {found.effect:23} {place:16} {numbers}", width))
        cycles = cycle_words(found)
        if cycles:
            lines += _hanging("    cycles per turn  ", cycles, width)
        if found.description is not None:
            lines += _hanging("    ", found.description.sentence, width)
        misfit = misfit_words(found)
        if misfit:
            lines += _hanging("    ", misfit, width)
    return lines


def meaning_lines(result: DiscoverResult, width: int = WIDTH) -> list[str]:
    """Cause, usual size, what to check and what would settle it, of every accepted effect of every arm."""
    lines: list[str] = []
    for name, arm in result.arms.items():
        said: set[str] = set()
        for found in arm.accepted:
            if found.meaning is None:
                continue
            lines.append(_cut(f"Arm {name}, {place_words(found.where)}: {found.title}", width))
            again = found.effect in said and found.description is None
            lines += [f"  as {found.effect} above"] if again else _meaning_lines(found.effect, found.meaning, width)
            lines.append("")
            said.add(found.effect)
    return lines


def _meaning_lines(effect: str, meaning: EffectMeaning, width: int) -> list[str]:
    lines = _hanging("  cause    ", meaning.cause, width)
    lines += _hanging("  size     ", size_words(meaning), width)
    for heading, items in (("check", meaning.check), ("settle", meaning.settle)):
        for place, item in enumerate(items):
            lines += _hanging(f"  {'' if place else heading:9}- ", item, width)
    return [*lines, f"  more     cellapp docs {effect}"]


def remark_lines(result: DiscoverResult) -> list[str]:
    """What contradicts an effect, is possible too, hardly fits its law, or is left with structure: a line each."""
    lines = []
    for name, arm in result.arms.items():
        possible = also_possible(arm)
        others = [f"Not accepted, but possible: {possible}."] if possible else []
        sentences = (*contradiction_sentences(arm), *others, *misfit_sentences(arm), *structure_sentences(arm))
        lines += [f"Arm {name}: {sentence}" for sentence in sentences]
    return [*lines, ""] if lines else []


def explanation_text(result: DiscoverResult) -> str:
    """All that explains the tables of a discovery."""
    return "\n".join([*remark_lines(result), *meaning_lines(result)])


def size_words(meaning: EffectMeaning) -> str:
    """The usual size with how well it is known."""
    return meaning.size if meaning.size_source == "none" else f"{meaning.size} ({meaning.size_source})"


def misfit_words(found: AcceptedEffect) -> str:
    """What the effect moves beside its law; empty where it has no free part or hardly any in it."""
    if found.law_misfit is None or found.law_misfit < _NOTICEABLE_MISFIT:
        return ""
    return (
        f"law not quite as expected: what {found.effect} moves beside its law is {100.0 * found.law_misfit:.0f} %"
        " of what the law moves"
    )


def also_possible(arm: ArmDiscoveryResult) -> str:
    """Effects that were not accepted and are not improbable, the most probable first."""
    accepted = {found.effect for found in arm.accepted}
    others = [(slug, p) for slug, p in arm.candidates.items() if slug not in accepted and p >= _NOT_IMPROBABLE]
    return ", ".join(f"{slug} ({probability_words(p)})" for slug, p in sorted(others, key=lambda entry: -entry[1]))


def cycle_words(found: AcceptedEffect) -> str:
    """Dominant cycles per turn of a free curve, joint by joint; empty for any other law."""
    if found.law.name != "curve":
        return ""
    return ", ".join(
        f"joint {joint}: {_band(band)} ({band.rms_urad:.0f} urad rms)" for joint, band in (found.cycles or {}).items()
    )


def _band(band: CycleBand) -> str:
    return str(band.first) if band.first == band.last else f"{band.first}-{band.last}"


def _hanging(first: str, text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, initial_indent=first, subsequent_indent=" " * len(first)) or [first.rstrip()]


def _cut(line: str, width: int) -> str:
    return line if len(line) <= width else line[: width - 3].rstrip() + "..."


# -- sentences for the page -------------------------------------------------------------------------------------------


def rival_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """Effects that could replace an accepted one, and those that the data rule out."""
    sentences = []
    for found in arm.accepted:
        rivals = found.indistinguishable
        if rivals:
            sentences.append(
                f"{' or '.join(rivals)} would explain these data as well as {found.effect}: the data cannot"
                " distinguish them. The finding is the whole answer set."
            )
        if found.ruled_out:
            sentences.append(
                f"Nearly as good as {found.effect}, but ruled out by these data: {', '.join(found.ruled_out)}."
            )
    return sentences


def contradiction_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """What behaves like an effect with an impossible sign or size."""
    return [f"Something {found.sentence}." for found in arm.contradictions]


def misfit_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """Accepted effects whose law is not quite as expected."""
    words = [misfit_words(found) for found in arm.accepted]
    return [f"{text[0].upper()}{text[1:]}." for text in words if text]


def structure_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """Whether what is left shows structure; empty where it was not tested."""
    if arm.structure is None:
        return []
    sentence = arm.structure.sentence
    return [f"{sentence[0].upper()}{sentence[1:]}."]


def undrawn_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """Joints of an accepted effect that have no figure."""
    sentences = []
    for found in arm.accepted:
        labels = {picture.y_label for picture in arm.pictures if picture.effect == found.effect}
        missing = [joint for joint in found.where.joints if f"offset of joint {joint} [urad]" not in labels]
        if missing:
            joints = f"joints {ranges(missing)}" if len(missing) > 1 else f"joint {missing[0]}"
            sentences.append(
                f"There is no figure of {found.effect} for {joints}: the SMR hardly moves with"
                f" {'these joints' if len(missing) > 1 else 'this joint'}."
            )
    return sentences


def remainder_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """What the effects leave, what a residual network finds in it, and the predicted uncertainty."""
    return [
        *structure_sentences(arm),
        *_scatter_sentences(arm),
        *_network_sentences(arm),
        *_uncertainty_sentences(arm),
    ]


def _scatter_sentences(arm: ArmDiscoveryResult) -> list[str]:
    if arm.scatter is None or arm.omnibus_p is None:
        return []
    p = "below 0.001" if arm.omnibus_p < 0.001 else f"{arm.omnibus_p:.2g}"
    return [
        f"The remaining scatter is {arm.scatter:.2f} times the stated uncertainty. If nothing were missing, the"
        f" probability of this much remaining structure is {p}."
    ]


def _network_sentences(arm: ArmDiscoveryResult) -> list[str]:
    if arm.network_mm is None:
        return []
    before, after = arm.network_mm.before, arm.network_mm.after
    if before == after == 0.0:
        return ["A residual network finds nothing to correct, neither before the effects nor after them."]
    if not arm.accepted:
        return [f"A residual network corrects {before:.4f} mm rms of what the geometry leaves."]
    remainder = "finds nothing" if after == 0.0 else f"corrects {after:.4f} mm rms"
    return [
        f"A residual network trained on what the geometry leaves corrects {before:.4f} mm rms; trained on what the"
        f" effects leave, it {remainder}."
    ]


def _uncertainty_sentences(arm: ArmDiscoveryResult) -> list[str]:
    predicted = arm.uncertainty_mm
    if predicted is None:
        return []
    return [
        f"Predicted standard deviation of a coordinate at held-out configurations: median {predicted.median:.4f} mm,"
        f" at most {predicted.largest:.4f} mm. It grows where a joint range has no training data."
    ]


def description_sentences(arm: ArmDiscoveryResult) -> list[tuple[str, str]]:
    """Heading and description of each data-driven term."""
    impossible = {contradiction.sentence for contradiction in arm.contradictions}
    descriptions = [
        found.description
        for found in arm.accepted
        if found.description is not None and found.description.sentence not in impossible
    ]
    sentences = []
    for term in descriptions:
        variables = " and ".join(term.variables)
        words = (
            f"The term acts in the channel '{term.channel}', depends on {variables}, and moves the SMR by"
            f" {term.size_um:.0f} µm rms beyond what the geometry can absorb."
        )
        if term.formula:
            gain = term.gain_over_curve
            words += f" A short formula fits as well as the curve: {term.formula}"
            words += "." if gain is None else f" (score {gain:+.1f} against the curve's)."
        else:
            words += " No short formula fits as well as the curve."
        sentences.append((f"Effect without a name: {term.channel}, {variables}", words))
    return sentences


def picture_words(picture: Picture) -> str:
    """Size, scatter, and for a curve over a whole turn its uncertainty and gaps in the data."""
    return " ".join([size_sentence(picture), *_certainty_sentences(picture), *gap_sentences(picture)])


def size_sentence(picture: Picture) -> str:
    """Size of an effect and scatter about it."""
    remaining = _rms([m - c for m, c in zip(picture.measured, picture.computed, strict=True)])
    unit = _unit(picture)
    return (
        f"The effect is {_rms(picture.computed):.0f} {unit} rms at these readings, which scatter"
        f" {remaining:.0f} {unit} rms about it."
    )


def _certainty_sentences(picture: Picture) -> list[str]:
    """Where a curve over a whole turn is most and least certain, if that differs."""
    curve, unit = picture.curve, _unit(picture)
    if curve is None or not _is_whole_turn(curve):
        return []
    points = list(zip(curve.band, curve.x, strict=True))
    (low, best), (high, worst) = (pick(points, key=lambda point: point[0]) for pick in (min, max))
    if high < _UNEVEN * low:
        return []
    return [
        f"The curve is most certain at {best:.0f}° (standard deviation {low:.0f} {unit}) and least certain at"
        f" {worst:.0f}° ({high:.0f} {unit})."
    ]


def gap_sentences(picture: Picture) -> list[str]:
    """The widest range without a reading of a curve over a whole turn."""
    if picture.curve is None or not _is_whole_turn(picture.curve):
        return []
    begin, end = _largest_gap(picture.x)
    if end - begin < _GAP_DEG:
        return []
    return [f"No reading was taken from {begin:.0f}° to {(end + 180.0) % 360.0 - 180.0:.0f}°."]


def _unit(picture: Picture) -> str:
    return "µrad" if picture.y_label.endswith("[urad]") else "µm"


def _is_whole_turn(curve: CurveRecord) -> bool:
    return curve.x[-1] - curve.x[0] == _TURN


def _largest_gap(angles: Sequence[float]) -> tuple[float, float]:
    """Ends [deg] of the widest range of a turn without a value; the second may be beyond 180."""
    around = [*angles, angles[0] + 360.0]
    return max(pairwise(around), key=lambda pair: pair[1] - pair[0])


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / max(len(values), 1))
