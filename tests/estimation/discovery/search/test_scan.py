"""The scan: scores are gains of the BIC in the complement of the nuisance parameters, with the price of choosing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.estimation.discovery.arm_data import CandidateLaw, ModelTerm
from cellapp.estimation.discovery.joint_fit import refit
from cellapp.estimation.discovery.records import RunnerUp
from cellapp.estimation.discovery.search import stepwise
from cellapp.estimation.discovery.search.discrepancy_term import with_discrepancies
from cellapp.estimation.discovery.search.review import review
from cellapp.estimation.discovery.search.scan import (
    corrected_p_value,
    score_threshold,
    simulate_null_maxima,
    smallest_detectable,
)
from cellapp.estimation.discovery.search.state import Posteriors, Review, SearchProblem, SearchResult, SearchState
from cellapp.ground.errors import NotConverged
from cellapp.ground.progress import JobSteps, JobToken
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import smr_positions
from tests.estimation.discovery.problems import PLAIN, N, arm_of, data_of, problem, refining_law
from tests.estimation.discovery.search.test_data_driven import readings_with
from tests.sure import sure
from tests.twin import altered


def test_the_score_is_the_bic_gain_of_the_chosen_block() -> None:
    one = problem(1)
    y = one.visible(one.first.rows[2] * 0.3 + one.noise())
    best = one.ranked(y)[0]
    assert (best.slug, best.names) == ("first", ("c",))
    projected = one.projector.project(one.first.rows[[2]])
    left = y - projected.T @ np.linalg.lstsq(projected.T, y, rcond=None)[0]
    f = N - one.design.shape[1]  # what is left of the coordinates behind the nuisance parameters
    assert best.value == pytest.approx(-f * np.log(left @ left / (y @ y)) - np.log(f), rel=1e-9)
    assert one.residual(y).bic_gain(one.first.rows[[2]]) == pytest.approx(best.value, rel=1e-9)


def test_choosing_among_laws_has_its_price() -> None:
    one = problem(1)
    y = one.visible(one.first.rows[2] * 0.3 + one.noise())
    tried = one.scan_of(CandidateLaw("first", PLAIN.law(tried=50), one.first.columns, one.first.rows))
    cheap, priced = one.ranked(y)[0], one.ranked(y, tried)[0]
    assert priced.names == cheap.names
    assert cheap.value - priced.value == pytest.approx(2.0 * math.log(50.0))


# -- Block selection: blocks stand or fall together, refinements never stand alone, spread effects are found whole -----


def test_a_refinement_alone_is_never_the_effect() -> None:
    """However well it explains: it joins a block that is chosen, or is left."""
    one = problem(9)
    law = refining_law(one.rng, one.noise())
    scan, main = one.scan_of(law), one.scan_of(law.keep((0, 1)))
    residual = one.residual(one.visible(3.0 * law.rows[2] + one.noise()))
    projected, square = residual.projected[:, None], np.array([residual.square])
    np.testing.assert_allclose(scan.best_block_scores(projected, square), main.best_block_scores(projected, square))
    for with_refinements in (False, True):
        found = sure(scan.score(0, residual, with_refinements=with_refinements))
        assert set(found.names) & {"a", "b"}


# -- Significance: the false-alarm rate is kept, and the smallest detectable size is just detected ---------------------


def test_the_stated_false_alarm_rate_is_kept() -> None:
    one = problem(4)
    least = score_threshold(simulate_null_maxima(one.scan, one.projector, 400, (4,)), 0.05)
    fresh = simulate_null_maxima(one.scan, one.projector, 2000, (99,))
    # 0.05 give or take the scatter of 400 and of 2000 draws
    assert 0.02 < np.mean(fresh > least) < 0.09
    assert corrected_p_value(fresh, float(fresh[-1]) + 1.0) == pytest.approx(1.0 / 2001.0)


def test_an_effect_of_the_smallest_detectable_size_is_detected_about_every_other_time() -> None:
    one = problem(5)
    least = 5.0
    size = smallest_detectable(one.scan, 0, least)["c"]
    alone = one.scan_of(one.first.keep([2]))
    hits = [one.ranked(one.visible(size * one.first.rows[2] + one.noise()), alone)[0].value > least for _ in range(300)]
    assert 0.3 < np.mean(hits) < 0.75


# -- Free parts of laws where the readings hardly exceed the parameters ------------------------------------------------


def test_laws_that_take_all_that_the_readings_hold_have_no_discrepancy_term():
    data, _ = readings_with(lambda q: 2e-4 * np.sin(q + 1.0), np.zeros_like, 20)
    terms = []
    for slug in ("joint_compliance", "backlash", "encoder_eccentricity"):
        law = EFFECTS[slug].laws(data.context)[0]
        terms.append(ModelTerm(slug, law, tuple(column.name for column in data.columns(slug, law))))
    state = SearchState(*refit(data, tuple(terms)))
    assert len(state.fit.residual) - state.fit.projector.effective_parameters < 1.0
    problem = SearchProblem(data, (), np.zeros(20), 30.0, JobToken(), lambda words: None)
    assert with_discrepancies(problem, state) is None


def test_a_candidate_whose_fit_does_not_converge_is_dropped_and_named_and_is_no_finding(monkeypatch):
    data, _ = readings_with(lambda q: 3e-4 * np.sin(q + 1.0), np.zeros_like, 150)

    def fails(*_):
        raise NotConverged.of("fit of geometry and effects", "no reason")

    monkeypatch.setattr(stepwise, "apply_step", fails)
    found = stepwise.search(data, ("encoder_eccentricity",), JobSteps())
    assert not [term for term in found.fit.terms if term.smooth is None]
    assert found.not_fitted[0] == f"{EFFECTS['encoder_eccentricity'].title} added"


# -- A name is accepted at even odds at least; alternatives that nothing distinguishes from it count with it ----------


TWIN = Path(__file__).parents[4] / "profiles" / "twin.yaml"
N_at_even_odds = 90
SIGMA_M = 10e-6
PLAY = 1e-4
SLUGS = ("backlash", "base_step")


def searched(
    monkeypatch: pytest.MonkeyPatch, stated: Mapping[str, float], limited: Mapping[str, float] | None = None
) -> SearchResult:
    """The outcome for an arm with backlash, where the probabilities of effects are those stated, else 1.

    ``limited`` are those once alternatives score less than the name.
    """
    profile = load_profile(TWIN)
    profile = altered(profile, discovery={"null_simulations": 60, "false_alarm": 0.02})
    rng = np.random.default_rng(8)
    q = rng.uniform(-2.5, 2.5, (N_at_even_odds, 6))
    approach = rng.choice([-1, 1], (N_at_even_odds, 6))
    exact = smr_positions(arm_of(profile).geometry, q - PLAY * approach)
    data = data_of(profile, q, approach, exact + rng.normal(0.0, SIGMA_M, (N_at_even_odds, 3)), SIGMA_M)

    def probable(found: SearchResult, scan: object) -> Posteriors:
        out = all(max(one.alternative_scores.values(), default=0.0) < one.score for one in found.reviews)
        here = stated if limited is None or not out else limited
        return Posteriors(tuple(here.get(term.slug, 1.0) for term in found.fit.terms), here)

    monkeypatch.setattr(stepwise, "posteriors_of", probable)
    return stepwise.search(data, SLUGS, JobSteps())


def test_an_improbable_name_is_dropped_and_not_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    found = searched(monkeypatch, {"backlash": 0.49})
    assert "backlash" not in {term.slug for term in found.fit.terms}
    assert found.improbable == {"backlash": 0.49}
    assert found.dropped[-1] == "backlash"


def test_confounded_names_count_together(monkeypatch: pytest.MonkeyPatch) -> None:
    other = RunnerUp(effect="friction_windup", statistic=50.0, distinguishable=False)
    monkeypatch.setattr(stepwise, "review", lambda *args: replace(review(*args), alternatives=(other,)))
    found = searched(monkeypatch, {"backlash": 0.4, "friction_windup": 0.3})
    assert [term.slug for term in found.fit.terms] == ["backlash"]
    found = searched(monkeypatch, {"backlash": 0.2, "friction_windup": 0.2})
    assert found.improbable == {"backlash": 0.4}, "of all confounded names"
    found = searched(monkeypatch, {"backlash": 0.3, "friction_windup": 0.6})
    assert [term.slug for term in found.fit.terms] == ["backlash"], "no search without it ends as well"
    assert found.improbable == {}


def test_an_alternative_in_whose_place_the_search_ends_worse_scores_less_than_the_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def led(*args: Any) -> Review:
        found = review(*args)
        other = RunnerUp(effect="friction_windup", statistic=found.score + 20.0, distinguishable=False)
        return replace(found, alternatives=(other,), alternative_scores={other.effect: other.statistic})

    monkeypatch.setattr(stepwise, "review", led)
    (found,) = searched(monkeypatch, {"backlash": 0.3, "friction_windup": 0.6}).reviews
    assert found.alternative_scores["friction_windup"] < found.score
    alone = searched(monkeypatch, {"backlash": 0.3, "friction_windup": 0.6}, {"backlash": 0.1, "friction_windup": 0.2})
    assert alone.improbable == {"backlash": pytest.approx(0.3)}, "its set was probable by that alternative only"


def test_a_name_gives_way_to_a_more_probable_alternative_that_explains_as_much(monkeypatch: pytest.MonkeyPatch) -> None:
    other = RunnerUp(effect="friction_windup", statistic=50.0, distinguishable=False)
    monkeypatch.setattr(stepwise, "review", lambda *args: replace(review(*args), alternatives=(other,)))
    monkeypatch.setattr(stepwise, "criterion", lambda fit: 0.0)  # of every model
    found = searched(monkeypatch, {"backlash": 0.3, "friction_windup": 0.6})
    assert "backlash" not in {term.slug for term in found.fit.terms}
    assert found.improbable == {"backlash": pytest.approx(0.9)}, "of all confounded names"
