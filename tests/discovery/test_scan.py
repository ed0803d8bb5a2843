"""The scan: projection is the joint refit, the threshold is honest, blocks belong together."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.discovery.scan import (
    Candidate,
    complement,
    corrected_p,
    null_maxima,
    scan,
    score,
    smallest_seen,
    threshold,
    visible_part,
)
from cellapp.effects import EffectColumn

N = 300


def column(name, joint):
    return EffectColumn(name, "rad", joint, np.zeros(0), -1.0, 1.0)


def problem(seed):
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(N, 10)))[0]
    first = Candidate("first", (column("a", 0), column("b", 0), column("c", 1)), rng.normal(size=(N, 3)))
    second = Candidate("second", (column("d", 2), column("e", 3)), rng.normal(size=(N, 2)))
    return rng, basis, [visible_part(effect, basis) for effect in (first, second)], (first, second)


def test_regression_in_the_complement_is_the_joint_regression():
    rng, basis, (visible, _), (first, _) = problem(0)
    y = rng.normal(size=N)
    joint = np.linalg.lstsq(np.hstack([basis, first.B]), y, rcond=None)[0][-3:]
    alone = np.linalg.lstsq(visible.B, complement(basis, y), rcond=None)[0]
    np.testing.assert_allclose(alone, joint, atol=1e-12)


def test_the_score_is_the_bic_gain_of_the_chosen_block():
    rng, basis, (visible, other), (first, _) = problem(1)
    y = complement(basis, first.B[:, 2] * 0.3 + rng.normal(size=N))
    scores = scan([visible, other], y)
    assert scores[0].slug == "first"
    assert scores[0].chosen == (2,)
    left = y - visible.B[:, [2]] @ np.linalg.lstsq(visible.B[:, [2]], y, rcond=None)[0]
    assert scores[0].score == pytest.approx(-N * np.log(left @ left / (y @ y)) - np.log(N), rel=1e-9)


def test_columns_of_one_joint_come_together():
    rng, basis, (visible, _), (first, _) = problem(2)
    y = complement(basis, first.B[:, 0] + 0.1 * rng.normal(size=N))
    assert score(visible, visible.B.T @ y, float(y @ y), N).chosen == (0, 1)


def test_what_geometry_takes_is_invisible():
    rng, basis, _, _ = problem(3)
    hidden = Candidate("hidden", (column("a", 0), column("b", 1)), np.column_stack([basis[:, 0], rng.normal(size=N)]))
    seen = visible_part(hidden, basis)
    assert seen.blocks == ((1,),)
    sizes = smallest_seen(seen, 5.0, N)
    assert np.isinf(sizes[0])
    assert 0.0 < sizes[1] < 1.0


def test_the_stated_false_alarm_rate_is_kept():
    rng, basis, effects, _ = problem(4)
    least = threshold(null_maxima(effects, basis, 400, rng), 0.05)
    fresh = null_maxima(effects, basis, 1000, np.random.default_rng(99))
    assert 0.02 < np.mean(fresh > least) < 0.09
    assert corrected_p(fresh, float(fresh[-1]) + 1.0) == pytest.approx(1.0 / 1001.0)


def test_an_effect_of_the_smallest_seen_size_is_about_as_often_seen_as_not():
    rng, basis, effects, (first, _) = problem(5)
    least = 5.0
    size = smallest_seen(effects[0], least, N)[2]
    hits = []
    for _ in range(300):
        y = complement(basis, size * first.B[:, 2] + rng.normal(size=N))
        hits.append(scan([effects[0]], y)[0].score > least)
    assert 0.3 < np.mean(hits) < 0.75
