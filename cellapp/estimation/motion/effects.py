"""Search of recordings for missing effects: laws of joints one after the other, and lines of the spectrum.

Each step adds the law that is least likely to be chance. A law of all joints is tested by ``chi^2 = b^T V^-1 b`` of its
parameters, V with the noise model of the recordings, so that neighbouring points do not count twice. Lines are scanned
in the residuals of all points: the power of every cycle count of every joint against the median of its neighbours,
which follows whatever colour the noise has; a line enters the fit with cosine and sine, and stays if they are
significant beside all other parameters. Columns and residuals pass a filter that whitens the residuals: the noise of a
motion is slow, and dense lines are fast. What a law leaves decides about the filter that it is fitted with in the end:
residuals without a large effect hold that effect, and a filter of them takes it for noise. P-values are multiplied by
the number of alternatives. Held-out errors are those of fits without a filter.

The mean lag of the joints is the same as an offset between the clocks: lags are stated against their mean, which the
offset takes up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from cellapp.estimation.motion.discrepancy import allow_for_missing
from cellapp.estimation.motion.fit import Problem, Solution, solve
from cellapp.estimation.motion.identify import RecordedArm, held_out_rms_mm, motion_fit, motion_problem
from cellapp.estimation.motion.lines import line_powers
from cellapp.estimation.motion.loops import Loop, loops
from cellapp.estimation.motion.noise import whitening_filter
from cellapp.estimation.motion.observe import residuals
from cellapp.estimation.motion.records import MotionFit
from cellapp.estimation.motion.terms import JointTerm, Law, terms_of
from cellapp.ground.progress import Told, ignore_words
from cellapp.robot.effects import EFFECTS, EffectTerm, MotionLaw, motion_laws
from cellapp.robot.kinematics.transforms import Array

_CHANCE = 1e-3
"""Corrected p-value below which a law enters."""
_MOST_LINES = 12
_ALIKE_TURNS = 1.0
"""Two lines of one joint closer than this over the turns that it made are one."""
_OF_POSTURE = (Law.WINDUP, Law.COMPLIANCE)
"""Laws that a filter for slow noise takes away while the residuals hold them: they are tested without it, too."""
_COUNT_ROUNDS = 3
SHOWN = 3.5
"""Standard errors from which a joint is named as having an effect that was found."""
_AT_REST = {Law.PLAY: "constant", Law.WINDUP: "load", Law.LINE: "lines", Law.COMPLIANCE: "linear"}
"""Forms of the effects' laws that say the same of stops; a lag has none."""
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
        form = _AT_REST[Law(self.slug)]
        law = EFFECTS[self.slug].law(form)
        return EffectTerm(self.slug, self.names, self.values, self.standard_errors, self.units, law)


@dataclass(frozen=True, eq=False)
class MotionDiscovery:
    """The fit with all effects that were found, in the order in which they entered, and the errors without any.

    ``covariance`` (k, k) is that of the estimated geometry, then of the parameters of ``terms``; ``loops`` are those of
    the joints that show lost motion.
    """

    fit: MotionFit
    effects: tuple[MotionEffect, ...]
    heldout_before_mm: float
    heldout_after_mm: float
    covariance: Array = field(repr=False)
    loops: tuple[Loop, ...] = ()

    def lags_s(self, joints: int) -> Array:
        """Lag of each joint (N,) behind the mean of all [s]; zero where none shows."""
        found = np.zeros(joints)
        for effect in self.effects:
            if effect.slug == Law.LAG.value:
                found[[joint - 1 for joint in effect.joints]] = effect.values
        return found

    @property
    def terms(self) -> tuple[EffectTerm, ...]:
        """Terms of an arm model that serve commands at rest."""
        return tuple(effect.term() for effect in self.effects if effect.at_rest and effect.names)


def effects_in_motion(arm: RecordedArm, told: Told = ignore_words) -> MotionDiscovery:
    """Search recordings of one arm for effects of its joints; as ``identify_from_motion``, which raises the same."""
    own = tuple(motion_laws(EFFECTS.values()))
    return _Search(*motion_problem(arm, told), told, own).run()


@dataclass(frozen=True)
class _Step:
    """What entered: its terms, its statistic, and held-out errors before and after."""

    law: Law | MotionLaw
    terms: tuple[JointTerm, ...]
    statistic: float
    p_value: float
    before_mm: float
    after_mm: float


@dataclass(frozen=True, eq=False)
class _State:
    """Problem with the terms so far, its solution, and the held-out error."""

    problem: Problem
    solution: Solution
    heldout_mm: float


@dataclass(frozen=True, eq=False)
class _Search:
    problem: Problem
    stop_rows: NDArray[np.intp]
    told: Told
    own: tuple[MotionLaw, ...] = ()
    """Laws of speeds that plug-ins add."""

    @property
    def alternatives(self) -> int:
        """Laws that chance may choose from."""
        return len(Law) + len(_OF_POSTURE) + len(self.own)

    def run(self) -> MotionDiscovery:
        """Laws of all joints and lines, until none is left that chance does not explain."""
        state = self._state(self.problem.without_terms(), None)
        state = _whitened(state)
        first_mm, steps = state.heldout_mm, list[_Step]()
        loads = (Law.WINDUP, Law.COMPLIANCE) if self.problem.masses is not None else ()
        own = (law for law in self.own if self.problem.masses is not None or not law.needs_torques)
        laws: list[Law | MotionLaw] = [Law.PLAY, Law.LAG, *loads, *own]
        while True:
            found = self._law(state, [law for law in laws if not _has(steps, law)]) or self._lines(state, steps)
            if found is None:
                break
            state, step = found
            steps.append(step)
        state, steps = self._with_exact_counts(state, steps)
        state, steps = self._without_chance(state, steps)
        final = self._unwhitened(state, self._plain(state))
        # with lags an offset is known by its sum with their mean only, and is left as it is
        freed = final.solution if _has(steps, Law.LAG) else allow_for_missing(final.problem, final.solution)
        fit = motion_fit(final.problem, freed)
        effects = tuple(_effect(final, law, steps) for law in dict.fromkeys(step.law for step in steps))
        laws_at_rest = [law for law in dict.fromkeys(step.law for step in steps) if law in _AT_REST]
        at_rest = [term for law in laws_at_rest for term in _shown(final, law, steps)]
        places = [*range(final.problem.layout.geometric), *_places(final, at_rest)]
        covariance = final.solution.noise.covariance[np.ix_(places, places)]
        lost = {joint for one in effects if one.slug in (Law.PLAY.value, Law.WINDUP.value) for joint in one.joints}
        drawn = loops(final.problem, final.solution, sorted(lost))
        return MotionDiscovery(fit, effects, first_mm, final.heldout_mm, covariance, drawn)

    def _with_exact_counts(self, state: _State, steps: list[_Step]) -> tuple[_State, list[_Step]]:
        """Lines at the counts that are best beside all other terms: the first ones entered before these were known.

        Lines of one joint that are not apart over the turns that it made are joined to the stronger one.
        """
        for _ in range(_COUNT_ROUNDS):
            lines = _terms(Law.LINE, steps)[::2]
            better: dict[tuple[int, int], int | None] = {}
            for term in lines:
                if (term.joint, term.cycles) in better:
                    continue
                self.told(f"cycles of lines of joint {term.joint + 1}")
                near = _near(state, term, lines)
                values = state.solution.values.copy()
                values[_places(state, [t for line in near for t in _pair(line.joint, line.cycles)])] = 0.0
                power = line_powers(state.problem, replace(state.solution, values=values))[0][term.joint]
                reach = np.abs(np.arange(len(power)) - term.cycles) <= _reach(state, term)
                count = int(np.argmax(np.where(reach & (np.arange(len(power)) > 1), power, 0.0)))
                better.update({(line.joint, line.cycles): None for line in near})
                better[term.joint, term.cycles] = count
            if all(cycles == count for (_, cycles), count in better.items()):
                break
            steps = [_recounted(step, better) for step in steps]
            steps = [step for step in steps if step.terms]
            state = self._refitted(state, steps)
        return state, steps

    def _without_chance(self, state: _State, steps: list[_Step]) -> tuple[_State, list[_Step]]:
        """Without laws that entered early and that chance explains beside all others."""
        for step in list(steps):
            if step.law is Law.LINE:
                continue
            p_value = min(1.0, float(chdtrc(len(step.terms), _statistic(state, step.terms))) * self.alternatives)
            if p_value > _CHANCE or not _shown(state, step.law, steps):
                steps = [one for one in steps if one is not step]
                state = self._refitted(state, steps)
        return state, steps

    def _refitted(self, state: _State, steps: Sequence[_Step]) -> _State:
        """The same with the terms of ``steps``, in the same order; new terms begin at zero."""
        layout, terms = state.problem.layout, tuple(term for step in steps for term in step.terms)
        problem = state.problem.without_terms().with_terms(terms)
        values = np.insert(
            np.delete(state.solution.values, np.arange(layout.geometric, layout.arm)),
            layout.geometric,
            [
                float(state.solution.values[_places(state, [term])[0]]) if term in layout.terms else 0.0
                for term in terms
            ],
        )
        return self._state(problem, values)

    def _plain(self, state: _State) -> _State:
        """All points as they are."""
        return self._state(replace(state.problem, whitening=None), state.solution.values)

    def _unwhitened(self, state: _State, plain: _State) -> _State:
        """All points as they are, for predictions; lines and play, which are fast, stay as the whitened residuals
        determine them, where these tell more of them than ``plain`` ones."""
        problem, solution, size = plain.problem, state.solution, state.problem.layout.geometric
        mean, precision = problem.mean.copy(), problem.precision.copy()
        own, theirs = (np.diag(one.noise.covariance) for one in (solution, plain.solution))
        for number, term in enumerate(problem.layout.terms, start=size):
            if term.law in (Law.LINE, Law.PLAY) and own[number] < theirs[number]:
                mean[number] = solution.values[number]
                precision[number] = 1.0 / own[number]
        if np.array_equal(precision, problem.precision):
            return plain
        return self._state(replace(problem, mean=mean, precision=precision), solution.values)

    def _judged(self, trial: _State) -> _State:
        """The same fitted with filters of what its terms leave, as those of residuals without them hide a part; with
        the held-out error of the arm by all points as they are, as filtered ones tell little of the geometry."""
        plain = self._plain(trial)
        filtered = self._state(_whitened(plain).problem, plain.solution.values)
        return replace(filtered, heldout_mm=self._unwhitened(filtered, plain).heldout_mm)

    def _state(self, problem: Problem, start: Array | None) -> _State:
        laws = list(dict.fromkeys(term.law.value for term in problem.layout.terms))
        beginning = f"with {', '.join(laws)}: " if laws else ""
        solution = solve(problem, self.stop_rows, start, lambda words: self.told(beginning + words))
        return _State(problem, solution, held_out_rms_mm(problem, solution))

    def _extended(self, state: _State, terms: tuple[JointTerm, ...]) -> _State:
        at = state.problem.layout.arm
        start = np.insert(state.solution.values, at, np.zeros(len(terms)))
        return self._state(state.problem.with_terms(terms), start)

    def _law(self, state: _State, laws: Sequence[Law | MotionLaw]) -> tuple[_State, _Step] | None:
        """The law of all joints that is least likely to be chance and lowers the held-out error."""
        tried = []
        for law in laws:
            terms = terms_of(law, state.problem.layout.parameters.joints)
            trials = [self._extended(state, terms)]
            if law in _OF_POSTURE:
                trials.append(self._extended(replace(state, problem=replace(state.problem, whitening=None)), terms))
            statistic, trial = max(((_statistic(one, terms), one) for one in trials), key=lambda each: each[0])
            p_value = min(1.0, float(chdtrc(len(terms), statistic)) * self.alternatives)
            if p_value < _CHANCE:
                tried.append((trial, _Step(law, terms, statistic, p_value, state.heldout_mm, math.nan)))
        for trial, step in sorted(tried, key=lambda each: (each[1].p_value, -each[1].statistic)):
            judged = self._judged(trial)
            if judged.heldout_mm < state.heldout_mm:
                return judged, replace(step, after_mm=judged.heldout_mm)
        return None

    def _lines(self, state: _State, steps: Sequence[_Step]) -> tuple[_State, _Step] | None:
        """The strongest lines of the residuals, at most one of each joint."""
        taken = [(term.joint, term.cycles) for step in steps for term in step.terms if term.law is Law.LINE]
        if len(taken) >= 2 * _MOST_LINES:
            return None
        power, turns = line_powers(state.problem, state.solution)
        threshold = math.log(power.size / _CHANCE)
        for joint, cycles in taken:
            near = np.abs(np.arange(power.shape[1]) - cycles) <= max(1.0, _ALIKE_TURNS / max(turns[joint], 1e-3))
            power[joint, near] = 0.0
        power[:, :2] = 0.0
        chosen = [
            (joint, int(np.argmax(power[joint]))) for joint in range(len(power)) if power[joint].max() > threshold
        ]
        terms = tuple(JointTerm(Law.LINE, joint, cycles, sine) for joint, cycles in chosen for sine in (False, True))
        if not terms:
            return None
        trial = self._extended(state, terms)
        tested = {pair: _statistic(trial, terms[2 * n : 2 * n + 2]) for n, pair in enumerate(chosen)}
        limit = float(chdtri(2, _CHANCE / power.size))
        kept = tuple(term for term in terms if tested[term.joint, term.cycles] > limit)
        if not kept:
            return None
        if len(kept) < len(terms):
            trial = self._extended(state, kept)
        statistic = _statistic(trial, kept)
        p_value = min(1.0, float(chdtrc(len(kept), statistic)) * power.size)
        trial = self._judged(trial)
        if trial.heldout_mm >= state.heldout_mm:
            return None
        return trial, _Step(Law.LINE, kept, statistic, p_value, state.heldout_mm, trial.heldout_mm)


def _whitened(state: _State) -> _State:
    """The same state, for steps that weigh every frequency by its noise."""
    model = state.problem.model(state.solution.values)
    filters = tuple(
        whitening_filter(residuals(model, track, number, source.rows), track.stamps.period_s)
        for number, (track, source) in enumerate(zip(state.problem.tracks, state.solution.sources))
    )
    return replace(state, problem=replace(state.problem, whitening=filters))


def _pair(joint: int, cycles: int) -> tuple[JointTerm, JointTerm]:
    return JointTerm(Law.LINE, joint, cycles, False), JointTerm(Law.LINE, joint, cycles, True)


def _reach(state: _State, term: JointTerm) -> float:
    """Counts that are not apart from that of a line over the turns that its joint made."""
    q = np.concatenate([track.path.at(track.path.stamps.time_s)[0][:, term.joint] for track in state.problem.tracks])
    return max(1.0, 2.0 * math.pi * _ALIKE_TURNS / max(float(np.ptp(q)), 1e-3))


def _near(state: _State, term: JointTerm, lines: Sequence[JointTerm]) -> list[JointTerm]:
    reach = _reach(state, term)
    return [line for line in lines if line.joint == term.joint and abs(line.cycles - term.cycles) <= 1.5 * reach]


def _recounted(step: _Step, better: Mapping[tuple[int, int], int | None]) -> _Step:
    """A step with its lines at other counts; those that are joined to another are gone."""
    if step.law is not Law.LINE:
        return step
    counts = [(term.joint, better[term.joint, term.cycles]) for term in step.terms[::2]]
    terms = [term for joint, count in counts if count is not None for term in _pair(joint, count)]
    return replace(step, terms=tuple(terms))


def _has(steps: Sequence[_Step], law: Law | MotionLaw) -> bool:
    return any(step.law.value == law.value for step in steps)


def _terms(law: Law | MotionLaw, steps: Sequence[_Step]) -> tuple[JointTerm, ...]:
    return tuple(term for step in steps if step.law is law for term in step.terms)


def _shown(state: _State, law: Law | MotionLaw, steps: Sequence[_Step]) -> tuple[JointTerm, ...]:
    """Terms of the joints that show a law."""
    terms = _terms(law, steps)
    values, covariance = _values(state, terms)
    errors = np.sqrt(np.diag(covariance))
    pairs = zip(terms, np.abs(values) > SHOWN * errors, strict=True)
    clear = {(term.joint, term.cycles) for term, shows in pairs if shows}
    return tuple(term for term in terms if (term.joint, term.cycles) in clear)


def _places(state: _State, terms: Sequence[JointTerm]) -> list[int]:
    layout = state.problem.layout
    return [layout.geometric + layout.terms.index(term) for term in terms]


def _values(state: _State, terms: Sequence[JointTerm]) -> tuple[Array, Array]:
    """Values of some terms and their covariance; lags less their mean."""
    places = _places(state, terms)
    values = state.solution.values[places]
    covariance = state.solution.noise.covariance[np.ix_(places, places)]
    if terms[0].law is Law.LAG:
        less_mean = np.eye(len(terms)) - 1.0 / len(terms)
        values, covariance = less_mean @ values, less_mean @ covariance @ less_mean.T
    return values, covariance


def _statistic(state: _State, terms: Sequence[JointTerm]) -> float:
    """Chi-square of some terms."""
    values, covariance = _values(state, terms)
    return float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)


def _effect(state: _State, law: Law | MotionLaw, steps: Sequence[_Step]) -> MotionEffect:
    own, terms = [step for step in steps if step.law is law], _shown(state, law, steps)
    values, covariance = _values(state, _terms(law, steps))
    places = [_terms(law, steps).index(term) for term in terms]
    values, errors = values[places], np.sqrt(np.diag(covariance))[places]
    only = ""
    if law is Law.LAG:
        only = "a delay moves nothing at rest"
    elif isinstance(law, MotionLaw):
        only = "it depends on speeds, which readings at rest do not have"
    elif law is Law.LINE and all(term.cycles >= DENSE for term in terms):
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
        at_rest=law in _AT_REST,
    )
