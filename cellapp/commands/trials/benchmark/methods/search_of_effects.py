"""The method ``cellapp``: discovery as ``cellapp discover`` does it, without a look at the held-out stops."""

from __future__ import annotations

from cellapp.commands.trials.benchmark.problem import Answer, Problem
from cellapp.estimation.discovery.search.stepwise import search
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.ground.progress import CancelToken
from cellapp.robot.effects import EFFECTS


def search_of_effects(problem: Problem) -> Answer:
    """Name what the search accepts, with its posterior probabilities."""
    found = search(problem.data, [slug for slug in EFFECTS if slug != UNKNOWN], CancelToken())
    assert found.posteriors is not None
    names: dict[str, float] = {}
    for term, probability in zip(found.fit.terms, found.posteriors.terms, strict=True):
        names[term.slug] = max(probability, names.get(term.slug, 0.0))
    return Answer(problem.predicted(found.fit.model), names)
