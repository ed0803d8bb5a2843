"""First screen of the page: verdict, before and after, findings, next steps.

First figure of the page: errors before and after on one logarithmic axis, as data for its template.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import date

from cellapp.cell.targets.records import ArmVerification
from cellapp.commands.discover.words import verdict_sentence
from cellapp.commands.next_step import PAIR_ERRORS, Next, open_steps
from cellapp.commands.report.data import ReportData
from cellapp.commands.run_state import RunState
from cellapp.commands.stages import HERE
from cellapp.commands.view.charts import SMALLEST_MM
from cellapp.commands.view.parts import Parts, sentence
from cellapp.commands.view.table import with_rows
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
from cellapp.estimation.uncertainty.records import Judgement, overall
from cellapp.ground.counting import counted, mm
from cellapp.ground.results import CALIBRATE, CHECK, DISCOVER, ErrorSummary, best_method, day_of

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
            more = "" if one.characteristic in PAIR_ERRORS and len(arms) == 2 else f", {one.where}"
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


def verdict(data: ReportData, judgements: Sequence[Judgement]) -> Verdict:
    """Summarize all judgements in a title and a sentence, or say how to give tolerances."""
    if CALIBRATE in data.results.out_of_date:
        return Verdict(
            "not decided", VERDICT_TITLES["not decided"], "The calibration is out of date: nothing is judged on it."
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
    if DISCOVER in data.results.out_of_date:
        return "The search for missing effects is out of date."
    return "Missing effects were not searched for yet."


def findings(data: ReportData) -> Iterator[Found]:
    """Yield what discovery found in each arm: the accepted effects, and what remains unknown or ambiguous."""
    for number, (name, arm) in enumerate(({} if data.discover is None else data.discover.arms).items(), start=1):
        anchor = f"discovery-{number}"
        for effect in arm.accepted:
            yield Found(f"Arm {name}: {effect.title}, {place_words(effect.where)}", _effect_words(effect), anchor)
        if not arm.accepted or arm.verdict in ("unknown effect", "ambiguous"):
            yield Found(f"Arm {name}: {arm.verdict}", sentence(verdict_sentence(name, arm)), anchor)


def _effect_words(effect: AcceptedEffect) -> str:
    gap = effect.evidence.heldout_mm
    known = math.isfinite(gap.before)  # else the fit without it did not converge
    error = f"In the model it takes the held-out error from {mm(gap.before)} to {mm(gap.after)} rms." if known else ""
    return error if effect.meaning is None else f"{_first_sentence(effect.meaning.cause)} {error}".rstrip()


# -- what to do next --------------------------------------------------------------------------------------------------


def steps(data: ReportData, judgements: Sequence[Judgement], today: date) -> Iterator[Next]:
    """Yield what to do next, the missing result first."""
    missing = [] if data.next_step is None else [data.next_step]
    yield from missing
    here = data.results.model_copy(update={"run": str(HERE)})  # the page is the same wherever it lies
    said = {one.command for one in missing}
    yield from (one for one in open_steps(data.profile, here, judgements) if one.command not in said)
    for name, arm in ({} if data.discover is None else data.discover.arms).items():
        yield from _effect_steps(name, arm)
    due = data.profile.traceability.tracker.due
    if due is not None and due < today:
        yield Next(f"Have the tracker calibrated: it was due on {due}.")
    driven = any(arm.driver.has_device for arm in data.profile.arms.values())
    if driven and data.results.check is None and CHECK not in data.results.out_of_date:
        yield Next("After each collision, repair or move, and at regular intervals:", f"cellapp check {HERE}")


def _effect_steps(name: str, arm: ArmDiscoveryResult) -> Iterator[Next]:
    for effect in arm.accepted:
        if effect.meaning is not None and effect.meaning.check:
            yield Next(f"Arm {name}, {place_words(effect.where)}: {_first_sentence(effect.meaning.check[0])}")


def _first_sentence(text: str) -> str:
    """Return a text up to the end of its first sentence."""
    first, stop, _ = text.partition(". ")
    return first + stop.rstrip()


# -- The verdict on a run for a screen --------------------------------------------------------------------------------


def read_verdict(state: RunState, data: ReportData | None, today: date) -> tuple[Verdict, Parts]:
    """Judge a run as it is now: its verdict; every judgement, the decision rules, what comes next.

    ``data`` are those of a calibrated run. Instruments are due as of ``today``.
    """
    judgements = state.judgements
    if data is None:
        words = "Collect and calibrate first; tests by ISO 9283 with nominal commands need no calibration."
        found, later = Verdict(overall(judgements), "Not calibrated yet", words), list[Next]()
    else:
        found, later = verdict(data, judgements), list(steps(data, judgements, today))
    rules = dict.fromkeys(RULE_WORDS[one.rule] for one in judgements)
    next_steps = (f"next: {f'{step.text} {step.command}'.strip()}" for step in later)
    return found, (*with_rows(judgement_table(judgements)), *rules, *next_steps)


_ROOM = 1.25
"""Factor by which the axis reaches beyond the smallest and the largest value."""

_FEW_DECADES = 4
"""Most decades of an axis with ticks at three times each power of ten: more have no room on a phone."""


@dataclass(frozen=True)
class ComparedErrors:
    """Mean errors [mm] of one arm or of the pair before and after, the largest error after, and the tolerance if any.

    ``source`` says where they were measured.
    """

    label: str
    source: str
    before_mm: float
    after_mm: float
    largest_mm: float
    tolerance_mm: float | None = None

    @property
    def words(self) -> str:
        """Both errors, as ``4.04 mm -> 0.026 mm``."""
        return f"{mm(self.before_mm)} \N{RIGHTWARDS ARROW} {mm(self.after_mm)}"


@dataclass(frozen=True)
class BeforeAfterFigure:
    """Rows on a common logarithmic axis from ``low_mm`` to ``high_mm``; ``message`` says what they show."""

    rows: tuple[ComparedErrors, ...]
    low_mm: float
    high_mm: float
    message: str

    def percent(self, value_mm: float) -> str:
        """Return the place of a value on the axis, as a percentage of its length for SVG."""
        share = math.log(max(value_mm, self.low_mm) / self.low_mm) / math.log(self.high_mm / self.low_mm)
        return f"{100.0 * share:.2f}%"

    @property
    def ticks(self) -> tuple[float, ...]:
        """Powers of ten on the axis [mm], and three times them if there is room."""
        first, last = math.floor(math.log10(self.low_mm)), math.ceil(math.log10(self.high_mm))
        steps = (1.0, 3.0) if last - first <= _FEW_DECADES else (1.0,)
        ticks = [step * 10.0**exponent for exponent in range(first, last + 1) for step in steps]
        return tuple(tick for tick in ticks if self.low_mm <= tick <= self.high_mm)


def before_after_figure(data: ReportData) -> BeforeAfterFigure | None:
    """Compare the nominal and the best model of every arm and of the pair; None if no errors of both are known.

    Errors are those measured at verified targets; without these, those at held-out configurations.
    """
    rows = list(_compared(data))
    if not rows:
        return None
    values = [value for row in rows for value in (row.before_mm, row.after_mm, row.largest_mm)]
    values += [row.tolerance_mm for row in rows if row.tolerance_mm is not None]
    low, high = max(min(values), SMALLEST_MM) / _ROOM, max(*values, SMALLEST_MM) * _ROOM
    outdated = "Out of date. " if CALIBRATE in data.results.out_of_date else ""
    return BeforeAfterFigure(tuple(rows), low, high, outdated + _message(rows))


def _compared(data: ReportData) -> Iterator[ComparedErrors]:
    """Yield the errors of every arm and of the pair that are known before and after."""
    verified, tolerances = data.results.verified, data.profile.tolerances
    for name, arm in data.calibrate.arms.items():
        nominal, best = (arm.validate_.get(stage) for stage in ("nominal", arm.best_stage))
        stages = (getattr(nominal, "position_mm", None), getattr(best, "position_mm", None))
        yield from _errors(f"Arm {name}", verified.arms.get(name), stages, "configuration", tolerances.position)
    pair = data.calibrate.pair
    nominal_pair, best_pair = (pair.get(method) for method in ("nominal", best_method(pair) or "nominal"))
    methods = (getattr(nominal_pair, "cooperative_mm", None), getattr(best_pair, "cooperative_mm", None))
    yield from _errors("Cooperative", verified.cooperative, methods, "stop", tolerances.cooperative)


def _errors(
    label: str,
    verified: ArmVerification | None,
    held_out: tuple[ErrorSummary | None, ErrorSummary | None],
    where: str,
    tolerance_m: float | None,
) -> Iterator[ComparedErrors]:
    """Yield the verified errors of one arm or of the pair, else the held-out ones, if both are known."""
    before, after = held_out if verified is None else (verified.nominal_mm, verified.compensated_mm)
    if before is not None and after is not None:
        source = f"{after.n} verified targets" if verified is not None else counted(after.n, f"held-out {where}")
        tolerance_mm = None if tolerance_m is None else tolerance_m * 1e3
        yield ComparedErrors(label, source, before.mean, after.mean, after.max, tolerance_mm)


def _message(rows: Sequence[ComparedErrors]) -> str:
    worse = [row.label for row in rows if row.after_mm >= row.before_mm]
    if worse:
        return f"The mean error did not fall: {', '.join(worse)}."
    factors = [row.before_mm / max(row.after_mm, SMALLEST_MM) for row in rows]
    low, high = _factor(min(factors)), _factor(max(factors))
    times = f"{low} times" if low == high else f"{low} to {high} times"
    return f"The mean error is {times} smaller than with the nominal model."


def _factor(value: float) -> str:
    return f"{value:.0f}" if value >= 9.5 else f"{value:.1f}"
