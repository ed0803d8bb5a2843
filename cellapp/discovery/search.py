"""The search: effects are added while the data ask for one, laws refined before a second name, names reviewed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from cellapp.calibration.curves import CYCLES, Curves, find_curves, variances
from cellapp.calibration.identification import TooFewReadings
from cellapp.discovery.data import ArmData, Choice, Fit, Part, whitening
from cellapp.discovery.scan import (
    Follower,
    Score,
    Seen,
    corrected_p,
    displacements,
    explained_by,
    null_maxima,
    threshold,
)
from cellapp.effects import EFFECTS, DriverVariable, Law
from cellapp.effects.data_driven import data_driven_form
from cellapp.effects.periodic import LINES, curve_law, wave_names
from cellapp.effects.unknown import dictionary, pairs
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel
from cellapp.progress import CancelToken

UNKNOWN = "unknown"
_MOST_EFFECTS = 5
_MOST_STEPS = 16
_MOST_TERMS = 3
_MANY_LINES = 10
"""Columns of a transmission error from which a free curve is tried instead."""
_RIVAL = 10.0
"""Effects whose score is this near the winner's are in its answer set; what is not in the library must lead by it."""
_SAME_CAUSE = 0.05
"""A later effect that depends on what an earlier one does and removes less than this share of what that one removed is
more likely the rest of an imperfect law than a second cause."""
_REMAINDER = 0.1
"""So much of what an effect does may be left over by its law, in rms, and look like another."""
_DOMINATED = 0.9
_READINGS_EACH = 4
"""Coordinates that each parameter of a model with a data-driven term needs."""
_LEAST_FOR_CURVES = 60
_REACHED = 0.001


@dataclass(frozen=True)
class Rival:
    """Another effect that scored near an accepted one in its place."""

    slug: str
    score: float
    told_apart: bool


@dataclass(frozen=True)
class Step:
    """One thing that the search did, with the model before and after it."""

    slug: str
    what: str
    score: float
    p_value: float
    choice: Choice
    model: ArmModel | None = None


@dataclass(frozen=True)
class Reviewed:
    """What an accepted effect is worth beside all the others, and who could take its place."""

    part: Part
    score: float
    p_value: float
    rivals: tuple[Rival, ...]


@dataclass(frozen=True, eq=False)
class Search:
    """The outcome: the fit, what each of its parts is worth, how it came about, and the null distribution."""

    data: ArmData
    first: Fit
    fit: Fit
    reviewed: tuple[Reviewed, ...]
    steps: tuple[Step, ...]
    maxima: Array
    least: float
    seen: Seen
    dropped: tuple[str, ...]


def search(data: ArmData, slugs: Sequence[str], cancel: CancelToken) -> Search:
    """Look for effects among ``slugs`` and, beyond them, for what no effect of the library explains.

    Where names alone do not reach the floor, a second way begins with what the library lacks, so that a name need not
    stand for it; the better of both, by the Bayesian information criterion, is told.
    """
    settings = data.profile.discovery
    weighed = data.weighed(())
    fit = weighed.fit(())
    here = weighed.at(fit.model)
    seen = Seen.of(here.candidates(fit, slugs), fit.follower)
    rng = np.random.default_rng([data.profile.seed, 0xD15C])
    maxima = null_maxima(seen, fit.follower, settings.null_simulations, rng)
    least = threshold(maxima, settings.false_alarm)
    engine = _Engine(data, tuple(slugs), maxima, least, cancel)
    named = engine.named(_Way(here, fit), seen)
    best = engine.reviewed_way(named)
    if not engine.floor_reached(best):
        further = engine.beyond_library(best)
        ways = [best] if further is None else [best, engine.reviewed_way(engine.named(further, None))]
        if best.fit.choice and further is not None and not engine.dominates(best, further):
            first = engine.beyond_library(_Way(here, fit))
            if first is not None:
                ways.append(engine.reviewed_way(engine.named(first, None)))
        best = engine.best(ways)
    reviewed = tuple(engine.worth(best, place) for place in range(len(best.fit.choice)))
    return Search(best.data, fit, best.fit, reviewed, best.steps, maxima, least, seen, best.dropped)


def on_all(found: Search, data: ArmData) -> Search:
    """The outcome of a search among some readings, fitted to all of them."""
    here = data.at(found.fit.model).weighed(found.fit.choice)
    fit = here.fit(found.fit.choice)
    here = here.at(fit.model)
    return replace(found, data=here, fit=here.fit(found.fit.choice))


@dataclass(frozen=True, eq=False)
class _Way:
    """A place in the search: the fit there and how it was reached."""

    data: ArmData
    fit: Fit
    steps: tuple[Step, ...] = ()
    dropped: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Engine:
    data: ArmData
    slugs: tuple[str, ...]
    maxima: Array
    least: float
    cancel: CancelToken

    def refit(self, choice: Choice) -> tuple[ArmData, Fit]:
        """Fit a choice with weights of its own; what effects depend on is taken at the geometry it finds."""
        here = self.data.weighed(choice)
        fit = here.fit(choice)
        here = here.at(fit.model)
        return here, here.fit(choice)

    def taken(self, way: _Way, step: Step) -> _Way:
        """The way after a step: refitted, and the constants of the laws improved."""
        here, fit = self.refit(step.choice)
        here, fit = self._improved(here, fit)
        return _Way(here, fit, (*way.steps, replace(step, choice=fit.choice, model=fit.model)), way.dropped)

    def named(self, way: _Way, seen: Seen | None) -> _Way:
        """Go on with effects of the library while one passes."""
        refused: set[tuple[str, str]] = set()
        refining = True
        for _ in range(_MOST_STEPS):
            self.cancel.check()
            step = self._next_step(way, seen, refused, refining=refining)
            if step is None:
                break
            after = self.taken(way, step)
            if step.slug in {part.slug for part in way.fit.choice} and self.best([after, way]) is way:
                refining = False  # what promised to be better in the linear scan is not
                continue
            way, seen = after, None
            if step.slug == "transmission_error" and len(step.choice[-1].names) >= _MANY_LINES:
                # so many lines are a curve: what it leaves is judged better than what some of its lines leave
                way = self._curve(way) or way
        return way

    def dominates(self, named: _Way, further: _Way) -> bool:
        """Whether the names explain nearly all of what is explained with a data-driven term as well."""
        nothing = self._unexplained(_Way(*self.refit(())))
        total = nothing - self._unexplained(further)
        return nothing - self._unexplained(named) > _DOMINATED * total

    @staticmethod
    def _unexplained(way: _Way) -> float:
        """Sum of squares of what a way leaves, against the stated uncertainty."""
        white = whitening(way.data.stated, len(way.data))
        return float(np.sum(np.einsum("acn,nc->an", white, way.fit.identification.residuals) ** 2))

    def best(self, ways: Sequence[_Way]) -> _Way:
        """The way with the least criterion; what curves are worth is asked only where not all have them."""
        curved = {any(part.curves is not None for part in way.fit.choice) for way in ways}
        return min(ways, key=lambda way: self.criterion(way, evidence=len(curved) > 1))

    def criterion(self, way: _Way, *, evidence: bool) -> float:
        """Bayesian information criterion of a way, for the same weights: the stated uncertainty.

        With ``evidence``, that of free curves takes the place of what counting effective parameters would give.
        """
        curved = next((part for part in way.fit.choice if part.curves is not None), None)
        if evidence and curved is not None and curved.curves is not None:
            rest = tuple(part for part in way.fit.choice if part is not curved)
            gain = curved.curves.evidence - _curve_price(curved.curves, way.data)
            return self.criterion(_Way(*self.refit(rest)), evidence=evidence) - gain + _RIVAL
        total = self._unexplained(way)
        N = 3 * len(way.data)
        price = float(np.sum(way.fit.follower.basis**2)) * math.log(N)
        for part in way.fit.choice:
            price += 2.0 * math.log(max(part.law.tried, 1)) + _RIVAL * (2.0 if part.slug == UNKNOWN else 1.0)
        return N * math.log(total) + price

    def _next_step(self, way: _Way, seen: Seen | None, refused: set[tuple[str, str]], *, refining: bool) -> Step | None:
        """The best new effect or the best refinement of one that is there; None if nothing passes."""
        here, fit = way.data, way.fit
        taken = {part.slug for part in fit.choice}
        if seen is None:
            left = [slug for slug in self.slugs if slug not in taken]
            seen = Seen.of(here.candidates(fit, left), fit.follower)
        MY = fit.follower.without(fit.residual)
        square = float(fit.residual @ MY)
        found = [score for score in seen.scores(MY, square) if (score.slug, score.candidate.law.name) not in refused]
        # before a second name is given, the law of the first is refined; without one it takes more to complicate it
        best_new = found[0].value if found else -math.inf
        needed = max(best_new - _RIVAL, 0.0) if best_new > self.least else max(self.least, _RIVAL)
        refinement = self._refinement(here, fit, needed) if refining else None
        if refinement is not None:
            return refinement
        for score in found:
            if score.value <= self.least or len(taken) >= _MOST_EFFECTS:
                break
            if (score.slug, score.candidate.law.name) in refused:
                continue
            accepted = self._accept(here, fit, score, seen, MY, square)
            if accepted is not None:
                return accepted
            refused.add((score.slug, score.candidate.law.name))
        return None

    def _line_beside(self, here: ArmData, fit: Fit, place: int, needed: float) -> Step | None:
        """A sharp line beside a free curve, which is smooth."""
        part = fit.choice[place]
        lines = next(law for law in EFFECTS[part.slug].laws(here.context) if law.form == LINES)
        candidate = here.candidate(fit, part.slug, lines)
        assert part.curves is not None
        sharp = [
            k
            for k, column in enumerate(candidate.columns)
            if column.joint in part.curves.joints and column.cycles is not None and column.cycles > CYCLES
        ]
        columns = tuple(candidate.columns[k] for k in sharp)
        candidate = replace(candidate, columns=columns, B=candidate.B[sharp])
        seen = Seen.of([candidate], fit.follower)
        MY = fit.follower.without(fit.residual)
        square = float(fit.residual @ MY)
        score = seen.greedy(0, MY, square)
        if score is None or score.value <= max(needed, self.least):
            return None
        blocks: dict[str, list[int]] = {}
        for k in score.chosen:
            blocks.setdefault(candidate.columns[k].block, []).append(k)
        folds = here.profile.discovery.folds
        held = [k for rows in blocks.values() if here.confirmed(fit, candidate.B[rows], folds) > _RIVAL for k in rows]
        names = tuple(candidate.columns[k].name for k in held if candidate.columns[k].name not in part.names)
        if not names:
            return None
        freed = frozenset(names) | part.free
        refined = replace(part, names=(*part.names, *names), free=freed)
        choice = (*fit.choice[:place], refined, *fit.choice[place + 1 :])
        title = EFFECTS[part.slug].title
        p_value = corrected_p(self.maxima, score.value)
        return Step(part.slug, f"{title}: lines beside the curve", score.value, p_value, choice)

    def _improved(self, here: ArmData, fit: Fit) -> tuple[ArmData, Fit]:
        """Move the constants of the laws (onset, time constant, knee, width) to where they explain most."""
        changed = False
        for place, part in enumerate(fit.choice):
            if part.slug == UNKNOWN or part.curves is not None:
                continue
            follower = fit.follower_without(place)
            y = fit.residual + fit.signal(place)
            MY = follower.without(y)
            names = set(part.names)
            law, value = part.law, float(explained_by(_own(fit, place), follower, MY))
            for shrink in (1.0, 1.0, 0.5, 0.5, 0.25, 0.12):
                for nearby in law.nearby(here.context, shrink):
                    columns = [c for c in here.columns(part.slug, nearby) if c.name in names]
                    rows = displacements(columns, fit.by_joint, fit.white)
                    trial = explained_by(rows, follower, MY)
                    if trial > value * (1.0 + 1e-9):
                        law, value = nearby, trial
            if law is not part.law:
                choice = (*fit.choice[:place], replace(part, law=law), *fit.choice[place + 1 :])
                fit = here.fit(choice)
                changed = True
        return self.refit(fit.choice) if changed else (here, fit)

    def _accept(self, here: ArmData, fit: Fit, score: Score, seen: Seen, MY: Array, square: float) -> Step | None:
        """Try to add an effect: without the blocks where it would be impossible, and confirmed on readings left out."""
        possible = self._plausible(here, fit.choice, fit.follower, score, seen, MY, square)
        if possible is None or possible.value <= self.least or self._remainder(here, fit, possible, square):
            return None
        number = seen.candidates.index(possible.candidate)
        B, _ = seen.part(number)
        if here.confirmed(fit, B[list(possible.chosen)], here.profile.discovery.folds) <= 0.0:
            return None
        part = Part(possible.slug, possible.candidate.law, possible.names)
        title = EFFECTS[possible.slug].title
        p_value = corrected_p(self.maxima, possible.value)
        return Step(possible.slug, f"{title} added", possible.value, p_value, (*fit.choice, part))

    def _remainder(self, here: ArmData, fit: Fit, score: Score, square: float) -> bool:
        """Whether a look-alike of something far larger is not needed: then it is what is left of that one's law."""
        if not self.floor_reached(_Way(here, fit)):
            return False
        for place, part in enumerate(fit.choice):
            if part.slug == UNKNOWN or part.curves is not None:
                continue
            alike = score.slug in EFFECTS[part.slug].look_alikes or part.slug in EFFECTS[score.slug].look_alikes
            if alike:
                removed = float(np.sum(fit.follower_without(place).without(fit.signal(place)) ** 2))
                if score.explained * square < _REMAINDER**2 * removed:
                    return True
        return False

    def _plausible(
        self, here: ArmData, rest: Choice, follower: Follower, score: Score, seen: Seen, MY: Array, square: float
    ) -> Score | None:
        """The score without the blocks whose values would be impossible; None if none is left.

        A negative stiffness is an alias of something else at that joint, which says nothing against the effect at
        others.
        """
        number = seen.candidates.index(score.candidate)
        candidate = score.candidate
        current: Score | None = score
        banned: set[str] = set()
        while current is not None:
            part = Part(current.slug, candidate.law, current.names)
            try:
                trial = here.fit((*rest, part))
            except TooFewReadings:  # so many columns are more than the readings left can tell
                return None
            wrong = here.impossible(trial, len(rest))
            if not wrong:
                return current
            banned |= wrong
            keep = [place for place, column in enumerate(candidate.columns) if column.block not in banned]
            if not keep:
                return None
            B, _ = seen.part(number)
            fewer = replace(candidate, columns=tuple(candidate.columns[p] for p in keep), B=B[keep])
            alone = Seen.of([fewer], follower)
            refined = any(candidate.columns[place].refines for place in score.chosen)
            again = alone.greedy(0, MY, square, refined=refined)
            if again is None:
                return None
            names = set(again.names)
            chosen = tuple(place for place, column in enumerate(candidate.columns) if column.name in names)
            current = Score(candidate, again.value, chosen, again.explained)
        return None

    def _refinement(self, here: ArmData, fit: Fit, needed: float) -> Step | None:
        """A better law, or more joints, for an effect that is there, that gains more than ``needed``."""
        best: Step | None = None
        for place, part in enumerate(fit.choice):
            if part.curves is not None:
                best = self._line_beside(here, fit, place, needed) or best
            if part.slug == UNKNOWN or part.curves is not None:
                continue
            follower = fit.follower_without(place)
            y = fit.residual + fit.signal(place)
            MY = follower.without(y)
            square = float(y @ MY)
            candidates = here.candidates(fit, [part.slug])
            if all(one.law != part.law for one in candidates):  # its constants were moved to where they explain most
                candidates.append(here.candidate(fit, part.slug, part.law))
            if len(part.names) >= _MANY_LINES:  # rather a curve than one line after the other
                candidates = [one for one in candidates if len(one.columns) <= 2 * _MANY_LINES]
            effect = EFFECTS[part.slug]
            further = effect.refinements(here.context, part.law, part.names)
            candidates += [here.candidate(fit, part.slug, law) for law in further]
            seen = Seen.of(candidates, follower)
            own = _value(fit, place, follower, MY, square)
            for score in seen.scores(MY, square, refined=True)[:3]:
                gain = score.value - own
                same = score.candidate.law.name == part.law.name and set(score.names) == set(part.names)
                if same or gain <= needed or (best is not None and gain <= best.score):
                    continue
                rest = fit.choice[:place] + fit.choice[place + 1 :]
                possible = self._plausible(here, rest, follower, score, seen, MY, square)
                if possible is None or possible.value - own <= needed:
                    continue
                refined = Part(part.slug, possible.candidate.law, possible.names)
                choice = (*fit.choice[:place], refined, *fit.choice[place + 1 :])
                words = refined.law.name.replace("_", " ") or "more of it"
                gain = possible.value - own
                title = EFFECTS[part.slug].title
                best = Step(part.slug, f"{title}: {words}", gain, corrected_p(self.maxima, gain), choice)
        return best

    # -- beyond the library ------------------------------------------------------------------------------------------

    @staticmethod
    def floor_reached(way: _Way) -> bool:
        """Whether the scatter needs no more than the stated uncertainty; unknown is no."""
        found = scatter(way.data, way.fit)
        return found is not None and found[1] > _REACHED

    def beyond_library(self, way: _Way) -> _Way | None:
        """What nothing of the library explains: a data-driven term, or free curves of the joints if they do better."""
        driven = self.data_driven(way)
        for _ in range(_MOST_TERMS - 1):  # a shift has three directions
            if driven is None or self.floor_reached(driven):
                break
            further = self.data_driven(driven)
            if further is None:
                break
            driven = further
        curved = None if driven is not None and self.floor_reached(driven) else self._curve(way)
        ways = [one for one in (curved, driven) if one is not None]
        return self.best(ways) if ways else None

    def _curve(self, way: _Way) -> _Way | None:
        """One free periodic curve a joint, instead of the lines found so far or beside them, where it pays."""
        if way.data.stated is None or any(part.curves is not None for part in way.fit.choice):
            return None
        if len(way.data) < _LEAST_FOR_CURVES:
            return None
        ways = [self._curve_beside(way, way)]
        rest = tuple(part for part in way.fit.choice if part.slug != "transmission_error")
        if len(rest) < len(way.fit.choice):
            ways.append(self._curve_beside(_Way(*self.refit(rest)), way))
        best = self.best([way, *(one for one in ways if one is not None)])
        return None if best is way else best

    def _curve_beside(self, base: _Way, way: _Way) -> _Way | None:
        """The curves that what ``base`` leaves asks for, added to it; the steps are those of ``way``."""
        here, fit = base.data, base.fit
        # in units of the stated uncertainty, as the curves' noise is a factor on it
        bare = replace(here, sigma=here.stated).fit(fit.choice)
        residual = bare.follower.without(bare.residual)
        levers = np.sqrt(np.mean(np.sum(bare.by_joint**2, axis=0), axis=1))
        joints = tuple(j for j in range(here.readings.joints) if levers[j] > 0.05 * levers.max())
        unit = np.ascontiguousarray(np.broadcast_to(np.eye(3)[:, :, None], (3, 3, len(here))))
        for cycles, evaluations in ((40, 12), (CYCLES, 60)):
            curves = find_curves(
                here.readings.q, bare.by_joint, unit, bare.follower.basis, residual, joints, cycles, evaluations
            )
            # what the curves change of the noise's own share counts against the same noise
            value = curves.evidence - _curve_price(curves, here)
            if value <= max(self.least, _RIVAL):
                return None
            levers_of = [levers[j] for j in curves.joints]
            joints = tuple(
                j
                for j, lever, amplitude in zip(curves.joints, levers_of, curves.amplitudes.tolist(), strict=True)
                if amplitude * lever > 0.2 * curves.noise
            )
            if not joints:
                return None
        place = next((i for i, part in enumerate(fit.choice) if part.slug == "transmission_error"), None)
        kept = [k for k, joint in enumerate(curves.joints) if joint in joints]
        curves = replace(curves, joints=joints, lengths=curves.lengths[kept], amplitudes=curves.amplitudes[kept])
        law, names = _curve_law(curves)
        rest = fit.choice
        if place is not None:  # lines beyond the curve's reach stay, free; those within it become part of the curve
            names = (*names, *(name for name in fit.choice[place].names if name not in set(names)))
            rest = fit.choice[:place] + fit.choice[place + 1 :]
        part = Part("transmission_error", law, names, curves=curves)
        title = EFFECTS["transmission_error"].title
        step = Step(
            "transmission_error",
            f"{title}: a free curve a joint",
            value,
            corrected_p(self.maxima, value),
            (*rest, part),
        )
        return self.taken(replace(base, steps=way.steps, dropped=way.dropped), step)

    def data_driven(self, way: _Way) -> _Way | None:
        """The channel and the one or two variables that explain most of what is left, added."""
        here, fit = way.data, way.fit
        taken = {data_driven_form(part.law).subject for part in fit.choice if part.slug == UNKNOWN}
        MY = fit.follower.without(fit.residual)
        square = float(fit.residual @ MY)
        laws = [law for law in dictionary(here.context) if data_driven_form(law).subject not in taken]
        best = self._best_law(here, fit, laws, MY, square)
        two_laws = list(pairs(here.context))
        if best is not None:
            channel = data_driven_form(best.candidate.law).channel
            known = {law.name for law in two_laws}
            two_laws += [law for law in pairs(here.context, channel) if law.name not in known]
        two_laws = [law for law in two_laws if data_driven_form(law).subject not in taken]
        two = self._best_law(here, fit, two_laws, MY, square)
        wanted = [score for score in (two, best) if score is not None and score.value > self.least]
        if len(wanted) == 2 and wanted[0].value <= wanted[1].value + _RIVAL:
            wanted = wanted[1:]
        folds = here.profile.discovery.folds
        held = (s for s in wanted if here.confirmed(fit, s.candidate.B[list(s.chosen)], folds) > 0.0)
        best = next(held, None)
        if best is None:
            return None
        law, p_value = best.candidate.law, corrected_p(self.maxima, best.value)
        choices: list[Choice] = [(*fit.choice, Part(UNKNOWN, law, best.names))]
        # a name that stood for a part of it gives way, as the term holds whatever its channel does with its variables
        place = best.candidate.columns[0].where
        others = tuple(part for part in fit.choice if not self._acts_on(here, part, place))
        if len(others) < len(fit.choice):
            names = tuple(column.name for column in here.columns(UNKNOWN, law))
            choices.append((*others, Part(UNKNOWN, law, names)))
        ways = [self.taken(way, Step(UNKNOWN, "a data-driven term added", best.value, p_value, c)) for c in choices]
        return self.best(ways)

    @staticmethod
    def _acts_on(here: ArmData, part: Part, place: str) -> bool:
        """Whether a named part acts on one place alone."""
        if part.slug == UNKNOWN or part.curves is not None:
            return False
        return {column.where for column in here.columns(part.slug, part.law, part.names)} == {place}

    @staticmethod
    def _best_law(here: ArmData, fit: Fit, laws: Sequence[Law], MY: Array, square: float) -> Score | None:
        """The best of many data-driven laws; choosing among them has its price."""
        best: Score | None = None
        for begin in range(0, len(laws), 200):
            group = [here.candidate(fit, UNKNOWN, law) for law in laws[begin : begin + 200]]
            # with few readings a rich term could follow anything
            free = int(np.count_nonzero(fit.precision == 0.0)) + len(fit.identification.parameter_set.columns)
            group = [one for one in group if _READINGS_EACH * (len(one.columns) + free) <= 3 * len(here)]
            seen = Seen.of(group, fit.follower)
            for score in seen.scores(MY, square)[:1]:
                if best is None or score.value > best.value:
                    best = score
        if best is None:
            return None
        return replace(best, value=best.value - 2.0 * math.log(max(len(laws), 1)))

    # -- review ------------------------------------------------------------------------------------------------------

    def reviewed_way(self, way: _Way) -> _Way:
        """Drop what the others made superfluous, or what is likely the rest of an imperfect law."""
        here, fit = way.data, way.fit
        dropped = list(way.dropped)
        while True:
            self.cancel.check()
            values = [self._own_value(fit, place) for place in range(len(fit.choice))]
            weak = [
                place for place, value in enumerate(values) if value <= self.least and fit.choice[place].curves is None
            ]
            if weak:
                out = min(weak, key=lambda place: values[place])
            elif (rest := self._rest_of_a_law(here, fit)) is not None:
                out = rest
            else:
                return _Way(here, fit, way.steps, tuple(dropped))
            dropped.append(fit.choice[out].slug)
            here, fit = self.refit(fit.choice[:out] + fit.choice[out + 1 :])

    def _rest_of_a_law(self, here: ArmData, fit: Fit) -> int | None:
        """A part that is likely the rest of an imperfect law of another: same variables, small, floor not reached."""
        if self.floor_reached(_Way(here, fit)):
            return None
        removed = [float(np.sum(fit.follower_without(i).without(fit.signal(i)) ** 2)) for i in range(len(fit.choice))]
        for place, part in enumerate(fit.choice):
            if part.slug == UNKNOWN:
                continue
            for other, more in enumerate(fit.choice):
                if more.slug == UNKNOWN or other == place:
                    continue
                # everything depends on the posture; that alone makes no kin
                shared = (EFFECTS[part.slug].variables & EFFECTS[more.slug].variables) - {DriverVariable.JOINT_ANGLE}
                if shared and removed[place] < _SAME_CAUSE * removed[other]:
                    return place
        return None

    def _own_value(self, fit: Fit, place: int) -> float:
        """The score of a part beside all others."""
        follower = fit.follower_without(place)
        MY = follower.without(fit.residual + fit.signal(place))
        return _value(fit, place, follower, MY, float((fit.residual + fit.signal(place)) @ MY))

    def worth(self, way: _Way, place: int) -> Reviewed:
        """What a part is worth beside the others, and who could take its place."""
        here, fit = way.data, way.fit
        part = fit.choice[place]
        follower = fit.follower_without(place)
        y = fit.residual + fit.signal(place)
        MY = follower.without(y)
        square = float(y @ MY)
        value = _value(fit, place, follower, MY, square)
        if part.curves is not None:
            return Reviewed(part, part.curves.evidence, corrected_p(self.maxima, part.curves.evidence), ())
        rivals = []
        if part.slug != UNKNOWN:
            taken = {p.slug for p in fit.choice}
            seen = Seen.of(here.candidates(fit, [slug for slug in self.slugs if slug not in taken]), follower)
            for score in best_of_each(seen.scores(MY, square)):
                if score.value > max(value - _RIVAL, 0.0):
                    rivals.append(Rival(score.slug, score.value, self._told_apart(fit, place, seen, score, y)))
        return Reviewed(part, value, corrected_p(self.maxima, value), tuple(rivals))

    def _told_apart(self, fit: Fit, place: int, seen: Seen, rival: Score, y: Array) -> bool:
        """Whether the part still explains something after the rival has explained all it can."""
        B, _ = seen.part(seen.candidates.index(rival.candidate))
        kept = np.ones(len(fit.rows), dtype=bool)
        kept[_place_of(fit, place)] = False
        design = np.concatenate([fit.rows[kept], B[list(rival.chosen)]])
        precision = np.concatenate([fit.precision[kept], np.zeros(len(rival.chosen))])
        follower = Follower.of(np.ascontiguousarray(design.T), precision)
        MY = follower.without(y)
        own = _own(fit, place)
        share = min(explained_by(own, follower, MY) / float(y @ MY), 1.0 - 1e-12)
        N = len(y)
        return -N * math.log1p(-share) - len(own) * math.log(N) > self.least


def _place_of(fit: Fit, place: int) -> slice:
    """Where a part's rows are among all that was fitted."""
    begin = len(fit.rows) - len(fit.columns) + sum(len(part.names) for part in fit.choice[:place])
    return slice(begin, begin + len(fit.choice[place].names))


def _own(fit: Fit, place: int) -> Array:
    """A part's whitened columns (m, d)."""
    return fit.rows[_place_of(fit, place)]


def _curve_price(curves: Curves, data: ArmData) -> float:
    """What the length and amplitude of each curve, and the noise, cost."""
    return (2 * len(curves.joints) + 1) * math.log(3 * len(data))


def _curve_law(curves: Curves) -> tuple[Law, tuple[str, ...]]:
    """The law ``curve`` with the prior's constants, and the names of its columns."""
    lengths = dict(zip(curves.joints, curves.lengths.tolist(), strict=True))
    amplitudes = dict(zip(curves.joints, curves.amplitudes.tolist(), strict=True))
    law = curve_law({joint: (lengths[joint], amplitudes[joint]) for joint in curves.joints}, CYCLES)
    # cycles whose prior is close to zero need no column
    names = [
        name for joint in curves.joints for name in wave_names(joint, range(2, _cycles_that_matter(lengths[joint]) + 1))
    ]
    return law, tuple(names)


def _cycles_that_matter(length: float) -> int:
    """Cycles a turn below which all but half a per cent of a curve's variance lies."""
    share = np.cumsum(variances(length, 1.0, 10 * CYCLES))
    return min(int(np.searchsorted(share, 0.995 * share[-1])) + 2, CYCLES)


def _value(fit: Fit, place: int, follower: Follower, MY: Array, square: float) -> float:
    """The score of a part as it is, where ``follower``, ``MY`` and ``square`` are of the model without it."""
    part, own = fit.choice[place], _own(fit, place)
    share = min(explained_by(own, follower, MY) / square, 1.0 - 1e-12)
    N = len(MY)
    begin = sum(len(p.names) for p in fit.choice[:place])
    blocks = len({column.block for column in fit.columns[begin : begin + len(own)]})
    many = part.law.form == LINES
    price = 2.0 * math.log(max(part.law.tried, 1)) * (blocks if many else 1)
    return -N * math.log1p(-share) - len(own) * math.log(N) - price


def best_of_each(scores: Sequence[Score]) -> list[Score]:
    """The best law of each effect, best first."""
    best: dict[str, Score] = {}
    for score in scores:
        if score.slug not in best:
            best[score.slug] = score
    return list(best.values())


def scatter(here: ArmData, fit: Fit) -> tuple[float, float] | None:
    """Root of chi-square per degree of freedom against the stated uncertainty, and the chance of one so large."""
    if here.stated is None:
        return None
    residuals = fit.identification.residuals
    white = whitening(here.stated, len(here))
    total = float(np.sum(np.einsum("acn,nc->an", white, residuals) ** 2))
    effective = fit.follower.basis.shape[1] if not np.any(fit.precision) else float(np.sum(fit.follower.basis**2))
    freedom = max(3.0 * len(here) - float(effective), 1.0)
    return math.sqrt(total / freedom), float(chi2.sf(total, freedom))
