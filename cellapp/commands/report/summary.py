"""First screen of the page: verdict, before and after, findings, next steps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import date

from cellapp.cell.run import RunFile
from cellapp.commands.certificate.judgements import judge_run
from cellapp.commands.discover.words import verdict_sentence
from cellapp.commands.next_step import Step, open_steps
from cellapp.commands.report.before_after import BeforeAfterFigure, before_after_figure
from cellapp.commands.report.data import ReportData, read_report_data
from cellapp.commands.run_results import read_results
from cellapp.commands.stages import HERE
from cellapp.commands.view.charts import mm
from cellapp.commands.view.table import Table
from cellapp.commands.view.words import (
    CHARACTERISTIC_WORDS,
    RULE_WORDS,
    VERDICT_TITLES,
    Verdict,
    judgement_table,
    place_words,
    verdict_of,
)
from cellapp.estimation.discovery.records import AcceptedEffect, ArmDiscoveryResult
from cellapp.estimation.uncertainty.records import Conformity, Judgement, overall
from cellapp.ground.errors import InputError
from cellapp.ground.results import CALIBRATE, CHECK, DISCOVER
from cellapp.ground.times import day_of

# -- Errors against their tolerances, as shown on the page's first screen ---------------------------------------------


@dataclass
class JudgedRow:
    """One characteristic: judgements by arm, or one of several arms together without a column of its own."""

    label: str
    tolerance: float
    by_arm: dict[str, Judgement] = field(default_factory=dict)
    together: Judgement | None = None


@dataclass(frozen=True)
class JudgedMatrix:
    """Characteristics in rows, arms in columns."""

    arms: tuple[str, ...]
    rows: tuple[JudgedRow, ...]


def judged_matrix(judgements: Sequence[Judgement], arms: Sequence[str]) -> JudgedMatrix:
    """Arrange judgements in a matrix: those of one characteristic by one tolerance form a row."""
    rows: list[JudgedRow] = []
    for one in judgements:
        label = CHARACTERISTIC_WORDS[one.characteristic]
        if one.where not in arms:
            more = "" if one.characteristic == "cooperative" and len(arms) == 2 else f", {one.where}"
            rows.append(JudgedRow(label + more, one.tolerance, together=one))
            continue
        free = (
            row
            for row in rows
            if (row.label, row.tolerance, row.together) == (label, one.tolerance, None) and one.where not in row.by_arm
        )
        row = next(free, None)
        if row is None:
            row = JudgedRow(label, one.tolerance)
            rows.append(row)
        row.by_arm[one.where] = one
    shown = tuple(arm for arm in arms if any(arm in row.by_arm for row in rows))
    return JudgedMatrix(shown, tuple(rows))


@dataclass(frozen=True)
class Found:
    """One finding: an effect and its place, its meaning in plain words; ``anchor`` links to the details."""

    heading: str
    text: str
    anchor: str


@dataclass(frozen=True)
class Summary:
    """The first screen; ``figure`` is None if no error before and after is known."""

    verdict: Verdict
    judged: JudgedMatrix
    figure: BeforeAfterFigure | None
    found: tuple[Found, ...]
    steps: tuple[Step, ...]


def summary(data: ReportData, judgements: Sequence[Judgement], today: date) -> Summary:
    """Build the first screen of a run with the judgements on its results; instruments are due as of ``today``."""
    return Summary(
        verdict=verdict(data, judgements),
        judged=judged_matrix(judgements, list(data.profile.arms)),
        figure=before_after_figure(data),
        found=tuple(_found(data)),
        steps=tuple(_steps(data, judgements, today)),
    )


def verdict(data: ReportData, judgements: Sequence[Judgement]) -> Verdict:
    """Summarize all judgements in a title and a sentence, or say how to give tolerances."""
    if CALIBRATE in data.out_of_date:
        return Verdict(
            "cannot say", VERDICT_TITLES["cannot say"], "The calibration is out of date: nothing is judged on it."
        )
    if not data.profile.tolerances.any_given:
        return Verdict(
            None,
            "Not judged: the profile has no tolerances",
            "Give the largest permissible errors in the profile's section 'tolerances', as position: \"0.1 mm\".",
        )
    return verdict_of(judgements)


def header_facts(data: ReportData) -> list[str]:
    """Say what was calibrated, with what, and when."""
    traced = data.profile.traceability
    facts = []
    for name, arm in data.profile.arms.items():
        serial = traced.arms[name].serial if name in traced.arms else ""
        facts.append(f"arm {name}: {arm.type.model}{f', serial {serial}' if serial else ''}")
    tracker = " ".join(filter(None, (traced.tracker.model, traced.tracker.serial)))
    facts += [f"tracker: {tracker}"] if tracker else []
    return [*facts, f"calibrated {day_of(data.calibrate.provenance.written)}"]


# -- what was found ---------------------------------------------------------------------------------------------------


def nothing_found(data: ReportData) -> str:
    """Say why no effect is named if there is no discovery that holds."""
    if DISCOVER in data.out_of_date:
        return "The search for missing effects is out of date."
    return "Missing effects were not searched for yet."


def _found(data: ReportData) -> Iterator[Found]:
    for number, (name, arm) in enumerate(({} if data.discover is None else data.discover.arms).items(), start=1):
        anchor = f"discovery-{number}"
        for effect in arm.accepted:
            yield Found(f"Arm {name}: {effect.title}, {place_words(effect.where)}", _effect_words(effect), anchor)
        if not arm.accepted or arm.verdict in ("unknown effect", "ambiguous"):
            yield Found(f"Arm {name}: {arm.verdict}", _capitalised(verdict_sentence(name, arm)) + ".", anchor)


def _effect_words(effect: AcceptedEffect) -> str:
    gap = effect.evidence.heldout_mm
    known = math.isfinite(gap.before)  # else the fit without it did not converge
    error = f"In the model it takes the held-out error from {mm(gap.before)} to {mm(gap.after)} rms." if known else ""
    return error if effect.meaning is None else f"{_first_sentence(effect.meaning.cause)} {error}".rstrip()


# -- what to do next --------------------------------------------------------------------------------------------------


def _steps(data: ReportData, judgements: Sequence[Judgement], today: date) -> Iterator[Step]:
    if data.next_step:
        yield Step(_next_words(data), data.next_step)
    here = data.results.model_copy(update={"run": str(HERE)})  # the page is the same wherever it lies
    steps = open_steps(data.profile, here, judgements)
    yield from (one for one in steps if not one.command or one.command != data.next_step)
    for name, arm in ({} if data.discover is None else data.discover.arms).items():
        yield from _effect_steps(name, arm)
    due = data.profile.traceability.tracker.due
    if due is not None and due < today:
        yield Step(f"Have the tracker calibrated: it was due on {due}.")
    driven = any(arm.driver.has_device for arm in data.profile.arms.values())
    if driven and data.results.check is None and CHECK not in data.out_of_date:
        yield Step("After each collision, repair or move, and at regular intervals:", f"cellapp check {HERE}")


def _next_words(data: ReportData) -> str:
    if " collect " in data.next_step:
        return "Measure the planned stops that are left, then calibrate and discover again:"
    return "Repeat what is out of date:" if data.out_of_date else "Go on with:"


def _effect_steps(name: str, arm: ArmDiscoveryResult) -> Iterator[Step]:
    for effect in arm.accepted:
        if effect.meaning is not None and effect.meaning.check:
            yield Step(f"Arm {name}, {place_words(effect.where)}: {_first_sentence(effect.meaning.check[0])}")


def _first_sentence(text: str) -> str:
    """Return a text up to the end of its first sentence."""
    first, stop, _ = text.partition(". ")
    return first + stop.rstrip()


def _capitalised(text: str) -> str:
    return text[:1].upper() + text[1:]


# -- The verdict on a run as a table and sentences: judgements, what is out of date, what comes next ------------------


@dataclass(frozen=True)
class RunVerdict:
    """The judgements on a run with a title and a sentence, and next steps; ``state`` is None if nothing is judged."""

    state: Conformity | None
    title: str
    sentence: str
    judgements: tuple[Judgement, ...]
    steps: tuple[str, ...]


def read_verdict(run: RunFile, today: date) -> RunVerdict:
    """Judge a run as it is now; instruments are due as of ``today``."""
    results = read_results(run)
    data = _report_data(run)
    if data is None:
        judgements = judge_run(run.profile, results)
        title = "Not calibrated yet"
        sentence = "Collect and calibrate first; tests by ISO 9283 with nominal commands need no calibration."
        return RunVerdict(overall(judgements), title, sentence, judgements, ())
    judgements = data.judgements
    first: Summary = summary(data, judgements, today)
    steps = tuple(f"{step.text} {step.command}".strip() for step in first.steps)
    verdict = first.verdict
    return RunVerdict(verdict.state, verdict.title, verdict.sentence, judgements, steps)


def verdict_tables(verdict: RunVerdict) -> list[Table]:
    """Show every judgement: error, expanded uncertainty, tolerance, decision, and source of the error."""
    return [judgement_table(verdict.judgements)] if verdict.judgements else []


def verdict_sentences(verdict: RunVerdict) -> list[str]:
    """State the decision rules, and what comes next."""
    rules = dict.fromkeys(RULE_WORDS[one.rule] for one in verdict.judgements)
    return [*rules, *(f"next: {step}" for step in verdict.steps)]


def _report_data(run: RunFile) -> ReportData | None:
    try:
        return read_report_data(run)
    except InputError:
        return None  # not calibrated yet
