"""The method ``cellapp``: discovery as ``cellapp discover`` does it, without a look at the held-out stops."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.commands.trials.benchmark.problem import Answer, Motion, Problem
from cellapp.estimation.discovery.discover import search_rows
from cellapp.estimation.discovery.outcome import Discovery
from cellapp.estimation.motion.calibrate import recorded_arm
from cellapp.estimation.motion.discovery import MotionAtRest
from cellapp.ground.progress import CancelToken


def search_of_effects(problem: Problem) -> Answer:
    """Name what the search accepts, with its posterior probabilities."""
    if problem.motion is not None and (found := _by_recordings(problem, problem.motion)) is not None:
        named = [(one.effect, one.posterior) for one in found.result.accepted if one.posterior is not None]
        return Answer(problem.predicted(found.model), _most_probable(named))
    searched = search_rows(problem.profile, problem.data.model, problem.learn, problem.learn_conditions, CancelToken())
    assert searched.judged.posteriors is not None
    slugs = [term.slug for term in searched.judged.fit.terms]
    named = list(zip(slugs, searched.judged.posteriors.terms, strict=True))
    return Answer(problem.predicted(searched.model), _most_probable(named))


def _most_probable(named: Sequence[tuple[str, float]]) -> dict[str, float]:
    """Each name once, with its largest probability."""
    return {slug: max(p for other, p in named if other == slug) for slug, _ in named}


def _by_recordings(problem: Problem, motion: Motion) -> Discovery | None:
    """Discovery that begins with what recordings show; None where that predicts no better than geometry."""
    name, geometry = problem.arm, problem.geometry_fit.model
    arm = recorded_arm(problem.profile, name, motion.stops, motion.recordings)
    found = MotionAtRest.of(arm, name, {name: geometry}, {name: motion.stops})
    return found.discovery(problem.profile, 0.0) if found.better_than(geometry) else None
