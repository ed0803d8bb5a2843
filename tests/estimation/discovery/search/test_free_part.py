"""Free parts of laws where the readings hardly exceed the parameters."""

from __future__ import annotations

import numpy as np

from cellapp.estimation.discovery.joint_fit import refit
from cellapp.estimation.discovery.search import stepwise
from cellapp.estimation.discovery.search.free_part import with_free_parts
from cellapp.estimation.discovery.search.state import SearchProblem, SearchState
from cellapp.estimation.discovery.terms import ModelTerm
from cellapp.ground.errors import NotConverged
from cellapp.ground.progress import CancelToken
from cellapp.robot.effects import EFFECTS
from tests.estimation.discovery.search.test_data_driven import readings_with


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
