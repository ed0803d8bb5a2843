"""Removal of the blocks of a law whose values are physically impossible, by a linear estimate or a joint fit.

A negative stiffness at one joint is an alias of another cause there. It is no evidence against the effect at other
joints.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.design.information import visible_root
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.candidates import BOUND_ERRORS, LawScore, blocks_beyond_bounds
from cellapp.estimation.discovery.joint_fit import fit_terms
from cellapp.estimation.discovery.projected_residual import ProjectedResidual
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.terms import ModelTerm, ModelTerms

NEARLY = 0.3
"""Relative change of a linearly estimated value that a joint fit may bring."""


def within_bounds(data: ArmData, others: ModelTerms, residual: ProjectedResidual, score: LawScore) -> LawScore | None:
    """Remove blocks whose values, fitted beside ``others``, are impossible; return the new score, or None."""

    def impossible(current: LawScore) -> set[str]:
        perhaps, surely = impossible_blocks(residual, current, NEARLY)
        if perhaps == surely:  # a joint fit would say the same
            return surely
        term = ModelTerm(current.slug, current.candidate.law, current.names)
        return fit_terms(data, (*others, term)).blocks_beyond_bounds(len(others))

    with_refinements = any(score.candidate.refines((place,)) for place in score.chosen)
    try:
        return _without_blocks(residual, score, impossible, with_refinements=with_refinements)
    except TooFewReadings:  # the readings do not determine all its columns
        return None


def possible_score(residual: ProjectedResidual, score: LawScore) -> float:
    """Return the score without blocks that need impossible values; minus infinity if no other block is left.

    Values are estimated linearly. A joint fit (``within_bounds``) is more exact at a hundred times the cost, too much
    for every rival of every effect.
    """
    possible = _without_blocks(
        residual, score, lambda current: impossible_blocks(residual, current)[1], with_refinements=False
    )
    return -math.inf if possible is None else possible.value


def _without_blocks(
    residual: ProjectedResidual,
    score: LawScore,
    impossible: Callable[[LawScore], set[str]],
    *,
    with_refinements: bool,
) -> LawScore | None:
    """Select a law's other blocks again until ``impossible`` names none; None if no block is left."""
    candidate, current = score.candidate, score
    left = list(range(len(candidate.columns)))
    while banned := impossible(current):
        left = [place for place in left if candidate.columns[place].block not in banned]
        if not left:
            return None
        scan = LawScan.of([candidate.keep(left)], residual.projector)
        again = scan.score(0, residual, with_refinements=with_refinements)
        if again is None:
            return None
        chosen = tuple(left[place] for place in again.chosen)
        current = replace(again, candidate=candidate, chosen=chosen)
    return current


def impossible_blocks(residual: ProjectedResidual, score: LawScore, nearly: float = 0.0) -> tuple[set[str], set[str]]:
    """Find blocks with a linearly estimated value outside its bounds by more than chance allows.

    Return those that may be outside if values change by a share ``nearly`` and their errors, and those that surely are.
    """
    columns = [score.candidate.columns[place] for place in score.chosen]
    if all(math.isinf(column.lower) and math.isinf(column.upper) for column in columns):
        return set(), set()
    root, _ = visible_root(score.rows @ residual.projector.project(score.rows).T, np.linalg.norm(score.rows, axis=1))
    values, errors = root @ (root.T @ (score.rows @ residual.projected)), np.linalg.norm(root, axis=1)
    change = nearly * np.abs(values) + (BOUND_ERRORS * errors if nearly else 0.0)
    more, less = (blocks_beyond_bounds(columns, values + sign * change, errors) for sign in (1.0, -1.0))
    return more | less, more & less
