"""The scan: scores are gains of the BIC in the complement of the nuisance parameters, with the price of choosing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellapp.estimation.design.information import NuisanceProjector
from cellapp.estimation.discovery.joint_fit import ProjectedResidual, refit
from cellapp.estimation.discovery.search import stepwise
from cellapp.estimation.discovery.search.free_part import with_free_parts
from cellapp.estimation.discovery.search.scan import (
    LawScan,
    corrected_p_value,
    score_threshold,
    simulate_null_maxima,
    smallest_detectable,
)
from cellapp.estimation.discovery.search.state import SearchProblem, SearchState
from cellapp.estimation.discovery.terms import CandidateLaw, ModelTerm
from cellapp.ground.errors import NotConverged
from cellapp.ground.progress import CancelToken
from cellapp.robot.effects import EFFECTS, EffectColumn
from tests.estimation.discovery.linear_problem import PLAIN, N, column, problem, refining_law
from tests.estimation.discovery.search.test_data_driven import readings_with


def test_regression_on_the_projected_rows_is_the_joint_regression() -> None:
    one = problem(0)
    y = one.noise()
    joint = np.linalg.lstsq(np.hstack([one.design, one.first.rows.T]), y, rcond=None)[0][-3:]
    projected = one.projector.project(one.first.rows)
    alone = np.linalg.lstsq(projected.T, one.visible(y), rcond=None)[0]
    np.testing.assert_allclose(alone, joint, atol=1e-12)


def test_with_priors_the_explained_share_is_that_of_generalised_least_squares() -> None:
    one = problem(6)
    sd = one.rng.uniform(0.1, 2.0, 10)
    projector = NuisanceProjector.of(one.design.T, 1.0 / sd**2)
    y = one.noise()
    covariance = np.eye(N) + (one.design * sd**2) @ one.design.T
    wanted = np.linalg.solve(covariance, y)
    rows = one.first.rows[:2]
    scan = LawScan.of([CandidateLaw("one", PLAIN.law(), one.first.columns[:2], rows)], projector)
    reduction = rows @ wanted @ np.linalg.solve(rows @ np.linalg.solve(covariance, rows.T), rows @ wanted)
    residual = ProjectedResidual(projector, y)
    assert scan.ranked(residual)[0].explained_share == pytest.approx(reduction / (y @ wanted), rel=1e-9)
    assert residual.explained(rows) == pytest.approx(reduction, rel=1e-9)


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


def test_nuisance_parameters_cost_their_coordinates() -> None:
    """A residual behind ten parameters scores as the numbers that it then has, without any."""
    one = problem(2)
    y = one.visible(one.first.rows[0] + one.noise())
    rest = np.linalg.svd(one.design)[0][:, one.design.shape[1] :]
    bare = NuisanceProjector.of(np.zeros((0, rest.shape[1])))
    alone = ProjectedResidual(bare, rest.T @ y)
    assert one.residual(y).bic_gain(one.first.rows[:2]) == pytest.approx(alone.bic_gain(one.first.rows[:2] @ rest))


def test_the_best_law_of_each_effect_is_its_first_of_all() -> None:
    """Whatever is left unselected, as its bound says that another law of the effect is better."""
    one = problem(3)
    laws = [CandidateLaw(f"effect {k % 3}", PLAIN.law(), columns(k), one.rng.normal(size=(4, N))) for k in range(24)]
    scan = one.scan_of(*laws)
    residual = one.residual(one.visible(sum(law.rows[k % 4] for k, law in enumerate(laws)) + one.noise()))
    first = {score.slug: score for score in reversed(scan.ranked(residual))}
    best = scan.best_of_each_effect(residual)
    assert [score.value for score in best] == sorted((score.value for score in best), reverse=True)
    assert {score.slug: (score.value, score.names) for score in best} == {
        slug: (score.value, score.names) for slug, score in first.items()
    }


def test_the_laws_beside_another_model_are_those_of_a_scan_of_its_own() -> None:
    one, other = problem(4), problem(5)
    residual = other.residual(other.visible(one.first.rows[0] + one.noise()))
    found = one.scan.behind_of(other.projector).ranked(residual)
    wanted = other.scan_of(*one.scan.candidates).ranked(residual)
    assert [(score.slug, score.names, score.value) for score in found] == [
        (score.slug, score.names, score.value) for score in wanted
    ]


def columns(number: int) -> tuple[EffectColumn, ...]:
    return tuple(column(f"x{number} {k}", f"joint {k}") for k in range(4))


def test_choosing_among_laws_has_its_price() -> None:
    one = problem(1)
    y = one.visible(one.first.rows[2] * 0.3 + one.noise())
    tried = one.scan_of(CandidateLaw("first", PLAIN.law(tried=50), one.first.columns, one.first.rows))
    cheap, priced = one.ranked(y)[0], one.ranked(y, tried)[0]
    assert priced.names == cheap.names
    assert cheap.value - priced.value == pytest.approx(2.0 * math.log(50.0))


def test_what_the_nuisance_parameters_explain_is_invisible() -> None:
    one = problem(3)
    rows = np.stack([one.design[:, 0], one.noise()])
    hidden = one.scan_of(CandidateLaw("hidden", PLAIN.law(), (column("a", "one"), column("b", "two")), rows))
    y = one.visible(one.noise() + 5.0 * rows[0])
    assert one.ranked(y, hidden)[0].names == ("b",)


# -- Block selection: blocks stand or fall together, refinements never stand alone, spread effects are found whole -----


def test_columns_of_one_block_come_together() -> None:
    one = problem(2)
    y = one.visible(one.first.rows[0] + 0.1 * one.noise())
    assert one.ranked(y)[0].names == ("a", "b")


def test_a_refinement_alone_is_never_the_effect() -> None:
    """However well it explains: it joins a block that is chosen, or is left."""
    one = problem(9)
    law = refining_law(one.rng, one.noise())
    scan, main = one.scan_of(law), one.scan_of(law.keep((0, 1)))
    residual = one.residual(one.visible(3.0 * law.rows[2] + one.noise()))
    projected, square = residual.projected[:, None], np.array([residual.square])
    np.testing.assert_allclose(scan.best_block_scores(projected, square), main.best_block_scores(projected, square))
    for with_refinements in (False, True):
        found = scan.score(0, residual, with_refinements=with_refinements)
        assert found is not None
        assert set(found.names) & {"a", "b"}


def test_a_refinement_joins_the_effect_only_where_it_is_asked_for() -> None:
    one = problem(9)
    law = refining_law(one.rng, one.noise())
    scan = one.scan_of(law)
    residual = one.residual(one.visible(law.rows[0] + 0.6 * law.rows[3] + 0.5 * one.noise()))
    (plain,) = scan.ranked(residual)
    (refined,) = scan.ranked(residual, with_refinements=True)
    assert plain.names == ("a",)
    assert refined.names == ("a", "d")
    assert refined.value > plain.value + 6.0


def test_without_a_visible_block_there_is_nothing_to_refine() -> None:
    one = problem(9)
    law = refining_law(one.rng, one.design[:, 0]).keep((0, 2, 3))
    scan = one.scan_of(law)
    residual = one.residual(one.visible(law.rows[1] + law.rows[2] + 0.1 * one.noise()))
    assert scan.score(0, residual) is None
    assert scan.ranked(residual, with_refinements=True) == []


def test_an_effect_spread_evenly_over_blocks_is_found_whole() -> None:
    one = problem(7)
    columns = tuple(column(f"x{i}", f"joint {i}") for i in range(6))
    many = CandidateLaw("many", PLAIN.law(), columns, one.rng.normal(size=(6, N)))
    y = one.visible(0.45 * many.rows.sum(axis=0) + one.noise())
    assert len(one.ranked(y, one.scan_of(many))[0].names) == 6


# -- Significance: the false-alarm rate is kept, and the smallest detectable size is just detected ---------------------


def test_the_stated_false_alarm_rate_is_kept() -> None:
    one = problem(4)
    least = score_threshold(simulate_null_maxima(one.scan, one.projector, 400, (4,)), 0.05)
    fresh = simulate_null_maxima(one.scan, one.projector, 2000, (99,))
    # 0.05 give or take the scatter of 400 and of 2000 draws
    assert 0.02 < np.mean(fresh > least) < 0.09
    assert corrected_p_value(fresh, float(fresh[-1]) + 1.0) == pytest.approx(1.0 / 2001.0)


def test_what_the_nuisance_parameters_explain_has_no_detectable_size() -> None:
    one = problem(3)
    rows = np.stack([one.design[:, 0], one.noise()])
    hidden = one.scan_of(CandidateLaw("hidden", PLAIN.law(), (column("a", "one"), column("b", "two")), rows))
    sizes = smallest_detectable(hidden, 0, 5.0)
    assert math.isinf(sizes["a"])
    assert 0.0 < sizes["b"] < 1.0


def test_an_effect_of_the_smallest_detectable_size_is_detected_about_every_other_time() -> None:
    one = problem(5)
    least = 5.0
    size = smallest_detectable(one.scan, 0, least)["c"]
    alone = one.scan_of(one.first.keep([2]))
    hits = [one.ranked(one.visible(size * one.first.rows[2] + one.noise()), alone)[0].value > least for _ in range(300)]
    assert 0.3 < np.mean(hits) < 0.75


# -- Free parts of laws where the readings hardly exceed the parameters ------------------------------------------------


def test_laws_that_take_all_that_the_readings_hold_have_no_free_part():
    data, _ = readings_with(lambda q: 2e-4 * np.sin(q + 1.0), np.zeros_like, 20)
    terms = []
    for slug in ("joint_compliance", "backlash", "encoder_eccentricity"):
        law = EFFECTS[slug].laws(data.context)[0]
        terms.append(ModelTerm(slug, law, tuple(column.name for column in data.columns(slug, law))))
    state = SearchState(*refit(data, tuple(terms)))
    assert len(state.fit.residual) - state.fit.projector.effective_parameters < 1.0
    problem = SearchProblem(data, (), np.zeros(20), 30.0, CancelToken(), lambda words: None)
    assert with_free_parts(problem, state) is None


def test_a_candidate_whose_fit_does_not_converge_is_dropped_and_named_and_is_no_finding(monkeypatch):
    data, _ = readings_with(lambda q: 3e-4 * np.sin(q + 1.0), np.zeros_like, 150)

    def fails(*_):
        raise NotConverged.of("fit of geometry and effects", "no reason")

    monkeypatch.setattr(stepwise, "apply_step", fails)
    found = stepwise.search(data, ("encoder_eccentricity",), CancelToken())
    assert not [term for term in found.fit.terms if term.smooth is None]
    assert found.not_fitted[0] == f"{EFFECTS['encoder_eccentricity'].title} added"
