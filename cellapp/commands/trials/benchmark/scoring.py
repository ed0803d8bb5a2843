"""Scores of answers: exact names, false names, honest probabilities, held-out error, time; by set and in total."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.commands.trials.benchmark.problem import Answer
from cellapp.commands.trials.sealed import GroundTruth
from cellapp.commands.trials.sealed_cases import NONE, OUT
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.ground.grouping import grouped
from cellapp.ground.results import Record
from cellapp.robot.kinematics.transforms import Array

CLEAN = "clean"
"""Set of the arms in which nothing is hidden."""


class Statement(Record):
    """An accepted name with its probability, and whether that effect is there."""

    effect: str
    probability: float
    true: bool


class ScoredAnswer(Record):
    """One answer beside the truth.

    Attributes
    ----------
    set : str
        Kind of the problem: clean, one, pair, triple, outside.
    hidden : tuple of str
        Effects that are there and larger than the noise; those below it count neither for nor against a method.
    exact : bool
        Whether the names are those of the hidden effects; outside the library: whether no effect of it is named.
    statements : tuple of Statement
        The accepted names.
    heldout_ratio : float
        Rms position error at the held-out stops over the rms length of the noise that was drawn there.
    seconds : float
        Processor time.
    """

    method: str
    problem: str
    set: str
    hidden: tuple[str, ...]
    exact: bool
    statements: tuple[Statement, ...]
    heldout_ratio: float
    seconds: float

    @property
    def false_names(self) -> int:
        """Number of accepted names of effects that are not there."""
        return sum(not one.true for one in self.statements)


class SetScore(Record):
    """Scores over a set of problems.

    ``exact`` and ``false_arms`` are shares of the arms, ``false_names`` names for each arm. ``brier`` is the mean
    square of probability less truth over accepted names, None without any; ``heldout_ratio`` and ``seconds`` medians.
    """

    n: int
    exact: float
    false_names: float
    false_arms: float
    brier: float | None
    heldout_ratio: float
    seconds: float


def scored(
    method: str, problem: str, arm: str, truth: GroundTruth, answer: Answer, measured: Array, seconds: float
) -> ScoredAnswer:
    """Compare an answer with the truth; ``measured`` (m, 3) [m] are the held-out points of the arm."""
    here = truth.effects if arm == truth.arm else ()
    kind = truth.kind if here and truth.kind != NONE else CLEAN
    hidden = {one.effect for one in here if one.visible_um > truth.noise_um[arm]} if kind != OUT else {UNKNOWN}
    faint = {one.effect for one in here} - hidden
    named = {slug: p for slug, p in answer.names.items() if slug not in faint}
    error_um = float(np.sqrt(np.mean(np.sum((answer.p_M - measured) ** 2, axis=1)))) * 1e6
    return ScoredAnswer(
        method=method,
        problem=problem,
        set=kind,
        hidden=tuple(sorted(hidden)),
        exact=not (set(named) - {UNKNOWN}) if kind == OUT else set(named) == hidden,
        statements=tuple(
            Statement(effect=slug, probability=p, true=slug in hidden)
            for slug, p in named.items()
            if slug != UNKNOWN or kind == CLEAN
        ),
        heldout_ratio=error_um / truth.held_out_um[arm],
        seconds=seconds,
    )


def by_set(answers: Sequence[ScoredAnswer]) -> Mapping[str, SetScore]:
    """Score of each set, in the order in which they first occur."""
    return {name: set_score(own) for name, own in grouped((one.set, one) for one in answers).items()}


def set_score(answers: Sequence[ScoredAnswer]) -> SetScore:
    """Score over some answers, at least one."""
    stated = [one for answer in answers for one in answer.statements]
    return SetScore(
        n=len(answers),
        exact=float(np.mean([one.exact for one in answers])),
        false_names=float(np.mean([one.false_names for one in answers])),
        false_arms=float(np.mean([one.false_names > 0 for one in answers])),
        brier=float(np.mean([(one.probability - one.true) ** 2 for one in stated])) if stated else None,
        heldout_ratio=float(np.median([one.heldout_ratio for one in answers])),
        seconds=float(np.median([one.seconds for one in answers])),
    )
