"""Charts of models: residuals over the run."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.commands.collect.charts import residual_drift_chart


def test_a_drift_is_told_from_noise() -> None:
    rng = np.random.default_rng(0)
    time_s, noise = np.linspace(0.0, 7200.0, 400), rng.normal(scale=2e-5, size=(400, 3))
    still = residual_drift_chart("left", time_s, noise)
    assert "do not drift" in still.message
    assert (len(still.series), still.x.unit, len(still.series[0].x)) == (3, "h", 20)
    slow = noise + np.outer(time_s / 7200.0 - 0.5, [5e-5, 0.0, 0.0])
    moving = residual_drift_chart("left", time_s, slow)
    assert "left drift:" in moving.message
    assert moving.series[0].y[-1] - moving.series[0].y[0] == pytest.approx(0.05, abs=0.02)


def test_the_bands_hold_what_they_promise() -> None:
    rng = np.random.default_rng(1)
    outside = 0
    for _ in range(40):
        chart = residual_drift_chart("left", np.arange(200.0), rng.normal(size=(200, 3)))
        outside += sum(int(np.count_nonzero(np.abs(one.y) > one.band)) for one in chart.series if one.band is not None)
    assert 0.03 < outside / (40 * 30) < 0.07


def test_without_times_or_readings_the_chart_says_so() -> None:
    order = residual_drift_chart("left", np.full(100, np.nan), np.zeros((100, 3)) + np.arange(100.0)[:, None] * 1e-6)
    assert order.x.label == "reading"
    gaps = residual_drift_chart(
        "left", np.arange(100.0), np.where(np.arange(100)[:, None] < 80, 1e-6, np.nan) * np.ones(3)
    )
    assert len(gaps.series[0].x) == 4
    assert "too few readings (30)" in residual_drift_chart("left", np.arange(30.0), np.zeros((30, 3))).message
