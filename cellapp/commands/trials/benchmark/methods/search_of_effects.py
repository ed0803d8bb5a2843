"""The method ``cellapp``: the search of ``cellapp discover``, which does not see the held-out stops."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from cellapp.commands.trials.benchmark.problem import Answer, Motion, Problem
from cellapp.estimation.discovery.discover import Searched, search_rows
from cellapp.estimation.motion.calibrate import recorded_arm
from cellapp.estimation.motion.discovery import MotionAtRest
from cellapp.ground.progress import CancelToken


def search_of_effects(problem: Problem) -> Answer:
    """Name the effects that the search accepts, with their posterior probabilities."""

    @cache
    def searched() -> Searched:
        return search_rows(problem.profile, problem.data.model, problem.learn, problem.learn_conditions, CancelToken())

    shown = None if problem.motion is None else _shown_by_recordings(problem, problem.motion)
    if shown is not None and shown.stands_beside(lambda: searched().model):
        found = shown.discovery(problem.profile, 0.0)
        named = [(one.effect, one.posterior) for one in found.result.accepted if one.posterior is not None]
        return Answer(problem.predicted(found.model), _most_probable(named))
    judged = searched().judged
    assert judged.posteriors is not None
    slugs = [term.slug for term in judged.fit.terms]
    return Answer(
        problem.predicted(searched().model), _most_probable(list(zip(slugs, judged.posteriors.terms, strict=True)))
    )


def _most_probable(named: Sequence[tuple[str, float]]) -> dict[str, float]:
    """Return each name once, with its largest probability."""
    return {slug: max(p for other, p in named if other == slug) for slug, _ in named}


def _shown_by_recordings(problem: Problem, motion: Motion) -> MotionAtRest:
    name, geometry = problem.arm, problem.geometry_fit.model
    arm = recorded_arm(problem.profile, name, motion.stops, motion.recordings)
    return MotionAtRest.of(arm, name, {name: geometry}, {name: motion.stops})
