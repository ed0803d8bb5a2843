"""Score of a law with physically possible values, estimated linearly behind a model's parameters."""

from __future__ import annotations

import math

import numpy as np

from cellapp.design.information import visible_root
from cellapp.discovery.candidates import LawScore
from cellapp.discovery.joint_fit import BOUND_ERRORS
from cellapp.discovery.projected_residual import ProjectedResidual
from cellapp.discovery.search.scan import LawScan


def possible_score(residual: ProjectedResidual, score: LawScore) -> float:
    """The score without the blocks that need impossible values; minus infinity where no other block is left.

    A joint fit says the same more exactly (``search.addition.within_bounds``) at a hundred times the cost, which is too
    much for every rival of every effect.
    """
    candidate, value, chosen = score.candidate, score.value, score.chosen
    left = list(range(len(candidate.columns)))
    while True:
        impossible = _impossible_blocks(residual, score, chosen)
        if not impossible:
            return value
        left = [place for place in left if candidate.columns[place].block not in impossible]
        if not left:
            return -math.inf
        again = LawScan.of([candidate.keep(left)], residual.projector).score(0, residual, with_refinements=False)
        if again is None:
            return -math.inf
        value, chosen = again.value, tuple(left[place] for place in again.chosen)


def _impossible_blocks(residual: ProjectedResidual, score: LawScore, chosen: tuple[int, ...]) -> set[str]:
    """Blocks with a value outside its bounds by more than chance allows."""
    columns = [score.candidate.columns[place] for place in chosen]
    if all(math.isinf(column.lower) and math.isinf(column.upper) for column in columns):
        return set()
    rows = score.candidate.rows[list(chosen)]
    root, _ = visible_root(rows @ residual.projector.project(rows).T, np.linalg.norm(rows, axis=1))
    values = root @ (root.T @ (rows @ residual.projected))
    errors = np.linalg.norm(root, axis=1)
    return {
        column.block
        for column, value, error in zip(columns, values.tolist(), errors.tolist(), strict=True)
        if not column.lower - BOUND_ERRORS * error <= value <= column.upper + BOUND_ERRORS * error
    }
