"""The method ``symbolic-regression``: genetic programming of gplearn on the residual of each joint.

A formula is kept where it explains rows that it was not fitted to. The effects that its variables stand for are named.
"""

from __future__ import annotations

import numpy as np

from cellapp.commands.trials.benchmark.features import Scaling, joint_features
from cellapp.commands.trials.benchmark.problem import Answer, JointProjection, Problem

_POPULATION, _GENERATIONS, _PARSIMONY = 300, 8, 0.01
_LEAST_SHARE = 0.1
"""Share of the variance of left-out rows that a formula must explain."""
_SEED = 0


def symbolic_regression(problem: Problem) -> Answer:
    """Name the effects of the variables in formulas that hold."""
    from gplearn.genetic import SymbolicRegressor

    projection = JointProjection.of(problem)
    learn, held = projection.context(held_out=False), projection.context(held_out=True)
    predicted = np.zeros((len(held), held.joints))
    names: dict[str, float] = {}
    tested = np.arange(len(learn)) % 4 == 0
    for joint in range(learn.joints):
        features = joint_features(learn, joint)
        scaling, y = Scaling.of(features), projection.offsets[:, joint]
        table, scale = scaling.table(features), float(y.std()) or 1.0
        formula = SymbolicRegressor(
            population_size=_POPULATION,
            generations=_GENERATIONS,
            function_set=("add", "sub", "mul"),
            parsimony_coefficient=_PARSIMONY,
            random_state=_SEED,
        )
        formula.fit(table[~tested], y[~tested] / scale)
        left = y[tested] / scale - formula.predict(table[tested])
        share = 1.0 - float(np.mean(left**2)) / float(np.var(y[tested] / scale))
        if share < _LEAST_SHARE:
            continue
        predicted[:, joint] = scale * formula.predict(scaling.table(joint_features(held, joint)))
        used = {node for node in formula._program.program if isinstance(node, int)}
        for place in used:
            slug = features[place].slug
            names[slug] = max(share, names.get(slug, 0.0))
    return Answer(projection.predicted(predicted), names)
