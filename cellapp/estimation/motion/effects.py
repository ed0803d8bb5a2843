"""Search of recordings for missing effects: joint laws one after the other, and lines of the spectrum.

Each step adds the law that is least likely to be chance. A law of all joints is tested by ``chi^2 = b^T V^-1 b`` of its
parameters, V with the noise model of the recordings, so neighbouring points do not count twice. Lines are found by
scanning the residuals of all points: the power of every cycle count of every joint relative to the median of its
neighbours, which adapts to coloured noise. A line enters the fit with cosine and sine, and stays if they are
significant beside all other parameters. Columns and residuals pass a filter that whitens the residuals, as the noise of
a motion is slow and dense lines are fast. The final filter of a law is estimated from the residuals with it: without
it, they contain its effect, and their filter treats that as noise. P-values are multiplied by the number of
alternatives. Held-out errors are those of fits without a filter. The mean lag of the joints is indistinguishable from a
clock offset: lags are stated relative to their mean, which the offset absorbs. A joint that accelerations turn against
the sense of a spring lags by a time constant. Vibration is searched when no other law is left (``search_state``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import TypeVar

import numpy as np
import scipy

from cellapp.estimation.calibration.least_squares import solve_psd
from cellapp.estimation.motion.fit import Solution, Source, allow_for_missing, normal_equations, solve
from cellapp.estimation.motion.identify import MotionFit, RecordedArm, held_out_rms_mm, motion_fit, motion_problem
from cellapp.estimation.motion.laws import (
    Fading,
    JointLaw,
    JointState,
    JointTerm,
    Knee,
    Masses,
    TimedPath,
    line,
    of_all_joints,
    state_at_rest,
    state_in_motion,
)
from cellapp.estimation.motion.residuals import MotionProblem, residuals, whitening_filter
from cellapp.estimation.motion.search_state import (
    CONFOUNDED,
    FREQUENCIES,
    ONLY_MOTION,
    SHOWN,
    LawStep,
    MotionEffect,
    State,
    beside_others,
    effects_of,
    is_improbable,
    log_chance,
    reshaped,
    settled,
    step_of,
    strongest_vibration,
    tested,
    white_residuals,
)
from cellapp.ground.errors import tried
from cellapp.ground.progress import Told, ignore_words
from cellapp.robot.effects import EFFECTS, EffectTerm, MotionLaw, motion_laws
from cellapp.robot.effects.joint_compliance import SOFTER
from cellapp.robot.effects.periodic import angle_powers
from cellapp.robot.kinematics.transforms import Array

Found = TypeVar("Found")

_CHANCE = 1e-3
"""Corrected p-value below which a law enters."""
_MOST_LINES = 12
_WORTH_A_FIT = 0.5
"""Share of the power that chance rarely gives a line, at which a line is fitted: its leakage raises the median of its
neighbours, so the evidence of the fit decides."""
_ALIKE_TURNS = 1.0
"""Distance of two lines of one joint, times the turns that it made, below which they are one line."""
_SEARCHED = (
    *(JointLaw.PLAY, JointLaw.LAG, JointLaw.INERTIA, JointLaw.ONE_CYCLE),
    *(JointLaw.WINDUP, JointLaw.COMPLIANCE),
)
"""Laws of all joints that are tried, beside those of plug-ins."""
_OF_POSTURE = (JointLaw.WINDUP, JointLaw.COMPLIANCE, JointLaw.ONE_CYCLE)
"""Laws that a filter for slow noise suppresses while the residuals contain them: they are tested without it, too."""
_AS_LIKELY = 4.5
"""Difference of log likelihoods within which the more usual of two counts is chosen: three standard deviations."""
_SHAPED_ROUNDS = 8
_AS_WELL = 1.01
"""Ratio of held-out errors up to which the simpler of two models is preferred."""
_COUNT_ROUNDS = 3
_JUDGED_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class MotionDiscovery:
    """Fit with all effects found, in the order in which they entered, and the held-out errors before and after.

    ``covariance`` (k, k) is that of the estimated geometry, then of the parameters of ``terms``. ``not_fitted`` are
    candidates whose fit did not converge.
    """

    fit: MotionFit
    effects: tuple[MotionEffect, ...]
    heldout_before_mm: float
    heldout_after_mm: float
    covariance: Array = field(repr=False)
    masses: Masses | None = field(repr=False)
    not_fitted: tuple[str, ...] = ()

    @property
    def terms(self) -> tuple[EffectTerm, ...]:
        """Terms for an arm model that serve commands at rest."""
        return tuple(effect.term() for effect in self.at_rest)

    @property
    def at_rest(self) -> tuple[MotionEffect, ...]:
        """Effects that serve commands at rest."""
        return tuple(effect for effect in self.effects if effect.found.at_rest)

    def joints_at_rest(self, path: TimedPath, time_s: Array) -> Array:
        """Return the joint positions (n, N) [rad] at which an arm at rest has the points of these times (n,) [s]:
        without the laws of motion only."""
        state = state_in_motion(path, time_s, None)
        return state.q + _offsets(state, [effect for effect in self.effects if not effect.found.at_rest])

    def joints_with_history(self, path: TimedPath, time_s: Array) -> Array:
        """Return ``joints_at_rest`` plus the part of the laws at rest that motion adds: lost motion from earlier
        reversals, and the torque of accelerations. At rest, only the last motion of each joint is known."""
        loaded = any(term.law.needs_torques for effect in self.at_rest for term in effect.terms)
        masses = self.masses if loaded else None
        q, moves = self.joints_at_rest(path, time_s), state_in_motion(path, time_s, masses)
        side, travel = np.sign(np.rint(moves.direction)), path.travel_at(time_s, moves.q)
        rests = state_at_rest(q, side, masses, travel)
        return q + _offsets(moves, self.at_rest) - _offsets(rests, self.at_rest)


def _offsets(state: JointState, effects: Sequence[MotionEffect]) -> Array:
    """Return the sum of the offsets of the joints (n, N) [rad] by effects."""
    values = [one.value for effect in effects for one in effect.found.parameters.values()]
    return state.offsets(tuple(term for effect in effects for term in effect.terms), np.array(values))


def effects_in_motion(arm: RecordedArm, told: Told = ignore_words) -> MotionDiscovery:
    """Search recordings of one arm for effects of its joints. Raise as ``identify_from_motion``."""
    return _Search(motion_problem(arm, told), told, tuple(motion_laws(EFFECTS.values()))).run()


@dataclass(frozen=True, eq=False)
class _Search:
    problem: MotionProblem
    told: Told
    own: tuple[MotionLaw, ...] = ()
    """Laws of plug-ins that depend on speeds."""
    to_its_end: bool = False
    """Whether fits iterate to full convergence, as in ``solve``."""
    not_fitted: list[str] = field(default_factory=list)
    """Candidates whose fit did not converge, in words: they were dropped without a judgement."""

    @property
    def _patient(self) -> _Search:
        """The search with fits to full convergence."""
        return replace(self, to_its_end=True)

    @property
    def alternatives(self) -> int:
        """Number of laws tried, for the correction of p-values."""
        return len(JointLaw) + len(_OF_POSTURE) + len(self.own)

    def run(self) -> MotionDiscovery:
        """Add laws of all joints and lines until chance explains the rest."""
        state = _whitened(self._state(self.problem.with_terms(()), None))
        first_mm = state.heldout_mm
        laws: list[JointLaw | MotionLaw] = [*_SEARCHED, *self.own]
        if self.problem.masses is None:
            laws = [law for law in laws if not law.needs_torques]
        while found := (
            self._law(state, laws)
            or self._all_lines(state)
            or self._tried("vibration of a joint", partial(self._vibration, state))
        ):
            state, law = found
            state = self._judged_to_its_end(state)
            state = self._tried("constants", partial(self._with_best_constants, state, law)) or state
            if law is JointLaw.INERTIA:
                state = self._tried("time constants", partial(self._with_time_constants, state)) or state
        for what, change in (
            ("one lag", self._with_one_lag),
            ("exact counts of lines", self._with_exact_counts),
            ("lines beside lines", self._with_sides),
            ("the model without laws of chance", self._without_chance),
            ("fewer terms", self._simpler),
        ):
            state = self._tried(what, partial(change, state)) or state
        return self._concluded(state, first_mm)

    def _concluded(self, state: State, first_mm: float) -> MotionDiscovery:
        """Fit the final model without filters, and state its effects."""
        steps = [step if step.law is JointLaw.LINE else beside_others(state, step) for step in state.steps]
        final = replace(self._patient._unwhitened(state, self._patient._plain(state)), steps=tuple(steps))
        final = self._settled(final)
        # with lags only the sum of an offset and their mean is known: leave it as it is
        late = final.has(JointLaw.LAG) or final.has(JointLaw.TIME_CONSTANT)
        freed = allow_for_missing(final.problem, final.solution, with_clocks=not late)
        effects = effects_of(final)
        stays = [term for effect in effects if effect.found.at_rest for term in effect.terms]
        places = [*range(final.problem.geometric), *final.places_of(stays)]
        return MotionDiscovery(
            motion_fit(final.problem, freed),
            effects,
            first_mm,
            final.heldout_mm,
            final.solution.covariance[np.ix_(places, places)],
            final.problem.masses,
            tuple(dict.fromkeys(self.not_fitted)),
        )

    def _tried(self, what: str, candidate: Callable[[], Found | None]) -> Found | None:
        return tried(what, candidate, self.not_fitted)

    def _with_exact_counts(self, state: State) -> State:
        """Move lines to the counts that fit best beside all other terms: early lines entered before these were known.

        Lines of one joint that are unresolved over its turns are merged into the stronger one.
        """
        for _ in range(_COUNT_ROUNDS):
            lines = state.terms_of(JointLaw.LINE)[::2]
            better: dict[tuple[int, int], int | None] = {}
            for term in lines:
                if term.place in better:
                    continue
                self.told(f"cycles of lines of joint {term.joint + 1}")
                reach = _reach(state, term)
                near = [t for t in lines if t.joint == term.joint and abs(t.cycles - term.cycles) <= 1.5 * reach]
                better |= {one.place: None for one in near}
                better[term.place] = self._best_count(state, term, near, reach)
            if all(cycles == count for (_, cycles), count in better.items()):
                break
            state = self._refitted(state, [_recounted(step, better) for step in state.steps])
        return state

    def _best_count(self, state: State, term: JointTerm, near: Sequence[JointTerm], reach: float) -> int:
        """Return the count with most power in the residuals without the lines ``near`` a line, within its reach."""
        values = state.solution.values.copy()
        values[state.places_of([wave for one in near for wave in line(*one.place)])] = 0.0
        ((power,), _) = line_powers(state.problem, replace(state.solution, values=values), [term.joint])
        power = np.where((np.abs(_COUNTS - term.cycles) <= reach) & (_COUNTS > 1), power, 0.0)
        count = int(np.argmax(power))
        # of the encoder disc with the one-cycle error
        return 2 if state.has(JointLaw.ONE_CYCLE) and power[2] > power[count] - _AS_LIKELY else count

    def _with_sides(self, state: State) -> State:
        """Add lines of the neighbouring counts if these clearly fit better: teeth whose amplitude is modulated by the
        run-out of a gear, or counts that are not whole."""
        places = dict.fromkeys(term.place for term in state.terms_of(JointLaw.LINE))
        taken, beside = set(places), list[list[JointTerm]]()
        for joint, cycles in places:
            free = [side for side in (-1, 1) if cycles > 2 and (joint, cycles + side) not in taken]
            taken |= {(joint, cycles + side) for side in free}
            beside.append([replace(term, side=side) for side in free for term in line(joint, cycles + side)])
        beside = [its for its in beside if its]
        if not beside:
            return state
        self.told("lines beside lines")
        tried = sum(cycles > 2 for _, cycles in places)
        trial, kept = self._with_proven(state, beside, self.alternatives * tried)
        if not kept:
            return state
        trial = self._judged(trial)
        if _AS_WELL * trial.heldout_mm > state.heldout_mm:
            return state
        return trial.entered(step_of(JointLaw.LINE, kept, trial, tried, state))

    def _with_best_constants(self, state: State, law: JointLaw | MotionLaw) -> State:
        """Estimate again the reaches of a law's lost motion, or the knees of its springs, with the noise left by the
        law: the residuals before contained it as noise."""
        known = state.terms_of(law)
        parts = [term for term in known if term.refines]
        if not parts or not isinstance(law, JointLaw):
            return state
        rest = tuple(term for term in state.problem.terms if term not in parts)
        values = np.delete(state.solution.values, state.places_of(parts))
        self.told(f"constants of {law.value.replace('_', ' ')}")
        better = refining_terms(state.problem.with_terms(rest), replace(state.solution, values=values), law)
        if set(better) == set(parts):
            return state
        terms = [*(term for term in known if not term.refines), *better]
        trial = self._judged_to_its_end(self._refitted(state, state.steps_with({law: terms})))
        return trial if trial.heldout_mm < state.heldout_mm else state

    def _with_time_constants(self, state: State) -> State:
        """Replace inertia by a time constant at joints that accelerations turn against the sense of a spring, if that
        fits better: a lag of time constant T adds ``T^2 qdd / 2`` to a delay."""
        step = state.steps[-1]
        values, covariance = state.values_of(step.terms)
        late = tuple(
            JointTerm(JointLaw.TIME_CONSTANT, term.joint, "time_constant", shape=(math.sqrt(-2.0 * value),))
            for term, value, error in zip(step.terms, values.tolist(), np.sqrt(np.diag(covariance)).tolist())
            if value < -SHOWN * error
        )
        if not late:
            return state
        joints = {term.joint for term in late}
        steps = state.steps_without([term for term in step.terms if term.joint in joints])
        steps.append(replace(step, law=JointLaw.TIME_CONSTANT, terms=late))
        trial = self._settled(self._refitted(state, steps))
        return state if trial.heldout_mm > step.before_mm else self._with_one_lag(trial)

    def _with_one_lag(self, state: State) -> State:
        """Give all joints time constants, no further delays, and twist under acceleration only at vibrating joints, if
        that fits as well: the simpler of two explanations."""
        late = state.terms_of(JointLaw.TIME_CONSTANT)
        if not late:
            return state
        usual, own = float(np.median([term.shape[0] for term in late])), {term.joint: term for term in late}
        joints = state.problem.parameters.joints
        everywhere = [own.get(joint, replace(late[0], joint=joint, shape=(usual,))) for joint in range(joints)]
        springs = {term.joint for term in state.terms_of(JointLaw.VIBRATION)}
        twisted = [term for term in of_all_joints(JointLaw.INERTIA, joints) if term.joint in springs]
        simple: dict[JointLaw | MotionLaw, list[JointTerm]]
        simple = {JointLaw.LAG: [], JointLaw.INERTIA: twisted, JointLaw.TIME_CONSTANT: everywhere}
        trial = self._settled(self._refitted(state, state.steps_with(simple)))
        return trial if trial.heldout_mm < _AS_WELL * state.heldout_mm else state

    def _vibration(self, state: State) -> tuple[State, JointLaw] | None:
        """Return the state with the joint vibration that is least likely to be chance; None if there is none."""
        taken = {term.joint for term in state.terms_of(JointLaw.VIBRATION)}
        joints = state.problem.parameters.joints
        if len(taken) == joints:
            return None
        power, terms = strongest_vibration(state.problem, state.solution, sorted(taken))
        tried = len(FREQUENCIES) * joints
        if power < math.log(tried / _CHANCE):
            return None
        self.told(f"vibration of joint {terms[0].joint + 1}")
        trial = self._extended(state, terms)
        trial = self._settled(trial.entered(step_of(JointLaw.VIBRATION, terms, trial, tried, state)), first=-1)
        step = step_of(JointLaw.VIBRATION, trial.steps[-1].terms, trial, tried, state)
        if step.log_p > math.log(_CHANCE) or not replace(trial, steps=(step,)).shown(JointLaw.VIBRATION):
            return None
        judged = self._judged(trial)
        if _AS_WELL * judged.heldout_mm > state.heldout_mm:
            return None
        return replace(judged, steps=judged.steps[:-1]).entered(step), JointLaw.VIBRATION

    def _settled(self, state: State, first: int = 0) -> State:
        """Repeat the fit with updated shapes of the steps from the ``first`` on, until these settle.

        Shapes that the recordings hardly determine may not: the round with the least held-out error counts then, and
        what was not settled is noted.
        """
        best = state
        for _ in range(_SHAPED_ROUNDS):
            before = [term for step in state.steps[first:] for term in step.terms]
            after = reshaped(before, state.values_of(before)[0].tolist())
            if settled(after, before):
                return state
            renamed = dict(zip(before, after, strict=True))
            self.told("shapes of laws")
            steps = [replace(one, terms=tuple(renamed.get(term, term) for term in one.terms)) for one in state.steps]
            state = self._refitted(state, steps)
            best = min(best, state, key=lambda one: one.heldout_mm)
        moving = dict.fromkeys(new.law.value for new, old in renamed.items() if not settled([new], [old]))
        self.not_fitted.append(f"exact shape of {', '.join(moving)}")
        return best

    def _without_chance(self, state: State) -> State:
        """Remove laws, and refining parts of laws, that entered early and that chance explains beside all others."""
        tried = self.alternatives
        for step in state.steps:  # one by one: each vibrating joint has its own step
            if step.law is JointLaw.LINE:
                continue
            parts = [term for term in step.terms if term.refines]
            if parts and _by_chance(state, parts, tried * alternatives(step.law)):
                step = replace(step, terms=tuple(term for term in step.terms if not term.refines))
                state = self._refitted(state, state.steps_without(parts))
            by_chance = _by_chance(state, step.terms, tried) or is_improbable(state, beside_others(state, step))
            if by_chance or not state.shown(step.law):
                state = self._refitted(state, state.steps_without(step.terms))
        return state

    def _simpler(self, state: State) -> State:
        """Simplify lost motion (sudden, without a part that grows with load) and springs (one stiffness) if that fits
        as well: lines and elastic joints look like either before they are part of the fit."""
        for law in (JointLaw.WINDUP, JointLaw.PLAY, JointLaw.COMPLIANCE):
            plain = [term for term in state.terms_of(law) if not term.refines]
            for fewer in (plain, []) if law is JointLaw.WINDUP and state.has(JointLaw.PLAY) else (plain,):
                if len(fewer) == len(state.terms_of(law)):
                    continue
                self.told(f"{law.value.replace('_', ' ')} with fewer terms")
                trial = self._judged_to_its_end(self._refitted(state, state.steps_with({law: fewer})))
                if trial.heldout_mm < _AS_WELL * state.heldout_mm:
                    state = trial
        return state

    def _state(self, problem: MotionProblem, start: Array | None, steps: Sequence[LawStep] = ()) -> State:
        laws = list(dict.fromkeys(term.law.value for term in problem.terms))
        beginning = f"with {', '.join(laws)}: " if laws else ""
        solution = solve(problem, start, lambda words: self.told(beginning + words), to_its_end=self.to_its_end)
        return State(problem, solution, held_out_rms_mm(problem, solution), tuple(steps))

    def _fitted(self, state: State, terms: Sequence[JointTerm]) -> State:
        """Fit with these terms, in this order, from the values of a state; terms that it lacks begin at their start."""
        before, own = state.problem, slice(state.problem.geometric, state.problem.arm)
        known = dict(zip(before.terms, state.solution.values[own].tolist(), strict=True))
        of_terms = [known.get(term, term.start) for term in terms]
        values = np.concatenate([state.solution.values[: own.start], of_terms, state.solution.values[own.stop :]])
        return self._state(before.with_terms(terms), values, state.steps)

    def _refitted(self, state: State, steps: Sequence[LawStep]) -> State:
        """Fit again with the terms of ``steps``."""
        return replace(self._fitted(state, [term for step in steps for term in step.terms]), steps=tuple(steps))

    def _extended(self, state: State, terms: Sequence[JointTerm]) -> State:
        """Fit again with further terms, which are in no step yet."""
        return self._fitted(state, (*state.problem.terms, *terms))

    def _plain(self, state: State) -> State:
        """Fit again without whitening."""
        return self._state(replace(state.problem, whitening=None), state.solution.values, state.steps)

    def _unwhitened(self, state: State, plain: State) -> State:
        """Fit without whitening, for predictions. Lines, which are fast, keep their values from the whitened residuals
        if these determine them better than ``plain`` does."""
        problem, values = plain.problem, state.solution.values
        own, theirs = (np.diag(one.solution.covariance) for one in (state, plain))
        lines = enumerate(problem.terms, start=problem.geometric)
        better = [place for place, term in lines if term.law is JointLaw.LINE and own[place] < theirs[place]]
        if not better:
            return plain
        mean, precision = problem.mean.copy(), problem.precision.copy()
        mean[better], precision[better] = values[better], 1.0 / own[better]
        return self._state(replace(problem, mean=mean, precision=precision), values, state.steps)

    def _judged(self, trial: State) -> State:
        """Fit again with filters estimated from the residuals of ``trial``, as filters from before its terms hide a
        part of them. The held-out error is that of the fit without filters, as filtered points contain little
        information on the geometry."""
        plain = self._plain(trial)
        filtered = self._state(_whitened(plain).problem, plain.solution.values, trial.steps)
        return replace(filtered, heldout_mm=self._unwhitened(filtered, plain).heldout_mm)

    def _judged_to_its_end(self, state: State) -> State:
        """Repeat with filters of its own residuals while that lowers the held-out error, so that this gain is not
        attributed to the next law."""
        for _ in range(_JUDGED_ROUNDS):
            again = self._tried("filters of the last residuals", partial(self._patient._judged, state))
            if again is None or again.heldout_mm >= state.heldout_mm:
                break
            state = again
        return state

    def _law(self, state: State, laws: Sequence[JointLaw | MotionLaw]) -> tuple[State, JointLaw | MotionLaw] | None:
        """Return the state with the law of all joints that is least likely chance and lowers the held-out error; None
        if none."""
        likely = []
        for law in laws:
            for terms, chances in self._terms_to_try(state, law):
                bare = replace(state, problem=replace(state.problem, whitening=None))
                starts = [state, bare] if law in _OF_POSTURE else [state]
                each = [self._tried(law.value, partial(self._extended, one, terms)) for one in starts]
                trials = [one for one in each if one is not None]
                if not trials:
                    continue
                steps = [(trial, step_of(law, terms, trial, chances, state)) for trial in trials]
                best = max(steps, key=lambda each: each[1].statistic)
                if best[1].log_p < math.log(_CHANCE):
                    likely.append(best)
        # laws of motion only come last: they absorb the residuals of lost motion and springs
        for trial, step in sorted(likely, key=lambda each: (each[1].law in ONLY_MOTION, each[1].log_p)):
            judged = self._tried(step.law.value, partial(self._judged, trial))
            if judged is None:
                continue
            if (_AS_WELL if step.law in ONLY_MOTION else 1.0) * judged.heldout_mm < state.heldout_mm:
                confounded = [one.log_p for _, one in likely if {one.law, step.law} == set(CONFOUNDED)]
                return judged.entered(replace(step, other_log_p=min(confounded, default=math.inf))), step.law
        return None

    def _terms_to_try(self, state: State, law: JointLaw | MotionLaw) -> Iterator[tuple[tuple[JointTerm, ...], int]]:
        """Yield terms with which a law may enter, and the number of alternatives: the plain law, the law with refining
        parts, or these parts beside what entered before."""
        plain = () if state.has(law) else of_all_joints(law, state.problem.parameters.joints)
        if plain:
            yield plain, self.alternatives
        refined = any(term.refines for term in state.terms_of(law))
        if isinstance(law, JointLaw) and law in REFINED and not refined and (law is JointLaw.PLAY or not plain):
            self.told(f"constants of {law.value.replace('_', ' ')}")
            parts = refining_terms(state.problem, state.solution, law)
            yield (*plain, *parts), self.alternatives * alternatives(law)

    def _all_lines(self, state: State) -> tuple[State, JointLaw] | None:
        """Return the state with all lines of its residuals; None if there are none."""
        found = None
        while more := self._tried("lines", partial(self._lines, found or state)):
            found = more
        return None if found is None else (found, JointLaw.LINE)

    def _lines(self, state: State) -> State | None:
        """Add the strongest lines of the residuals, at most one for each joint; None if none is significant."""
        taken = [(term.joint, term.cycles) for term in state.terms_of(JointLaw.LINE)]
        if len(taken) >= 2 * _MOST_LINES:
            return None
        power, turns = line_powers(state.problem, state.solution, range(state.problem.parameters.joints))
        threshold = _WORTH_A_FIT * math.log(power.size / _CHANCE)
        for joint, cycles in taken:
            power[joint, np.abs(_COUNTS - cycles) <= max(1.0, _ALIKE_TURNS / max(turns[joint], 1e-3))] = 0.0
        power[:, :2] = 0.0
        strongest = enumerate(power.argmax(axis=1).tolist())
        pairs = [line(joint, cycles) for joint, cycles in strongest if power[joint, cycles] > threshold]
        if not pairs:
            return None
        trial, kept = self._with_proven(state, pairs, power.size)
        if not kept:
            return None
        judged = self._judged(trial)
        if judged.heldout_mm >= state.heldout_mm:
            return None
        return judged.entered(step_of(JointLaw.LINE, kept, trial, power.size, state))

    def _with_proven(
        self, state: State, groups: Sequence[Sequence[JointTerm]], tried: int
    ) -> tuple[State, tuple[JointTerm, ...]]:
        """Fit again with those groups of terms that chance does not explain beside all others; return them, too."""
        trial = self._extended(state, [term for its in groups for term in its])
        proven = [its for its in groups if not _by_chance(trial, its, tried)]
        kept = tuple(term for its in proven for term in its)
        return (self._extended(state, kept) if 0 < len(proven) < len(groups) else trial), kept


def _by_chance(state: State, terms: Sequence[JointTerm], tried: int) -> bool:
    """Return whether chance explains some terms, the best of ``tried`` alternatives."""
    return log_chance(state.statistic_of(terms), len(tested(terms)), tried) > math.log(_CHANCE)


def _whitened(state: State) -> State:
    """Return the state with whitening filters of its residuals, so that every frequency is weighted by its noise."""
    filters = tuple(
        whitening_filter(residuals(state.problem, state.solution.values, number, source.rows), track.stamps.period_s)
        for number, (track, source) in enumerate(zip(state.problem.tracks, state.solution.sources))
    )
    return replace(state, problem=replace(state.problem, whitening=filters))


def _reach(state: State, term: JointTerm) -> float:
    """Return the distance in counts below which lines are unresolved over the turns that a joint made."""
    q = np.concatenate([track.path.at(track.path.stamps.time_s)[0][:, term.joint] for track in state.problem.tracks])
    return max(1.0, 2.0 * math.pi * _ALIKE_TURNS / max(float(np.ptp(q)), 1e-3))


def _recounted(step: LawStep, better: Mapping[tuple[int, int], int | None]) -> LawStep:
    """Move the lines of a step to other counts; drop lines that were merged into another."""
    if step.law is not JointLaw.LINE:
        return step
    counts = [(term.joint, better[term.place]) for term in step.terms[::2]]
    terms = [term for joint, count in counts if count is not None for term in line(joint, count)]
    return replace(step, terms=tuple(terms))


# -- Lines of the spectrum of joints: the power of every cycle count of every joint in the residuals of recordings ----


_MOST_CYCLES = 210
"""Largest cycle count: twice the ratio of a 1:100 strain-wave gear, and a margin."""
_COUNTS = np.arange(_MOST_CYCLES + 1)
_RESPONSE = 1024
"""Number of frequencies at which the response of a filter is tabulated."""
_CHUNK = 4096
_NEIGHBOURS = 31
"""Number of cycle counts whose median power is the noise level."""
_LOG_2 = math.log(2.0)
"""Ratio of median to mean power of noise: powers of cosine and sine together are exponential."""


def line_powers(problem: MotionProblem, solution: Solution, joints: Sequence[int]) -> tuple[Array, Array]:
    """Return the power (joints, counts + 1) of each cycle count of some joints in the residuals, in units of the noise
    there: by chance it exceeds ``ln(1 / p)`` with probability p. Return also the turns (joints,) in the range of each.

    A line of c cycles has the slowly varying frequency ``c qd / 2 pi``: whitening multiplies it by the filter's
    response there.
    """
    own, shape = list(joints), (len(joints), _MOST_CYCLES + 1)
    sums, energy = np.zeros(shape, dtype=np.complex128), np.zeros(shape)
    low, high = np.full(len(own), np.inf), np.full(len(own), -np.inf)
    for track, whitening, u, scale, rotated, weight in white_residuals(problem, solution):
        response = np.conj(np.fft.fft(whitening, _RESPONSE))
        step = track.stamps.period_s * _RESPONSE / (2.0 * math.pi)
        q, qd = (one[:, own] for one in track.path.at(u))
        low, high = np.minimum(low, q.min(axis=0)), np.maximum(high, q.max(axis=0))
        for joint, first in product(range(len(own)), range(0, len(u), _CHUNK)):
            part = slice(first, first + _CHUNK)
            gain = response[np.rint(np.outer(_COUNTS, qd[part, joint] * step)).astype(np.intp) % _RESPONSE]
            powers = np.conj(angle_powers(q[part, joint], _MOST_CYCLES))
            sums[joint] += np.einsum("cn,cn,n->c", powers, gain, rotated[part, own[joint]] * scale)
            energy[joint] += (gain.real**2 + gain.imag**2) @ (weight[part, own[joint]] * scale)
    raw = np.abs(sums) ** 2 / np.maximum(energy, 1e-300)
    floor = scipy.ndimage.median_filter(raw, (1, _NEIGHBOURS), mode="nearest") / _LOG_2
    return raw / np.maximum(floor, 1e-300), (high - low) / (2.0 * math.pi)


# -- Refining parts of a law of all joints, with a non-linear constant chosen from the residuals of a fit -------------
#
# Play and wind-up change at once where a joint reverses; a part fades with the travel since, over a reach
# (``joint_path.Fading``). Springs push back in proportion; a part is softer below a knee torque. All constants of all
# kinds are columns of one normal matrix. What each would remove from the residuals beside the present fit is the
# solution of a small system.


REACHES = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Reaches to try [rad]: 1.4 to 46 degrees."""
_KINDS = (Fading(1.0, kept=False), Fading(1.0, kept=True), Fading(1.0, kept=False, bell=True))
_KNEES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Knees to try, as shares of the largest torque of the joint in all recordings."""
_NEARER = (0.025, 0.005)
"""Steps of the shares in the following finer searches, about those chosen."""
_STEPS = (-4, -3, -2, -1, 0, 1, 2, 3, 4)
_MOST_POINTS = 8000
_OF_ITS_OWN = 9.0
"""Chi-square that a separate constant, or a second knee, must gain at a joint: three standard deviations."""
_TORQUES = 1000
"""Points of each recording at which torques are computed."""
REFINED = (JointLaw.PLAY, JointLaw.WINDUP, JointLaw.COMPLIANCE)
"""Laws with refining parts."""


def alternatives(law: JointLaw | MotionLaw) -> int:
    """Return the number of alternative parts, for the correction of p-values."""
    return len(_KNEES) ** 2 if law is JointLaw.COMPLIANCE else len(_KINDS) * len(REACHES)


def refining_terms(problem: MotionProblem, solution: Solution, law: JointLaw) -> tuple[JointTerm, ...]:
    """Return the parts of one of the laws ``REFINED`` that remove most from the residuals: for lost motion of one kind
    and with one reach, except at joints that a separate reach fits clearly better; for compliance one or two knees a
    joint."""
    return _knees(problem, solution) if law is JointLaw.COMPLIANCE else _fading(problem, solution, law)


def _fading(problem: MotionProblem, solution: Solution, law: JointLaw) -> tuple[JointTerm, ...]:
    plain = of_all_joints(law, problem.parameters.joints)
    joints = range(len(plain))

    def parts(kind: Fading, reaches: Sequence[float]) -> tuple[JointTerm, ...]:
        return tuple(replace(term, fading=replace(kind, reach=own)) for term, own in zip(plain, reaches))

    options = [(kind, [reach] * len(joints)) for kind in _KINDS for reach in REACHES]
    gains = _gains(problem, solution, law, [part for option in options for part in parts(*option)])
    kind, reaches = max(options, key=lambda option: gains(parts(*option)))
    of_usual = [gains(parts(kind, [own] * len(joints))) for own in REACHES]
    usual, top = reaches[0], _top(REACHES, REACHES.index(reaches[0]), of_usual)
    for joint in joints:
        tried = [[*reaches[:joint], own, *reaches[joint + 1 :]] for own in REACHES]
        best = max(tried, key=lambda one: gains(parts(kind, one)))
        if gains(parts(kind, best)) > gains(parts(kind, reaches)) + _OF_ITS_OWN:
            reaches = best
    return parts(kind, [top if own == usual else own for own in reaches])


def _top(grid: Sequence[float], place: int, gains: Sequence[float]) -> float:
    """Return the constant at the top of the parabola through a point of a geometric grid and its neighbours."""
    if not 0 < place < len(grid) - 1:
        return grid[place]
    bend, slope, _ = np.polyfit((-1.0, 0.0, 1.0), gains[place - 1 : place + 2], 2).tolist()
    top = -0.5 * slope / bend if bend < 0.0 else 0.0
    return float(grid[place] * (grid[place + 1] / grid[place]) ** top)


def _knees(problem: MotionProblem, solution: Solution) -> tuple[JointTerm, ...]:
    """Choose the knees of all joints: one of each, two where both clearly gain; then refine their values."""
    largest = _largest_torques(problem)
    options = [_one_or_two(_KNEES, _KNEES)] * len(largest)
    chosen = _best_shares(problem, solution, largest, options)
    for step in _NEARER:
        near = [[[share + step * n for n in _STEPS if share + step * n > 0.0] for share in own] for own in chosen]
        options = [_one_or_two(grids[0], grids[-1]) for grids in near]
        chosen = _best_shares(problem, solution, largest, options)
    return tuple(
        JointTerm(JointLaw.COMPLIANCE, joint, "compliance", knee=Knee(share * torque, constant))
        for joint, (own, torque) in enumerate(zip(chosen, largest.tolist()))
        for constant, share in zip(SOFTER, own)
    )


def _one_or_two(first: Sequence[float], second: Sequence[float]) -> list[tuple[float, ...]]:
    """Return each share alone, and each of the first with each larger one of the second."""
    alone = sorted({*first, *second})
    return [(one,) for one in alone] + [(one, other) for one in first for other in second if one < other]


def _best_shares(
    problem: MotionProblem, solution: Solution, largest: Array, options: Sequence[Sequence[tuple[float, ...]]]
) -> list[tuple[float, ...]]:
    """Choose one option of each joint, joint by joint the one with the largest gain beside those of the others."""

    def parts(chosen: Sequence[Sequence[float]]) -> list[JointTerm]:
        each = zip(of_all_joints(JointLaw.COMPLIANCE, len(largest)), chosen, largest.tolist(), strict=True)
        return [replace(term, knee=Knee(share * torque)) for term, own, torque in each for share in own]

    every = parts([sorted({share for one in own for share in one}) for own in options])
    gains = _gains(problem, solution, JointLaw.COMPLIANCE, every)

    def gain(chosen: Sequence[tuple[float, ...]]) -> float:
        return gains(parts(chosen)) - _OF_ITS_OWN * sum(map(len, chosen))

    chosen = [own[len(own) // 2] for own in options]
    for joint in (*range(len(options)), *range(len(options))):
        chosen[joint] = max(options[joint], key=lambda one: gain([*chosen[:joint], one, *chosen[joint + 1 :]]))
    return chosen


def _largest_torques(problem: MotionProblem) -> Array:
    """Return the largest torque (N,) [Nm] of each joint in all recordings."""
    paths = [track.path for track in problem.tracks]
    times = [np.linspace(path.stamps.time_s[0], path.stamps.time_s[-1], _TORQUES) for path in paths]
    torques = [state_in_motion(path, its, problem.masses).torque for path, its in zip(paths, times, strict=True)]
    return np.asarray(np.abs(np.concatenate(torques)).max(axis=0))


def _gains(
    problem: MotionProblem, solution: Solution, law: JointLaw, parts: Sequence[JointTerm]
) -> Callable[[Sequence[JointTerm]], float]:
    """Return what computes the chi-square that chosen ``parts`` remove from the residuals, beside the parameters of a
    fit."""
    every = of_all_joints(law, problem.parameters.joints)
    plain = [term for term in every if term not in problem.terms]
    at, first = problem.arm, problem.arm + len(plain)
    # a subset of the points selects the part; the fit with it, and its evidence, use all points
    extended = replace(problem.with_terms((*problem.terms, *plain, *parts)), whitening=None)
    sources = [_thinned(source, _MOST_POINTS // len(solution.sources)) for source in solution.sources]
    values = np.insert(solution.values, at, np.zeros(len(plain) + len(parts)))
    A, b = normal_equations(extended, values, sources)
    A, b = A + np.diag(extended.precision), b + extended.precision * (extended.mean - values)
    new = np.zeros(len(b), dtype=np.bool_)
    new[first : first + len(parts)] = True
    of_fit = solve_psd(A[~new][:, ~new], np.column_stack([A[~new][:, new], b[~new]]))
    matrix = A[new][:, new] - A[new][:, ~new] @ of_fit[:, :-1]
    matrix = 0.5 * (matrix + matrix.T)
    right = b[new] - A[new][:, ~new] @ of_fit[:, -1]
    place = {part: number for number, part in enumerate(parts)}

    def gain(chosen: Sequence[JointTerm]) -> float:
        own = np.array([place[part] for part in chosen])
        return float(right[own] @ solve_psd(matrix[np.ix_(own, own)], right[own]))

    return gain


def _thinned(source: Source, most: int) -> Source:
    """Return a subset of the rows of a source, each with more weight."""
    each = max(len(source.rows) // max(most, 1), 1)
    return Source(source.rows[::each], source.sigma_m, source.relative[::each], source.worth * each)
