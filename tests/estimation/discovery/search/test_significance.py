"""Significance: the false-alarm rate is kept, and the smallest detectable size is just detected."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellapp.estimation.discovery.search.scan import (
    corrected_p_value,
    score_threshold,
    simulate_null_maxima,
    smallest_detectable,
)
from cellapp.estimation.discovery.terms import CandidateLaw
from tests.estimation.discovery.linear_problem import PLAIN, column, problem

pytestmark = pytest.mark.fast


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
