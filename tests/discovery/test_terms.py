"""Layout of parameters: geometry first, then one term after the other; priors of free curves."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.calibration.curve_prior import CurvePrior, spectrum_variances
from cellapp.discovery.terms import ModelTerm, TermLayout, has_curves, prior_sd, with_term, without_term
from cellapp.effects import EffectColumn, Wave, joint_column
from cellapp.effects.periodic import CURVE
from tests.discovery.linear_problem import PLAIN

pytestmark = pytest.mark.fast


def wave_column(name: str, joint: int, count: int, *, sine: bool) -> EffectColumn:
    return joint_column(name, "rad", joint, np.zeros(2), -1.0, 1.0, wave=Wave(count, sine))


def test_each_term_has_its_columns_behind_the_geometry() -> None:
    layout = TermLayout.of(5, [2, 0, 3])
    assert layout.total == 10
    assert [layout.columns(term) for term in range(3)] == [slice(0, 2), slice(2, 2), slice(2, 5)]
    assert layout.parameters(2) == slice(7, 10)
    np.testing.assert_array_equal(np.flatnonzero(layout.all_but(0)), [0, 1, 2, 3, 4, 7, 8, 9])
    assert TermLayout.of(5, []).total == 5


def test_terms_are_left_out_and_replaced() -> None:
    terms = tuple(ModelTerm(slug, PLAIN.law(), ()) for slug in ("one", "two", "three"))
    assert [term.slug for term in without_term(terms, 1)] == ["one", "three"]
    assert [term.slug for term in with_term(terms, 1, terms[0])] == ["one", "one", "three"]


def test_only_coefficients_of_the_curve_have_a_prior() -> None:
    curves = CurvePrior((1,), np.array([0.1]), np.array([2e-4]), 1.0, 0.0)
    columns = [
        wave_column("cos2q2", 1, 2, sine=False),
        wave_column("sin7q2", 1, 7, sine=True),
        wave_column("cos120q2", 1, 120, sine=False),
        wave_column("cos9q2", 1, 9, sine=False),
        wave_column("cos2q1", 0, 2, sine=False),
    ]
    names = tuple(column.name for column in columns)
    term = ModelTerm("transmission_error", CURVE.law(), names, curves, free=frozenset({"cos9q2"}))
    wanted = np.sqrt(spectrum_variances(0.1, 2e-4, 10))
    np.testing.assert_allclose(term.prior_sd(columns), [wanted[1], wanted[6], np.inf, np.inf, np.inf])
    plain = ModelTerm("backlash", PLAIN.law(), ("half_play1",))
    play = joint_column("half_play1", "rad", 0, np.zeros(2), 0.0, 1.0)
    assert prior_sd((plain,), [play]) is None
    assert has_curves((plain, term))
    sd = prior_sd((plain, term), [play, *columns])
    assert sd is not None
    np.testing.assert_array_equal(sd, [np.inf, *term.prior_sd(columns)])
