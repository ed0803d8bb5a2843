"""Stated probabilities of effects against the truth of blind trials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.commands.trials.judge_records import PosteriorScore, ReliabilityBin, ScoredRun
from cellapp.commands.trials.sealed_cases import FLIP
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.robot.effects import EFFECTS

EVERY, STATED, ACCEPTED = "every effect that the plan can show", "effects with a stated probability", "accepted names"
"""Groups of statements that are scored."""
_BINS = 5

Statement = tuple[float, bool]
"""A stated probability, and whether the effect is really there."""


def posterior_scores(runs: Sequence[ScoredRun]) -> tuple[PosteriorScore, ...]:
    """Score the statements in all arms; empty if there are none.

    The groups are every effect that the plan can show (without a stated probability it counts as zero), effects with a
    stated probability, and accepted names. Hidden effects below the noise do not count: no method can be expected to
    see them.
    """
    about: dict[str, list[Statement]] = {EVERY: [], STATED: [], ACCEPTED: []}
    for run in runs:
        for arm, found in run.arms.items():
            if not found.posteriors:
                continue
            hidden = run.hidden if arm == run.arm and run.kind != FLIP else ()
            present = {effect.effect for effect in hidden}
            left_out = {UNKNOWN, *found.invisible, *(effect.effect for effect in hidden if not effect.visible)}
            for slug in EFFECTS:
                stated = found.posteriors.get(slug)
                if slug in left_out:
                    continue
                statement = (stated or 0.0, slug in present)
                about[EVERY].append(statement)
                if stated is not None:
                    about[STATED].append(statement)
                if slug in found.names:
                    about[ACCEPTED].append(statement)
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
