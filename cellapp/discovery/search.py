"""The search: effects are added while the data ask for one, laws are refined before a second name, names are reviewed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from cellapp.calibration.curves import CYCLES, find_curves
from cellapp.discovery.data import ArmData, Choice, Fit, Part, whitening
from cellapp.discovery.scan import Follower, Score, Seen, corrected_p, explained_by, null_maxima, threshold
from cellapp.effects import EFFECTS, Law
from cellapp.effects.unknown import dictionary, pairs
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel
from cellapp.progress import CancelToken

UNKNOWN = "unknown"
_MOST_EFFECTS = 5
_MOST_STEPS = 16
_RIVAL = 10.0
"""Effects whose score is this near the winner's are in its answer set; what is not in the library must lead by it."""
_SAME_CAUSE = 0.05
"""A later effect that depends on what an earlier one does and removes less than this share of what that one removed is
more likely the rest of an imperfect law than a second cause."""
_REACHED = 0.01
_LINES_TO_CURVE = 3


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
    """Look for effects among ``slugs`` and, beyond them, for what no effect of the library explains."""
    settings = data.profile.discovery
    weighed = data.weighed(())
    fit = weighed.fit(())
    weighed = weighed.at(fit.model)
    first = fit
    seen = Seen.of(weighed.candidates(fit, slugs), fit.follower)
    rng = np.random.default_rng([data.profile.seed, 0xD15C])
    maxima = null_maxima(seen, fit.follower, settings.null_simulations, rng)
    least = threshold(maxima, settings.false_alarm)
    engine = _Engine(data, tuple(slugs), maxima, least, cancel)
    steps: list[Step] = []
    choice: Choice = ()
    refused: set[tuple[str, str]] = set()
    here = weighed
    for _ in range(_MOST_STEPS):
        cancel.check()
        step = engine.next_step(here, fit, seen if not choice else None, refused)
        if step is None:
            step = engine.beyond_library(here, fit)
            if step is None:
                break
        choice = step.choice
        here, fit = engine.refit(choice)
        steps.append(replace(step, model=fit.model))
        if len({part.slug for part in choice}) >= _MOST_EFFECTS and step.slug == UNKNOWN:
            break
    here, fit, reviewed, dropped = engine.review(here, fit)
    return Search(here, first, fit, reviewed, tuple(steps), maxima, least, seen, dropped)


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

    def next_step(self, here: ArmData, fit: Fit, seen: Seen | None, refused: set[tuple[str, str]]) -> Step | None:
        """The best new effect or the best refinement of one that is there; None if nothing passes."""
        taken = {part.slug for part in fit.choice}
        if seen is None:
            left = [slug for slug in self.slugs if slug not in taken]
            seen = Seen.of(here.candidates(fit, left), fit.follower)
        square = float(fit.residual @ fit.follower.without(fit.residual))
        MY = fit.follower.without(fit.residual)
        found = best_of_each(seen.scores(MY, square))
        refinement = self._refinement(here, fit)
        new = next((score for score in found if (score.slug, score.candidate.law.name) not in refused), None)
        best_new = -math.inf if new is None else new.value
        if refinement is not None and refinement[0] > max(best_new - _RIVAL, 0.0):
            gain, step = refinement
            return step
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

    def _accept(self, here: ArmData, fit: Fit, score: Score, seen: Seen, MY: Array, square: float) -> Step | None:
        """Try to add an effect: without the blocks where it would be impossible, and confirmed on readings left out."""
        possible = self._plausible(here, fit, score, seen, MY, square)
        if possible is None or possible.value <= self.least:
            return None
        number = seen.candidates.index(possible.candidate)
        B, _ = seen.part(number)
        if here.confirmed(fit, B[list(possible.chosen)], here.profile.discovery.folds) <= 0.0:
            return None
        part = Part(possible.slug, possible.candidate.law, possible.names)
        title = EFFECTS[possible.slug].title
        return Step(
            possible.slug, f"{title} added", possible.value, corrected_p(self.maxima, possible.value), (*fit.choice, part)
        )

    def _plausible(
        self, here: ArmData, fit: Fit, score: Score, seen: Seen, MY: Array, square: float
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
            trial = here.fit((*fit.choice, part))
            wrong = here.impossible(trial, len(fit.choice))
            if not wrong:
                return current
            banned |= wrong
            keep = [place for place, column in enumerate(candidate.columns) if column.block not in banned]
            if not keep:
                return None
            B, MB = seen.part(number)
            fewer = replace(candidate, columns=tuple(candidate.columns[p] for p in keep), B=B[keep])
            alone = Seen.of([fewer], fit.follower)
            again = alone.greedy(0, MY, square)
            if again is None:
                return None
            names = set(again.names)
            chosen = tuple(place for place, column in enumerate(candidate.columns) if column.name in names)
            current = Score(candidate, again.value, chosen, again.explained)
        return None

    def _refinement(self, here: ArmData, fit: Fit) -> tuple[float, Step] | None:
        """A better law, or more joints, for an effect that is there: the gain over what it has, and the step."""
        best: tuple[float, Step] | None = None
        for place, part in enumerate(fit.choice):
            if part.slug == UNKNOWN or part.curves is not None:
                continue
            follower = fit.follower_without(place)
            y = fit.residual + fit.signal(place)
            MY = follower.without(y)
            square = float(y @ MY)
            seen = Seen.of(here.candidates(fit, [part.slug]), follower)
            own = _value(here, fit, place, seen, MY, square)
            for score in seen.scores(MY, square)[:2]:
                gain = score.value - own
                same = score.candidate.law.name == part.law.name and set(score.names) == set(part.names)
                if same or gain <= max(self.least, _RIVAL) or (best is not None and gain <= best[0]):
                    continue
                without = replace(fit, choice=fit.choice[:place] + fit.choice[place + 1 :])
                possible = self._plausible(here, without, score, seen, MY, square)
                if possible is None or possible.value - own <= max(self.least, _RIVAL):
                    continue
                refined = Part(part.slug, possible.candidate.law, possible.names)
                choice = (*fit.choice[:place], refined, *fit.choice[place + 1 :])
                words = refined.law.name.replace("_", " ") or "more of it"
                step = Step(
                    part.slug,
                    f"{EFFECTS[part.slug].title}: {words}",
                    possible.value - own,
                    corrected_p(self.maxima, possible.value - own),
                    choice,
                )
                best = (possible.value - own, step)
        return best

    # -- beyond the library ------------------------------------------------------------------------------------------

    def beyond_library(self, here: ArmData, fit: Fit) -> Step | None:
        """When nothing of the library passes any more: a free curve of the joints, or a data-driven term."""
        if any(part.slug == UNKNOWN for part in fit.choice) or self._floor_reached(here, fit):
            return None
        return self._curve(here, fit) or self._data_driven(here, fit)

    @staticmethod
    def _floor_reached(here: ArmData, fit: Fit) -> bool:
        """Whether the scatter needs no more than the stated uncertainty; unknown is no."""
        found = scatter(here, fit)
        return found is not None and found[1] > _REACHED

    def _curve(self, here: ArmData, fit: Fit) -> Step | None:
        """One free periodic curve a joint, where its evidence is above that of the lines found so far."""
        if here.stated is None or any(part.curves is not None for part in fit.choice):
            return None
        lines = next((i for i, part in enumerate(fit.choice) if part.slug == "transmission_error"), None)
        y, follower, worth = fit.residual, fit.follower, 0.0
        if lines is not None:
            y = fit.residual + fit.signal(lines)
            follower = fit.follower_without(lines)
            MY = follower.without(y)
            seen = Seen.of([here.candidate(fit, "transmission_error", fit.choice[lines].law)], follower)
            worth = _value(here, fit, lines, seen, MY, float(y @ MY))
        # in units of the stated uncertainty, as the curves' noise is a factor on it
        stated = replace(here, sigma=here.stated)
        bare = stated.fit(tuple(part for i, part in enumerate(fit.choice) if i != lines))
        residual = bare.follower.without(bare.residual)
        levers = np.sqrt(np.mean(np.sum(bare.by_joint**2, axis=0), axis=1))
        joints = tuple(j for j in range(here.readings.joints) if levers[j] > 0.05 * levers.max())
        curves = find_curves(
            here.readings.q, bare.by_joint, np.eye(3)[:, :, None] * np.ones(len(here)),
            bare.follower.basis, residual, joints, CYCLES,
        )
        price = (2 * len(joints) + 1) * math.log(len(residual))
        value = curves.evidence - price - worth
        if value <= max(self.least, _RIVAL):
            return None
        matters = [
            k for k, j in enumerate(curves.joints) if curves.amplitudes[k] * levers[j] > 0.3 * curves.noise
        ]
        if not matters:
            return None
        curves = replace(
            curves,
            joints=tuple(curves.joints[k] for k in matters),
            lengths=curves.lengths[matters],
            amplitudes=curves.amplitudes[matters],
        )
        constants: dict[str, float] = {"cycles": float(CYCLES)}
        for j, length, amplitude in zip(
            curves.joints, curves.lengths.tolist(), curves.amplitudes.tolist(), strict=True
        ):
            constants |= {f"length{j + 1}": length, f"amplitude{j + 1}": amplitude}
        law = Law("curve", constants)
        names = tuple(column.name for column in EFFECTS["transmission_error"].columns(here.context, law))
        part = Part("transmission_error", law, names, curves=curves)
        rest = tuple(p for i, p in enumerate(fit.choice) if i != lines)
        title = EFFECTS["transmission_error"].title
        return Step(
            "transmission_error",
            f"{title}: a free curve a joint",
            value,
            corrected_p(self.maxima, value),
            (*rest, part),
        )

    def _data_driven(self, here: ArmData, fit: Fit) -> Step | None:
        """The channel and the one or two variables that explain most of what is left."""
        MY = fit.follower.without(fit.residual)
        square = float(fit.residual @ MY)
        laws = [law for _, _, law in dictionary(here.context)]
        best = self._best_law(here, fit, laws, MY, square)
        two_laws = list(pairs(here.context))
        if best is not None:
            channel = best.candidate.law.name.split("|")[0]
            known = {law.name for law in two_laws}
            two_laws += [law for law in pairs(here.context, channel) if law.name not in known]
        two = self._best_law(here, fit, two_laws, MY, square)
        if two is not None and (best is None or two.value > best.value + _RIVAL):
            best = two
        if best is None or best.value <= self.least:
            return None
        number_columns = list(best.chosen)
        if here.confirmed(fit, best.candidate.B[number_columns], here.profile.discovery.folds) <= 0.0:
            return None
        part = Part(UNKNOWN, best.candidate.law, best.names)
        return Step(
            UNKNOWN, "a data-driven term added", best.value, corrected_p(self.maxima, best.value), (*fit.choice, part)
        )

    @staticmethod
    def _best_law(here: ArmData, fit: Fit, laws: Sequence[Law], MY: Array, square: float) -> Score | None:
        """The best of many data-driven laws; choosing among them has its price."""
        best: Score | None = None
        for begin in range(0, len(laws), 200):
            group = [here.candidate(fit, UNKNOWN, law) for law in laws[begin : begin + 200]]
            seen = Seen.of(group, fit.follower)
            for score in seen.scores(MY, square)[:1]:
                if best is None or score.value > best.value:
                    best = score
        if best is None:
            return None
        return replace(best, value=best.value - 2.0 * math.log(max(len(laws), 1)))

    # -- review ------------------------------------------------------------------------------------------------------

    def review(self, here: ArmData, fit: Fit) -> tuple[ArmData, Fit, tuple[Reviewed, ...], tuple[str, ...]]:
        """Drop what the others made superfluous or what is the rest of an imperfect law; find each one's rivals."""
        dropped: list[str] = []
        while True:
            self.cancel.check()
            reviewed = [self._reviewed(here, fit, place) for place in range(len(fit.choice))]
            weak = [
                place
                for place, one in enumerate(reviewed)
                if one.score <= self.least and one.part.curves is None
            ]
            if weak and len(fit.choice) > 1:
                out = min(weak, key=lambda place: reviewed[place].score)
            elif (rest := self._rest_of_a_law(here, fit)) is not None:
                out = rest
            else:
                return here, fit, tuple(reviewed), tuple(dropped)
            dropped.append(fit.choice[out].slug)
            here, fit = self.refit(fit.choice[:out] + fit.choice[out + 1 :])

    def _rest_of_a_law(self, here: ArmData, fit: Fit) -> int | None:
        """A part that is likely what an imperfect law of another left over: same variables, small, floor not reached."""
        if self._floor_reached(here, fit):
            return None
        removed = [float(np.sum(fit.follower_without(i).without(fit.signal(i)) ** 2)) for i in range(len(fit.choice))]
        for place, part in enumerate(fit.choice):
            if part.slug == UNKNOWN:
                continue
            for other, more in enumerate(fit.choice):
                if more.slug == UNKNOWN or other == place:
                    continue
                shared = EFFECTS[part.slug].variables & EFFECTS[more.slug].variables
                if shared and removed[place] < _SAME_CAUSE * removed[other]:
                    return place
        return None

    def _reviewed(self, here: ArmData, fit: Fit, place: int) -> Reviewed:
        part = fit.choice[place]
        follower = fit.follower_without(place)
        y = fit.residual + fit.signal(place)
        MY = follower.without(y)
        square = float(y @ MY)
        if part.curves is not None:
            value = part.curves.evidence
            return Reviewed(part, value, corrected_p(self.maxima, value), ())
        taken = {p.slug for p in fit.choice}
        others = [slug for slug in self.slugs if slug not in taken]
        own = here.candidate(fit, part.slug, part.law)
        seen = Seen.of([own, *here.candidates(fit, others)], follower)
        value = _value(here, fit, place, seen, MY, square)
        rivals = []
        if part.slug != UNKNOWN:
            for score in best_of_each(seen.scores(MY, square, range(1, len(seen.candidates)))):
                if score.value > max(value - _RIVAL, 0.0):
                    apart = self._told_apart(fit, place, seen, score, y)
                    rivals.append(Rival(score.slug, score.value, apart))
        return Reviewed(part, value, corrected_p(self.maxima, value), tuple(rivals))

    def _told_apart(self, fit: Fit, place: int, seen: Seen, rival: Score, y: Array) -> bool:
        """Whether the part still explains something after the rival has explained all it can."""
        number = seen.candidates.index(rival.candidate)
        B, _ = seen.part(number)
        begin = len(fit.rows) - len(fit.columns) + sum(len(p.names) for p in fit.choice[:place])
        kept = np.ones(len(fit.rows), dtype=bool)
        kept[begin : begin + len(fit.choice[place].names)] = False
        design = np.concatenate([fit.rows[kept], B[list(rival.chosen)]])
        precision = np.concatenate([fit.precision[kept], np.zeros(len(rival.chosen))])
        follower = Follower.of(np.ascontiguousarray(design.T), precision)
        MY = follower.without(y)
        square = float(y @ MY)
        own = fit.rows[begin : begin + len(fit.choice[place].names)]
        explained = explained_by(own, follower, MY)
        share = min(explained / square, 1.0 - 1e-12)
        N = len(y)
        return -N * math.log1p(-share) - len(own) * math.log(N) > self.least


def _value(here: ArmData, fit: Fit, place: int, seen: Seen, MY: Array, square: float) -> float:
    """The score of a part as it is, where ``MY`` and ``square`` are of the residual without it."""
    part = fit.choice[place]
    begin = len(fit.rows) - len(fit.columns) + sum(len(p.names) for p in fit.choice[:place])
    own = fit.rows[begin : begin + len(part.names)]
    follower = fit.follower_without(place)
    share = min(explained_by(own, follower, MY) / square, 1.0 - 1e-12)
    N = len(MY)
    blocks = len({column.block for column in fit.columns[begin - (len(fit.rows) - len(fit.columns)) :][: len(own)]})
    many = part.slug == "transmission_error" and part.law.name == "lines"
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
    """Root of chi-square per degree of freedom against the stated uncertainty, and the chance of one at least as large."""
    if here.stated is None:
        return None
    residuals = fit.identification.residuals
    white = whitening(here.stated, len(here))
    total = float(np.sum(np.einsum("acn,nc->an", white, residuals) ** 2))
    effective = fit.follower.basis.shape[1] if not np.any(fit.precision) else float(np.sum(fit.follower.basis**2))
    freedom = max(3.0 * len(here) - float(effective), 1.0)
    return math.sqrt(total / freedom), float(chi2.sf(total, freedom))
