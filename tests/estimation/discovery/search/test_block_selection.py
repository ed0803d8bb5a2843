"""Block selection: blocks stand or fall together, refinements never stand alone, spread effects are found whole."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.discovery.terms import CandidateLaw
from tests.estimation.discovery.linear_problem import PLAIN, N, column, problem, refining_law

pytestmark = pytest.mark.fast


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
