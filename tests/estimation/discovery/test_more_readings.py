"""More readings than are searched never make it worse, and a numerical failure is no finding."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.least_squares import minimise
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.discovery import all_readings, discover
from cellapp.estimation.discovery.all_readings import fit_to_all
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.discover import Searched, discover_arm, search_rows
from cellapp.estimation.discovery.outcome import HeldOut
from cellapp.estimation.discovery.search.stepwise import search
from cellapp.estimation.discovery.terms import has_smooth_terms
from cellapp.ground.errors import NotConverged
from cellapp.ground.progress import CancelToken
from tests.evidence.shared.series import draw_rows, load_entrant

SEARCHED, ROWS = 200, 320


@cache
def drawn():
    """A draw of a real UR10: its profile, calibrated model, readings with splits, and their conditions."""
    series = load_entrant("D")
    readings = draw_rows(series, ROWS, 3).split(series.readings)
    arm, _ = calibrate_arm(series.profile, series.arm, readings)
    return series.profile, series.arm, arm.model, readings, measurement_conditions(readings)


@cache
def searched() -> Searched:
    profile, _, model, readings, conditions = drawn()
    rows = readings.in_split("identify")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(discover, "_MOST_SEARCHED", SEARCHED)
        return search_rows(profile, model, readings.take(rows), conditions.take(rows), CancelToken())


def held_out() -> HeldOut:
    _, _, _, readings, conditions = drawn()
    return HeldOut.of(readings, conditions)


def test_rows_beyond_those_that_are_searched_lower_the_error():
    result = searched()
    assert has_smooth_terms(result.found.fit.terms)
    assert (result.only_some, len(result.search.data), result.fitted) == ("", SEARCHED, ROWS)
    of_search = Searched.of_search(result.search, result.data).model
    assert held_out().rms_mm(result.model) < held_out().rms_mm(of_search) < held_out().rms_mm(drawn()[2])


def test_a_start_far_from_the_solution_reaches_the_same_minimum():
    result = searched()
    fit = result.found.fit
    weighed = replace(result.data, sigma=np.full(len(result.data), 5e-5)).at(fit.model)
    reached = all_readings._fitted(weighed, fit)
    vector = fit.model.geometry.vector()
    vector[list(fit.identification.estimated.columns)] += np.random.default_rng(0).normal(
        0.0, 3e-3, len(fit.identification.estimated.columns)
    )
    far = replace(
        fit,
        model=replace(fit.model, geometry=fit.model.geometry.with_vector(vector)),
        identification=replace(fit.identification, effect_values=np.zeros_like(fit.identification.effect_values)),
    )
    again = all_readings._fitted(weighed, far)
    readings, conditions = result.data.readings, result.data.conditions
    one, other = (model.predict(readings.q, conditions=conditions) for model in (reached, again))
    assert np.linalg.norm(one - other, axis=1).max() < 5e-6


def test_no_step_of_the_fit_to_all_raises_its_objective(monkeypatch):
    seen: list[tuple[float, float, bool]] = []

    def watched(problem, start, **settings):
        found = minimise(problem, start, **settings)
        seen.append((problem.objective(start), problem.objective(found.point), found.converged))
        return found

    monkeypatch.setattr(all_readings, "minimise", watched)
    result = searched()
    fit_to_all(result.search, result.data, result.search.threshold)
    ((before, after, converged),) = seen
    assert converged
    assert after < before


@pytest.mark.slow
def test_where_the_fit_to_all_fails_the_model_of_the_search_is_in_force_and_said(monkeypatch):
    profile, name, model, readings, conditions = drawn()
    found = searched().search
    monkeypatch.setattr(discover, "_MOST_SEARCHED", SEARCHED)
    monkeypatch.setattr(discover, "search", lambda *_: found)
    monkeypatch.setattr(all_readings, "_MOST_STEPS", 1)
    result = discover_arm(profile, name, model, readings, conditions=conditions).result
    assert [one.effect for one in result.accepted] == [term.slug for term in found.fit.terms]
    assert result.heldout_mm.after < 0.5 * result.heldout_mm.before
    assert f"the model rests on {SEARCHED} of {ROWS} readings" in result.sentence
    assert "no finding" in result.sentence
    assert "measure more" not in result.sentence
    assert not any("fitted to all" in step.what for step in result.steps)


def test_a_fit_that_does_not_converge_is_an_error(monkeypatch):
    monkeypatch.setattr(all_readings, "_MOST_STEPS", 1)
    result = searched()
    with pytest.raises(NotConverged, match="effects to all readings"):
        fit_to_all(result.search, result.data, result.search.threshold)


def test_only_terms_that_predict_worse_are_removed():
    """The last term of the model is spoilt: it goes, and no other one does."""
    result, judge = searched(), held_out()
    terms = result.found.fit.terms
    spoilt = replace(
        result.model,
        effects=(*result.model.effects[:-1], replace(result.model.effects[-1], values=np.full(terms[-1].size, 5e-3))),
    )
    left = discover._judged_by_held_out(replace(result, model=spoilt, only_some="spoilt here"), judge)
    assert left.harmful == (terms[-1].slug,)
    assert len(left.found.fit.terms) == len(terms) - 1
    assert len(left.found.reviews) == len(terms) - 1
    assert judge.rms_mm(left.model) < 0.6 * judge.rms_mm(left.found.geometry_only.model)


@pytest.mark.slow
def test_gross_errors_beyond_the_searched_rows_need_no_other_search(monkeypatch):
    profile, name, model, readings, conditions = drawn()
    monkeypatch.setattr(discover, "_MOST_SEARCHED", SEARCHED)
    searches: list[int] = []

    def counted(data: ArmData, *rest):
        searches.append(len(data))
        return search(data, *rest)

    monkeypatch.setattr(discover, "search", counted)
    rows = readings.in_split("identify")
    seen = set(searched().search.data.readings.configuration.tolist())
    p_M, wrong = readings.p_M.copy(), next(row for row in rows if readings.configuration[row] not in seen)
    p_M[wrong] += 0.0012  # far below what the geometry alone shows
    found = discover_arm(profile, name, model, replace(readings, p_M=p_M), conditions=conditions).result
    assert found.left_out_configurations == (readings.configuration[wrong],)
    assert searches == [SEARCHED]
