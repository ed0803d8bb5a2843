"""The method ``ard``: automatic relevance determination over all library columns at once, by the simplest laws.

Each coefficient has its own prior precision, found by evidence (MacKay, Neural Comput. 4 (1992) 415; Tipping, J.
Mach. Learn. Res. 1 (2001) 211); most precisions grow without bound, and their columns are removed. An effect is named
if its remaining columns gain in the extended Bayesian information criterion beside all others.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cellapp.commands.trials.benchmark.methods.forward_selection import even_odds, library_laws
from cellapp.commands.trials.benchmark.problem import Answer, Problem
from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.design.information import NuisanceProjector
from cellapp.estimation.discovery.joint_fit import fit_terms
from cellapp.estimation.discovery.projected_residual import ProjectedResidual
from cellapp.estimation.discovery.terms import ModelTerm
from cellapp.ground.grouping import grouped
from cellapp.robot.kinematics.transforms import Array

_ROUNDS = 60
_PRUNED = 1e6
"""Precision, in units of the noise of a unit-length column, beyond which a column is removed."""


def relevant_rows(rows: Array, y: Array) -> NDArray[np.intp]:
    """Return which rows (m,) keep a finite prior precision; ``rows`` (m, d) have unit length, ``y`` (d,) unit noise."""
    kept = np.arange(len(rows))
    alpha = np.ones(len(rows))
    gram, moment = rows @ rows.T, rows @ y
    for _ in range(_ROUNDS):
        covariance = np.linalg.inv(gram[np.ix_(kept, kept)] + np.diag(alpha))
        mean = covariance @ moment[kept]
        determined = np.clip(1.0 - alpha * np.diag(covariance), 1e-12, 1.0)
        alpha = determined / np.maximum(mean**2, 1e-300)
        stays = alpha < _PRUNED
        kept, alpha = kept[stays], alpha[stays]
        if not len(kept):
            break
    return kept


def ard(problem: Problem) -> Answer:
    """Name the effects whose relevant columns gain beside all others."""
    fit = problem.geometry_fit
    laws = [own[0] for own in grouped((one.slug, one) for one in library_laws(problem, fit)).values()]
    owner = [(one, place) for one in laws for place in range(len(one.columns))]
    if not owner:
        return Answer(problem.predicted(fit.model))
    rows = np.concatenate([one.rows for one in laws])
    projected = fit.projector.project(rows)
    length = np.linalg.norm(projected, axis=1)
    seen = np.flatnonzero(length > 1e-6 * np.linalg.norm(rows, axis=1).clip(1e-300))
    kept = seen[relevant_rows(projected[seen] / length[seen, None], fit.projected_residual.projected)]
    best = grouped((owner[k][0].slug, int(k)) for k in kept)
    names, terms, price = dict[str, float](), [], 2.0 * math.log(len(rows))
    for slug, places in best.items():
        others = np.concatenate([fit.rows, *(rows[those] for other, those in best.items() if other != slug)])
        beside = ProjectedResidual(NuisanceProjector.of(others, np.zeros(len(others))), fit.residual)
        gain = beside.bic_gain(rows[places]) - price
        if gain > 0.0:
            names[slug] = even_odds(gain)
            law = owner[places[0]][0]
            terms.append(ModelTerm(slug, law.law, tuple(law.columns[owner[k][1]].name for k in places)))
    try:
        return Answer(problem.predicted(fit_terms(problem.data, tuple(terms)).model), names)
    except TooFewReadings:
        return Answer(problem.predicted(fit.model), names)
