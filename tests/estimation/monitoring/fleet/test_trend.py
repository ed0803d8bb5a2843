"""The regression of a figure over time: intervals hold the truth as often as they say, on drawn histories."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.estimation.monitoring.fleet.trend import Line, crossing, fit_line

pytestmark = pytest.mark.fast

DRAWS = 1000
MONTHS = np.array([0.0, 31.0, 58.0, 92.0, 120.0, 149.0, 183.0, 211.0])
ERRORS = np.array([1.0, 2.0, 1.0, 3.0, 1.5, 1.0, 2.0, 1.0])
TRUE_LEVEL, TRUE_SLOPE = 40.0, 0.1


def drawn_lines(excess: float, *, known: bool) -> list[Line]:
    """Lines through histories whose values scatter ``excess`` times as widely as their standard errors say."""
    rng = np.random.default_rng(11)
    true = TRUE_LEVEL + TRUE_SLOPE * MONTHS
    scatter = ERRORS if known else np.full(len(MONTHS), 1.5)
    values = true + excess * scatter * rng.standard_normal((DRAWS, len(MONTHS)))
    lines = [fit_line(MONTHS, row, ERRORS if known else None) for row in values]
    assert None not in lines
    return lines  # type: ignore[return-value]


def share(held: list[bool]) -> float:
    return sum(held) / len(held)


CASES = pytest.mark.parametrize(
    ("excess", "known"), [(1.0, True), (3.0, True), (1.0, False)], ids=["known", "wider than known", "unknown"]
)
LEAST = 0.95 - 3.0 * math.sqrt(0.95 * 0.05 / DRAWS)
"""Share of intervals that hold the truth, less three standard errors of that share."""


@CASES
@pytest.mark.parametrize("day", [0.0, 100.0, 400.0])
def test_the_band_holds_the_true_line(excess: float, known: bool, day: float) -> None:
    true, at = TRUE_LEVEL + TRUE_SLOPE * day, np.array([day])
    lines = drawn_lines(excess, known=known)
    assert share([abs(float(line.at(at)[0]) - true) <= float(line.half_width(at)[0]) for line in lines]) >= LEAST


@CASES
def test_the_interval_of_the_crossing_holds_the_true_time(excess: float, known: bool) -> None:
    limit = 100.0
    true = (limit - TRUE_LEVEL) / TRUE_SLOPE
    held = []
    for line in drawn_lines(excess, known=known):
        _, earliest, latest = crossing(line, limit)
        held.append(earliest is None or latest is None or earliest <= true <= latest)
    assert share(held) >= LEAST


@CASES
def test_no_more_slopes_are_called_significant_than_chance_allows(excess: float, known: bool) -> None:
    rng = np.random.default_rng(5)
    scatter = ERRORS if known else np.full(len(MONTHS), 1.5)
    values = excess * scatter * rng.standard_normal((DRAWS, len(MONTHS)))
    lines = [fit_line(MONTHS, row, ERRORS if known else None) for row in values]
    significant = share([line is not None and line.p_value < 0.05 for line in lines])
    assert significant <= 0.05 + 3.0 * math.sqrt(0.05 * 0.95 / DRAWS)


def test_a_line_worked_by_hand() -> None:
    # y = 1, 2, 2, 4 at t = 0, 1, 2, 3: mean 2.25 at 1.5, S = 5, slope 0.9; residuals 0.1, 0.2, -0.7, 0.4; s^2 = 0.35
    line = fit_line(np.arange(4.0), np.array([1.0, 2.0, 2.0, 4.0]), None)
    assert line is not None
    assert (line.origin, line.level, line.slope) == pytest.approx((1.5, 2.25, 0.9))
    assert line.level_standard_error == pytest.approx(math.sqrt(0.35 / 4))
    assert line.slope_standard_error == pytest.approx(math.sqrt(0.35 / 5))
    assert line.degrees_of_freedom == 2
    assert crossing(line, 4.95)[0] == pytest.approx(4.5)


def test_known_errors_are_not_made_smaller_by_lucky_values() -> None:
    line = fit_line(MONTHS, TRUE_SLOPE * MONTHS, ERRORS)
    assert line is not None
    weights = 1.0 / ERRORS**2
    spread = weights @ (MONTHS - weights @ MONTHS / weights.sum()) ** 2
    assert line.slope_standard_error == pytest.approx(1.0 / math.sqrt(spread))


def test_without_a_significant_slope_the_crossing_has_no_limits() -> None:
    line = Line(0.0, 1.0, 0.001, 0.1, 0.01, 6)
    time, *limits = crossing(line, 2.0)
    assert time == pytest.approx(1000.0)
    assert limits == [None, None]


@pytest.mark.parametrize(
    "time", [[0.0, 1.0, 2.0], [5.0, 5.0, 5.0, 5.0], []], ids=["three values", "one time", "nothing"]
)
def test_too_little_for_a_line(time: list[float]) -> None:
    assert fit_line(np.array(time), np.array(time), None) is None


@given(
    shift=st.floats(-1e4, 1e4),
    scale=st.floats(0.1, 10.0),
    values=st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8),
)
def test_the_line_moves_with_its_values(shift: float, scale: float, values: list[float]) -> None:
    y = np.array(values)
    one, other = fit_line(MONTHS, y, ERRORS), fit_line(MONTHS + shift, scale * y, scale * ERRORS)
    assert one is not None
    assert other is not None
    assert other.slope == pytest.approx(scale * one.slope, rel=1e-6, abs=1e-9 * scale)
    assert other.slope_standard_error == pytest.approx(scale * one.slope_standard_error, rel=1e-6)
    assert other.origin == pytest.approx(one.origin + shift, abs=1e-6)
