"""Free periodic curves of the joint errors in place of, or beside, the lines of a transmission error.

A gear error with many components would need dozens of lines. A smooth curve for each joint under a Gaussian-process
prior (see ``calibration.curve_prior``) holds them all; it is accepted by its evidence.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellapp.calibration.curve_prior import MAX_CYCLES, CurvePrior, fit_curve_prior, spectrum_variances
from cellapp.discovery.arm_data import ArmData, whitening
from cellapp.discovery.joint_fit import fit_terms
from cellapp.discovery.search.comparison import best_state, curve_price
from cellapp.discovery.search.state import SCORE_MARGIN, SearchProblem, SearchState
from cellapp.discovery.search.tuning import apply_step
from cellapp.discovery.terms import TRANSMISSION_ERROR, ModelTerm, has_curves, without_term
from cellapp.effects import EFFECTS, Law
from cellapp.effects.periodic import curve_law, wave_names
from cellapp.kinematics.transforms import Array

_LEAST_READINGS = 60
"""Readings from which curves are tried: 180 coordinates for 15 parameters of the prior beside some 30 of geometry."""
_LEAST_LEVER = 0.05
"""Joints whose rms lever is below this share of the longest get no curve: their errors do not show at the SMR."""
_LEAST_SIGNAL = 0.2
"""Joints whose curve moves the SMR by less than this share of the noise lose it again."""
_SCREENING = (40, 12)
"""Cycles and evaluations of the first pass, which finds the joints that need a curve, at a tenth of the full cost."""
_FULL = (MAX_CYCLES, 60)
"""Cycles and evaluations of the second pass."""
_KEPT_VARIANCE = 0.995
"""Share of a curve's prior variance that its kept cycles hold: what is cut, 7 % in rms, is below the noise of curves
that are found at all."""


def with_joint_curves(problem: SearchProblem, state: SearchState) -> SearchState | None:
    """The state with free curves where that is better, beside the lines found so far or in their place."""
    terms = state.fit.terms
    if state.data.stated is None or has_curves(terms) or len(state.data) < _LEAST_READINGS:
        return None
    bases = [state]
    rest = tuple(term for term in terms if term.slug != TRANSMISSION_ERROR)
    if len(rest) < len(terms):
        bases.append(problem.state(rest, state.steps, state.dropped))
    curved = [_add_curves(problem, base) for base in bases]
    best = best_state(problem, [state, *(one for one in curved if one is not None)])
    return None if best is state else best


def _add_curves(problem: SearchProblem, state: SearchState) -> SearchState | None:
    """Add curves to the joints whose residual needs them; None where no curve passes."""
    found = _curve_prior(problem, state.data, state.fit.terms)
    if found is None:
        return None
    curves, score = found
    law, names = _curve_law(curves)
    terms = state.fit.terms
    place = next((number for number, term in enumerate(terms) if term.slug == TRANSMISSION_ERROR), None)
    if place is not None:  # lines of more cycles stay, without a prior; those of fewer become part of the curve
        names = (*names, *(name for name in terms[place].names if name not in set(names)))
        terms = without_term(terms, place)
    term = ModelTerm(TRANSMISSION_ERROR, law, names, curves=curves)
    title = EFFECTS[TRANSMISSION_ERROR].title
    step = problem.step(TRANSMISSION_ERROR, f"{title}: a free curve a joint", score, (*terms, term))
    return apply_step(problem, state, step)


def _curve_prior(
    problem: SearchProblem, data: ArmData, terms: tuple[ModelTerm, ...]
) -> tuple[CurvePrior, float] | None:
    """Prior of the curves of the joints that need one, and its score; None if the evidence does not pass."""
    # in units of the stated uncertainty, as the noise of the curves is a factor on it
    fit = fit_terms(replace(data, sigma=data.stated), terms)
    residual = fit.projector.project(fit.residual)
    levers = np.sqrt(np.mean(np.sum(fit.by_joint**2, axis=0), axis=1))
    joints = tuple(np.flatnonzero(levers > _LEAST_LEVER * levers.max()).tolist())
    whitened = whitening(None, len(data))  # the derivatives are whitened already
    for cycles, evaluations in (_SCREENING, _FULL):
        curves = fit_curve_prior(
            data.readings.q, fit.by_joint, whitened, fit.projector.basis, residual, joints, cycles, evaluations
        )
        score = curves.evidence - curve_price(curves, 3 * len(data))
        if score <= max(problem.threshold, SCORE_MARGIN):
            return None
        moved = curves.amplitudes * levers[list(curves.joints)]
        kept = np.flatnonzero(moved > _LEAST_SIGNAL * curves.noise)
        joints = tuple(curves.joints[k] for k in kept)
        if not joints:
            return None
    curves = replace(curves, joints=joints, lengths=curves.lengths[kept], amplitudes=curves.amplitudes[kept])
    return curves, score


def _curve_law(curves: CurvePrior) -> tuple[Law, tuple[str, ...]]:
    """The law ``curve`` with the prior's parameters as constants, and the names of the columns that matter."""
    lengths = dict(zip(curves.joints, curves.lengths.tolist(), strict=True))
    amplitudes = dict(zip(curves.joints, curves.amplitudes.tolist(), strict=True))
    law = curve_law({joint: (lengths[joint], amplitudes[joint]) for joint in curves.joints}, MAX_CYCLES)
    names = [
        name for joint in curves.joints for name in wave_names(joint, range(2, _cycles_that_matter(lengths[joint]) + 1))
    ]
    return law, tuple(names)


def _cycles_that_matter(length: float) -> int:
    """Cycles a turn that hold all but a negligible share of a curve's variance."""
    share: Array = np.cumsum(spectrum_variances(length, 1.0, 10 * MAX_CYCLES))
    return min(int(np.searchsorted(share, _KEPT_VARIANCE * share[-1])) + 2, MAX_CYCLES)
