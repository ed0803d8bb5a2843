"""State of a search of recordings: steps, the fit with their terms, and the effects that follow."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
import scipy

from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.discovery.arm_data import whitening
from cellapp.estimation.discovery.records import BeforeAfter, Evidence, LawRecord, MotionEffectResult
from cellapp.estimation.motion.fit import Solution, with_lags_in_clocks
from cellapp.estimation.motion.laws import JointLaw, JointState, JointTerm, line, of_all_joints
from cellapp.estimation.motion.residuals import MotionProblem, residuals
from cellapp.estimation.motion.tracks import Track
from cellapp.ground.results import Estimate
from cellapp.robot.effects import EFFECTS, EffectTerm, MotionLaw, term_from_json
from cellapp.robot.effects.backlash import BELL, LOAD_BELL, LOAD_REACH, REACH
from cellapp.robot.effects.joint_compliance import SECOND_KNEE
from cellapp.robot.kinematics.chain import Geometry, JointAngles, joint_jacobian
from cellapp.robot.kinematics.transforms import Array

SHOWN = 3.5
"""Standard errors at which a joint is reported as having an effect."""
_AS_WELL = 0.5 * SHOWN
"""Standard errors for a joint beside another one that clearly has the effect."""
_OF_GEARS = (JointLaw.PLAY, JointLaw.WINDUP, JointLaw.COMPLIANCE)
"""Laws that all joints of an arm probably have if one has them."""
CONFOUNDED = (JointLaw.PLAY, JointLaw.WINDUP)
"""Laws that move a joint alike if its load hardly changes."""
_LEAST = 1e-300
_LEAST_LOG = math.log(_LEAST)
_POSITIVE = (JointLaw.COMPLIANCE, JointLaw.INERTIA, JointLaw.TIME_CONSTANT, JointLaw.VIBRATION)
AT_REST: Mapping[JointLaw | MotionLaw, str] = {
    JointLaw.PLAY: "constant",
    JointLaw.WINDUP: "load",
    JointLaw.LINE: "lines",
    JointLaw.ONE_CYCLE: "",
    JointLaw.COMPLIANCE: "linear",
}
"""Forms of the laws at rest that describe the same effect, without refining parts; a lag has none."""
ONLY_MOTION = {law for law in JointLaw if law.only_motion}
"""Laws that stops cannot show."""
_REACHES = {(False, False): REACH, (False, True): BELL, (True, False): LOAD_REACH, (True, True): LOAD_BELL}
"""Constants of laws at rest by (under load, as a bell curve)."""
OF_SPEEDS = "it depends on speeds, which readings at rest do not have"
"""Reason why stops cannot show a law of a plug-in."""
DENSE = 20
"""Cycles a turn at which lines are too dense for the few hundred stops of a plan."""


@dataclass(frozen=True, eq=False)
class MotionEffect:
    """An effect found in recordings, as it is stored; the terms of its parameters, and the probability that it is
    present. Its slug is ``tracking_lag`` for the delay of a joint behind the others."""

    found: MotionEffectResult
    terms: tuple[JointTerm, ...]
    posterior: float

    def term(self) -> EffectTerm:
        """Return an effect that acts at rest as a term of an arm model."""
        return term_from_json(self.found.model_dump(), EFFECTS)


@dataclass(frozen=True)
class LawStep:
    """A step of the search: its terms, chi-square, log probability of as large a value by chance, and held-out errors
    before and after; ``other_log_p`` is the log probability of the best confounded law."""

    law: JointLaw | MotionLaw
    terms: tuple[JointTerm, ...]
    statistic: float
    log_p: float
    before_mm: float
    after_mm: float = math.nan
    other_log_p: float = math.inf


@dataclass(frozen=True, eq=False)
class State:
    """Problem with the terms of the steps so far, its solution, and the held-out error."""

    problem: MotionProblem
    solution: Solution
    heldout_mm: float
    steps: tuple[LawStep, ...] = ()

    def has(self, law: JointLaw | MotionLaw) -> bool:
        """Return whether a law entered; a law of a plug-in with any values of its tuned parameters."""
        return any(step.law.value == law.value for step in self.steps)

    def terms_of(self, law: JointLaw | MotionLaw) -> tuple[JointTerm, ...]:
        """Return the terms of a law."""
        return tuple(term for step in self.steps if step.law is law for term in step.terms)

    def places_of(self, terms: Sequence[JointTerm]) -> list[int]:
        """Return the indices of some terms among the parameters."""
        return [self.problem.geometric + self.problem.terms.index(term) for term in terms]

    def values_of(self, terms: Sequence[JointTerm]) -> tuple[Array, Array]:
        """Return the values of some terms and their covariance; lags relative to the mean of all."""
        values, covariance = with_lags_in_clocks(self.problem, self.solution)
        places = self.places_of(terms)
        return values[places], covariance[np.ix_(places, places)]

    def statistic_of(self, terms: Sequence[JointTerm]) -> float:
        """Return the chi-square of some terms."""
        values, covariance = self.values_of(tested(terms))
        return float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)

    def entered(self, step: LawStep) -> State:
        """Return the state with a step, whose terms were fitted; further terms of a law that entered before join its
        step, except for lines and vibrations."""
        steps, laws, step = list(self.steps), [one.law for one in self.steps], replace(step, after_mm=self.heldout_mm)
        if step.law in (JointLaw.LINE, JointLaw.VIBRATION) or step.law not in laws:
            return replace(self, steps=(*steps, step))
        place = laws.index(step.law)
        one = steps[place]
        terms, statistic = one.terms + step.terms, one.statistic + step.statistic
        steps[place] = replace(one, terms=terms, statistic=statistic, after_mm=step.after_mm)
        return replace(self, steps=tuple(steps))

    def steps_with(self, terms: Mapping[JointLaw | MotionLaw, Sequence[JointTerm]]) -> list[LawStep]:
        """Return the steps with other terms of some laws, without those that then have none."""
        changed = (replace(step, terms=tuple(terms.get(step.law, step.terms))) for step in self.steps)
        return [step for step in changed if step.terms]

    def steps_without(self, terms: Collection[JointTerm]) -> list[LawStep]:
        """Return the steps without some terms."""
        kept = (replace(step, terms=tuple(term for term in step.terms if term not in terms)) for step in self.steps)
        return [step for step in kept if step.terms]

    def shown(self, law: JointLaw | MotionLaw) -> tuple[JointTerm, ...]:
        """Return the terms of the joints that show a law; springs of the wrong sign do not count. A refining part
        counts with the plain part of its joint. If one joint shows a law of gears, other joints with the usual sign
        need half as many standard errors: the law is known by then, and commands without these terms would have larger
        errors."""
        terms = self.terms_of(law)
        if not terms:
            return ()
        values, covariance = self.values_of(terms)
        size = dict[tuple[int, int], float]()
        for term, own in zip(terms, (values / np.sqrt(np.diag(covariance))).tolist(), strict=True):
            if not term.part and not term.refines:
                size[term.place] = max(size.get(term.place, 0.0), own if law in _POSITIVE else abs(own))
        for place in {term.place for term in terms if term.refines and size.get(term.place, 1.0) > 0.0}:
            own_terms = [term for term in terms if term.place == place]
            probability = float(scipy.special.chdtrc(len(own_terms), self.statistic_of(own_terms)))
            size[place] = math.sqrt(float(scipy.special.chdtri(1, max(probability, _LEAST))))
        usual = {term.place for term, value in zip(terms, values.tolist()) if value > 0.0 and not term.refines}
        clear = {place for place, own in size.items() if own > SHOWN}
        if clear and law in _OF_GEARS:
            clear |= {place for place, own in size.items() if own > _AS_WELL and place in usual}
        return tuple(term for term in terms if term.place in clear)


def log_chance(statistic: float, parameters: int, tried: int) -> float:
    """Return the log probability of a chi-square at least this large by chance, in the best of ``tried`` alternatives.
    If it underflows, use the first terms of the asymptotic series."""
    probability = float(scipy.special.chdtrc(parameters, statistic))
    if probability > 0.0:
        return min(0.0, math.log(probability) + math.log(tried))
    half, degree = 0.5 * statistic, 0.5 * parameters - 1.0
    return -half + degree * math.log(half) + math.log1p(degree / half) - math.lgamma(degree + 1.0) + math.log(tried)


def step_of(
    law: JointLaw | MotionLaw, terms: tuple[JointTerm, ...], trial: State, tried: int, before: State
) -> LawStep:
    """Return the step from a state to a trial with further terms of a law, the best of ``tried`` alternatives."""
    statistic = trial.statistic_of(terms)
    return LawStep(law, terms, statistic, log_chance(statistic, len(tested(terms)), tried), before.heldout_mm)


def tested(terms: Sequence[JointTerm]) -> list[JointTerm]:
    """Return the terms that are zero without an effect: all but frequencies and dampings."""
    return [term for term in terms if not term.part]


def effects_of(state: State) -> tuple[MotionEffect, ...]:
    """Return the effects of all laws that entered and that some joint shows.

    Two laws with one cause give one effect: play beside wind-up is the dry part of friction; two cycles beside more
    than three times as much of one cycle are of the same disc.
    """
    groups = {law: {law: state.shown(law)} for law in dict.fromkeys(step.law for step in state.steps)}
    if groups.get(JointLaw.WINDUP, {}).get(JointLaw.WINDUP) and JointLaw.PLAY in groups:
        groups[JointLaw.WINDUP].update(groups.pop(JointLaw.PLAY))
    if JointLaw.ONE_CYCLE in groups and JointLaw.LINE in groups:
        lines = groups[JointLaw.LINE][JointLaw.LINE]
        tilted = _of_tilted_discs(state, (*groups[JointLaw.ONE_CYCLE][JointLaw.ONE_CYCLE], *lines))
        groups[JointLaw.ONE_CYCLE][JointLaw.LINE] = tilted
        groups[JointLaw.LINE][JointLaw.LINE] = tuple(term for term in lines if term not in tilted)
    return tuple(_effect_of(state, group) for group in groups.values() if any(group.values()))


def _of_tilted_discs(state: State, waves: Sequence[JointTerm]) -> tuple[JointTerm, ...]:
    """Return lines of two cycles that are less than a third of one cycle of the same joint."""
    size = dict[tuple[int, int], float]()
    for term, value in zip(waves, state.values_of(waves)[0].tolist(), strict=True):
        size[term.joint, term.cycles] = math.hypot(size.get((term.joint, term.cycles), 0.0), value)
    small = {joint for joint, count in size if count == 2 and size[joint, 2] < size.get((joint, 1), 0.0) / 3.0}
    return tuple(term for term in waves if term.cycles == 2 and term.joint in small)


def _effect_of(state: State, group: Mapping[JointLaw | MotionLaw, tuple[JointTerm, ...]]) -> MotionEffect:
    """Return the effect of the first law of a group, to which the other laws belong."""
    law, *others = (one for one, its in group.items() if its)
    terms = tuple(term for its in group.values() for term in its)
    values, covariance = state.values_of(terms)
    own = [step for step in state.steps if set(step.terms) & set(terms)]
    only = OF_SPEEDS if isinstance(law, MotionLaw) else law.only_motion
    if law is JointLaw.LINE and all(term.cycles >= DENSE for term in terms):
        only = "lines as dense as these are aliased by the few hundred stops of a plan"
    log_p, statistic = min(step.log_p for step in own), sum(step.statistic for step in own)
    names = [term.name.replace("half_play", "dry") if JointLaw.PLAY in others else term.name for term in terms]
    errors = np.sqrt(np.diag(covariance)).tolist()
    at_rest = law in AT_REST
    found = MotionEffectResult(
        effect=law.value,
        title=law.title if isinstance(law, JointLaw) and law.title else EFFECTS[law.value].title,
        joints=tuple(sorted({term.joint + 1 for term in terms})),
        parameters=Estimate.by_name(names, values.tolist(), errors, [term.unit for term in terms]),
        evidence=Evidence(
            statistic=statistic,
            corrected_p=math.exp(max(log_p, _LEAST_LOG)),
            heldout_mm=BeforeAfter(before=own[0].before_mm, after=own[-1].after_mm),
        ),
        only_motion=only or None,
        at_rest=at_rest,
        law=LawRecord(name=_form(law, terms, others), constants=_constants(terms)) if at_rest else None,
    )
    parameters = sum(len(tested(step.terms)) for step in own)
    return MotionEffect(found, terms, _probability(state, statistic, parameters, log_p) * _odds(state.steps, law))


def _constants(terms: Sequence[JointTerm]) -> dict[str, float]:
    """Return the constants of the law at rest: reaches of lost motion, knees of springs."""
    reaches = {
        _REACHES[term.law is JointLaw.WINDUP, term.fading.bell].key(term.joint): term.fading.reach
        for term in terms
        if term.fading
    }
    return reaches | {term.knee.constant.key(term.joint): term.knee.torque for term in terms if term.knee}


def _form(law: JointLaw | MotionLaw, terms: Sequence[JointTerm], others: Sequence[JointLaw | MotionLaw]) -> str:
    """Return the form of the effect's law that describes the same at stops."""
    if any(term.fading for term in terms):
        return "gradual"
    if knees := [term.knee for term in terms if term.knee]:
        return "three_slope" if any(knee.constant is SECOND_KNEE for knee in knees) else "two_slope"
    if others:
        return "both" if JointLaw.PLAY in others else "tilted"
    return AT_REST[law]


def beside_others(state: State, step: LawStep) -> LawStep:
    """Return the step with the evidence of its terms beside all others. It may be larger than when the step entered:
    until then, effects of the others counted as noise."""
    parameters = len(tested(step.terms))
    statistic = state.statistic_of(step.terms)
    more = log_chance(statistic, parameters, 1) - log_chance(step.statistic, parameters, 1)
    return replace(step, statistic=statistic, log_p=min(step.log_p + more, 0.0), other_log_p=step.other_log_p + more)


def is_improbable(state: State, step: LawStep) -> bool:
    """Return whether a step is more probably absent than present."""
    return _probability(state, step.statistic, len(tested(step.terms)), step.log_p) < 0.5


def _odds(steps: Sequence[LawStep], law: JointLaw | MotionLaw) -> float:
    """Return the probability of a law against the one confounded with it, at even prior odds, by the evidence of
    either; 1 if both entered or none is confounded."""
    entered = {step.law: step for step in steps if step.law in CONFOUNDED}
    if law not in entered or len(entered) == len(CONFOUNDED):
        return 1.0
    return float(scipy.special.expit(entered[law].other_log_p - entered[law].log_p))


def _probability(state: State, statistic: float, parameters: int, log_p: float) -> float:
    """Return the probability that terms with this chi-square are present, by the Bayesian information criterion at even
    odds, corrected for alternatives as the p-value is."""
    points = sum(min(1.0, source.worth) * len(source.rows) for source in state.solution.sources)
    tried = max(log_p - log_chance(statistic, parameters, 1), 0.0)
    return float(scipy.special.expit(0.5 * (statistic - parameters * math.log(max(points, 2.0))) - tried))


# -- Laws of recordings with non-linear parameters: time constants and vibration of joints ----------------------------
#
# Their terms are linearised at a shape (``terms``); a fit gives new values, which define the next shape. A vibration is
# searched in the residuals: how much they contain of the response of a spring of each frequency, on each joint. Columns
# and residuals pass the filter that whitens the residuals; a spring of one frequency passes it as a tone of that
# frequency.


FREQUENCIES = np.geomspace(3.0, 40.0, 47)
"""Natural frequencies to try [Hz]: some 6 % apart, the width of a resonance at usual damping."""
_DAMPING = 0.06
"""Start value of the damping: arms swing on for some cycles."""
_CHUNK = 4096
_SAME = 1e-3
"""Relative change of a shape below which it has settled."""
_REACH: Mapping[JointLaw | MotionLaw, tuple[tuple[float, float], ...]] = {
    JointLaw.TIME_CONSTANT: ((1e-3, 0.3),),
    JointLaw.VIBRATION: ((1e-7, 1.0), (1.0, 60.0), (3e-3, 0.7)),
}
"""Bounds of the shapes: time constant [s]; gain [s^2], frequency [Hz], damping."""


def reshaped(terms: Sequence[JointTerm], values: Sequence[float]) -> list[JointTerm]:
    """Return the terms linearised at their ``values``; those without a shape unchanged."""
    found, rest = list(terms), dict(zip(terms, values, strict=True))
    for place, term in enumerate(terms):
        if not term.shape:
            continue
        near = [rest[replace(term, parameter=name)] for name in term.law.parameters]
        shape = tuple(float(np.clip(v, *reach)) for v, reach in zip(near, _REACH[term.law], strict=True))
        # at most a factor of two at once: far from its shape the linearisation fails
        shape = tuple(float(np.clip(new, 0.5 * old, 2.0 * old)) for new, old in zip(shape, term.shape))
        found[place] = replace(term, shape=shape)
    return found


def settled(terms: Sequence[JointTerm], before: Sequence[JointTerm]) -> bool:
    """Return whether all shapes have settled."""
    pairs = [(new, old) for a, b in zip(terms, before, strict=True) for new, old in zip(a.shape, b.shape)]
    return all(abs(new - old) <= _SAME * abs(old) for new, old in pairs)


def strongest_vibration(
    problem: MotionProblem, solution: Solution, taken: Sequence[int]
) -> tuple[float, tuple[JointTerm, ...]]:
    """Find the vibration that is least likely to be chance, of a joint that is not ``taken``; return half of its
    chi-square, and its terms."""
    free = sorted(set(range(problem.parameters.joints)) - set(taken))
    product, square = _matched(problem, solution, free)
    product, square = np.maximum(product, 0.0), np.maximum(square, 1e-300)  # springs yield to a load, never against it
    power = 0.5 * product**2 / square
    joint, place = np.unravel_index(int(np.argmax(power)), power.shape)
    gain = float(product[joint, place] / square[joint, place])
    shape, law = (gain, float(FREQUENCIES[place]), _DAMPING), JointLaw.VIBRATION
    terms = tuple(JointTerm(law, int(joint), name, shape=shape) for name in law.parameters)
    return float(power[joint, place]), terms


def _matched(problem: MotionProblem, solution: Solution, free: Sequence[int]) -> tuple[Array, Array]:
    """Return the products of residuals and unit responses by joint and frequency (N, F), and of the responses with
    themselves, in units of the noise; zero for joints that are not ``free``."""
    from scipy.signal import freqz  # it loads scipy.stats: not for commands without recordings

    product, square = np.zeros((2, problem.parameters.joints, len(FREQUENCIES)))
    for track, white, u, scale, angular, weight in white_residuals(problem, solution, twice=True):
        _, gain = freqz(white, 1.0, 2.0 * math.pi * FREQUENCIES * track.stamps.period_s)
        even = track.path.even
        for joint in free:
            for place, frequency in enumerate(FREQUENCIES.tolist()):
                answer = even.at(even.vibrating(joint, frequency, _DAMPING), u)
                product[joint, place] += scale * float(angular[:, joint] @ answer)
                square[joint, place] += scale * abs(gain[place]) ** 2 * float(weight[:, joint] @ answer**2)
    return product, square


def white_residuals(
    problem: MotionProblem, solution: Solution, *, twice: bool = False
) -> Iterator[tuple[Track, Array, Array, float, Array, Array]]:
    """Yield each recording, its whitening filter, times (n,) of its points, the inverse of the variance of its filtered
    residuals, and ``_rotated`` of these; ``twice``: filtered once more, backwards, as if columns passed the filter."""
    from scipy.signal import lfilter  # as in ``_matched``

    values, geometry = solution.values, problem.geometry(solution.values)
    for number, (track, source) in enumerate(zip(problem.tracks, solution.sources)):
        white = np.ones(1) if problem.whitening is None else problem.whitening[number]
        filtered = lfilter(white, [1.0], residuals(problem, values, number, source.rows), axis=0)
        scale = 1.0 / max(float(np.mean(filtered**2)), 1e-300)
        if twice:
            filtered = lfilter(white, [1.0], filtered[::-1], axis=0)[::-1]
        u = track.controller_times(source.rows, values[problem.clock(number)])
        yield track, white, u, scale, *_rotated(geometry, track.path.at(u)[0], filtered)


def _rotated(geometry: Geometry, q: Array, residuals: Array) -> tuple[Array, Array]:
    """Return the residuals (n, 3) projected on the motion by each joint, and the square of that motion, (n, N) each."""
    parts: list[tuple[Array, Array]] = []
    for first in range(0, len(q), _CHUNK):
        _, J = joint_jacobian(geometry, JointAngles.of(q[first : first + _CHUNK]))
        own = residuals[first : first + _CHUNK]
        parts.append((np.einsum("ajn,na->nj", J, own), np.einsum("ajn,ajn->nj", J, J)))
    angular, weight = (np.concatenate(each) for each in zip(*parts, strict=True))
    return angular, weight


# -- Information of stops and sweeps before any motion, by which sweeps are chosen -------------------------------------
#
# Points of a motion are correlated: one of each half second counts as an independent reading, with the noise of the
# tracker and the scatter of the arm, as in recordings of the twin (handbook, chapter "motion"). Information of stops
# and sweeps adds up.

_CYCLES = (2, 40)
"""Cycles of the lines that sweeps are to show: slow ones of eccentric parts, dense ones of gears."""
_PLAIN = (JointLaw.PLAY, JointLaw.WINDUP, JointLaw.LAG, JointLaw.COMPLIANCE)
"""Laws with one parameter a joint that sweeps are to show."""


def foreseen_terms(joints: int) -> tuple[JointTerm, ...]:
    """Return the terms of all joints, law by law, that sweeps are to show."""
    plain = [of_all_joints(law, joints) for law in _PLAIN]
    lines = [line(joint, cycles) for cycles in _CYCLES for joint in range(joints)]
    return tuple(chain.from_iterable([*plain, *lines]))


def motion_information(
    nominal: Geometry, estimated: ParameterSet, terms: tuple[JointTerm, ...], state: JointState, covariance: Array
) -> Array:
    """Compute the information (P, P) on the geometry, the terms, and last the delay between the clocks.

    ``state`` is that of an arm to be measured, ``covariance`` (n, 3, 3) that of each point [m^2].
    """
    k = len(estimated.columns)
    thetas = tuple(6 + 5 * joint for joint in range(nominal.joints))
    _, J = estimated.jacobian(nominal, JointAngles.of(state.q), more=thetas)
    by_joint, by_geometry = J[:, :-k], J[:, -k:]
    of_terms = [by_joint[:, term.joint] * term.offset(state) for term in terms]
    delay = -np.einsum("ajn,nj->an", by_joint, state.qd)
    columns = np.concatenate([by_geometry, np.stack([*of_terms, delay], axis=1)], axis=1)
    X = np.einsum("acn,ckn->kan", whitening(covariance), columns)
    flat = X.reshape(len(X), -1)
    return np.asarray(flat @ flat.T)
