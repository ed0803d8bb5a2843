"""The scan: scores are gains of the BIC in the complement of the nuisance parameters, with the price of choosing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellapp.estimation.design.information import NuisanceProjector
from cellapp.estimation.discovery.joint_fit import ProjectedResidual
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.terms import CandidateLaw
from cellapp.robot.effects import EffectColumn
from tests.estimation.discovery.linear_problem import PLAIN, N, column, problem

pytestmark = pytest.mark.fast


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
