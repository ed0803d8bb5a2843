"""Scores of answers: exact names, false names, calibrated probabilities, held-out error, time; by set and in total."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from cellapp.commands.trials.benchmark.problem import Answer
from cellapp.commands.trials.sealed import GroundTruth
from cellapp.commands.trials.sealed_cases import NONE, OUT
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.ground.grouping import grouped
from cellapp.ground.results import Record
from cellapp.robot.kinematics.transforms import Array

CLEAN = "clean"
"""Name of the set of arms without hidden effects."""


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
        Kind of the problem: clean, one, pair, triple, outside; the name of a further cell, or of a real series.
    hidden : tuple of str
        Effects that are there and larger than the noise; those below it count neither for nor against a method.
    exact : bool or None
        Whether the names are those of the hidden effects; outside the library: whether no effect of it is named. None
        for a real series, whose truth nobody knows.
    statements : tuple of Statement
        The accepted names.
    heldout_ratio : float or None
        Rms position error at the held-out stops over the rms length of the noise that was drawn there.
    heldout_mm : float or None
        Mean position error at the held-out stops.
    seconds : float
        Processor time.
    answered : bool
        Whether the method takes this kind of problem.
    """

    method: str
    problem: str
    set: str
    hidden: tuple[str, ...]
    exact: bool | None
    statements: tuple[Statement, ...]
    heldout_ratio: float | None
    seconds: float
    heldout_mm: float | None = None
    answered: bool = True

    @property
    def false_names(self) -> int:
        """Number of accepted names of effects that are not there."""
        return sum(not one.true for one in self.statements)


class SetScore(Record):
    """Scores over a set of problems.

    ``answered`` of ``n`` were answered. ``exact`` and ``false_arms`` are shares of the arms whose truth is known, None
    without any, ``false_names`` names for each of them; what is not answered is not exact. ``brier`` is the mean square
    of probability less truth over accepted names, None without any; ``heldout_ratio`` and ``seconds`` are medians,
    ``heldout_mm`` is a mean.
    """

    n: int
    exact: float | None
    false_names: float | None
    false_arms: float | None
    brier: float | None
    heldout_ratio: float | None
    seconds: float | None
    heldout_mm: float | None = None
    answered: int = 0


def scored(
    method: str,
    problem: str,
    arm: str,
    truth: GroundTruth,
    answer: Answer | None,
    measured: Array,
    seconds: float,
    cell: str = "",
) -> ScoredAnswer:
    """Compare an answer with the truth; ``measured`` (m, 3) [m] are the arm's held-out points.

    The answer is None if the method gave none. ``cell`` is the set of a further cell.
    """
    here = truth.effects if arm == truth.arm else ()
    kind = truth.kind if here and truth.kind != NONE else CLEAN
    hidden = {one.effect for one in here if one.visible_um > truth.noise_um[arm]} if kind != OUT else {UNKNOWN}
    faint = {one.effect for one in here} - hidden
    named = {} if answer is None else {slug: p for slug, p in answer.names.items() if slug not in faint}
    lengths = None if answer is None else np.linalg.norm(answer.p_M - measured, axis=1)
    exact = not (set(named) - {UNKNOWN}) if kind == OUT else set(named) == hidden
    return ScoredAnswer(
        method=method,
        problem=problem,
        set=cell or kind,
        hidden=tuple(sorted(hidden)),
        exact=exact and answer is not None,
        statements=tuple(
            Statement(effect=slug, probability=p, true=slug in hidden)
            for slug, p in named.items()
            if slug != UNKNOWN or kind == CLEAN
        ),
        heldout_ratio=None if lengths is None else 1e6 * float(np.sqrt(np.mean(lengths**2))) / truth.held_out_um[arm],
        seconds=seconds,
        heldout_mm=None if lengths is None else 1e3 * float(np.mean(lengths)),
        answered=answer is not None,
    )


def by_set(answers: Sequence[ScoredAnswer]) -> Mapping[str, SetScore]:
    """Return the score of each set, in the order of their first occurrence."""
    return {name: set_score(own) for name, own in grouped((one.set, one) for one in answers).items()}


def set_score(answers: Sequence[ScoredAnswer]) -> SetScore:
    """Compute the score over some answers, at least one."""
    stated = [one for answer in answers for one in answer.statements]
    known = [one for one in answers if one.exact is not None]
    told = [one for one in answers if one.answered]
    return SetScore(
        n=len(answers),
        exact=_over([one.exact for one in known]),
        false_names=_over([one.false_names for one in known]),
        false_arms=_over([one.false_names > 0 for one in known]),
        brier=_over([(one.probability - one.true) ** 2 for one in stated]),
        heldout_ratio=_over([one.heldout_ratio for one in told if one.heldout_ratio is not None], np.median),
        seconds=_over([one.seconds for one in told], np.median),
        heldout_mm=_over([one.heldout_mm for one in told if one.heldout_mm is not None]),
        answered=len(told),
    )


def _over(values: Sequence[Any], of: Callable[[Any], Any] = np.mean) -> float | None:
    """Return the mean of some values, or another statistic ``of``; None if there are no values."""
    return float(of(values)) if values else None
