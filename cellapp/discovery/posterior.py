"""Posterior probabilities of effects, from the final set of effects and the sets next to it.

The sets are the final one S, S without one effect, S with a rival in an effect's place, and S with one further effect.
A score is a gain of the Bayesian information criterion, twice the log of a Bayes factor, so that beside S

    ln weight = 0                            S,
                -(score - threshold) / 2     S without an effect that has ``score`` beside all others,
                (rival - score) / 2          S with a rival in its place, which has the score ``rival`` there,
                (score - threshold) / 2      S with a further effect.

The threshold is the prior: with log prior odds of -threshold / 2 for each effect, a score at the threshold leaves it
open whether the effect is there. The threshold is the score that noise exceeds with the wanted chance of a false alarm,
over all that was tried: one who wants fewer false alarms holds that effects are rarer. Sets that differ from S by more
have far smaller weights unless two differences are likely each; they are left out.

    p(e) = sum of the weights of sets that hold e / sum of all weights.

Rivals that tie share the probability. (Bayes factors: Kass, Raftery, J. Am. Stat. Ass. 90 (1995) 773; averages over
models: Hoeting et al., Stat. Sci. 14 (1999) 382.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.discovery.candidates import best_law_of_each_effect
from cellapp.discovery.cross_validation import cross_validated_gain
from cellapp.discovery.search.free_part import behind_free_parts
from cellapp.discovery.search.possible_score import possible_score
from cellapp.discovery.search.scan import LawScan
from cellapp.discovery.search.state import SCORE_MARGIN, Review, SearchResult, SearchState
from cellapp.discovery.terms import UNKNOWN
from cellapp.effects import EFFECTS


@dataclass(frozen=True)
class Posteriors:
    """Probability that each term's effect is there, in their order, and that of every effect that was tested."""

    terms: tuple[float, ...]
    effects: Mapping[str, float]


@dataclass(frozen=True)
class _Set:
    """A set of effects: the log of its weight, which effect of the final set it lacks, and which it has beside them."""

    log_weight: float
    lacks: str | None = None
    has: str | None = None


def posteriors(reviews: Sequence[Review], further: Mapping[str, float], threshold: float) -> Posteriors:
    """Probabilities from the scores of a final set's terms, of their rivals, and of ``further`` effects beside it.

    Several terms of one effect count as one, whose score is the sum of theirs; each data-driven term is an effect of
    its own.
    """
    keys = [_key(review, number) for number, review in enumerate(reviews)]
    sets = [_Set(0.0), *(_Set((score - threshold) / 2.0, has=slug) for slug, score in further.items())]
    for key in dict.fromkeys(keys):
        own = [review for review, of in zip(reviews, keys, strict=True) if of == key]
        score = sum(review.score for review in own)
        sets.append(_Set(-(score - threshold) / 2.0, lacks=key))
        if len(own) == 1:
            sets += [_Set((rival - score) / 2.0, key, slug) for slug, rival in own[0].alternatives.items()]
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


def _key(review: Review, number: int) -> str:
    slug = review.term.slug
    return f"{slug} {number}" if slug == UNKNOWN else slug


def remaining_scan(found: SearchResult) -> LawScan:
    """Scan of all effects of the library that the final model does not have."""
    if not found.fit.terms:
        return found.scan
    taken = {term.slug for term in found.fit.terms}
    slugs = [slug for slug in EFFECTS if slug not in taken and slug != UNKNOWN]
    return LawScan.of(found.fit.candidates(found.data, slugs), found.fit.projector)


def further_scores(found: SearchResult, scan: LawScan) -> dict[str, float]:
    """Score beside the final model of every effect that the data can show and that is not in it.

    An effect that the search refused counts with the least of what is for it: its score with possible values, behind
    the free parts of the laws in the model, on left-out readings, and the threshold, as it is then no more probable
    than not.
    """
    fit, residual = found.fit, found.fit.projected_residual
    best = best_law_of_each_effect(scan.ranked(residual))
    scores = {score.slug: score.value for score in best}
    likely = [score for score in best if score.value > found.threshold - SCORE_MARGIN]
    behind = behind_free_parts(SearchState(found.data, fit)) if likely else None
    for score in likely:
        value = min(possible_score(residual, score), found.threshold)
        if behind is not None:
            value = min(value, behind.bic_gain(score.rows))
        if value > found.threshold - SCORE_MARGIN:
            value = min(value, cross_validated_gain(found.data, fit, score.rows))
        scores[score.slug] = value
    return scores
