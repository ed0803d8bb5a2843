"""Posterior probabilities of effects from the scores of competing sets."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cellapp.estimation.discovery import posterior
from cellapp.estimation.discovery.joint_fit import ProjectedResidual
from cellapp.estimation.discovery.posterior import posteriors
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.state import Review, possible_score
from cellapp.estimation.discovery.terms import UNKNOWN, CandidateLaw, LawScore, ModelTerm
from cellapp.robot.effects import Channel, EffectColumn
from cellapp.robot.effects.periodic import LINES
from tests.estimation.discovery.linear_problem import PLAIN, problem

pytestmark = pytest.mark.fast

THRESHOLD = 8.0
COORDINATES = 900


def review(slug, score, **alternatives):
    return Review(ModelTerm(slug, PLAIN.law(), ()), score, 0.001, (), alternatives)


def test_a_score_at_the_threshold_leaves_it_open():
    found = posteriors([review("backlash", THRESHOLD)], {}, THRESHOLD, COORDINATES)
    assert found.terms[0] == pytest.approx(0.5)
    assert found.effects["backlash"] == found.terms[0]
    assert posteriors([], {"backlash": THRESHOLD}, THRESHOLD, COORDINATES).effects["backlash"] == pytest.approx(0.5)


def test_evidence_far_from_the_threshold_decides():
    found = posteriors([review("backlash", 5000.0)], {"base_step": -6.0}, THRESHOLD, COORDINATES)
    assert found.terms[0] == pytest.approx(1.0, abs=1e-3)
    assert found.effects["base_step"] < 0.001
    assert sum(found.effects.values()) < 1.01


def test_rivals_that_tie_share_the_probability():
    tied = review("backlash", 900.0, unsettled_measurement=900.0, friction_windup=300.0, base_step=-math.inf)
    found = posteriors([tied, review("joint_compliance", 400.0)], {}, THRESHOLD, COORDINATES)
    np.testing.assert_allclose(found.terms, (0.5, 1.0), atol=1e-3)
    assert found.effects["unsettled_measurement"] == pytest.approx(0.5, abs=1e-3)
    assert found.effects["friction_windup"] < 1e-4
    assert found.effects["base_step"] == 0.0
    three = review("backlash", 900.0, unsettled_measurement=900.0, friction_windup=900.0)
    assert posteriors([three], {}, THRESHOLD, COORDINATES).terms[0] == pytest.approx(1.0 / 3.0, abs=1e-3)


def beside_rival_that_leaves(rival, share, score, **law):
    """Probability of a drift of joint zeros of which a rival leaves a share."""
    squares = math.exp(-score / COORDINATES)
    its = -COORDINATES * math.log(squares + share**2 * (1.0 - squares))
    named = review("joint_drift", score, **{rival: its})
    named = replace(named, term=replace(named.term, **law))
    return posteriors([named], {}, THRESHOLD, COORDINATES).terms[0]


def test_errors_of_a_law_look_like_its_look_alikes_where_the_readings_would_not_show_them():
    alike = [beside_rival_that_leaves("base_drift", 0.3, score) for score in (40.0, 600.0)]
    assert 0.6 < alike[0] < beside_rival_that_leaves("target_slip", 0.3, 40.0) - 0.1
    assert alike[1] > 0.99
    assert beside_rival_that_leaves("base_drift", 0.0, 100.0) == pytest.approx(0.5, abs=1e-3)
    off = beside_rival_that_leaves("base_drift", 0.1, 600.0, modulations=("a free part",))
    assert off < 0.8 < beside_rival_that_leaves("base_drift", 0.1, 600.0), "of a law that is off"


@pytest.mark.parametrize("score", [100.0, 600.0, 6000.0])
def test_a_rival_that_leaves_what_a_law_may_leave_is_possible(score):
    """The share m of the effect that a rival leaves decides where noise is small; not noise alone."""

    assert 0.49 < beside_rival_that_leaves("target_slip", 0.01, score) < 0.7
    assert beside_rival_that_leaves("target_slip", 0.4, score) > 0.99
    assert beside_rival_that_leaves("target_slip", 0.0, score) == pytest.approx(0.5, abs=1e-3)
    better = review("joint_drift", score, target_slip=score + 1.0)
    assert posteriors([better], {}, THRESHOLD, COORDINATES).terms[0] < 0.5


def test_two_terms_of_one_effect_count_as_one():
    found = posteriors(
        [review("transmission_error", 3.0), review("transmission_error", 20.0)], {}, THRESHOLD, COORDINATES
    )
    wanted = 1.0 / (1.0 + math.exp(-(23.0 - THRESHOLD) / 2.0))
    np.testing.assert_allclose(found.terms, wanted)


def test_a_cause_outside_the_library_may_be_in_the_place_of_a_name():
    sure = [review("backlash", 900.0), review("joint_compliance", 900.0)]
    outside = {"backlash": math.log(1.5), "joint_compliance": math.log(0.02)}
    found = posteriors(sure, {}, THRESHOLD, COORDINATES, outside)
    np.testing.assert_allclose(found.terms, (1.02 / 2.52, 2.5 / 2.52))
    tied = posteriors([review("backlash", 900.0, base_step=900.0)], {}, THRESHOLD, COORDINATES, {"backlash": 0.0})
    np.testing.assert_allclose((tied.terms[0], tied.effects["base_step"]), 1.0 / 3.0, rtol=1e-6)


def found_by(reviews) -> Any:
    return SimpleNamespace(fit=SimpleNamespace(terms=[None]), data=None, reviews=reviews, threshold=THRESHOLD)


def test_a_name_just_above_the_threshold_is_less_likely_than_not(monkeypatch):
    """Effects so small are rarer than noise of that score."""
    monkeypatch.setattr(posterior, "possible_free_parts", lambda *_: [])
    monkeypatch.setattr(posterior, "_share_of_a_larger", lambda fit, number: math.inf)

    def accepted(score):
        reviews = posterior.cautious_reviews(found_by([review("backlash", score, base_step=score - 6.0)]))
        return posteriors(reviews, {}, THRESHOLD, COORDINATES).terms[0]

    assert accepted(THRESHOLD + 6.0) < 0.2
    assert accepted(THRESHOLD + 30.0) > 0.9


def cycles_of(*counts: int) -> Any:
    """A fit with one term of lines at some cycle counts of joint 1."""
    columns = [SimpleNamespace(joint=0, cycles=count) for count in counts for _ in range(2)]
    term = ModelTerm("transmission_error", LINES.law(), ())
    return SimpleNamespace(terms=[term], term_columns=lambda number: columns)


def test_a_row_of_the_lowest_cycles_of_a_joint_is_a_free_function():
    assert posterior.is_free_function(cycles_of(2, 3, 4, 5), 0)
    assert not posterior.is_free_function(cycles_of(2, 4, 50, 100, 150), 0)


def test_a_rival_loses_what_the_effect_loses_beside_a_larger_one(monkeypatch):
    """Else a worse rival would take the place of what other laws may have left over."""
    monkeypatch.setattr(posterior, "possible_free_parts", lambda *_: [])
    monkeypatch.setattr(posterior, "_share_of_a_larger", lambda fit, number: 0.01)
    reviews = [review("backlash", 637.0, friction_windup=580.0)]
    (cautious,) = posterior.cautious_reviews(found_by(reviews))
    assert THRESHOLD < cautious.score < 637.0
    assert cautious.alternatives["friction_windup"] == pytest.approx(cautious.score - 57.0)


def test_data_driven_terms_are_effects_of_their_own_and_not_among_the_names():
    found = posteriors([review(UNKNOWN, THRESHOLD), review(UNKNOWN, 300.0)], {"backlash": -2.0}, THRESHOLD, COORDINATES)
    assert found.terms[0] == pytest.approx(0.5, abs=0.01)
    assert found.terms[1] == pytest.approx(1.0)
    assert set(found.effects) == {"backlash"}


def test_posteriors_are_calibrated_where_effects_are_as_frequent_as_the_prior_says():
    """Scores of effects with the assumed prior: of those stated at p, a share p is there."""
    rng = np.random.default_rng(1)
    n, stated, true = 4000, [], []
    coordinates, odds = 300, math.exp(-THRESHOLD / 2.0)
    for _ in range(n):
        there = rng.random() < odds / (1.0 + odds)
        # the unit information prior, whose Bayes factor the criterion approximates
        value = rng.normal(0.0, math.sqrt(1.0 + coordinates)) if there else rng.normal()
        score = value**2 - math.log(coordinates)
        p = posteriors([], {"backlash": score}, THRESHOLD, COORDINATES).effects["backlash"]
        stated.append(p)
        true.append(there)
    assert np.mean(stated) == pytest.approx(np.mean(true), abs=0.008)
    likely = np.array(stated) > 0.5
    assert np.mean(np.array(true)[likely]) == pytest.approx(np.mean(np.array(stated)[likely]), abs=0.1)


def bounded(name, block):
    return EffectColumn(name, "rad", block, 0.0, 1.0e3, Channel.BASE)


def test_impossible_values_are_no_evidence():
    case = problem(7)
    rows = case.rng.normal(size=(2, len(case.projector.basis)))
    law = CandidateLaw("first", PLAIN.law(), (bounded("a", "one"), bounded("b", "two")), rows)

    def score(signal):
        residual = ProjectedResidual(case.projector, case.visible(signal + case.noise()))
        found = LawScan.of([law], case.projector).score(0, residual)
        assert isinstance(found, LawScore)
        return found.value, possible_score(residual, found)

    value, possible = score(2.0 * rows[0] + rows[1])
    assert possible == value
    value, possible = score(2.0 * rows[0] - 1.0 * rows[1])
    assert 0.0 < possible < value - 50.0
    value, possible = score(-2.0 * rows[0] - rows[1])
    assert value > 100.0
    assert possible == -math.inf
