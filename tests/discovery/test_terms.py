"""Layout of parameters: geometry first, then one term after the other; priors of free curves."""

from __future__ import annotations

import numpy as np

from cellapp.calibration.curves import CurvePrior, spectrum_variances
from cellapp.discovery.terms import ModelTerm, TermLayout, has_curves, prior_sd, with_term, without_term
from cellapp.effects import Law


def test_each_term_has_its_columns_behind_the_geometry() -> None:
    layout = TermLayout.of(5, [2, 0, 3])
    assert layout.total == 10
    assert [layout.columns(term) for term in range(3)] == [slice(0, 2), slice(2, 2), slice(2, 5)]
    assert layout.parameters(2) == slice(7, 10)
    np.testing.assert_array_equal(np.flatnonzero(layout.all_but(0)), [0, 1, 2, 3, 4, 7, 8, 9])
    assert TermLayout.of(5, []).total == 5


def test_terms_are_left_out_and_replaced() -> None:
    terms = tuple(ModelTerm(slug, Law(), ()) for slug in ("one", "two", "three"))
    assert [term.slug for term in without_term(terms, 1)] == ["one", "three"]
    assert [term.slug for term in with_term(terms, 1, terms[0])] == ["one", "one", "three"]


def test_only_coefficients_of_the_curve_have_a_prior() -> None:
    curves = CurvePrior((1,), np.array([0.1]), np.array([2e-4]), 1.0, 0.0)
    names = ("cos2q2", "sin7q2", "cos120q2", "cos9q2", "cos2q1")
    term = ModelTerm("transmission_error", Law("curve"), names, curves, free=frozenset({"cos9q2"}))
    wanted = np.sqrt(spectrum_variances(0.1, 2e-4, 10))
    np.testing.assert_allclose(term.prior_sd(), [wanted[1], wanted[6], np.inf, np.inf, np.inf])
    plain = ModelTerm("backlash", Law(), ("half_play1",))
    assert prior_sd((plain,)) is None
    assert has_curves((plain, term))
    assert len(prior_sd((plain, term))) == 6
