"""Ticks of logarithmic axes: one function, ascending, round, read as what they are."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cellapp.commands.view.charts import Axis
from cellapp.interfaces.render.chart import log_ticks, scale_of

pytestmark = pytest.mark.fast


@pytest.mark.slow
@example(low=2.0, decades=1.5, most=2)
@given(
    low=st.floats(min_value=1e-9, max_value=1e6),
    decades=st.floats(min_value=0.01, max_value=20.0),
    most=st.integers(min_value=2, max_value=12),
)
def test_round_values_ascend_inside_of_the_axis(low: float, decades: float, most: int) -> None:
    high = low * 10.0**decades
    ticks = log_ticks(low, high, most)
    assert len(ticks) <= most
    assert ticks == sorted(set(ticks))
    assert all(low * 0.999999 <= tick <= high * 1.000001 for tick in ticks)
    assert all(f"{tick:.1e}".split("e")[0] in ("1.0", "1.5", "2.0", "3.0", "5.0", "7.0") for tick in ticks)
    assert ticks or decades < math.log10(4.0), "a range of a factor of four has ticks"


def test_a_logarithmic_axis_is_read_in_decades() -> None:
    axis, values = Axis("expected error", "mm", logarithmic=True), np.array([0.011, 9.0])
    assert [label for _, label in scale_of(axis, values, 0.0, 300.0).labels(6)] == ["0.01", "0.1", "1", "10"]
