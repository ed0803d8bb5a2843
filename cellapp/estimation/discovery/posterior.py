"""Posterior probabilities of effects, from the final set of effects and the sets next to it.

The sets are the final set S; S without one effect; S with an alternative in an effect's place; and S with one further
effect. A score is a gain of the Bayesian information criterion, twice the log of a Bayes factor. So relative to S

    ln weight = 0                            S,
                -(score - threshold) / 2     S without an effect that has ``score`` beside all others,
                -penalty / 2                 S with an alternative in its place,
                (score - threshold) / 2      S with a further effect.

The threshold acts as the prior. With log prior odds of -threshold / 2 for each effect, an effect with a score at the
threshold is as probable as not. The threshold is the score that noise exceeds with the wanted chance of a false alarm,
over all laws tried: whoever wants fewer false alarms assumes that effects are rarer. A name in S was the best of all
that could be added, and few effects are so small that they score just above the threshold. Its score is therefore
reduced by the margin of very strong evidence, 10. Of six names within that margin above the threshold none was right;
of thirteen within the next 50 eight were (seeds 20261226, 20261227). Sets that differ from S by more have far smaller
weights unless two differences are likely each; they are left out.

    p(e) = sum of the weights of sets that hold e / sum of all weights.

Laws are only nearly right, and enough readings show that. An alternative that scores less by D leaves a share m^2 of
the sum of squares that the effect explains. This is either chance in the noise, at a penalty of D, or an error of the
alternative's law, at a penalty of m^2 / t^2 if the errors of laws in that direction are N(0, t^2) relative to their
size:

    penalty = 1 / (1 / D + t^2 / m^2).

For an effect confounded with it, every error of its law has that direction. There t is the share that a discrepancy
term of the law may have, 0.3, but no more than the readings would have shown: 10 over the effect's score. If the law is
off, so that a discrepancy term was kept, t is the share that this part may miss: an error of t scores t^2 times as much
as the effect, and 5 is needed.

The residuals of other laws in S may likewise look like an effect. Its score is therefore taken beside their discrepancy
terms, and its lead over the threshold is limited in the same way if a larger effect depends on the same variables.
Alternatives that tie share the probability.

The library may also lack the cause, and a name stand in for it. Before a search the odds of that are 1 to 9. A law that
is right leaves little of what it removes. Let w = residual / (residual + removed) be the share of sums of squares,
and residual what remains beyond the stated noise; its density is (k + 1)(1 - w)^k with k = 5. A law that stands in for
something else leaves any share: w is uniform. So each named effect has a set in which another cause is in its place,
with

    ln weight = -ln 9 - ln(k + 1) - k ln(1 - w).

A named free function leaves little whatever the cause is, and so does a series of a joint's lowest cycles, which is a
Fourier series. They are taken if no law of the effect has the shape: one in three of the effects that are there, and
every one of the others. Hence ln weight = ln 3 - ln 9.

With too few readings for data-driven laws the search names what stands in for something else, as nothing competes.
There such laws get priors on their values, and the best one has an evidence G: twice the logarithm less the price of
choosing it. A law that beats the effect's score by the same measure has G / 2 in place of 0, and takes its place with

    ln weight = -ln 9 - (score - threshold - G) / 2.

So no name is more probable than 98 %, and one that removes clearly less than what remains is not accepted. (Bayes
factors: Kass, Raftery, J. Am. Stat. Ass. 90 (1995) 773; averages over models: Hoeting et al., Stat. Sci. 14 (1999)
382.)
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.design.information import SMALLEST, NuisanceProjector, visible_squares
from cellapp.estimation.discovery.arm_data import UNKNOWN, ArmData, ModelTerm
from cellapp.estimation.discovery.joint_fit import MOST_SHARE, JointFit, ProjectedResidual, cross_validated_gain
from cellapp.estimation.discovery.search.discrepancy_term import (
    CAUTIOUS_SHARE,
    LEAST_EVIDENCE,
    SHARES,
    DiscrepancyTerm,
    are_confounded,
    gain_beside_discrepancies,
    possible_discrepancies,
)
from cellapp.estimation.discovery.search.scan import NO_DISPLACEMENT, LawScan
from cellapp.estimation.discovery.search.state import (
    SCORE_MARGIN,
    Posteriors,
    Review,
    SearchResult,
    SearchState,
    possible_score,
    scatter,
)
from cellapp.ground.grouping import grouped
from cellapp.robot.effects import EFFECTS, ActsOn, EffectColumn, InputVariable
from cellapp.robot.effects.data_driven import ActedOn, acted_on, form_of
from cellapp.robot.effects.periodic import LINES
from cellapp.robot.effects.unknown import (
    FunctionFamily,
    FunctionTable,
    acted_directions,
    curve_families,
    own_angles,
    pair_families,
)
from cellapp.robot.kinematics.transforms import Array

# -- Evidence for a law outside the library in place of a name, if the readings are too few to search for such laws ---
#
# If the readings determine all values of a data-driven term, it competes with every name. With fewer readings nothing
# else takes a name's place, and whatever looks a little like the cause is named. There the same functions in the same
# places get normal priors: their evidence needs no value to be determined.

COORDINATES_EACH = 4
"""Measured coordinates needed for each parameter of a model with a data-driven term; with fewer it could fit noise."""


def fitted_parameters(fit: JointFit) -> int:
    """Count the parameters of a model beside a data-driven term: those without priors, and all of the geometry."""
    return int(np.count_nonzero(fit.precision == 0.0)) + fit.layout.geometric


def too_few_to_compete(data: ArmData, fit: JointFit) -> bool:
    """Return whether the readings are too few for some data-driven laws of one or two joint angles."""
    most = max(Families.of(data, pair_families(data.context, own_angles(data.context))).sizes, default=0)
    return COORDINATES_EACH * (int(most) + fitted_parameters(fit)) > 3 * len(data)


def gains_by_another_cause(data: ArmData, fit: JointFit, numbers: Sequence[int]) -> list[float]:
    """Return twice the log evidence of the best law outside the library in place of each term, less the price of
    choosing.

    Laws with the term's own cause do not count: functions of variables that the effect depends on, and functions of a
    moved joint's own angle in the same place.
    """
    context, every = data.context, acted_on(data.context.joints)
    families = [*curve_families(context), *pair_families(context, own_angles(context))]
    evaluated, gains = Families.of(data, families), list[float]()
    for number in numbers:
        values = DirectionScan.of(data, fit, fit.residual_without(number)).evidence(evaluated, every)
        tried = int(np.count_nonzero(np.isfinite(values)))
        values[_of_same_cause(fit.terms[number], fit.term_columns(number), every, families)] = -math.inf
        gains.append(float(values.max(initial=-math.inf)) - 2.0 * math.log(max(tried, 1)))
    return gains


def _of_same_cause(
    term: ModelTerm, columns: tuple[EffectColumn, ...], every: tuple[ActedOn, ...], families: list[FunctionFamily]
) -> NDArray[np.bool_]:
    """Return a mask (places, families) of the functions that are a named effect in another shape."""
    own = EFFECTS[term.slug].variables
    moved = {(column.acts_on, column.index) for column in columns}
    found = np.zeros((len(every), len(families)), dtype=bool)
    for row, acts_on in enumerate(every):
        moves_alike = (acts_on.acts_on, acts_on.joint) in moved
        for place, family in enumerate(families):
            form = form_of(acts_on, family.inputs)
            if form.variables <= own:
                of_angles = form.variables <= {InputVariable.JOINT_ANGLE}
                of_its_joint = all(one.joint in (None, acts_on.joint) for one in family.inputs)
                found[row, place] = not of_angles or (moves_alike and of_its_joint)
    return found


# -- Scores of data-driven laws: every family of functions in every place, without forming their rows ---------------
#
# A law has functions f (k, n) of its variables, in a place whose directions move the SMR by u_d (3, n) per unit,
# whitened: its rows are f u_d. In the complement M = I - Q Q^T of a model's parameters its information and moments are
#
#     B M B^T = f K_de f^T,    K_de = sum_ab diag(u_da) M_ab diag(u_eb),    (n, n)
#     B M y = f (u_d . M y)
#
# for directions d, e, with M and M y of coordinates a, b. K depends on the directions alone, so all families share it.
# The score is that of ``search.scan`` for a law of one block.


_FAMILIES_AT_ONCE = 128
"""Batch size of families of equal size: bounds the memory (24 functions each, 800 parameters: 20 MB)."""
_SIZES = (0.3, 1.0, 3.0, 10.0, 30.0)
"""Sizes of a law's functions relative to the noise (rms, of a coordinate), tried for its evidence."""
MOST_COLUMNS = 72
"""Most columns of a law: a shift in three directions by 24 functions, or an offset of a joint by all."""
_Judge = Callable[[Array, Array, Array], Array]
"""Function that judges b laws: information, norms and moments -> values (b,)."""


@dataclass(frozen=True, eq=False)
class _Direction:
    """One direction of a place: u (3, n), and u . M y (n,)."""

    unit: Array
    moment: Array


@dataclass(frozen=True, eq=False)
class DirectionScan:
    """Directions of all places in the complement of a fit's parameters.

    Attributes
    ----------
    directions : mapping
        Directions of each place.
    residual : ProjectedResidual
    """

    directions: Mapping[ActedOn, tuple[_Direction, ...]]
    residual: ProjectedResidual

    @classmethod
    def of(cls, data: ArmData, fit: JointFit, residual: ProjectedResidual | None = None) -> DirectionScan:
        """Compute the directions of all places of an arm; a shift in any direction shares those of its parts.

        ``residual`` is that of the fit if None, else for instance that without a term.
        """
        n, residual = len(data), fit.projected_residual if residual is None else residual
        projected = residual.projected.reshape(3, n)

        def direction(unit: Array) -> _Direction:
            return _Direction(unit, np.einsum("an,an->n", unit, projected))

        found: dict[ActedOn, tuple[_Direction, ...]] = {}
        several = []
        for acts_on in acted_on(data.context.joints):
            if acts_on.acts_on is ActsOn.JOINT:
                found[acts_on] = (direction(fit.by_joint[:, acts_on.joint]),)
            elif len(acts_on.parts) > 1:
                several.append(acts_on)
            else:
                (moved,) = acted_directions(data.context, acts_on)
                found[acts_on] = (direction(np.einsum("acn,nc->an", fit.white, moved)),)
        for acts_on in several:
            found[acts_on] = tuple(found[part][0] for part in acts_on.parts)
        return cls(found, residual)

    def scores(self, families: Families, chosen: Sequence[ActedOn]) -> Array:
        """Return the score (places, families) of each law, without the price of choosing it; minus infinity if it is
        invisible or has too many columns."""
        return self._over(families, chosen, self._gain)

    def evidence(self, families: Families, chosen: Sequence[ActedOn]) -> Array:
        """Return twice the gain of log evidence (places, families) by each law; otherwise as ``scores``.

        The values of a law have normal priors of a common size, scaled so that each function moves the SMR alike; the
        best of several sizes is taken. So few readings can show a law even if they do not determine all its values.
        """
        return self._over(families, chosen, self._log_evidence)

    def _over(self, families: Families, chosen: Sequence[ActedOn], judge: _Judge) -> Array:
        values = np.full((len(chosen), len(families.sizes)), -np.inf)
        batches = families.batches()
        kernel = self.residual.projector.kernel
        for row, acts_on in enumerate(chosen):
            directions = self.directions[acts_on]
            # project the distinct functions only: families share many, and one large product is faster than many small
            # ones
            projected = [
                [families.distinct @ kernel(one.unit, other.unit) for other in directions[: k + 1]]
                for k, one in enumerate(directions)
            ]
            for numbers, places in batches:
                if len(directions) * places.shape[1] <= MOST_COLUMNS:
                    those = [[one[places] for one in row_of] for row_of in projected]
                    values[row, numbers] = judge(*_information(families.distinct[places], directions, those))
        return values

    def _gain(self, gram: Array, norms: Array, moments: Array) -> Array:
        """Return the gain of the BIC (b,)."""
        explained, rank = visible_squares(gram, norms, moments)
        share = np.minimum(explained / self.residual.square, MOST_SHARE)
        freedom = self.residual.freedom
        value = -freedom * np.log1p(-share) - rank * math.log(freedom)
        return np.where((rank > 0) & (norms.max(axis=1) > NO_DISPLACEMENT), value, -np.inf)

    def _log_evidence(self, gram: Array, norms: Array, moments: Array) -> Array:
        """Return twice the log evidence (b,) at the best of ``_SIZES`` and of noise, less the price of that choice."""
        scale = math.sqrt(len(self.residual)) / np.maximum(norms, NO_DISPLACEMENT)
        values, vectors = np.linalg.eigh(gram * scale[:, :, None] * scale[:, None, :])
        values = np.maximum(values, 0.0)[None]
        along = np.einsum("bkr,bk->br", vectors, scale * moments)[None] ** 2
        size = np.array(_SIZES)[:, None, None] ** 2
        share = np.minimum(np.sum(along * size / (1.0 + size * values), axis=2) / self.residual.square, MOST_SHARE)
        found = -self.residual.freedom * np.log1p(-share) - np.sum(np.log1p(size * values), axis=2)
        return np.asarray(found.max(axis=0) - 2.0 * math.log(len(_SIZES)))


def _information(
    functions: Array, directions: Sequence[_Direction], projected: Sequence[Sequence[Array]]
) -> tuple[Array, Array, Array]:
    """Compute information (b, m, m), norms and moments (b, m) of b families of functions f (b, k, n) in one place.

    ``projected`` holds f K_de (b, k, n).
    """
    size = functions.shape[1]
    gram = np.empty((len(functions), len(directions) * size, len(directions) * size))
    squares = np.empty((len(functions), len(directions) * size))
    for i, one in enumerate(directions):
        here = slice(i * size, (i + 1) * size)
        squares[:, here] = functions**2 @ np.einsum("an,an->n", one.unit, one.unit)
        for j, of_pair in enumerate(projected[i]):
            there = slice(j * size, (j + 1) * size)
            block = of_pair @ functions.swapaxes(1, 2)
            gram[:, here, there] = block
            gram[:, there, here] = block.swapaxes(1, 2)
    moments = np.concatenate([functions @ one.moment for one in directions], axis=1)
    return gram, np.sqrt(squares), moments


@dataclass(frozen=True, eq=False)
class Families:
    """The ``distinct`` functions (u, n) of some families, and the indices of each family's functions among them."""

    distinct: Array
    places: tuple[NDArray[np.intp], ...]

    @classmethod
    def of(cls, data: ArmData, members: Sequence[FunctionFamily]) -> Families:
        """Evaluate the functions at the readings."""
        table = FunctionTable(data.context)
        found: dict[bytes, tuple[int, Array]] = {}
        places = [
            np.array([found.setdefault(f.tobytes(), (len(found), f))[0] for f in of_one.values()], dtype=np.intp)
            for of_one in (table.functions(one.inputs, one.constants) for one in members)
        ]
        return cls(np.array([f for _, f in found.values()]), tuple(places))

    @property
    def sizes(self) -> NDArray[np.intp]:
        """Number of functions of each family."""
        return np.array([len(one) for one in self.places], dtype=np.intp)

    def batches(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Return batches of families of equal size: their indices, and those of their functions (b, k)."""
        found = []
        for size in np.unique(self.sizes):
            numbers = np.flatnonzero(self.sizes == size)
            for begin in range(0, len(numbers), _FAMILIES_AT_ONCE):
                some = numbers[begin : begin + _FAMILIES_AT_ONCE]
                found.append((some, np.stack([self.places[k] for k in some])))
        return found


_LIKE_AN_ALTERNATIVE = CAUTIOUS_SHARE / 10.0
"""Error of a law, as a share of its effect, in the direction of one given alternative that is not confounded. Laws
hold to some 10 %, but an error has many directions (a hundred of equal variance), and the alternative's is one of
them."""
_LIKE_ANOTHER = CAUTIOUS_SHARE / 2.0
"""Error of a law, as a share of its effect, that may look like another effect of the same variables with any values."""
_ODDS_OUTSIDE = 1.0 / 9.0
"""Prior odds that the library lacks a visible cause. Estimated together with ``_LEAVES`` from 92 names of the blind
runs of seed 20261126; the reported runs have other seeds."""
_FREE_FORM = 3.0
"""Odds that a named free function stands in for something else, relative to other names. Of seven such names, not
counting functions of a single joint's angle, five were right (seeds 20261226 to 20261128)."""
_ROW, _SERIES = 8, 4
"""``_SERIES`` lines of a joint below ``_ROW`` cycles a turn are a Fourier series: a gear has lines at few counts."""
_LEAVES = 5.0
"""Power of the density of the share that a right law leaves. The mean there was 0.06, which would give 15; but a second
cause or unstated scatter may be left, so the tail is made longer."""


@dataclass(frozen=True)
class _Set:
    """A set of effects: log of its weight, the effect of the final set that it lacks, and the effect that it adds."""

    log_weight: float
    lacks: str | None = None
    has: str | None = None


def posteriors_of(found: SearchResult, scan: LawScan) -> Posteriors:
    """Compute the probabilities after a search; ``scan`` is ``remaining_scan(found)``."""
    further, reviews = further_scores(found, scan), cautious_reviews(found)
    return posteriors(reviews, further, found.threshold, found.fit.projector.freedom, _log_odds_outside(found, reviews))


def posteriors(
    reviews: Sequence[Review],
    further: Mapping[str, float],
    threshold: float,
    coordinates: float,
    outside: Mapping[str, float] | None = None,
) -> Posteriors:
    """Compute probabilities from the scores of a final set's terms, of their alternatives, and of ``further`` effects.

    ``coordinates`` is the number of coordinates less the parameters of the final set. Several terms of one effect count
    as one, whose score is their sum; each data-driven term is an effect of its own. ``outside`` maps an effect to the
    log odds that a cause which the library lacks is in its place.
    """
    keys = [_key(review, number) for number, review in enumerate(reviews)]
    sets = [_Set(0.0), *(_Set((score - threshold) / 2.0, has=slug) for slug, score in further.items())]
    for key in dict.fromkeys(keys):
        own = [review for review, of in zip(reviews, keys, strict=True) if of == key]
        score = sum(review.score for review in own)
        sets.append(_Set(-(score - threshold) / 2.0, lacks=key))
        if len(own) == 1:
            others = own[0].alternative_scores.items()
            sets += [_Set(-_penalty(own[0], slug, other, coordinates) / 2.0, key, slug) for slug, other in others]
    sets += [_Set(log_odds, lacks=slug) for slug, log_odds in (outside or {}).items()]
    log_weights = np.array([one.log_weight for one in sets])
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    lacking, having = dict.fromkeys(keys, 0.0), dict.fromkeys((one.has for one in sets if one.has is not None), 0.0)
    for one, weight in zip(sets, weights.tolist(), strict=True):
        if one.lacks is not None:
            lacking[one.lacks] += weight
        if one.has is not None:
            having[one.has] += weight
    terms = tuple(max(1.0 - lacking[key], 0.0) for key in keys)
    named = {review.term.slug: p for review, p in zip(reviews, terms, strict=True) if review.term.slug != UNKNOWN}
    return Posteriors(terms, {**having, **named})


def _penalty(own: Review, slug: str, other: float, coordinates: float) -> float:
    """Return the penalty of an alternative in an effect's place, from its score there; negative if the alternative
    scores more."""
    if math.isinf(other):
        return math.inf
    less, more = sorted((own.score, other))
    explained = -math.expm1(-max(more, 0.0) / coordinates)
    remaining = math.exp(-less / coordinates) - math.exp(-more / coordinates)
    if remaining <= 0.0:
        return 0.0
    error = _LIKE_AN_ALTERNATIVE
    if more > 0.0 and are_confounded(own.term.slug, slug):
        unseen = math.sqrt(LEAST_EVIDENCE / more) if own.term.modulations else SCORE_MARGIN / more
        error = max(error, min(SHARES[-1], unseen))
    return math.copysign(1.0 / (1.0 / (more - less) + error**2 * explained / remaining), own.score - other)


def _log_odds_outside(found: SearchResult, reviews: Sequence[Review]) -> dict[str, float]:
    """Return for each named effect the log odds that the library lacks its cause, from the squares removed and left.

    With few readings the evidence of such a cause counts too, relative to the effect's score in ``reviews``.
    """
    fit, remaining = found.fit, scatter(found.data, found.fit)
    beyond_noise = 0.0 if remaining is None else max(1.0 - remaining.ratio**-2, 0.0) * fit.projected_residual.square
    removed = grouped(
        (term.slug, fit.removed_square(number)) for number, term in enumerate(fit.terms) if term.is_library_effect
    )
    prior = math.log(_ODDS_OUTSIDE / (_LEAVES + 1.0))
    free = {term.slug for number, term in enumerate(fit.terms) if is_free_function(fit, number)}
    log_odds = {
        slug: prior + _LEAVES * math.log1p(beyond_noise / max(math.fsum(squares), SMALLEST))
        for slug, squares in removed.items()
    } | dict.fromkeys(free, math.log(_ODDS_OUTSIDE * _FREE_FORM))
    for slug, evidence in _of_another_cause(found, reviews).items():
        log_odds[slug] = float(np.logaddexp(log_odds[slug], math.log(_ODDS_OUTSIDE) + evidence / 2.0))
    return log_odds


def _of_another_cause(found: SearchResult, reviews: Sequence[Review]) -> dict[str, float]:
    """Return for each named effect the evidence of a law outside the library over its own; empty if data suffice."""
    data, fit = found.data, found.fit
    named = [number for number, term in enumerate(fit.terms) if term.is_library_effect]
    if not named or not too_few_to_compete(data, fit):
        return {}
    leads = grouped(
        (fit.terms[number].slug, gain + found.threshold - reviews[number].score)
        for number, gain in zip(named, gains_by_another_cause(data, fit, named), strict=True)
    )
    return {slug: min(of_terms) for slug, of_terms in leads.items()}


def is_free_function(fit: JointFit, number: int) -> bool:
    """Return whether a named term is a free function: smooth by prior, or a Fourier series of a joint's low cycles."""
    term = fit.terms[number]
    if term.law.form != LINES:
        return term.smooth is not None and term.slug != UNKNOWN
    slow = {(column.joint, column.cycles) for column in fit.term_columns(number) if (column.cycles or _ROW) < _ROW}
    return max(Counter(joint for joint, _ in slow).values(), default=0) >= _SERIES


def _key(review: Review, number: int) -> str:
    slug = review.term.slug
    return f"{slug} {number}" if slug == UNKNOWN else slug


def cautious_reviews(found: SearchResult) -> tuple[Review, ...]:
    """Return the reviews with scores beside the discrepancy terms of all other laws, which may be slightly off.

    Alternatives lose as much as the effect they would replace.
    """
    fit, cautious = found.fit, []
    parts = [possible_discrepancies(found.data, fit, number) for number in range(len(fit.terms))]
    for number, review in enumerate(found.reviews):
        others = [part for other, own in enumerate(parts) if other != number for part in own]
        score = review.score
        if review.term.smooth is None and others:
            score -= max(_lost_beside(fit, number, others), 0.0)
        share = _share_of_a_larger(fit, number)
        if score > found.threshold and share < math.inf:
            score = found.threshold + 1.0 / (1.0 / (score - found.threshold) + _LIKE_ANOTHER**2 / share)
        score = min(score, review.score - SCORE_MARGIN)
        alternative_scores = {slug: value - review.score + score for slug, value in review.alternative_scores.items()}
        cautious.append(replace(review, score=score, alternative_scores=alternative_scores))
    return tuple(cautious)


def _share_of_a_larger(fit: JointFit, number: int) -> float:
    """Return the least ratio of a term's squares to those of a larger term with common variables; infinite if none.

    Such a term may be a residual of the larger one's law. The joint angles do not count as a common variable.
    """
    own, least = fit.terms[number], math.inf
    if not own.is_library_effect:
        return least
    removed = fit.removed_square(number)
    for other, term in enumerate(fit.terms):
        if other == number or not term.is_library_effect:
            continue
        common = (EFFECTS[own.slug].variables & EFFECTS[term.slug].variables) - {InputVariable.JOINT_ANGLE}
        larger = fit.removed_square(other)
        if common and larger > removed:
            least = min(least, removed / larger)
    return least


def _lost_beside(fit: JointFit, number: int, discrepancies: Sequence[DiscrepancyTerm]) -> float:
    """Return the score that a term loses beside discrepancy terms of the other laws."""
    kept, rows = fit.layout.all_but(number), fit.law_rows(number)
    share = CAUTIOUS_SHARE / math.sqrt(len(discrepancies))
    nuisance = np.concatenate([fit.rows[kept], *(part.rows for part in discrepancies)])
    precision = np.concatenate([fit.precision[kept], *(1.0 / (share * part.sd) ** 2 for part in discrepancies)])
    by_law = fit.term_values(number)[: len(rows)] @ rows
    behind = ProjectedResidual(NuisanceProjector.of(nuisance, precision), fit.target + by_law)
    return fit.residual_without(number).bic_gain(rows) - behind.bic_gain(rows)


def remaining_scan(found: SearchResult) -> LawScan:
    """Scan all effects of the library that are not in the final model."""
    return SearchState(found.data, found.fit).scan(found.absent)


def further_scores(found: SearchResult, scan: LawScan) -> dict[str, float]:
    """Return the score of every testable effect that is not in the final model, beside that model.

    For an effect that the search refused take the least of: its score with physically possible values, its score beside
    the discrepancy terms of the laws in the model, its gain on left-out readings, and the threshold (not more probable
    than not).
    """
    fit, residual = found.fit, found.fit.projected_residual
    best = scan.best_of_each_effect(residual)
    scores = {score.slug: score.value for score in best}
    likely = [score for score in best if score.value > found.threshold - SCORE_MARGIN]
    gain = gain_beside_discrepancies(SearchState(found.data, fit)) if likely else None
    for score in likely:
        value = min(possible_score(residual, score), found.threshold)
        if gain is not None:
            value = min(value, gain(score))
        if value > found.threshold - SCORE_MARGIN:
            value = min(value, cross_validated_gain(found.data, fit, score.rows))
        scores[score.slug] = value
    return scores
