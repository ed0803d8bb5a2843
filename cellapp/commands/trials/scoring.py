"""Scores of blind trials: findings beside what was hidden, counts, targets, misses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cellapp.commands.trials.judge_records import (
    OUTCOMES,
    VERDICTS,
    ArmFindings,
    CleanCounts,
    EffectCounts,
    EndState,
    HiddenEffect,
    Miss,
    OutcomeCounts,
    OutsideCounts,
    ScoredRun,
    Scores,
    Spread,
)
from cellapp.commands.trials.posteriors import posterior_scores
from cellapp.commands.trials.targets import targets
from cellapp.ground.grouping import grouped


def scores(runs: Sequence[ScoredRun]) -> Scores:
    """Count outcomes and targets over all runs."""
    one = [run for run in runs if run.kind in ("one", "flipped")]
    outside = [run for run in runs if run.kind == "outside"]
    several = [run for run in runs if len(run.hidden) > 1]
    clean = [found for run in runs if run.kind == "none" for found in run.arms.values()]
    beside = [found for run in runs if run.arm for arm, found in run.arms.items() if arm != run.arm]
    without = {"nothing hidden in the run": clean, "arm beside one that hides something": beside}
    every = [found for run in runs for found in run.arms.values()]
    posteriors = posterior_scores(runs)
    return Scores(
        targets=tuple(targets(runs, clean, posteriors)),
        one={slug: _effect_counts(group) for slug, group in _groups(one).items()},
        none={what: _clean_counts(arms) for what, arms in without.items() if arms},
        outside={slug: _outside_counts(group) for slug, group in _groups(outside).items()},
        pair={
            names: _effect_counts(group).model_copy(update={"look_alikes": group[0].look_alikes})
            for names, group in _groups(several).items()
        },
        posteriors=posteriors,
        seconds_an_arm=Spread.of([found.seconds for found in every]),
        cpu_seconds_an_arm=Spread.of([found.cpu_seconds for found in every]),
        misses=tuple(miss for run in runs for miss in [_miss(run, arm) for arm in run.arms if _missed(run, arm)]),
        trials=tuple(runs),
    )


# -- counting ---------------------------------------------------------------------------------------------------------


def _groups(runs: Sequence[ScoredRun]) -> dict[str, list[ScoredRun]]:
    """Group the runs that hide the same, look-alikes last."""
    ordered = sorted(runs, key=lambda run: (run.look_alikes, run.hidden_names))
    return grouped((run.hidden_names, run) for run in ordered)


def _effect_counts(runs: Sequence[ScoredRun]) -> EffectCounts:
    return EffectCounts(
        visible=_outcome_counts([run for run in runs if run.visible]),
        below=_outcome_counts([run for run in runs if not run.visible]),
    )


def _outcome_counts(runs: Sequence[ScoredRun]) -> OutcomeCounts:
    counts: dict[str, Any] = {outcome: sum(run.outcome == outcome for run in runs) for outcome in OUTCOMES}
    return OutcomeCounts(
        **dict(_end_state([run.findings for run in runs])),
        **counts,
        n=len(runs),
        visible_um=Spread.of([min(effect.visible_um for effect in run.hidden) for run in runs]),
        beyond_law_um=Spread.of(
            [effect.beyond_law_um for run in runs for effect in run.hidden if effect.beyond_law_um]
        ),
        in_answer_set=sum(bool(run.in_answer_set) for run in runs),
    )


def _clean_counts(arms: Sequence[ArmFindings]) -> CleanCounts:
    return CleanCounts(
        **dict(_end_state(arms)),
        n=len(arms),
        false_names=sum(bool(found.names) for found in arms),
        false_unknown=sum(found.unknown for found in arms),
    )


def _outside_counts(runs: Sequence[ScoredRun]) -> OutsideCounts:
    return OutsideCounts(
        **dict(_end_state([run.findings for run in runs])),
        n=len(runs),
        visible_um=Spread.of([run.hidden[0].visible_um for run in runs]),
        unknown=sum(run.findings.unknown for run in runs),
        right=sum(run.description == "right" for run in runs),
        part=sum(run.description == "part" for run in runs),
        false_names=sum(bool(run.findings.names) for run in runs),
    )


def _end_state(arms: Sequence[ArmFindings]) -> EndState:
    verdicts = [found.verdict for found in arms]
    return EndState(
        heldout_to_drawn=Spread.of([found.to_drawn for found in arms]),
        heldout_to_stated=Spread.of([found.to_stated for found in arms if found.to_stated is not None]),
        verdicts={word: verdicts.count(word) for word in VERDICTS if word in verdicts},
    )


def _missed(run: ScoredRun, arm: str) -> bool:
    found = run.arms[arm]
    if arm != run.arm:
        return bool(found.accepted) or found.unknown
    if run.kind == "flipped":
        return not (found.unknown and run.says_convention)
    if run.kind == "outside":
        return run.description != "right" or bool(found.names)
    if run.kind == "hard" and run.second_names:
        return True
    return run.outcome != "named" and (bool(run.visible) or bool(found.accepted))


def _miss(run: ScoredRun, arm: str) -> Miss:
    found = run.arms[arm]
    others = {slug for answers in found.answer_sets for slug in answers[1:]}
    described = [f"{term.channel}: {', '.join(term.variables)}" for term in found.described]
    effects = [_hidden_words(one) for one in run.hidden] if arm == run.arm else []
    return Miss(
        run=run.run,
        arm=arm,
        hidden=" + ".join(effects),
        found=" + ".join(found.accepted),
        said="; ".join([*(f"or {slug}" for slug in sorted(others)), *described]),
        verdict=found.verdict,
        to_drawn=found.to_drawn,
    )


def _hidden_words(effect: HiddenEffect) -> str:
    """Describe an effect, ``backlash/many_plays (84, beyond its law 12)``: visible size, size beyond the law [µm]."""
    law = f"/{effect.law}" if effect.law else ""
    beyond = "" if effect.beyond_law_um is None else f", beyond its law {effect.beyond_law_um:.0f}"
    return f"{effect.plant}{law} ({effect.visible_um:.0f}{beyond})"
