"""The result of ``discover``: a section for each arm; on the page of a run also how discovery decides.

Charts of a discovery: held-out error step by step, pictures of effects.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from cellapp.commands.discover.tables import (
    accepted_table,
    candidates_table,
    cycle_table,
    evidence_table,
    gap_steps,
    invisible_table,
    noise_floor,
    noise_floor_words,
    not_found_table,
    numbered_steps_table,
    size_tables,
)
from cellapp.commands.discover.words import (
    ahead_sentences,
    also_possible,
    alternative_sentences,
    description_sentences,
    misfit_sentences,
    orientation_sentences,
    remainder_sentences,
    size_sentence,
    size_words,
    verdict_sentence,
)
from cellapp.commands.record import Request, View
from cellapp.commands.view.charts import Axis, Chart, drawable_mm, noise_limit, series
from cellapp.commands.view.parts import Facts, Part, Section, section_of, sentence
from cellapp.commands.view.table import table_of, with_rows
from cellapp.commands.view.words import law_words, place_words, ranges, short_reason
from cellapp.estimation.discovery.records import ArmDiscoveryResult, DiscoverResult, Picture, Proposal, ProposalQuestion
from cellapp.ground.counting import mm
from cellapp.ground.profile.schema import DiscoverySettings
from cellapp.robot.kinematics.transforms import Array

_MOST_PICTURES = 6
"""Most pictures of an arm's effects, for the joints that move most; the JSON has all values."""


def view(result: DiscoverResult, request: Request | None = None) -> View:
    """Show the effects found in each arm and their meaning, notes, and proposed stops."""
    return View((*found_parts(result), *([] if result.proposal is None else proposal_parts(result.proposal))))


def found_parts(result: DiscoverResult) -> list[Part]:
    """Show a section for each arm, then notes."""
    return [*_arm_sections(result), *(f"Note: {note}" for note in result.notes or ())]


def _arm_sections(result: DiscoverResult) -> list[Section]:
    return [arm_section(f"discovery-{number}", *one) for number, one in enumerate(result.arms.items(), start=1)]


def discovery_section(discover: DiscoverResult, settings: DiscoverySettings) -> Section:
    """Show all arms, and how discovery decides."""
    verdicts = (f"arm {name}, {arm.verdict}: {verdict_sentence(name, arm)}" for name, arm in discover.arms.items())
    decides = Section([_decision_words(settings)], folded=True, title="How discovery decides")
    return section_of([*_arm_sections(discover), decides], message="; ".join(verdicts))


def arm_section(key: str, name: str, arm: ArmDiscoveryResult) -> Section:
    """Show one arm: verdict, accepted effects, steps, pictures, undetectable effects, and the remainder."""
    found = with_rows(
        accepted_table(name, arm), numbered_steps_table(name, arm), *size_tables(name, arm), cycle_table(name, arm)
    )
    parts: list[Part] = [
        *_remarks(arm),
        *remainder_sentences(arm),
        gap_chart(name, arm),
        *found,
        *_meanings(arm),
        *(Section([words], title=heading) for heading, words in description_sentences(arm)),
        *_pictures(name, arm),
    ]
    evidence = with_rows(candidates_table(name, arm), evidence_table(name, arm))
    undetected = with_rows(invisible_table(name, arm), not_found_table(name, arm))
    parts.append(Section(evidence, folded=True, title="All evidence"))
    title = "Effects that were not found, or that these data cannot show"
    parts.append(Section(undetected, folded=True, title=title))
    return Section(parts, message=sentence(verdict_sentence(name, arm)), key=key, title=f"Arm {name}: {arm.verdict}")


def _motion_sentences(arm: ArmDiscoveryResult) -> list[str]:
    """Say what recordings of motion show, what only they can show, and which effects commands do not use."""
    if arm.motion is None:
        return []
    said = []
    for one in arm.motion.effects:
        place = f"joint{'s' if len(one.joints) > 1 else ''} {ranges(one.joints)}"
        only = f"; only motion can: {one.only_motion}" if one.only_motion else ""
        law = f", {law_words(one.effect, one.law, one.joints)}" if one.law is not None and one.law.constants else ""
        aside = "" if one.at_rest else "; it stays out of commands for poses at rest"
        said.append(f"Recordings of motion show {one.effect} ({one.title}) of {place}{law}{only}{aside}.")
    return said or ["Recordings of motion show no effect of the joints."]


def _remarks(arm: ArmDiscoveryResult) -> list[str]:
    """Say what could replace or is possible beside an effect, fits its law badly, or cannot be shown."""
    possible = also_possible(arm)
    hidden = [f"{one.effect} ({short_reason(one.reason)})" for one in arm.invisible]
    return [
        *orientation_sentences(arm),
        *_motion_sentences(arm),
        *alternative_sentences(arm),
        *([f"Not accepted, but possible: {possible}."] if possible else []),
        *misfit_sentences(arm),
        *ahead_sentences(arm),
        *([f"Not visible in these data: {', '.join(hidden)}."] if hidden else []),
    ]


def _meanings(arm: ArmDiscoveryResult) -> Iterator[Section]:
    """Yield cause, usual size, checks, and deciding measurement of every accepted effect."""
    for found in arm.accepted:
        meaning = found.meaning
        if meaning is None:
            continue
        rows: list[tuple[str, str]] = []
        for title, lines in (
            ("Check or mend", meaning.check),
            ("Further stops or observations that settle it", meaning.settle),
            ("More", (f"'cellapp docs {found.effect}'",)),
        ):
            rows += [(title if place == 0 else "", line) for place, line in enumerate(lines)]
        words = f"{meaning.cause} Usual size: {size_words(meaning)}."
        yield Section([words, Facts(tuple(rows))], title=f"What it means: {found.title}, {place_words(found.where)}")


def _pictures(name: str, arm: ArmDiscoveryResult) -> Iterator[Section]:
    shown, others = arm.pictures[:_MOST_PICTURES], [picture.title for picture in arm.pictures[_MOST_PICTURES:]]
    drawn = [picture_chart(name, picture) for picture in shown]
    if drawn:
        more = f" Smaller ones are in the JSON: {'; '.join(dict.fromkeys(others))}." if others else ""
        about = (
            "Dots are measured values of one effect, with all other parts of the model subtracted, at the readings that"
            f" the search used.{more}"
        )
        yield Section(drawn, about=about, title="What the effects look like")


def _decision_words(settings: DiscoverySettings) -> str:
    return (
        "Physical effects that the geometry cannot explain, in the order in which they were found, evaluated on"
        " configurations that the search did not use. The score of an effect is what it explains beside the re-fitted"
        " geometry and all other effects, minus a penalty for its parameters. The corrected p-value is the probability"
        " of such a score anywhere in the scan if nothing were missing: an effect is accepted below"
        f" {settings.false_alarm}. With {settings.null_simulations} simulations without effects, p is at least"
        f" {1.0 / (settings.null_simulations + 1):.2g}. The probability of an effect compares all sets of effects that"
        " were tried; beside its law, relative to what the law moves, is what follows its variables otherwise than the"
        " law says. 'cellapp docs NAME' explains each effect, 'cellapp docs discovery' how discovery decides."
    )


# -- Proposed stops in words: which questions they answer, their gain, and how to go on -------------------------------


_HIDDEN = 0.01
"""If the present discrimination is below this share of the proposed one, the data show nothing of the effect yet."""


def proposal_parts(proposal: Proposal) -> list[Part]:
    """Show the questions with their discriminations, advice and next steps.

    A discrimination is a non-centrality lambda: now, with the proposed stops, with as many random stops of the same
    candidates; then the gain of proposed over random stops, and the value that a clear answer needs.
    """
    table = table_of(
        f"Discrimination by {proposal.count} proposed stops",
        [(name, question) for name, questions in proposal.arms.items() for question in questions],
        ("arm", lambda row: row[0]),
        ("effect", lambda row: row[1].effect),
        ("against", lambda row: row[1].against or "nothing"),
        ("now", lambda row: row[1].discrimination.now, ".1f"),
        ("proposed", lambda row: row[1].discrimination.proposed, ".1f"),
        ("random", lambda row: row[1].discrimination.random, ".1f"),
        ("gain", lambda row: row[1].gain_over_random, ".1f"),
        ("needed", lambda row: row[1].needed, ".1f"),
        ("these stops", lambda row: _outcome(row[1])),
    )
    said = [*proposal.advice, *proposal.notes]
    if proposal.written and proposal.first_configuration is not None:
        first = proposal.first_configuration + 1
        said.append(
            f"the plan now has stops {first} to {first + proposal.count - 1} too: collect with --resume, then calibrate"
            " and discover again"
        )
    return [table, *said]


def _outcome(question: ProposalQuestion) -> str:
    now, proposed = question.discrimination.now, question.discrimination.proposed
    if question.against is None:
        if now < _HIDDEN * proposed:
            return "would show it: it is not visible so far"
        # the visible size scales with the inverse square root of the non-centrality
        share = math.sqrt(now / max(proposed, 1e-12))
        return f"would lower the smallest visible size to {100.0 * share:.0f} %"
    if now >= question.needed:
        return "would make it more certain: they are distinguished already"
    return "would distinguish them" if proposed >= question.needed else "would not suffice"


_SMOOTH = 0.02
"""Points farther off the line between their neighbours, as a share of the range, are drawn as a cloud, not a line."""
_BAND_SIGMAS = 2.0
"""Half width of a drawn band in standard deviations."""


def gap_chart(name: str, arm: ArmDiscoveryResult) -> Chart:
    """Show the held-out error before the search and after each step, with the noise floor."""
    steps, floor = gap_steps(arm), noise_floor(arm)
    gaps = drawable_mm([gap for _, gap in steps])
    drawn = series("held-out rms", np.arange(float(len(gaps))), gaps)
    limits = noise_limit(floor, name=noise_floor_words(arm))
    axis = Axis("held-out rms", "mm", logarithmic=True)
    message = _gap_message(arm, floor)
    return Chart(f"Arm {name}: error after each step", Axis("step"), axis, (drawn,), message, limits)


def _gap_message(arm: ArmDiscoveryResult, floor_mm: float | None) -> str:
    before, after = arm.heldout_mm.before, arm.heldout_mm.after
    floor = "" if floor_mm is None else f" The {noise_floor_words(arm)} is {mm(floor_mm)}."
    if not arm.accepted:
        return f"Held-out error is {mm(after)}; the search added no effect.{floor}"
    if after >= before:
        return f"Held-out error did not fall: {mm(before)} before, {mm(after)} after.{floor}"
    share, effect = _largest_step(arm)
    cause = f"; {effect.replace('_', ' ')} explains {'most' if share > 0.5 else f'{share:.0%}'} of it" if effect else ""
    return f"Held-out error fell from {mm(before)} to {mm(after)}{cause}.{floor}"


def _largest_step(arm: ArmDiscoveryResult) -> tuple[float, str]:
    """Return the largest share of the squared error that one effect removed, and the effect; empty if none is named."""
    total = arm.heldout_mm.before**2 - arm.heldout_mm.after**2
    taken: dict[str, float] = {}
    for before, step in zip(arm.steps, arm.steps[1:], strict=False):
        if step.effect:
            taken[step.effect] = taken.get(step.effect, 0.0) + before.heldout_mm**2 - step.heldout_mm**2
    return max(((gain / total, effect) for effect, gain in taken.items()), default=(0.0, ""))


def picture_chart(name: str, picture: Picture) -> Chart:
    """Show measured points of one effect and the model: a curve with a band of two sigma, or points."""
    shown = picture if picture.curve is None else picture.curve
    computed = picture.computed if picture.curve is None else picture.curve.value
    line = is_line(picture)
    band = _BAND_SIGMAS * np.array(shown.band) if line and shown.band else None
    drawn = (
        series("measured", picture.x, picture.measured, "points"),
        series("computed", shown.x, computed, "line" if line else "points", band=band, style=1),
    )
    x, y = _axis(picture.x_label), _axis(picture.y_label)
    values = np.concatenate([picture.measured, computed])
    shown_range = typical_range(values, np.array(picture.computed)) if len(values) else None
    title, message = f"Arm {name}: {picture_title(picture)}", size_sentence(picture)
    return Chart(title, x, y, drawn, message, y_range=shown_range, by_stage=True)


def is_line(picture: Picture) -> bool:
    """Return whether the computed values are a function of x, drawn as a line, and not a cloud."""
    if picture.curve is not None or len(picture.x) < 3:
        return picture.curve is not None
    x, y = np.array(picture.x), np.array(picture.computed)
    share = np.diff(x)[:-1] / np.maximum(x[2:] - x[:-2], 1e-12)
    between = y[:-2] + share * (y[2:] - y[:-2])
    return float(np.median(np.abs(y[1:-1] - between))) <= _SMOOTH * float(np.ptp(y)) + 1e-12


def picture_title(picture: Picture) -> str:
    """Return the title with the variable of the x axis, unless it is named already."""
    variable = picture.x_label.partition(" [")[0]
    if picture.title.endswith(variable) or picture.curve is not None:
        return picture.title
    names = ("joint ", "time", "azimuth", "elevation", "incidence")
    return f"{picture.title}, against {variable if variable.startswith(names) else f'the {variable}'}"


def typical_range(values: Array, always: Array) -> tuple[float, float]:
    """Return limits that leave out the farthest 1 % of ``values`` on either side, but contain all of ``always``."""
    low, high = np.quantile(values, (0.01, 0.99))
    low, high = min(float(low), float(always.min())), max(float(high), float(always.max()))
    room = 0.08 * (high - low) or 1.0
    return low - room, high + room


def with_micro_sign(label: str) -> str:
    """Return a label with the page's units: ``[µrad]`` for ``[urad]``."""
    return label.replace("[urad]", "[µrad]").replace("[um]", "[µm]")


def _axis(label: str) -> Axis:
    words, _, unit = with_micro_sign(label).partition(" [")
    return Axis(words, unit.removesuffix("]"))
