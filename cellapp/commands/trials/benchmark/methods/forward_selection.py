"""The method ``forward-bic``: least squares with forward selection by the Bayesian information criterion.

It has the same library of laws as cellapp. In each step the law with the largest gain joins, and all is fitted anew.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellapp.commands.trials.benchmark.problem import Answer, Problem
from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.design.information import visible_root
from cellapp.estimation.discovery.candidates import CandidateLaw
from cellapp.estimation.discovery.joint_fit import JointFit, fit_terms
from cellapp.estimation.discovery.projected_residual import bic_gain
from cellapp.estimation.discovery.terms import UNKNOWN, ModelTerm
from cellapp.robot.effects import EFFECTS

_MOST_EFFECTS = 8


def main_columns(candidate: CandidateLaw) -> CandidateLaw:
    """A law without columns that only refine others."""
    return candidate.keep([place for place, column in enumerate(candidate.columns) if not column.refines])


def candidate_laws(problem: Problem, fit: JointFit, absent: list[str]) -> list[CandidateLaw]:
    """All laws of some effects that the readings allow to test, their main columns each."""
    return [main for one in fit.candidates(problem.data, absent) if len((main := main_columns(one)).columns)]


def gains(fit: JointFit, laws: Sequence[CandidateLaw]) -> list[float]:
    """Gain of the criterion by each law beside all that was fitted."""
    if not laws:
        return []
    residual = fit.projected_residual
    behind = np.split(fit.projector.project(np.concatenate([one.rows for one in laws])), _ends(laws)[:-1])
    found = []
    for law, projected in zip(laws, behind, strict=True):
        root, rank = visible_root(law.rows @ projected.T, np.linalg.norm(law.rows, axis=1))
        explained = float(np.sum((root.T @ (law.rows @ residual.projected)) ** 2))
        found.append(bic_gain(explained / residual.square, len(residual), int(rank)))
    return found


def _ends(laws: Sequence[CandidateLaw]) -> NDArray[np.intp]:
    return np.cumsum([len(one.columns) for one in laws])


def even_odds(gain: float) -> float:
    """Probability of what gains so much of the criterion, at even odds before."""
    return 1.0 / (1.0 + math.exp(-min(max(gain, -700.0), 700.0) / 2.0))


def forward_bic(problem: Problem) -> Answer:
    """Add laws of the library while one gains."""
    fit, names = problem.geometry_fit, dict[str, float]()
    while len(names) < _MOST_EFFECTS:
        absent = [slug for slug in EFFECTS if slug not in names and slug != UNKNOWN]
        laws = candidate_laws(problem, fit, absent)
        gain, best = max(zip(gains(fit, laws), laws, strict=True), key=lambda one: one[0], default=(0.0, None))
        if best is None or gain <= 0.0:
            break
        term = ModelTerm(best.slug, best.law, tuple(column.name for column in best.columns))
        try:
            fit = fit_terms(problem.data, (*fit.terms, term))
        except TooFewReadings:  # the readings do not determine all its columns
            break
        names[best.slug] = even_odds(gain)
    return Answer(problem.predicted(fit.model), names)
