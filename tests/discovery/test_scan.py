"""The scan: projection is the joint refit, the threshold is honest, blocks belong together."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellapp.discovery.scan import (
    Candidate,
    Follower,
    Seen,
    corrected_p,
    displacements,
    null_maxima,
    smallest_seen,
    threshold,
)
from cellapp.effects import Channel, EffectColumn, LawForm

N = 300
PLAIN = LawForm("", "plain")


def column(name: str, block: str, *, refines: bool = False) -> EffectColumn:
    return EffectColumn(name, "rad", block, -1.0, 1.0, Channel.BASE, refines=refines)


def problem(seed: int):
    rng = np.random.default_rng(seed)
    design = rng.normal(size=(N, 10))
    first = Candidate(
        "first", PLAIN.law(), (column("a", "one"), column("b", "one"), column("c", "two")), rng.normal(size=(3, N))
    )
    second = Candidate("second", PLAIN.law(), (column("d", "three"), column("e", "four")), rng.normal(size=(2, N)))
    follower = Follower.of(design)
    return rng, design, follower, Seen.of([first, second], follower), (first, second)


def scores(seen: Seen, follower: Follower, y: np.ndarray):
    MY = follower.without(y)
    return seen.scores(MY, float(y @ MY))


def test_regression_in_the_complement_is_the_joint_regression() -> None:
    rng, design, follower, seen, (first, _) = problem(0)
    y = rng.normal(size=N)
    joint = np.linalg.lstsq(np.hstack([design, first.B.T]), y, rcond=None)[0][-3:]
    _, MB = seen.part(0)
    alone = np.linalg.lstsq(MB.T, follower.without(y), rcond=None)[0]
    np.testing.assert_allclose(alone, joint, atol=1e-12)


def test_with_priors_the_follower_is_generalised_least_squares() -> None:
    rng, design, _, _, (first, _) = problem(6)
    sd = rng.uniform(0.1, 2.0, 10)
    follower = Follower.of(design, 1.0 / sd**2)
    y = rng.normal(size=N)
    covariance = np.eye(N) + (design * sd**2) @ design.T
    wanted = np.linalg.solve(covariance, y)
    np.testing.assert_allclose(follower.without(y), wanted, atol=1e-10)
    rows = first.B[:2]
    seen = Seen.of([Candidate("one", PLAIN.law(), first.columns[:2], rows)], follower)
    weighted = rows @ np.linalg.solve(covariance, rows.T)
    reduction = rows @ wanted @ np.linalg.solve(weighted, rows @ wanted)
    found = scores(seen, follower, y)[0]
    assert found.explained == pytest.approx(reduction / (y @ wanted), rel=1e-9)


def test_the_score_is_the_bic_gain_of_the_chosen_block() -> None:
    rng, _, follower, seen, (first, _) = problem(1)
    y = follower.without(first.B[2] * 0.3 + rng.normal(size=N))
    found = scores(seen, follower, y)
    assert (found[0].slug, found[0].names) == ("first", ("c",))
    _, MB = seen.part(0)
    left = y - MB[[2]].T @ np.linalg.lstsq(MB[[2]].T, y, rcond=None)[0]
    assert found[0].value == pytest.approx(-N * np.log(left @ left / (y @ y)) - np.log(N), rel=1e-9)


def test_choosing_among_laws_has_its_price() -> None:
    rng, _, follower, seen, (first, _) = problem(1)
    y = follower.without(first.B[2] * 0.3 + rng.normal(size=N))
    dear = Seen.of([Candidate("first", PLAIN.law(tried=50), first.columns, first.B)], follower)
    cheap, priced = scores(seen, follower, y)[0], scores(dear, follower, y)[0]
    assert priced.names == cheap.names
    assert cheap.value - priced.value == pytest.approx(2.0 * math.log(50.0))


def test_columns_of_one_block_come_together() -> None:
    rng, _, follower, seen, (first, _) = problem(2)
    y = follower.without(first.B[0] + 0.1 * rng.normal(size=N))
    assert scores(seen, follower, y)[0].names == ("a", "b")


def refining(rng: np.random.Generator, main: np.ndarray) -> tuple[Candidate, np.ndarray]:
    """An effect of two blocks and what only refines them, and rows of the latter."""
    rows = np.stack([main, *rng.normal(size=(3, N))])
    names = (
        column("a", "one"),
        column("b", "two"),
        column("c", "three", refines=True),
        column("d", "four", refines=True),
    )
    return Candidate("refined", PLAIN.law(), names, rows), rows


def test_what_only_refines_is_never_the_effect() -> None:
    """However well it explains: it joins a block that is chosen, or is left."""
    rng, _, follower, _, _ = problem(9)
    one, rows = refining(rng, rng.normal(size=N))
    seen = Seen.of([one], follower)
    y = follower.without(3.0 * rows[2] + rng.normal(size=N))
    MY = follower.without(y)[:, None]
    alone = Seen.of([Candidate("main", PLAIN.law(), one.columns[:2], rows[:2])], follower)
    square = np.array([float(y @ MY[:, 0])])
    np.testing.assert_allclose(seen.block_scores(MY, square), alone.block_scores(MY, square))
    for refined in (False, True):
        found = seen.greedy(0, MY[:, 0], float(square[0]), refined=refined)
        assert found is not None
        assert set(found.names) & {"a", "b"}


def test_a_refinement_joins_the_effect_only_where_it_is_asked_for() -> None:
    rng, _, follower, _, _ = problem(9)
    one, rows = refining(rng, rng.normal(size=N))
    seen = Seen.of([one], follower)
    y = follower.without(rows[0] + 0.6 * rows[3] + 0.5 * rng.normal(size=N))
    square = float(y @ follower.without(y))
    (plain,) = seen.scores(follower.without(y), square)
    (refined,) = seen.scores(follower.without(y), square, refined=True)
    assert plain.names == ("a",)
    assert refined.names == ("a", "d")
    assert refined.value > plain.value + 6.0


def test_without_a_block_that_can_be_seen_there_is_nothing_to_refine() -> None:
    rng, design, follower, _, _ = problem(9)
    one, rows = refining(rng, design[:, 0])
    hidden = Candidate(one.slug, one.law, (one.columns[0], *one.columns[2:]), rows[[0, 2, 3]])
    seen = Seen.of([hidden], follower)
    y = follower.without(rows[2] + rows[3] + 0.1 * rng.normal(size=N))
    assert seen.greedy(0, y, float(y @ y)) is None
    assert seen.scores(y, float(y @ y), refined=True) == []


def test_an_effect_spread_evenly_over_blocks_is_found_whole() -> None:
    rng, _, follower, _, _ = problem(7)
    many = Candidate(
        "many", PLAIN.law(), tuple(column(f"x{i}", f"joint {i}") for i in range(6)), rng.normal(size=(6, N))
    )
    y = follower.without(0.45 * many.B.sum(axis=0) + rng.normal(size=N))
    assert len(scores(Seen.of([many], follower), follower, y)[0].names) == 6


def test_what_the_model_follows_is_invisible() -> None:
    rng, design, follower, _, _ = problem(3)
    rows = np.stack([design[:, 0], rng.normal(size=N)])
    hidden = Candidate("hidden", PLAIN.law(), (column("a", "one"), column("b", "two")), rows)
    seen = Seen.of([hidden], follower)
    sizes = smallest_seen(seen, 0, 5.0)
    assert math.isinf(sizes["a"])
    assert 0.0 < sizes["b"] < 1.0
    y = follower.without(rng.normal(size=N) + 5.0 * rows[0])
    assert scores(seen, follower, y)[0].names == ("b",)


def test_the_stated_false_alarm_rate_is_kept() -> None:
    rng, _, follower, seen, _ = problem(4)
    least = threshold(null_maxima(seen, follower, 400, rng), 0.05)
    fresh = null_maxima(seen, follower, 2000, np.random.default_rng(99))
    # 0.05 give or take the scatter of 400 and of 2000 draws
    assert 0.02 < np.mean(fresh > least) < 0.09
    assert corrected_p(fresh, float(fresh[-1]) + 1.0) == pytest.approx(1.0 / 2001.0)


def test_an_effect_of_the_smallest_seen_size_is_about_as_often_seen_as_not() -> None:
    rng, _, follower, seen, (first, _) = problem(5)
    least = 5.0
    size = smallest_seen(seen, 0, least)["c"]
    hits = []
    alone = Seen.of([Candidate("c", PLAIN.law(), first.columns[2:], first.B[2:])], follower)
    for _ in range(300):
        y = follower.without(size * first.B[2] + rng.normal(size=N))
        hits.append(scores(alone, follower, y)[0].value > least)
    assert 0.3 < np.mean(hits) < 0.75


def test_turning_and_shifting_columns_are_whitened_alike() -> None:
    rng = np.random.default_rng(8)
    n = 20
    white = rng.normal(size=(3, 3, n))
    by_joint = rng.normal(size=(3, 6, n))
    offset, shift = rng.normal(size=n), rng.normal(size=(n, 3))
    columns = (
        EffectColumn("shift", "m", "base", -1, 1, Channel.BASE, shift_M=shift),
        EffectColumn("turn", "rad", "joint 3", -1, 1, Channel.JOINT, 2, offset=offset),
    )
    B = displacements(columns, np.einsum("acn,cjn->ajn", white, by_joint), white)
    np.testing.assert_allclose(B[0].reshape(3, n), np.einsum("acn,nc->an", white, shift), atol=1e-12)
    np.testing.assert_allclose(B[1].reshape(3, n), np.einsum("acn,cn->an", white, by_joint[:, 2] * offset), atol=1e-12)
