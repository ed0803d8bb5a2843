"""Scores of blind trials: findings beside what was hidden, counts, targets, misses.

Records of judged trials: findings in an arm, score of a run, counts, targets, misses.

Tables of blind trials for terminal and handbook.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import numpy as np

from cellapp.commands.trials.sealed import DescribedTerm, HiddenLaw, SealHeader
from cellapp.commands.trials.sealed_setup import MASS_ERROR, Setup
from cellapp.commands.view.table import Interval, Number, Table, table_of, with_rows
from cellapp.estimation.discovery.arm_data import UNKNOWN
from cellapp.estimation.discovery.records import BeforeAfter
from cellapp.ground.counting import counted
from cellapp.ground.grouping import grouped
from cellapp.ground.results import Record, Result, day_of
from cellapp.robot.effects import EFFECTS

EVERY, ACCEPTED = "every effect that the plan can show", "accepted names"
"""Groups of statements that are scored."""
_BINS = 5

Statement = tuple[float, bool]
"""A stated probability, and whether the effect is really there."""


def posterior_scores(runs: Sequence[ScoredRun]) -> tuple[PosteriorScore, ...]:
    """Score the statements in all arms; empty if there are none.

    The groups are every effect that the plan can show (without a stated probability it counts as zero), and accepted
    names. Hidden effects below the noise do not count: no method can be expected to see them.
    """
    about: dict[str, list[Statement]] = {EVERY: [], ACCEPTED: []}
    for run in runs:
        for arm, found in run.arms.items():
            if not found.posteriors:
                continue
            hidden = run.hidden if arm == run.arm else ()
            present = {effect.effect for effect in hidden}
            left_out = {UNKNOWN, *found.invisible, *(effect.effect for effect in hidden if not effect.visible)}
            for slug in EFFECTS:
                if slug not in left_out:
                    statement = (found.posteriors.get(slug, 0.0), slug in present)
                    about[EVERY].append(statement)
                    about[ACCEPTED] += [statement] if slug in found.names else []
    return tuple(_score(what, statements) for what, statements in about.items() if statements)


def _score(about: str, statements: Sequence[Statement]) -> PosteriorScore:
    stated = np.array([probability for probability, _ in statements])
    true = np.array([fact for _, fact in statements], dtype=np.float64)
    place = np.minimum((stated * _BINS).astype(int), _BINS - 1)
    bins = []
    for k in range(_BINS):
        here = place == k
        bins.append(
            ReliabilityBin(
                low=k / _BINS,
                high=(k + 1) / _BINS,
                n=int(here.sum()),
                stated=float(stated[here].mean()) if here.any() else None,
                true=float(true[here].mean()) if here.any() else None,
            )
        )
    return PosteriorScore(about=about, n=len(stated), brier=float(((stated - true) ** 2).mean()), bins=tuple(bins))


AT_FLOOR = 1.05
"""A held-out rms within this factor of the noise counts as reaching it."""
USUAL_S, SLOWEST_S = 1.0, 5.0
"""Targets for the search time of one arm, median and worst [s]."""
ENOUGH_CLEAN = 300
"""Least arms without effects to confirm a rate of 1 %: 3 false alarms are expected at that rate."""
_ONE, _SEVERAL, _OUTSIDE, _SECOND = 34, 13, 20, 50
"""Least trials for a limit to count: it then still tolerates one miss."""
_BRIER = 0.05
_LEAST, _MOST = "at least", "at most"
_STATEMENTS = 100
"""Least stated probabilities for their Brier score to count."""


def targets(
    runs: Sequence[ScoredRun], clean: Sequence[ArmFindings], posteriors: Sequence[PosteriorScore]
) -> list[TargetScore]:
    """Return the required and reached share of every target that has trials; ``clean`` arms hide nothing."""
    every = [found for run in runs for found in run.arms.values()]
    beside = [found for run in runs if run.arm for arm, found in run.arms.items() if arm != run.arm]
    known = [run for run in runs if run.kind in ("one", "pair", "triple")]
    names, unknown = [bool(arm.names) for arm in clean], [arm.unknown for arm in clean]
    false_beside = [bool(arm.accepted) or arm.unknown for arm in beside]
    wrong_below = [run.outcome not in ("none", "named") for run in known if run.kind == "one" and not run.visible]
    too_many = [bool(run.second_names) for run in runs if run.kind == "hard"]
    at_floor = [run.findings.to_drawn <= AT_FLOOR for run in known]
    usual, slowest = ([arm.seconds <= limit_s for arm in every] for limit_s in (USUAL_S, SLOWEST_S))
    found = (
        *_names([run for run in known if run.visible]),
        _share("none", "false names, by arm", _MOST, 0.01, names, ENOUGH_CLEAN),
        _share("none", "false unknown effects, by arm", _MOST, 0.01, unknown, ENOUGH_CLEAN),
        _share("beside", "false names, arms beside one that hides something", _MOST, 0.01, false_beside, ENOUGH_CLEAN),
        *_outside([run for run in runs if run.kind == "outside"]),
        _share("hard", "a name too many", _MOST, 0.02, too_many, _SECOND, bar=False),
        _share("one", "below the noise: another name", _MOST, 0.02, wrong_below, _SECOND, bar=False),
        *(_brier(score) for score in posteriors if score.about in (EVERY, ACCEPTED)),
        _share("one, pair, triple", "held out within 5 % of the sampled noise", _LEAST, 1.0, at_floor),
        _share("all", f"one arm within {USUAL_S:g} s", _LEAST, 0.5, usual),
        _share("all", f"one arm within {SLOWEST_S:g} s", _LEAST, 1.0, slowest),
    )
    return [target for target in found if target is not None]


def _names(visible: Sequence[ScoredRun]) -> list[TargetScore | None]:
    """Score the names of visible effects of the library: exactly those, and no further ones."""
    one, several = ([run for run in visible if (run.kind == "one") is asked] for asked in (True, False))
    exactly = [run.outcome == "named" for run in one]
    among = [bool(run.in_answer_set) for run in one]
    ordinary = [run.outcome == "named" for run in several if not run.look_alikes]
    alike = [run.outcome == "named" for run in several if run.look_alikes]
    beyond = [bool(run.second_names) for run in visible]
    return [
        _share("one", "visible: exactly its name", _LEAST, 0.97, exactly, _ONE),
        _share("one", "visible: truth among the alternatives", _LEAST, 0.99, among),
        _share("pair, triple", "visible: exactly their names", _LEAST, 0.92, ordinary, _SEVERAL),
        _share("pair", "visible, confounded: exactly their names", _LEAST, 0.92, alike),
        _share("one, pair, triple", "second names", _MOST, 0.02, beyond, _SECOND),
    ]


def _outside(outside: Sequence[ScoredRun]) -> list[TargetScore | None]:
    """Score laws outside the library: called unknown and described, above the noise; and no further names."""
    called = [run.findings.unknown for run in outside if run.visible]
    described = [run.description == "right" for run in outside if run.visible]
    further = [bool(run.second_names) for run in outside]
    return [
        _share("outside", "visible: called unknown", _LEAST, 0.95, called, _OUTSIDE),
        _share("outside", "visible: right place and variables", _LEAST, 0.85, described, _OUTSIDE),
        _share("outside", "names beyond the one description", _MOST, 0.02, further, _SECOND),
    ]


def _brier(score: PosteriorScore) -> TargetScore:
    """Return the Brier score of some statements as a target."""
    return _target("all", f"Brier score, {score.about}", _MOST, _BRIER, score.brier, score.n, _STATEMENTS)


def _share(
    kind: str, what: str, sign: str, wanted: float, hits: Sequence[bool], enough: int = 0, *, bar: bool = True
) -> TargetScore | None:
    """Return a share of hits as a target, a limit only from ``enough`` trials on; None without trials."""
    n, reached = len(hits), sum(hits)
    if not n:
        return None
    return _target(kind, what, sign, wanted, reached / n, n, max(enough, 1), reached, bar=bar and enough > 0)


def _target(
    kind: str,
    what: str,
    sign: str,
    wanted: float,
    share: float,
    n: int,
    enough: int,
    reached: int | None = None,
    *,
    bar: bool = True,
) -> TargetScore:
    """Return one target. Less than ``enough`` trials can refute it but not confirm it."""
    held = share <= wanted if sign == _MOST else share >= wanted
    return TargetScore(
        kind=kind,
        target=what,
        wanted=wanted,
        at_most=sign == _MOST,
        trials_wanted=enough,
        reached=reached,
        n=n,
        share=share,
        met=held if n >= enough or not held else None,
        bar=bar,
    )


def scores(runs: Sequence[ScoredRun]) -> Scores:
    """Count outcomes and targets over all runs."""
    clean = [found for run in runs if run.kind == "none" for found in run.arms.values()]
    posteriors = posterior_scores(runs)
    return Scores(
        targets=tuple(targets(runs, clean, posteriors)),
        counts=tuple(_counts(runs)),
        posteriors=posteriors,
        trials=tuple(runs),
    )


# -- counting ---------------------------------------------------------------------------------------------------------


def _counts(runs: Sequence[ScoredRun]) -> Iterator[HiddenCounts]:
    """Yield the counts of each group of arms that hide the same, several effects and look-alikes last."""
    ordered = sorted(runs, key=lambda run: (len(run.hidden) > 1, run.look_alikes, run.hidden_names, not run.visible))
    groups = grouped((_group_words(run, arm), (run, arm)) for run in ordered for arm in run.arms)
    for hidden, arms in groups.items():
        sizes = [min(one.visible_um for one in run.hidden) for run, arm in arms if arm == run.arm]
        yield HiddenCounts(
            hidden=hidden,
            n=len(arms),
            visible_um=(min(sizes), max(sizes)) if sizes else None,
            outcomes=Counter(_outcome_words(run, arm) for run, arm in arms),
        )


def _group_words(run: ScoredRun, arm: str) -> str:
    """Say what an arm hides, and whether below the noise."""
    if arm != run.arm:
        return "nothing, beside an arm that hides something" if run.arm else "nothing in the run"
    return f"{run.hidden_names}{' (confounded)' if run.look_alikes else ''}{'' if run.visible else ', below'}"


def _outcome_words(run: ScoredRun, arm: str) -> str:
    """Return the outcome of an arm; an unknown effect with how far its description is right."""
    found = run.arms[arm]
    if arm != run.arm:
        return "false name" if found.names else "false unknown" if found.unknown else "none"
    described = {"right": "described", "part": "described in part"}
    return described.get(run.description, "unknown") if run.outcome == "unknown" else run.outcome or "none"


def _missed(run: ScoredRun, arm: str) -> bool:
    """Return whether not exactly the hidden effects were found in an arm."""
    found = run.arms[arm]
    if arm != run.arm:
        return bool(found.accepted) or found.unknown
    if run.kind == "outside":
        return run.description != "right" or bool(found.names)
    if run.kind == "hard" and run.second_names:
        return True
    return run.outcome != "named" and (bool(run.visible) or bool(found.accepted))


THRESHOLD = "visible rms above the rms length of the stated noise (noise per coordinate times root 3)"
NOT_KNOWN = "unknown effect"

Outcome = Literal["named", "extra", "part", "wrong", "unknown", "none"]
Likeness = Literal["", "part", "right"]
"""How far a description matches a law outside the library."""


class HiddenEffect(HiddenLaw):
    """One hidden effect; ``visible`` is whether its visible size is above the noise."""

    visible: bool = True


class ArmFindings(Record):
    """What discovery found in one arm.

    ``posteriors`` are the stated probabilities of the effects (slug -> probability), empty where none were stated;
    ``invisible`` the effects that this plan cannot show; ``sentence`` the verdict in words. ``seconds`` are of wall
    clock, ``cpu_seconds`` of processor time.
    """

    accepted: tuple[str, ...]
    answer_sets: tuple[tuple[str, ...], ...]
    described: tuple[DescribedTerm, ...]
    posteriors: Mapping[str, float] = {}
    invisible: tuple[str, ...] = ()
    verdict: str
    sentence: str = ""
    heldout_um: BeforeAfter
    noise_um: float
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
        """Held-out rms over that of the noise really sampled at those stops."""
        return self.heldout_um.after / self.noise_um


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
    description: Likeness
    second_names: tuple[str, ...] = ()
    arms: Mapping[str, ArmFindings]

    @property
    def findings(self) -> ArmFindings:
        """What was found in the arm with the hidden effects."""
        return self.arms[self.arm]

    @property
    def hidden_names(self) -> str:
        """The hidden effects as the plant names them; a single one with its law."""
        names = " + ".join(effect.plant for effect in self.hidden)
        law = self.hidden[0].law if len(self.hidden) == 1 else ""
        return names + (f"/{law}" if law else "")


class HiddenCounts(Record):
    """Arms that hide the same, all above or all below the noise: smallest and largest visible size [µm], outcomes."""

    hidden: str
    n: int
    visible_um: tuple[float, float] | None
    outcomes: Mapping[str, int]


class TargetScore(Record):
    """One target: the share that is wanted and that was reached.

    ``met`` is None where there were too few trials. ``bar`` is whether a miss with enough trials is an error of the
    whole command. ``reached`` is None where ``share`` is a score, not a share of ``n``.
    """

    kind: str
    target: str
    wanted: float
    at_most: bool
    trials_wanted: int
    reached: int | None
    n: int
    share: float
    met: bool | None
    bar: bool = False

    @property
    def missed(self) -> bool:
        """Whether a limit was missed in enough trials to say so."""
        return self.bar and self.met is False and self.n >= self.trials_wanted


class ReliabilityBin(Record):
    """Statements with a probability from ``low`` to ``high``: number, mean stated probability, share that is true."""

    low: float
    high: float
    n: int
    stated: float | None
    true: float | None


class PosteriorScore(Record):
    """Stated probabilities against the truth: mean squared difference (Brier 1950), and a reliability table."""

    about: str
    n: int
    brier: float
    bins: tuple[ReliabilityBin, ...]


class Scores(Record):
    """Targets, counts by what was hidden, stated probabilities, and every run."""

    targets: tuple[TargetScore, ...]
    counts: tuple[HiddenCounts, ...]
    posteriors: tuple[PosteriorScore, ...] = ()
    trials: tuple[ScoredRun, ...]

    @property
    def missed(self) -> tuple[TargetScore, ...]:
        """Limits that were missed in enough trials to say so."""
        return tuple(target for target in self.targets if target.missed)


class JudgeResult(Scores, Result, schema="cellapp-trials-judge"):
    """``trials judge``: scores, how the trials were sealed, and runs that could not be scored with the reason."""

    date: str
    program: str
    source: str
    judged_by_other_source: int
    sealed: SealHeader
    failed: tuple[str, ...]


def judge_tables(result: Scores) -> list[Table]:
    """Show the targets, the outcomes by what was hidden, the stated probabilities, and the misses."""
    counts = table_of(
        "What was found, by what was hidden",
        result.counts,
        ("hidden", "hidden"),
        ("visible µm", lambda one: one.visible_um and Interval(*one.visible_um), ".0f"),
        ("n", "n", "d"),
        ("outcomes", lambda one: ", ".join(f"{word} {count}" for word, count in one.outcomes.items())),
    )
    misses = [(run, arm) for run in result.trials for arm in run.arms if _missed(run, arm)]
    return with_rows(_target_table(result.targets), counts, *map(_posterior_table, result.posteriors), _misses(misses))


def judge_sentences(result: JudgeResult) -> list[str]:
    """State the conditions of the tables: threshold, abbreviations, speed, date, seed, program."""
    sealed, every = result.sealed, [found for run in result.trials for found in run.arms.values()]
    said = [
        f"Visible: {THRESHOLD}, each hidden effect alone; below: not so, which counts for the targets of pairs and of"
        " the held-out error only. Held out: rms over that of the noise sampled at those stops."
    ]
    if every:
        wall, cpu = [found.seconds for found in every], [found.cpu_seconds for found in every]
        said.append(
            f"Discovery of one arm: median {np.median(wall):.1f} s, longest {max(wall):.1f} s (processor"
            f" {np.median(cpu):.1f} and {max(cpu):.1f} s)."
        )
    if result.judged_by_other_source:
        said.append(
            f"{counted(result.judged_by_other_source, 'run was', 'runs were')} judged by another state of the"
            " program than the present one; --again judges them again."
        )
    said += [f"Not judged: {failure}." for failure in result.failed]
    said.append(
        f"{result.date}; {result.program}, source {result.source}; {counted(sealed.runs, 'run')} of"
        f" {counted(sealed.stops, 'stop')} an arm, profile {sealed.profile}, {setup_words(sealed.setup)},"
        f" seed {sealed.seed}, sealed {day_of(sealed.written)} by {sealed.program}."
    )
    return said


def setup_words(setup: Setup) -> str:
    """Describe the conditions of a set of trials."""
    said = [f"kind {setup.kind}", f"laws {setup.laws}", f"ranges {setup.ranges}"]
    said.append(f"masses {100 * MASS_ERROR:.0f} % off")
    return ", ".join([*said, *([] if setup.stated else ["no stated uncertainty"])])


# -- inside -----------------------------------------------------------------------------------------------------------


def _target_table(targets: Sequence[TargetScore]) -> Table:
    return table_of(
        "Sealed trials: targets",
        targets,
        ("kind", "kind"),
        ("target", "target"),
        ("wanted", _wanted),
        ("reached", lambda one: f"{one.n} statements" if one.reached is None else f"{one.reached} of {one.n}"),
        ("share", lambda one: Number(one.share, 3) if one.reached is None else Number(100 * one.share, 1, "%")),
        ("", lambda one: "limit" if one.bar else ""),
        ("met", lambda one: {True: "yes", False: "MISSED" if one.missed else "no", None: "too few"}[one.met]),
    )


def _wanted(target: TargetScore) -> str:
    sign = _MOST if target.at_most else _LEAST
    wanted = f"{sign} {100 * target.wanted:.0f} %" if target.reached is not None else f"{sign} {target.wanted:g}"
    return wanted + (f" of {target.trials_wanted}" if target.n < target.trials_wanted else "")


def _posterior_table(score: PosteriorScore) -> Table:
    return table_of(
        f"Stated probabilities, {score.about}: Brier score {score.brier:.3f}",
        score.bins,
        ("stated", lambda one: f"{one.low:.1f} to {one.high:.1f}"),
        ("n", "n", "d"),
        ("mean stated", "stated", ".3f"),
        ("true", "true", ".3f"),
    )


def _misses(misses: Sequence[tuple[ScoredRun, str]]) -> Table:
    """Show arms in which not exactly the hidden effects were found."""
    rows = [(run, arm, run.arms[arm]) for run, arm in misses]
    return table_of(
        "Misses",
        rows,
        ("run", lambda row: f"{row[0].run} {row[1]}"),
        ("hidden (visible µm)", lambda row: hidden_words(row[0], row[1])),
        ("found", lambda row: " + ".join(row[2].accepted) or "nothing"),
        ("or / described", lambda row: _also_said(row[2])),
        ("verdict", lambda row: row[2].verdict),
        ("held out", lambda row: row[2].to_drawn, ".3f"),
    )


def hidden_words(run: ScoredRun, arm: str) -> str:
    """Describe what an arm hides, as ``backlash/many_plays (84)``: each effect with its law and visible size [µm]."""
    effects = run.hidden if arm == run.arm else ()
    words = (f"{one.plant}{f'/{one.law}' if one.law else ''} ({one.visible_um:.0f})" for one in effects)
    return " + ".join(words) or "nothing"


def _also_said(found: ArmFindings) -> str:
    """List the alternatives of the accepted names, and the descriptions of unknown effects."""
    others = {slug for answers in found.answer_sets for slug in answers[1:]}
    described = [f"{term.channel}: {', '.join(term.variables)}" for term in found.described]
    return "; ".join([*(f"or {slug}" for slug in sorted(others)), *described])
