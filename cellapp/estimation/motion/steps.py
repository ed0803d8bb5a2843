"""What a search of recordings has found so far: steps, the fit with their terms, and what it says of each law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cellapp.estimation.motion.fit import Problem, Solution
from cellapp.estimation.motion.terms import JointTerm, Law
from cellapp.robot.effects import EFFECTS, EffectTerm, MotionLaw
from cellapp.robot.kinematics.transforms import Array

SHOWN = 3.5
"""Standard errors from which a joint is named as having an effect that was found."""
_POSITIVE = (Law.INERTIA, Law.TIME_CONSTANT, Law.VIBRATION)
AT_REST = {Law.PLAY: "constant", Law.WINDUP: "load", Law.LINE: "lines", Law.COMPLIANCE: "linear"}
"""Forms of the effects' laws that say the same of stops; a lag has none."""
ONLY_MOTION = {
    Law.LAG: "a delay moves nothing at rest",
    Law.TIME_CONSTANT: "a time constant moves nothing at rest",
    Law.INERTIA: "nothing accelerates at rest",
    Law.VIBRATION: "an arm at rest does not swing",
}
"""Why stops cannot show a law."""
OF_SPEEDS = "it depends on speeds, which readings at rest do not have"
"""The same of a law of a plug-in."""
DENSE = 20
"""Cycles a turn from which lines are too dense for the few hundred stops of a plan."""


@dataclass(frozen=True)
class MotionEffect:
    """An effect that recordings show.

    Attributes
    ----------
    slug : str
        Of the effect; ``tracking_lag`` for the delay of a joint behind the others.
    names, units : tuple of str
    values, standard_errors : array
        Parameters of the joints that show it.
    joints : tuple of int
        Joints that show it, from 1.
    statistic : float
        Chi-square of the parameters.
    p_value : float
        Corrected for the alternatives.
    heldout_before_mm, heldout_after_mm : float
        Rms distance of held-out points before and after it entered.
    only_motion : str
        Why stops cannot show it; empty where they can.
    at_rest : bool
        Whether it belongs into commands of poses at rest.
    """

    slug: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array = field(repr=False)
    standard_errors: Array = field(repr=False)
    joints: tuple[int, ...]
    statistic: float
    p_value: float
    heldout_before_mm: float
    heldout_after_mm: float
    only_motion: str
    at_rest: bool

    def term(self) -> EffectTerm:
        """The same as a term of an arm model.

        Raises
        ------
        ValueError
            If it does not act at rest.
        """
        if not self.at_rest:
            raise ValueError(f"{self.slug} acts in motion only")
        form = AT_REST[Law(self.slug)]
        law = EFFECTS[self.slug].law(form)
        return EffectTerm(self.slug, self.names, self.values, self.standard_errors, self.units, law)


@dataclass(frozen=True)
class Step:
    """What entered: its terms, its statistic, and held-out errors before and after."""

    law: Law | MotionLaw
    terms: tuple[JointTerm, ...]
    statistic: float
    p_value: float
    before_mm: float
    after_mm: float


@dataclass(frozen=True, eq=False)
class State:
    """Problem with the terms so far, its solution, and the held-out error."""

    problem: Problem
    solution: Solution
    heldout_mm: float


def has(steps: Sequence[Step], law: Law | MotionLaw) -> bool:
    """Whether a law entered; one of a plug-in with any values of its tuned parameters."""
    return any(step.law.value == law.value for step in steps)


def terms_of(law: Law | MotionLaw, steps: Sequence[Step]) -> tuple[JointTerm, ...]:
    return tuple(term for step in steps if step.law is law for term in step.terms)


def tested(terms: Sequence[JointTerm]) -> list[JointTerm]:
    """Terms that are zero where there is no effect: all but frequencies and dampings."""
    return [term for term in terms if not term.part]


def with_values(state: State, terms: Sequence[JointTerm]) -> list[tuple[JointTerm, float]]:
    """Terms of one law, each with its value."""
    if not terms:
        return []
    laws = [term for term in state.problem.layout.terms if term.law is terms[0].law]
    values = dict(zip(laws, values_of(state, laws)[0].tolist(), strict=True))  # lags less the mean of all
    return [(term, values[term]) for term in terms]


def started(state: State, terms: Sequence[JointTerm]) -> Array:
    """Values with those of terms that have a shape at it."""
    values, first = state.solution.values.copy(), state.problem.layout.geometric
    for place, term in enumerate(terms, start=first):
        if term.shape:
            values[place] = term.start
    return values


def shown(state: State, law: Law | MotionLaw, steps: Sequence[Step]) -> tuple[JointTerm, ...]:
    """Terms of the joints that show a law; springs that push back are none."""
    terms = terms_of(law, steps)
    if not terms:
        return ()
    values, covariance = values_of(state, terms)
    errors, size = np.sqrt(np.diag(covariance)), values if law in _POSITIVE else np.abs(values)
    pairs = zip(terms, size > SHOWN * errors, strict=True)
    clear = {(term.joint, term.cycles) for term, shows in pairs if shows and not term.part}
    return tuple(term for term in terms if (term.joint, term.cycles) in clear)


def places_of(state: State, terms: Sequence[JointTerm]) -> list[int]:
    layout = state.problem.layout
    return [layout.geometric + layout.terms.index(term) for term in terms]


def values_of(state: State, terms: Sequence[JointTerm]) -> tuple[Array, Array]:
    """Values of some terms and their covariance; lags less their mean."""
    places = places_of(state, terms)
    values = state.solution.values[places]
    covariance = state.solution.noise.covariance[np.ix_(places, places)]
    if terms[0].law is Law.LAG:
        less_mean = np.eye(len(terms)) - 1.0 / len(terms)
        values, covariance = less_mean @ values, less_mean @ covariance @ less_mean.T
    return values, covariance


def statistic_of(state: State, terms: Sequence[JointTerm]) -> float:
    """Chi-square of some terms."""
    values, covariance = values_of(state, tested(terms))
    return float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)


def effect_of(state: State, law: Law | MotionLaw, steps: Sequence[Step]) -> MotionEffect:
    own, terms = [step for step in steps if step.law is law], shown(state, law, steps)
    values, covariance = values_of(state, terms_of(law, steps))
    places = [terms_of(law, steps).index(term) for term in terms]
    values, errors = values[places], np.sqrt(np.diag(covariance))[places]
    only = OF_SPEEDS if isinstance(law, MotionLaw) else ONLY_MOTION.get(law, "")
    if law is Law.LINE and all(term.cycles >= DENSE for term in terms):
        only = "lines as dense as these are aliased by the few hundred stops of a plan"
    return MotionEffect(
        slug=law.value,
        names=tuple(term.name for term in terms),
        units=tuple(term.unit for term in terms),
        values=values,
        standard_errors=errors,
        joints=tuple(sorted({term.joint + 1 for term in terms})),
        statistic=sum(step.statistic for step in own),
        p_value=min(step.p_value for step in own),
        heldout_before_mm=own[0].before_mm,
        heldout_after_mm=own[-1].after_mm,
        only_motion=only,
        at_rest=law in AT_REST,
    )
