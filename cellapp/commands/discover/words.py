"""A discovery in words: what was found, its alternatives, what remains."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from cellapp.commands.view.words import probability_words, ranges
from cellapp.estimation.discovery.records import AcceptedEffect, ArmDiscoveryResult, Picture
from cellapp.estimation.discovery.verdict import unnamed_words
from cellapp.robot.effects.effect import Meaning

_PLAY = re.compile(r"half_play(\d+)")
_SURELY = 2.0
"""Standard errors below zero from which half play is called negative."""
_NOTICEABLE_MISFIT = 0.1
"""Ratio of the displacement beside a law to that by the law, from which the law counts as not quite as expected: below
a tenth it is hidden by the uncertainty of the masses alone."""
_NOT_IMPROBABLE = 0.05
"""Probability from which an effect that was not accepted is mentioned."""


def verdict_sentence(name: str, arm: ArmDiscoveryResult) -> str:
    """Return the verdict's sentence without the arm's name."""
    return arm.sentence.removeprefix(f"arm {name}: ")


def orientation_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """State held-out orientation errors before and after; none if no orientation was measured."""
    errors = arm.heldout_orientation_mrad
    if errors is None:
        return []
    scatter = "" if arm.noise_mrad is None else f"; a component scatters by {arm.noise_mrad:.3f} mrad about the model"
    return [
        f"Held-out orientations: mean {errors.before.mean:.3f} mrad with geometry alone, {errors.after.mean:.3f} mrad"
        f" with what was found{scatter}."
    ]


def size_words(meaning: Meaning) -> str:
    """Return the usual size of an effect and how well it is known."""
    return meaning.size if meaning.size_source == "none" else f"{meaning.size} ({meaning.size_source})"


def misfit_words(found: AcceptedEffect) -> str:
    """State the displacement beside the effect's law; empty if it has no discrepancy term or hardly any displacement in
    it."""
    if found.law_misfit is None or found.law_misfit < _NOTICEABLE_MISFIT:
        return ""
    return (
        f"law not quite as expected: what {found.effect} moves beside its law is {100.0 * found.law_misfit:.0f} %"
        " of what the law moves"
    )


def also_possible(arm: ArmDiscoveryResult) -> str:
    """List effects that were not accepted, are visible and not improbable, the most probable first."""
    settled = {found.effect for found in arm.accepted} | {one.effect for one in arm.invisible}
    others = [(slug, p) for slug, p in arm.candidates.items() if slug not in settled and p >= _NOT_IMPROBABLE]
    return ", ".join(f"{slug} ({probability_words(p)})" for slug, p in sorted(others, key=lambda entry: -entry[1]))


def alternative_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """State effects that could replace an accepted one, and those that the data rule out."""
    sentences = []
    for found in arm.accepted:
        confounded = found.indistinguishable
        if confounded:
            sentences.append(
                f"{' or '.join(confounded)} would explain these data as well as {found.effect}: the data cannot"
                " distinguish them. One of these alternatives is there."
            )
        if found.ruled_out:
            sentences.append(
                f"Nearly as good as {found.effect}, but ruled out by these data: {', '.join(found.ruled_out)}."
            )
    return sentences


def misfit_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """State the accepted effects whose law is not quite as expected."""
    words = [misfit_words(found) for found in arm.accepted]
    return [f"{text[0].upper()}{text[1:]}." for text in words if text]


def ahead_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """State what a half play below zero means, of joints where it is surely so."""
    plays = [(_PLAY.fullmatch(name), play) for found in arm.accepted for name, play in found.parameters.items()]
    joints = {int(name[1]) for name, play in plays if name and play.value < -_SURELY * (play.standard_error or 0.0)}
    words = (
        f"Half play is negative at joint{'s' if len(joints) > 1 else ''} {ranges([*joints])}: the arm rests ahead of"
    )
    then = (
        "its last motion, not behind it. That is no lag of a gear: it overshoots, or rows stand in another order than"
    )
    return [f"{words} {then} the motions."] if joints else []


def structure_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """Say whether the final residuals show structure; empty if that was not tested."""
    if arm.structure is None:
        return []
    sentence = arm.structure.sentence
    return [f"{sentence[0].upper()}{sentence[1:]}."]


def remainder_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """State what remains unexplained, and the predicted uncertainty."""
    return [*_unnamed_sentences(arm), *structure_sentences(arm), *_scatter_sentences(arm), *_uncertainty_sentences(arm)]


def _unnamed_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """State what the unnamed term looks like and what it is worth; empty if none is in force."""
    found = arm.unnamed
    if found is None or not found.in_force:
        return []
    settle = " and ".join(f"'cellapp docs {cause}'" for cause in found.causes if cause != "unknown")
    said = [f"What it looks like, and what would settle it: {settle}."] if settle else []
    if found.left_out_mm is not None:
        worth = f"Readings left out of the fit: mean {found.left_out_mm.before:.4f} mm without it"
        said.append(f"{worth}, {found.left_out_mm.after:.4f} mm with it.")
    return [" ".join([f"{unnamed_words(found).capitalize()}.", *said])]


def _scatter_sentences(arm: ArmDiscoveryResult) -> list[str]:
    if arm.scatter is None or arm.omnibus_p is None:
        return []
    p = "below 0.001" if arm.omnibus_p < 0.001 else f"{arm.omnibus_p:.2g}"
    against = "the stated uncertainty" if arm.claim is None else "the estimated noise"
    return [
        f"The remaining scatter is {arm.scatter:.2f} times {against}. If nothing were missing, the"
        f" probability of this much remaining structure is {p}."
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
    """Return a heading and a description of each data-driven term; of impossible values the verdict says enough."""
    descriptions = [
        found.description
        for found in arm.accepted
        if found.description is not None and not found.law.name.startswith("contradiction|")
    ]
    sentences = []
    for term in descriptions:
        variables = " and ".join(term.variables)
        words = (
            f"The term acts on '{term.channel}', depends on {variables}, and moves the SMR by"
            f" {term.size_um:.0f} µm rms beyond what the geometry can absorb."
        )
        if term.formula:
            words += f" A short formula fits as well as the curve: {term.formula}."
        else:
            words += " No short formula fits as well as the curve."
        sentences.append((f"Effect without a name: {term.channel}, {variables}", words))
    return sentences


def size_sentence(picture: Picture) -> str:
    """State the size of an effect and the scatter about it."""
    remaining = _rms([m - c for m, c in zip(picture.measured, picture.computed, strict=True)])
    unit = _unit(picture)
    return (
        f"The effect is {_rms(picture.computed):.0f} {unit} rms at these readings, which scatter"
        f" {remaining:.0f} {unit} rms about it."
    )


def _unit(picture: Picture) -> str:
    return "µrad" if picture.y_label.endswith("[urad]") else "µm"


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / max(len(values), 1))
