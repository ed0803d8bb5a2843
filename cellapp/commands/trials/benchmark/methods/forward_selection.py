"""The method ``forward-bic``: least squares with forward selection by the extended Bayesian information criterion.

It has the same library of laws as cellapp. Each step adds the block of columns (of one joint, of one frame) with the
largest gain and refits everything. The criterion includes a penalty of 2 ln m for the choice among m blocks; without
it, chance would find names in every arm (Chen, Chen, Biometrika 95 (2008) 759).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy

from cellapp.commands.trials.benchmark.problem import Answer, Problem
from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.design.information import visible_root
from cellapp.estimation.discovery.candidates import CandidateLaw
from cellapp.estimation.discovery.joint_fit import JointFit, fit_terms
from cellapp.estimation.discovery.projected_residual import bic_gain
from cellapp.estimation.discovery.terms import UNKNOWN, ModelTerm
from cellapp.robot.effects import EFFECTS

_MOST_BLOCKS = 24


def main_columns(candidate: CandidateLaw) -> CandidateLaw:
    """Return a law without the columns that only refine others."""
    return candidate.keep([place for place, column in enumerate(candidate.columns) if not column.refines])


def library_laws(problem: Problem, fit: JointFit) -> list[CandidateLaw]:
    """Return the laws that the readings allow to test, each with its main columns."""
    slugs = [slug for slug in EFFECTS if slug != UNKNOWN]
    return [main for one in fit.candidates(problem.data, slugs) if len((main := main_columns(one)).columns)]


def even_odds(gain: float) -> float:
    """Return the posterior probability of a term with this ``gain`` of the criterion, at even prior odds."""
    return float(scipy.special.expit(gain / 2.0))


def gains(fit: JointFit, blocks: Sequence[CandidateLaw]) -> list[float]:
    """Return the gain of the criterion by adding each block to the fit."""
    if not blocks:
        return []
    residual, price = fit.projected_residual, 2.0 * math.log(len(blocks))
    ends = np.cumsum([len(one.columns) for one in blocks])
    behind = np.split(fit.projector.project(np.concatenate([one.rows for one in blocks])), ends[:-1])
    found = []
    for block, projected in zip(blocks, behind, strict=True):
        root, rank = visible_root(block.rows @ projected.T, np.linalg.norm(block.rows, axis=1))
        explained = float(np.sum((root.T @ (block.rows @ residual.projected)) ** 2))
        found.append(bic_gain(explained / residual.square, len(residual), int(rank)) - price)
    return found


def forward_bic(problem: Problem) -> Answer:
    """Add blocks of the library's laws as long as one gains."""
    fit, terms, names = problem.geometry_fit, dict[str, ModelTerm](), dict[str, float]()
    for _ in range(_MOST_BLOCKS):
        blocks = [
            one.keep(block) for one in library_laws(problem, fit) for block in one.blocks if _open(one, block, terms)
        ]
        gain, best = max(zip(gains(fit, blocks), blocks, strict=True), key=lambda one: one[0], default=(0.0, None))
        if best is None or gain <= 0.0:
            break
        before = terms[best.slug].names if best.slug in terms else ()
        columns = (*before, *(column.name for column in best.columns))
        after = {**terms, best.slug: ModelTerm(best.slug, best.law, columns)}
        try:
            fit = fit_terms(problem.data, tuple(after.values()))
        except TooFewReadings:  # the readings do not determine all columns
            break
        terms, names = after, {**names, best.slug: max(even_odds(gain), names.get(best.slug, 0.0))}
    return Answer(problem.predicted(fit.model), names)


def _open(law: CandidateLaw, block: Sequence[int], terms: dict[str, ModelTerm]) -> bool:
    """Return whether a block may be added: of a new effect, or of the same law of an accepted effect."""
    if law.slug not in terms:
        return True
    found = terms[law.slug]
    return law.law == found.law and not {law.columns[place].name for place in block} & set(found.names)
