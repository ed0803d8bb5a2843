"""The method ``geometry``: least squares of the geometry alone. It names nothing."""

from __future__ import annotations

from cellapp.commands.trials.benchmark.problem import Answer, Problem


def geometry(problem: Problem) -> Answer:
    """Predict by the best-fitting rigid arm."""
    return Answer(problem.predicted(problem.geometry_fit.model))
