"""Posterior probabilities of effects, from the final set of effects and the sets next to it.

The sets are the final set S; S without one effect; S with a rival in an effect's place; and S with one further effect.
A score is a gain of the Bayesian information criterion, twice the log of a Bayes factor. So relative to S

    ln weight = 0                            S,
                -(score - threshold) / 2     S without an effect that has ``score`` beside all others,
                -penalty / 2                 S with a rival in its place,
                (score - threshold) / 2      S with a further effect.

The threshold acts as the prior. With log prior odds of -threshold / 2 for each effect, an effect with a score at the
threshold is as probable as not. The threshold is the score that noise exceeds with the wanted chance of a false alarm,
over all laws tried: whoever wants fewer false alarms assumes that effects are rarer. A name in S was the best of all
that could be added, and few effects are so small that they score just above the threshold. Its score is therefore
reduced by the margin of very strong evidence, 10. Of six names within that margin above the threshold none was right;
of thirteen within the next 50 eight were (seeds 20261226, 20261227). Sets that differ from S by more have far smaller
weights unless two differences are likely each; they are left out.

    p(e) = sum of the weights of sets that hold e / sum of all weights.

Laws are only nearly right, and enough readings show that. A rival that scores less by D leaves a share m^2 of the sum
of squares that the effect explains. This is either chance in the noise, at a penalty of D, or an error of the rival's
law, at a penalty of m^2 / t^2 if the errors of laws in that direction are N(0, t^2) relative to their size:

    penalty = 1 / (1 / D + t^2 / m^2).

For a look-alike of the effect, every error of its law has that direction. There t is the share that a free part of the
law may have, 0.3, but no more than the readings would have shown: 10 over the effect's score. If the law is off, so
that a free part was kept, t is the share that this part may miss: an error of t scores t^2 times as much as the effect,
and 5 is needed.

The residuals of other laws in S may likewise look like an effect. Its score is therefore taken beside their free parts,
and its lead over the threshold is limited in the same way if a larger effect depends on the same variables. Rivals that
tie share the probability.

The library may also lack the cause, and a name stand in for it. Before a search the odds of that are 1 to 9. A law that
is right leaves little of what it removes. Let w = left / (left + removed) be the share of sums of squares, where left
is what remains beyond the stated noise; its density is (k + 1)(1 - w)^k with k = 5. A law that stands in for something
else leaves any share: w is uniform. So each named effect has a set in which another cause is in its place, with

    ln weight = -ln 9 - ln(k + 1) - k ln(1 - w).

A named free function leaves little whatever the cause is, and so does a series of a joint's lowest cycles, which is a
Fourier series. They are taken if no law of the effect has the shape: one in three of the effects that are there, and
every one of the others. Hence ln weight = ln 3 - ln 9.

With too few readings for data-driven laws the search names what stands in for something else, as nothing competes.
There such laws get priors on their values, and the best one has an evidence G: twice the logarithm less the price of
choosing it. A law that beats the effect's score by the same measure has G / 2 in place of 0, and takes its place with

    ln weight = -ln 9 - (score - threshold - G) / 2.

So no name is more probable than 98 %, and one that removes clearly less than what is left is not accepted. (Bayes
factors: Kass, Raftery, J. Am. Stat. Ass. 90 (1995) 773; averages over models: Hoeting et al., Stat. Sci. 14 (1999)
382.)
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.estimation.design.information import SMALLEST, NuisanceProjector
from cellapp.estimation.discovery.cross_validation import cross_validated_gain
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.projected_residual import ProjectedResidual
from cellapp.estimation.discovery.search.another_cause import gains_by_another_cause, too_few_to_compete
from cellapp.estimation.discovery.search.bounds import possible_score
from cellapp.estimation.discovery.search.comparison import scatter
from cellapp.estimation.discovery.search.free_part import (
    CAUTIOUS_SHARE,
    LEAST_EVIDENCE,
    SHARES,
    FreePart,
    are_look_alikes,
    gain_beside_free_parts,
    possible_free_parts,
)
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.state import SCORE_MARGIN, Posteriors, Review, SearchResult, SearchState
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.ground.grouping import grouped
from cellapp.robot.effects import EFFECTS, DriverVariable
from cellapp.robot.effects.periodic import LINES

_LIKE_A_RIVAL = CAUTIOUS_SHARE / 10.0
"""Error of a law, as a share of its effect, in the direction of one given rival that is no look-alike. Laws hold to
some 10 %, but an error has many directions (a hundred of equal variance), and the rival's is one of them."""
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
    """Compute probabilities from the scores of a final set's terms, of their rivals, and of ``further`` effects.

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
            rivals = own[0].alternatives.items()
            sets += [_Set(-_penalty(own[0], slug, rival, coordinates) / 2.0, key, slug) for slug, rival in rivals]
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


def _penalty(own: Review, slug: str, rival: float, coordinates: float) -> float:
    """Return the penalty of a rival in an effect's place, from its score there; negative if the rival scores more."""
    if math.isinf(rival):
        return math.inf
    less, more = sorted((own.score, rival))
    explained = -math.expm1(-max(more, 0.0) / coordinates)
    left = math.exp(-less / coordinates) - math.exp(-more / coordinates)
    if left <= 0.0:
        return 0.0
    error = _LIKE_A_RIVAL
    if more > 0.0 and are_look_alikes(own.term.slug, slug):
        unseen = math.sqrt(LEAST_EVIDENCE / more) if own.term.modulations else SCORE_MARGIN / more
        error = max(error, min(SHARES[-1], unseen))
    return math.copysign(1.0 / (1.0 / (more - less) + error**2 * explained / left), own.score - rival)


def _log_odds_outside(found: SearchResult, reviews: Sequence[Review]) -> dict[str, float]:
    """Return for each named effect the log odds that the library lacks its cause, from the squares removed and left.

    With few readings the evidence of such a cause counts too, relative to the effect's score in ``reviews``.
    """
    fit, left = found.fit, scatter(found.data, found.fit)
    beyond_noise = 0.0 if left is None else max(1.0 - left.ratio**-2, 0.0) * fit.projected_residual.square
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
    """Return the reviews with scores beside the free parts of all other laws, which may be slightly off.

    Rivals lose as much as the effect they would replace.
    """
    fit, cautious = found.fit, []
    parts = [possible_free_parts(found.data, fit, number) for number in range(len(fit.terms))]
    for number, review in enumerate(found.reviews):
        others = [part for other, own in enumerate(parts) if other != number for part in own]
        score = review.score
        if review.term.smooth is None and others:
            score -= max(_lost_beside(fit, number, others), 0.0)
        share = _share_of_a_larger(fit, number)
        if score > found.threshold and share < math.inf:
            score = found.threshold + 1.0 / (1.0 / (score - found.threshold) + _LIKE_ANOTHER**2 / share)
        score = min(score, review.score - SCORE_MARGIN)
        alternatives = {slug: rival - review.score + score for slug, rival in review.alternatives.items()}
        cautious.append(replace(review, score=score, alternatives=alternatives))
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
        common = (EFFECTS[own.slug].variables & EFFECTS[term.slug].variables) - {DriverVariable.JOINT_ANGLE}
        larger = fit.removed_square(other)
        if common and larger > removed:
            least = min(least, removed / larger)
    return least


def _lost_beside(fit: JointFit, number: int, free_parts: Sequence[FreePart]) -> float:
    """Return the score that a term loses beside free parts of the other laws."""
    kept, rows = fit.layout.all_but(number), fit.law_rows(number)
    share = CAUTIOUS_SHARE / math.sqrt(len(free_parts))
    nuisance = np.concatenate([fit.rows[kept], *(part.rows for part in free_parts)])
    precision = np.concatenate([fit.precision[kept], *(1.0 / (share * part.sd) ** 2 for part in free_parts)])
    by_law = fit.term_values(number)[: len(rows)] @ rows
    behind = ProjectedResidual(NuisanceProjector.of(nuisance, precision), fit.target + by_law)
    return fit.residual_without(number).bic_gain(rows) - behind.bic_gain(rows)


def remaining_scan(found: SearchResult) -> LawScan:
    """Scan all effects of the library that are not in the final model."""
    return SearchState(found.data, found.fit).scan(found.absent)


def further_scores(found: SearchResult, scan: LawScan) -> dict[str, float]:
    """Return the score of every testable effect that is not in the final model, beside that model.

    For an effect that the search refused take the least of: its score with physically possible values, its score beside
    the free parts of the laws in the model, its gain on left-out readings, and the threshold (not more probable than
    not).
    """
    fit, residual = found.fit, found.fit.projected_residual
    best = scan.best_of_each_effect(residual)
    scores = {score.slug: score.value for score in best}
    likely = [score for score in best if score.value > found.threshold - SCORE_MARGIN]
    gain = gain_beside_free_parts(SearchState(found.data, fit)) if likely else None
    for score in likely:
        value = min(possible_score(residual, score), found.threshold)
        if gain is not None:
            value = min(value, gain(score))
        if value > found.threshold - SCORE_MARGIN:
            value = min(value, cross_validated_gain(found.data, fit, score.rows))
        scores[score.slug] = value
    return scores
