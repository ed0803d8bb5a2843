"""Scores of blind trials: what was found beside what was hidden, counts, targets, misses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from cellapp.discovery.terms import UNKNOWN
from cellapp.results import BeforeAfter, Record, Result
from cellapp.trials.sealed import GroundTruth, SealHeader

AT_FLOOR = 1.05
"""Held-out rms within this factor of the noise counts as reaching it."""
SLOWEST_S = 3.0
"""Target for the search of one arm [s]."""
THRESHOLD = "visible rms above the rms length of the stated noise (noise per coordinate times root 3)"
NOTHING, NOT_KNOWN = "nothing missing", "unknown effect"
VERDICTS = ("explained", "ambiguous", NOT_KNOWN, NOTHING)
ENOUGH_CLEAN = 300
"""Arms without effects from which a rate of 1 % can be confirmed: 3 false alarms are expected at that rate."""

Outcome = Literal["named", "extra", "part", "wrong", "unknown", "none"]
OUTCOMES: tuple[Outcome, ...] = ("named", "extra", "part", "wrong", "unknown", "none")


# -- records ----------------------------------------------------------------------------------------------------------


class Spread(Record):
    """Median and range of some values."""

    median: float
    min: float
    max: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread | None:
        """Median and range; None of none."""
        if not values:
            return None
        return cls(median=float(np.median(values)), min=float(min(values)), max=float(max(values)))


class DescribedTerm(Record):
    """Channel and variables of a data-driven term."""

    channel: str
    variables: tuple[str, ...]


class NoiseLengths(Record):
    """Rms length of the stated noise, and of the noise that was really drawn at the held-out stops [um]."""

    stated: float
    drawn: float


class HiddenEffect(Record):
    """One hidden effect in short, as in ``truth.json``."""

    effect: str
    plant: str
    raw_um: float
    visible_um: float


class ArmFindings(Record):
    """What discovery found in one arm; ``seconds`` of wall clock and ``cpu_seconds`` of processor time."""

    accepted: tuple[str, ...]
    answer_sets: tuple[tuple[str, ...], ...]
    described: tuple[DescribedTerm, ...]
    verdict: str
    heldout_um: BeforeAfter
    noise_um: NoiseLengths
    seconds: float
    cpu_seconds: float

    @property
    def names(self) -> tuple[str, ...]:
        """Accepted effects of the library."""
        return tuple(slug for slug in self.accepted if slug != UNKNOWN)

    @property
    def unknown(self) -> bool:
        """Whether discovery reported that the library lacks something."""
        return self.verdict == NOT_KNOWN or UNKNOWN in self.accepted

    @property
    def to_drawn(self) -> float:
        """Held-out rms over that of the noise really drawn at those stops."""
        return self.heldout_um.after / self.noise_um.drawn

    @property
    def to_stated(self) -> float:
        """Held-out rms over that of the stated noise."""
        return self.heldout_um.after / self.noise_um.stated


class ScoredRun(Record):
    """One run: what was hidden in which arm, what was found, and how that scores.

    ``visible``, ``outcome`` and ``in_answer_set`` are None where nothing is hidden. ``outcome`` is ``named`` (exactly
    the names), ``extra`` (those and more), ``part`` (some of them and nothing else), ``unknown`` (data-driven terms
    only), ``none`` or ``wrong``. ``description`` is ``right`` where a term has the channel and the variables of a law
    outside the library, ``part`` with the channel and some of them, else empty.
    """

    run: str
    kind: str
    look_alikes: bool
    arm: str
    hidden: tuple[HiddenEffect, ...]
    expected: DescribedTerm | None
    visible: bool | None
    outcome: Outcome | None
    in_answer_set: bool | None
    description: Literal["", "part", "right"]
    arms: Mapping[str, ArmFindings]

    @property
    def findings(self) -> ArmFindings:
        """What was found in the arm with the hidden effects."""
        return self.arms[self.arm]

    @property
    def hidden_names(self) -> str:
        """The hidden effects as the plant names them."""
        return " + ".join(effect.plant for effect in self.hidden)


class EndState(Record):
    """Held-out error against drawn and stated noise, and number of each verdict."""

    heldout_to_drawn: Spread | None
    heldout_to_stated: Spread | None
    verdicts: Mapping[str, int]


class OutcomeCounts(EndState):
    """Number of each outcome in runs that hide the same."""

    n: int
    visible_um: Spread | None
    named: int
    extra: int
    part: int
    wrong: int
    unknown: int
    none: int
    in_answer_set: int

    def count(self, outcome: Outcome) -> int:
        """Number of one outcome."""
        return {
            "named": self.named,
            "extra": self.extra,
            "part": self.part,
            "wrong": self.wrong,
            "unknown": self.unknown,
            "none": self.none,
        }[outcome]


class EffectCounts(Record):
    """Runs that hide the same, apart for visible and for smaller effects; ``look_alikes`` for pairs only."""

    visible: OutcomeCounts
    below: OutcomeCounts
    look_alikes: bool | None = None
    omitted_when_none = frozenset({"look_alikes"})


class CleanCounts(EndState):
    """False alarms in arms without hidden effects."""

    n: int
    false_names: int
    false_unknown: int


class OutsideCounts(EndState):
    """Runs with a law that the library lacks."""

    n: int
    visible_um: Spread | None
    unknown: int
    right: int
    part: int
    false_names: int


class TargetScore(Record):
    """One target: the share that is wanted and that was reached; ``met`` is None where there were too few trials."""

    kind: str
    target: str
    wanted: float
    at_most: bool
    trials_wanted: int
    reached: int
    n: int
    share: float
    met: bool | None


class Miss(Record):
    """An arm in which not exactly the hidden effects were found."""

    run: str
    arm: str
    hidden: str
    found: str
    said: str
    verdict: str
    to_drawn: float


class Scores(Record):
    """Targets, counts by effect, law and pair, arms without effects, speed, misses, and every run."""

    threshold: str = THRESHOLD
    targets: tuple[TargetScore, ...]
    one: Mapping[str, EffectCounts]
    none: Mapping[str, CleanCounts]
    outside: Mapping[str, OutsideCounts]
    pair: Mapping[str, EffectCounts]
    seconds_an_arm: Spread | None
    cpu_seconds_an_arm: Spread | None
    misses: tuple[Miss, ...]
    trials: tuple[ScoredRun, ...]


class JudgeResult(Scores, Result):
    """``trials judge``: scores, how the trials were sealed, and runs that could not be scored with the reason."""

    schema_: Literal["cellapp-trials-judge"] = "cellapp-trials-judge"
    version: Literal[1] = 1
    date: str
    program: str
    source: str
    judged_by_other_source: int
    jobs: int
    sealed: SealHeader
    failed: tuple[str, ...]


# -- scoring ----------------------------------------------------------------------------------------------------------


def score_run(truth: GroundTruth, arms: Mapping[str, ArmFindings]) -> ScoredRun:
    """Compare what was found in one run with what was hidden in it."""
    hidden = frozenset(effect.effect for effect in truth.effects)
    expected = None if truth.expected is None else DescribedTerm.model_validate(truth.expected.model_dump())
    here = arms.get(truth.arm)
    visible = outcome = answered = None
    if here is not None:
        visible = all(effect.visible_um > truth.noise_um[truth.arm] for effect in truth.effects)
        outcome = _outcome(hidden, frozenset(here.accepted))
        answered = hidden <= {slug for answers in here.answer_sets for slug in answers}
    return ScoredRun(
        run=truth.run,
        kind=truth.kind,
        look_alikes=truth.look_alikes,
        arm=truth.arm,
        hidden=tuple(
            HiddenEffect(effect=one.effect, plant=one.plant, raw_um=one.raw_um, visible_um=one.visible_um)
            for one in truth.effects
        ),
        expected=expected,
        visible=visible,
        outcome=outcome,
        in_answer_set=answered,
        description="" if here is None or expected is None else _description(expected, here.described),
        arms=arms,
    )


def scores(runs: Sequence[ScoredRun]) -> Scores:
    """Counts and targets over all runs."""
    one = [run for run in runs if run.kind == "one"]
    outside = [run for run in runs if run.kind == "outside"]
    pairs = [run for run in runs if run.kind == "pair"]
    clean = [found for run in runs if run.kind == "none" for found in run.arms.values()]
    beside = [found for run in runs if run.arm for arm, found in run.arms.items() if arm != run.arm]
    without = {"nothing hidden in the run": clean, "arm beside one that hides something": beside}
    every = [found for run in runs for found in run.arms.values()]
    return Scores(
        targets=tuple(_targets(runs, one, clean, outside, pairs)),
        one={slug: _effect_counts(group) for slug, group in _groups(one).items()},
        none={what: _clean_counts(arms) for what, arms in without.items() if arms},
        outside={slug: _outside_counts(group) for slug, group in _groups(outside).items()},
        pair={
            names: _effect_counts(group).model_copy(update={"look_alikes": group[0].look_alikes})
            for names, group in _groups(pairs).items()
        },
        seconds_an_arm=Spread.of([found.seconds for found in every]),
        cpu_seconds_an_arm=Spread.of([found.cpu_seconds for found in every]),
        misses=tuple(miss for run in runs for miss in _misses(run)),
        trials=tuple(runs),
    )


def _outcome(hidden: frozenset[str], accepted: frozenset[str]) -> Outcome:
    if accepted == hidden:
        return "named"
    if not accepted:
        return "none"
    if accepted > hidden:
        return "extra"
    if accepted < hidden:
        return "part"
    return "unknown" if accepted == {UNKNOWN} else "wrong"


def _description(expected: DescribedTerm, described: Sequence[DescribedTerm]) -> Literal["", "part", "right"]:
    """How well the best data-driven term matches; a channel in one direction only counts as that channel."""
    best: Literal["", "part"] = ""
    for term in described:
        if term.channel != expected.channel and not term.channel.startswith(f"{expected.channel} "):
            continue
        if set(term.variables) == set(expected.variables):
            return "right"
        if set(term.variables) & set(expected.variables):
            best = "part"
    return best


# -- counting ---------------------------------------------------------------------------------------------------------


def _groups(runs: Sequence[ScoredRun]) -> dict[str, list[ScoredRun]]:
    """Runs that hide the same, look-alikes last."""
    groups: dict[str, list[ScoredRun]] = {}
    for run in sorted(runs, key=lambda run: (run.look_alikes, run.hidden_names)):
        groups.setdefault(run.hidden_names, []).append(run)
    return groups


def _effect_counts(runs: Sequence[ScoredRun]) -> EffectCounts:
    return EffectCounts(
        visible=_outcome_counts([run for run in runs if run.visible]),
        below=_outcome_counts([run for run in runs if not run.visible]),
    )


def _outcome_counts(runs: Sequence[ScoredRun]) -> OutcomeCounts:
    def count(outcome: Outcome) -> int:
        return sum(run.outcome == outcome for run in runs)

    end = _end_state([run.findings for run in runs])
    return OutcomeCounts(
        n=len(runs),
        visible_um=Spread.of([min(effect.visible_um for effect in run.hidden) for run in runs]),
        named=count("named"),
        extra=count("extra"),
        part=count("part"),
        wrong=count("wrong"),
        unknown=count("unknown"),
        none=count("none"),
        in_answer_set=sum(bool(run.in_answer_set) for run in runs),
        heldout_to_drawn=end.heldout_to_drawn,
        heldout_to_stated=end.heldout_to_stated,
        verdicts=end.verdicts,
    )


def _clean_counts(arms: Sequence[ArmFindings]) -> CleanCounts:
    end = _end_state(arms)
    return CleanCounts(
        n=len(arms),
        false_names=sum(bool(found.names) for found in arms),
        false_unknown=sum(found.unknown for found in arms),
        heldout_to_drawn=end.heldout_to_drawn,
        heldout_to_stated=end.heldout_to_stated,
        verdicts=end.verdicts,
    )


def _outside_counts(runs: Sequence[ScoredRun]) -> OutsideCounts:
    end = _end_state([run.findings for run in runs])
    return OutsideCounts(
        n=len(runs),
        visible_um=Spread.of([run.hidden[0].visible_um for run in runs]),
        unknown=sum(run.findings.unknown for run in runs),
        right=sum(run.description == "right" for run in runs),
        part=sum(run.description == "part" for run in runs),
        false_names=sum(bool(run.findings.names) for run in runs),
        heldout_to_drawn=end.heldout_to_drawn,
        heldout_to_stated=end.heldout_to_stated,
        verdicts=end.verdicts,
    )


def _end_state(arms: Sequence[ArmFindings]) -> EndState:
    verdicts = [found.verdict for found in arms]
    return EndState(
        heldout_to_drawn=Spread.of([found.to_drawn for found in arms]),
        heldout_to_stated=Spread.of([found.to_stated for found in arms]),
        verdicts={word: verdicts.count(word) for word in VERDICTS if word in verdicts},
    )


def _targets(
    runs: Sequence[ScoredRun],
    one: Sequence[ScoredRun],
    clean: Sequence[ArmFindings],
    outside: Sequence[ScoredRun],
    pairs: Sequence[ScoredRun],
) -> list[TargetScore]:
    """The wanted and the reached share of every target for which there are trials."""
    seen = [run for run in one if run.visible]
    known = [run.findings for run in (*one, *pairs)]
    ordinary = [run.outcome == "named" for run in pairs if not run.look_alikes]
    alike = [run.outcome == "named" for run in pairs if run.look_alikes]
    quick = [found.seconds <= SLOWEST_S for run in runs for found in run.arms.values()]
    drawn = [found.to_drawn <= AT_FLOOR for found in known]
    stated = [found.to_stated <= AT_FLOOR for found in known]
    false_names = [bool(found.names) for found in clean]
    false_unknown = [found.unknown for found in clean]
    few = ENOUGH_CLEAN
    targets = (
        _at_least("one", "visible: exactly its name", 0.97, [run.outcome == "named" for run in seen]),
        _at_least("one", "visible: truth in the answer set", 0.99, [bool(run.in_answer_set) for run in seen]),
        _at_least("one, pair", "held out within 5 % of the drawn noise", 1.0, drawn),
        _at_least("one, pair", "the same against the stated noise, which scatters", 1.0, stated),
        _at_most("none", "false names, by arm", 0.01, false_names, few),
        _at_most("none", "false unknown effects, by arm", 0.01, false_unknown, few),
        _at_least("outside", "called unknown", 0.95, [run.findings.unknown for run in outside]),
        _at_least("outside", "right channel and variables", 0.80, [run.description == "right" for run in outside]),
        _at_least("pair", "ordinary: exactly both names", 0.90, ordinary),
        _at_least("pair", "look-alikes: exactly both names", 0.0, alike),
        _at_least("all", f"one arm within {SLOWEST_S:.0f} s", 1.0, quick),
    )
    return [target for target in targets if target is not None]


def _at_least(kind: str, what: str, wanted: float, hits: Sequence[bool]) -> TargetScore | None:
    return _target(kind, what, wanted, hits, at_most=False, trials_wanted=1)


def _at_most(kind: str, what: str, wanted: float, hits: Sequence[bool], trials_wanted: int) -> TargetScore | None:
    return _target(kind, what, wanted, hits, at_most=True, trials_wanted=trials_wanted)


def _target(
    kind: str, what: str, wanted: float, hits: Sequence[bool], *, at_most: bool, trials_wanted: int
) -> TargetScore | None:
    """One target; None where there is no trial for it. Too few trials can refute it but not confirm it."""
    n, reached = len(hits), sum(hits)
    if not n:
        return None
    held = reached <= wanted * n if at_most else reached >= wanted * n
    return TargetScore(
        kind=kind,
        target=what,
        wanted=wanted,
        at_most=at_most,
        trials_wanted=trials_wanted,
        reached=reached,
        n=n,
        share=reached / n,
        met=held if n >= trials_wanted or not held else None,
    )


def _misses(run: ScoredRun) -> list[Miss]:
    """The arms of a run in which not exactly the hidden effects were found."""
    return [_miss(run, arm) for arm in run.arms if _missed(run, arm)]


def _missed(run: ScoredRun, arm: str) -> bool:
    found = run.arms[arm]
    if arm != run.arm:
        return bool(found.accepted) or found.unknown
    if run.kind == "outside":
        return run.description != "right" or bool(found.names)
    return run.outcome != "named" and (bool(run.visible) or bool(found.accepted))


def _miss(run: ScoredRun, arm: str) -> Miss:
    found = run.arms[arm]
    others = {slug for answers in found.answer_sets for slug in answers[1:]}
    described = [f"{term.channel}: {', '.join(term.variables)}" for term in found.described]
    effects = [f"{one.plant} ({one.visible_um:.0f})" for one in run.hidden] if arm == run.arm else []
    return Miss(
        run=run.run,
        arm=arm,
        hidden=" + ".join(effects),
        found=" + ".join(found.accepted),
        said="; ".join([*(f"or {slug}" for slug in sorted(others)), *described]),
        verdict=found.verdict,
        to_drawn=found.to_drawn,
    )
