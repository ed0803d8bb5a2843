"""Layout of parameters: geometry first, then one term after the other; priors of free curves."""

from __future__ import annotations

import numpy as np

from cellapp.estimation.discovery.terms import (
    Excess,
    ModelTerm,
    Smoothness,
    TermLayout,
    prior_sd,
    smoothness_of,
    with_term,
    without_term,
)
from cellapp.robot.effects import EFFECTS, joint_column
from cellapp.robot.effects.law import circle_variances
from cellapp.robot.effects.periodic import CURVE
from tests.estimation.discovery.linear_problem import PLAIN
from tests.robot.effects.cell import context_of


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
    names = ("cos2q2", "sin7q2", "cos120q2", "cos2q1")
    law = CURVE.law({"cycles": 80.0, "length2": 0.1, "amplitude2": 2e-4})
    columns = EFFECTS["transmission_error"].columns(context_of(5), law, names)
    by_name = {column.name: column.prior_sd for column in columns}
    wanted = 2e-4 * np.sqrt(circle_variances(0.1, 10))
    np.testing.assert_allclose([by_name[name] for name in names], [wanted[1], wanted[6], np.inf, np.inf])
    play = joint_column("half_play1", "rad", 0, np.zeros(2), 0.0, 1.0)
    assert prior_sd([play]) is None
    sd = prior_sd([play, *columns])
    assert sd is not None
    assert sd[0] == np.inf
    smooth = ModelTerm("transmission_error", CURVE.law(), names, Smoothness(1.0, 2, Excess(1e-5)))
    assert smoothness_of((smooth,)) is smooth.smooth
