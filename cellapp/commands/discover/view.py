"""The result of ``discover`` as lines, tables and charts."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from cellapp.commands.discover.charts import candidates_chart, gap_chart, picture_chart
from cellapp.commands.discover.proposal_view import proposal_lines
from cellapp.commands.discover.tables import gap_steps, noise_floor, noise_floor_words, size_tables
from cellapp.commands.discover.words import (
    also_possible,
    contradiction_sentences,
    cycle_words,
    misfit_sentences,
    misfit_words,
    size_words,
    structure_sentences,
    verdict_sentence,
)
from cellapp.commands.record import Request, View
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Part
from cellapp.commands.view.words import place_words, probability_words, short_reason
from cellapp.estimation.discovery.records import AcceptedEffect, DiscoverResult, EffectMeaning

WIDTH = 80
"""Columns of a terminal."""


def view(result: DiscoverResult, request: Request | None = None) -> View:
    """What was found, the sizes of the effects, what they mean, and the stops that were proposed."""
    proposed = () if result.proposal is None else ("", *proposal_lines(result.proposal))
    told: tuple[Part, ...] = (*discovery_lines(result), *size_tables(result), "", *meaning_lines(result), *proposed)
    return View((*told, *_charts(result)))


def _charts(result: DiscoverResult) -> Iterator[Chart]:
    """How the error fell, what is probable, and what each effect looks like, arm by arm."""
    for name, arm in result.arms.items():
        yield gap_chart(name, arm)
        yield candidates_chart(name, arm)
        yield from (picture_chart(name, picture) for picture in arm.pictures)


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
            lines += _hanging("    cycles/revolution  ", cycles, width)
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


def _hanging(first: str, text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, initial_indent=first, subsequent_indent=" " * len(first)) or [first.rstrip()]


def _cut(line: str, width: int) -> str:
    return line if len(line) <= width else line[: width - 3].rstrip() + "..."
