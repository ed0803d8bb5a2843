"""The method ``symbolic-regression``: genetic programming of gplearn on the residual of each joint.

A formula is kept if it explains rows that it was not fitted to. The effects that its variables stand for are named.
"""

from __future__ import annotations

import numpy as np

from cellapp.commands.trials.benchmark.features import JointRule, regressed_by_joint
from cellapp.commands.trials.benchmark.problem import Answer, Problem
from cellapp.robot.kinematics.transforms import Array

_POPULATION, _GENERATIONS, _PARSIMONY = 300, 8, 0.01
_LEAST_SHARE = 0.1
"""Least share of the variance of left-out rows that a formula must explain."""
_SEED = 0


def symbolic_regression(problem: Problem) -> Answer:
    """Name the effects of the variables in valid formulas."""
    return regressed_by_joint(problem, _formula)


def _formula(table: Array, offset: Array) -> tuple[JointRule, dict[int, float]]:
    """Fit a formula; its variables' probability is the explained share of left-out rows, zero if that is small."""
    from gplearn.genetic import SymbolicRegressor

    scale = float(offset.std()) or 1.0
    y, tested = offset / scale, np.arange(len(offset)) % 4 == 0
    formula = SymbolicRegressor(
        population_size=_POPULATION,
        generations=_GENERATIONS,
        function_set=("add", "sub", "mul"),
        parsimony_coefficient=_PARSIMONY,
        random_state=_SEED,
    )
    formula.fit(table[~tested], y[~tested])
    left = y[tested] - formula.predict(table[tested])
    share = 1.0 - float(np.mean(left**2)) / float(np.var(y[tested]))
    if share < _LEAST_SHARE:
        return lambda asked: np.zeros(len(asked)), {}
    used = {node for node in formula._program.program if isinstance(node, int)}
    return lambda asked: scale * formula.predict(asked), dict.fromkeys(used, share)
