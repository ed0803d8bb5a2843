"""Search for effects from a ball in sockets: with few places, laws of any form fit the training readings.

Elastic joints come first if they hold: every arm with gears has them, and at few places bending links and the base look
alike. Another effect is added only if it improves the prediction of left-out places, and of most of them. With g the
decrease of the sum of squares at each left-out placement, the condition is sum g > t (sum g^2)^1/2. If m placements
gain alike, the sum is m^1/2 times the root; if one placement alone gains, both are equal. An effect may show much more
at some placements. It is therefore also added if more than half of them have very strong evidence for it and the rest
together none against it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.discovery.candidates import LawScore
from cellapp.estimation.discovery.cross_validation import may_leave_placements_out, placement_gains
from cellapp.estimation.discovery.search.addition import addition
from cellapp.estimation.discovery.search.state import SCORE_MARGIN, SearchProblem, SearchState, SearchStep
from cellapp.estimation.discovery.search.tuning import apply_step
from cellapp.ground.counting import counted
from cellapp.robot.effects.joint_compliance import JointCompliance
from cellapp.robot.kinematics.transforms import Array

_FIRST = JointCompliance.slug
_MOST_EFFECTS = 3
"""Most effects in one model: with some ten places, more would be chance."""
_MOST_TRIED = 12
"""Number of best laws tried in one step."""
_CLEAR = 1.5
"""t above: between the ratio of one placement alone (1) and that of four that gain alike (2)."""


def with_effects_in_sockets(problem: SearchProblem, start: SearchState) -> SearchState:
    """Add elastic joints if they hold, then further effects that improve the prediction of left-out places."""
    ranked = start.scan(problem.slugs).ranked(start.fit.projected_residual)
    elastic = [score for score in ranked if score.slug == _FIRST]
    state = _first_that_holds(problem, start, elastic) or start
    while may_leave_placements_out(start.data) and len(state.fit.terms) < _MOST_EFFECTS:
        problem.cancel.check()
        problem.say(f"model with {counted(len(state.fit.terms), 'effect')}")
        left = [slug for slug in problem.slugs if slug not in state.slugs]
        scores = state.scan(left).ranked(state.fit.projected_residual)
        after = _best_elsewhere(problem, state, scores)
        if after is None:
            break
        state = after
    return state


def _first_that_holds(problem: SearchProblem, state: SearchState, scores: Sequence[LawScore]) -> SearchState | None:
    """Return the state with the best law that passes threshold, bounds and cross-validation; None if none does."""
    for score in scores:
        if score.value <= problem.threshold:
            return None
        step = addition(problem, state, score)
        if step is not None:
            return _applied(problem, state, step)
    return None


def _best_elsewhere(problem: SearchProblem, state: SearchState, scores: Sequence[LawScore]) -> SearchState | None:
    """Return the state with the law that predicts left-out placements best, if it holds at most of them; else None."""
    found: list[tuple[float, SearchStep]] = []
    for score in scores[:_MOST_TRIED]:
        if score.value <= problem.threshold:
            break
        step = addition(problem, state, score)
        if step is None:
            continue
        term = step.terms[-1]
        columns = state.data.columns(term.slug, term.law, term.names)
        gains = placement_gains(state.data, state.fit, state.fit.displacements(columns))
        if _holds_elsewhere(gains):
            found.append((float(gains.sum()), step))
    if not found:
        return None
    return _applied(problem, state, max(found, key=lambda one: one[0])[1])


def _holds_elsewhere(gains: Array) -> bool:
    """Return whether most left-out placements gain, alike or with very strong evidence, from their gains (m,)."""
    most = gains.sum() > _CLEAR * np.linalg.norm(gains)
    beyond_doubt = np.mean(gains > SCORE_MARGIN) > 0.5 and gains[gains < 0.0].sum() > -SCORE_MARGIN
    return bool(most or beyond_doubt)


def _applied(problem: SearchProblem, state: SearchState, step: SearchStep) -> SearchState | None:
    try:
        return apply_step(problem, state, step)
    except TooFewReadings:  # too few for the parameters of the step
        return None
