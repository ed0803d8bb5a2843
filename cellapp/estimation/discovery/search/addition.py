"""Addition of a library effect: the best law that passes threshold, physical bounds and cross-validation."""

from __future__ import annotations

import numpy as np

from cellapp.estimation.discovery.candidates import LawScore
from cellapp.estimation.discovery.cross_validation import cross_validated_gain
from cellapp.estimation.discovery.search.bounds import within_bounds
from cellapp.estimation.discovery.search.comparison import floor_reached
from cellapp.estimation.discovery.search.free_part import are_look_alikes, explains_beside_free_parts
from cellapp.estimation.discovery.search.state import SearchProblem, SearchState, SearchStep
from cellapp.estimation.discovery.terms import ModelTerm
from cellapp.robot.effects import EFFECTS, Channel

_REMAINDER = 0.1
"""Share (rms) of an effect that its law may leave as a residual, which may look like another effect: laws are taken to
hold to 10 %."""

_OTHER_WAY = 0.1
"""Least share of the square explained by a wobble that its second direction must hold."""
_SAME_DIRECTION = 0.995
"""Cosine from which two columns count as the same motion: neighbouring axes of real arms meet to a few mrad."""


def addition(problem: SearchProblem, state: SearchState, score: LawScore) -> SearchStep | None:
    """Return the step that adds the law of ``score``; None if the law does not hold."""
    residual = state.fit.projected_residual
    possible = within_bounds(state.data, state.fit.terms, residual, score)
    if possible is None or possible.value <= problem.threshold or _is_remainder(state, possible):
        return None
    if _acts_as_one_joint(state, possible):
        return None
    if not explains_beside_free_parts(problem, state, possible):
        return None
    if cross_validated_gain(state.data, state.fit, possible.rows) <= 0.0:
        return None
    term = ModelTerm(possible.slug, possible.candidate.law, possible.names)
    title = EFFECTS[possible.slug].title
    return problem.step(possible.slug, f"{title} added", possible.value, (*state.fit.terms, term))


def _is_remainder(state: SearchState, score: LawScore) -> bool:
    """Return whether a law probably explains only the imperfection of a far larger look-alike's law."""
    if not floor_reached(state):
        return False
    fit = state.fit
    explained = score.explained_share * fit.projected_residual.square
    return any(
        explained < _REMAINDER**2 * fit.removed_square(number)
        for number, term in enumerate(fit.terms)
        if term.effect is not None and are_look_alikes(score.slug, term.effect.slug)
    )


def _acts_as_one_joint(state: SearchState, score: LawScore) -> bool:
    """Return whether a wobble tilts an axis in one direction only, which is just an offset of a neighbouring joint.

    The axis of a joint tilts about the axis of the preceding joint when that joint has an offset. Bearings tilt an axis
    in both directions. A tilt in one direction only is an error of that joint that depends on its neighbour's angle.
    """
    rows = score.rows
    axial = [column.channel is Channel.AXIS and column.wave is not None for column in score.candidate.columns]
    if not all(axial[place] for place in score.chosen):
        return False
    imitated = np.array([_is_joint_offset(state, score, k) for k in range(len(rows))])
    if not imitated.any():
        return False
    residual = state.fit.projected_residual
    return residual.explained(rows) - residual.explained(rows[imitated]) < _OTHER_WAY * residual.explained(rows)


def _is_joint_offset(state: SearchState, score: LawScore, place: int) -> bool:
    """Return whether a chosen column is the offset of some joint by the same wave."""
    column, row = score.candidate.columns[score.chosen[place]], score.rows[place]
    if column.wave is None or column.index is None:
        return False
    along = column.wave(state.data.readings.q[:, column.index])
    offsets = (state.fit.by_joint * along).swapaxes(0, 1).reshape(len(state.fit.by_joint[0]), -1)
    cosines = offsets @ row / np.maximum(np.linalg.norm(offsets, axis=1) * np.linalg.norm(row), 1e-300)
    return bool(np.max(np.abs(cosines)) > _SAME_DIRECTION)
