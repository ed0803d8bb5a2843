"""The method ``cellapp``: discovery as ``cellapp discover`` does it, without a look at the held-out stops."""

from __future__ import annotations

from cellapp.commands.trials.benchmark.problem import Answer, Motion, Problem
from cellapp.estimation.discovery.discover import search_rows
from cellapp.estimation.motion.calibrate import recorded_arm
from cellapp.estimation.motion.discovery import MotionAtRest
from cellapp.ground.progress import CancelToken
from cellapp.robot.model import ArmModel


def search_of_effects(problem: Problem) -> Answer:
    """Name what the search accepts, with its posterior probabilities."""
    nominal = problem.data.model
    found = search_rows(problem.profile, nominal, problem.learn, problem.learn_conditions, CancelToken())
    if problem.motion is not None and (better := _by_recordings(problem, problem.motion, found.model)) is not None:
        return better
    assert found.judged.posteriors is not None
    names: dict[str, float] = {}
    for term, probability in zip(found.judged.fit.terms, found.judged.posteriors.terms, strict=True):
        names[term.slug] = max(probability, names.get(term.slug, 0.0))
    return Answer(problem.predicted(found.model), names)


def _by_recordings(problem: Problem, motion: Motion, by_samples: ArmModel) -> Answer | None:
    """What recordings show; None where the search of samples predicts their held-out blocks better."""
    name = problem.arm
    arm = recorded_arm(problem.profile, name, motion.stops, motion.recordings)
    found = MotionAtRest.of(arm, name, {name: problem.geometry_fit.model}, {name: motion.stops})
    if not found.better_than(by_samples):
        return None
    return Answer(problem.predicted(found.model), {effect.slug: effect.posterior for effect in found.effects})
