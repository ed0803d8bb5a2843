"""Targets of blind trials: the required and the reached share of each, and which of them are bars."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.commands.trials.judge_records import ArmFindings, PosteriorScore, ScoredRun, TargetScore
from cellapp.commands.trials.posteriors import ACCEPTED, EVERY

AT_FLOOR = 1.05
"""A held-out rms within this factor of the noise counts as reaching it."""
USUAL_S, SLOWEST_S = 1.0, 5.0
"""Targets for the search time of one arm, median and worst [s]."""
ENOUGH_CLEAN = 300
"""Least arms without effects to confirm a rate of 1 %: 3 false alarms are expected at that rate."""
_ONE, _SEVERAL, _OUTSIDE, _SECOND = 34, 13, 20, 50
"""Least trials for a bar to count: it then still tolerates one miss."""
_BRIER = 0.05
_STATEMENTS = 100
"""Least stated probabilities for their Brier score to count."""


def targets(
    runs: Sequence[ScoredRun], clean: Sequence[ArmFindings], posteriors: Sequence[PosteriorScore]
) -> list[TargetScore]:
    """Return the required and reached share of every target that has trials; ``clean`` arms hide nothing."""
    every = [found for run in runs for found in run.arms.values()]
    beside = [found for run in runs if run.arm for arm, found in run.arms.items() if arm != run.arm]
    known = [run for run in runs if run.kind in ("one", "pair", "triple")]
    found = (
        *_names([run for run in known if run.visible]),
        _at_most("none", "false names, by arm", 0.01, [bool(arm.names) for arm in clean], ENOUGH_CLEAN),
        _at_most("none", "false unknown effects, by arm", 0.01, [arm.unknown for arm in clean], ENOUGH_CLEAN),
        _at_most("beside", "false names, arms beside one that hides something", 0.01, _false(beside), ENOUGH_CLEAN),
        *_outside([run for run in runs if run.kind == "outside"], [run for run in runs if run.kind == "flipped"]),
        _at_most("hard", "a name too many", 0.02, _too_many(runs), _SECOND, bar=False),
        _at_most("one", "below the noise: another name", 0.02, _wrong_below(known), _SECOND, bar=False),
        *_second([run for run in known if run.visible], [run for run in runs if run.kind == "outside"]),
        *(_brier(score) for score in posteriors if score.about in (EVERY, ACCEPTED)),
        *_errors([run.findings for run in known]),
        _at_least("all", f"one arm within {USUAL_S:g} s", 0.5, [arm.seconds <= USUAL_S for arm in every]),
        _at_least("all", f"one arm within {SLOWEST_S:g} s", 1.0, [arm.seconds <= SLOWEST_S for arm in every]),
    )
    return [target for target in found if target is not None]


def _false(arms: Sequence[ArmFindings]) -> list[bool]:
    """Return for each arm that hides nothing whether anything was named or called unknown."""
    return [bool(found.accepted) or found.unknown for found in arms]


def _names(visible: Sequence[ScoredRun]) -> list[TargetScore | None]:
    """Score exact names of visible effects."""
    one = [run for run in visible if run.kind == "one"]
    several = [run for run in visible if run.kind != "one"]
    ordinary = [run.outcome == "named" for run in several if not run.look_alikes]
    alike = [run.outcome == "named" for run in several if run.look_alikes]
    return [
        _at_least("one", "visible: exactly its name", 0.97, [run.outcome == "named" for run in one], _ONE),
        _at_least("one", "visible: truth in the answer set", 0.99, [bool(run.in_answer_set) for run in one]),
        _at_least("pair, triple", "visible: exactly their names", 0.92, ordinary, _SEVERAL),
        _at_least("pair", "visible look-alikes: exactly their names", 0.92, alike),
    ]


def _wrong_below(known: Sequence[ScoredRun]) -> list[bool]:
    """Return for each single effect below the noise whether the search accepted anything else."""
    below = [run for run in known if run.kind == "one" and not run.visible]
    return [run.outcome not in ("none", "named") for run in below]


def _too_many(runs: Sequence[ScoredRun]) -> list[bool]:
    """Return for each hard case whether it got more names, or unknown terms, than it has causes."""
    return [bool(run.second_names) for run in runs if run.kind == "hard"]


def _outside(outside: Sequence[ScoredRun], flipped: Sequence[ScoredRun]) -> list[TargetScore | None]:
    """Score laws outside the library, and signs of the wrong convention; only above the noise."""
    called = [run.findings.unknown for run in outside if run.visible]
    described = [run.description == "right" for run in outside if run.visible]
    said = [run.findings.unknown and bool(run.says_convention) for run in flipped if run.visible]
    return [
        _at_least("outside", "visible: called unknown", 0.95, called, _OUTSIDE),
        _at_least("outside", "visible: right channel and variables", 0.85, described, _OUTSIDE),
        _at_least("flipped", "visible: called unknown, opposite sign said", 0.95, said, _OUTSIDE),
    ]


def _second(known: Sequence[ScoredRun], outside: Sequence[ScoredRun]) -> list[TargetScore | None]:
    """Score names beyond those of the hidden effects."""
    beyond = [bool(run.second_names) for run in known]
    same = [any(one.same_cause for one in run.second_names) for run in known]
    further = [bool(run.second_names) for run in outside]
    return [
        _at_most("one, pair, triple", "second names", 0.02, beyond, _SECOND),
        _at_most("one, pair, triple", "of these for the same cause", 0.02, same, _SECOND, bar=False),
        _at_most("outside", "names beyond the one description", 0.02, further, _SECOND),
    ]


def _errors(known: Sequence[ArmFindings]) -> list[TargetScore | None]:
    """Score held-out errors of arms that hide effects of the library."""
    stated = [found.to_stated for found in known]
    return [
        _at_least(
            "one, pair, triple",
            "held out within 5 % of the drawn noise",
            1.0,
            [found.to_drawn <= AT_FLOOR for found in known],
        ),
        _at_least(
            "one, pair, triple",
            "the same against the assumed noise, which scatters",
            1.0,
            [ratio <= AT_FLOOR for ratio in stated if ratio is not None],
        ),
    ]


def _brier(score: PosteriorScore) -> TargetScore:
    """Return the Brier score of some statements as a target."""
    held = score.brier <= _BRIER
    return TargetScore(
        kind="all",
        target=f"Brier score, {score.about}",
        wanted=_BRIER,
        at_most=True,
        trials_wanted=_STATEMENTS,
        reached=None,
        n=score.n,
        share=score.brier,
        met=held if score.n >= _STATEMENTS or not held else None,
        bar=True,
    )


def _at_least(kind: str, what: str, wanted: float, hits: Sequence[bool], bar_from: int = 0) -> TargetScore | None:
    """Return a target with a least share; a bar from ``bar_from`` trials on, if given."""
    return _target(kind, what, wanted, hits, at_most=False, trials_wanted=max(bar_from, 1), bar=bar_from > 0)


def _at_most(
    kind: str, what: str, wanted: float, hits: Sequence[bool], trials_wanted: int, *, bar: bool = True
) -> TargetScore | None:
    return _target(kind, what, wanted, hits, at_most=True, trials_wanted=trials_wanted, bar=bar)


def _target(
    kind: str, what: str, wanted: float, hits: Sequence[bool], *, at_most: bool, trials_wanted: int, bar: bool
) -> TargetScore | None:
    """Return one target; None if it has no trials. Too few trials can refute it but not confirm it."""
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
        bar=bar,
    )
