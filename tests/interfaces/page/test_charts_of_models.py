"""Charts of models: joint curves with the bands of the posterior, residuals over the run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.charts_accuracy import joint_curve_charts
from cellapp.commands.collect.charts import residual_drift_chart
from cellapp.commands.stages import read_stages
from cellapp.commands.view.charts import Chart
from cellapp.estimation.readings import Readings
from cellapp.ground.results import CALIBRATE
from cellapp.robot.effects import EFFECTS, EffectTerm, MeasurementConditions
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.model import PosteriorDraws


def term(slug: str, **values: float) -> EffectTerm:
    numbers = np.array(list(values.values()))
    law = EFFECTS[slug].law("constant" if slug == "backlash" else "", {})
    return EffectTerm(slug, tuple(values), numbers, 0.01 * np.abs(numbers), ("rad",) * len(values), law)


@pytest.fixture
def arm(single: RunFile) -> tuple[ArmModel, Readings]:
    model = CellModel.from_json(read_stages(single).current[CALIBRATE].model or "").arms["only"]
    return model, single.readings("only")


def charts_of(model: ArmModel, readings: Readings) -> list[Chart]:
    conditions = MeasurementConditions(approach=np.ones(readings.q.shape))
    return list(joint_curve_charts("only", model, readings, conditions, 3))


def test_a_curve_is_the_effects_own_and_its_band_that_of_the_draws(arm: tuple[ArmModel, Readings]) -> None:
    model, readings = arm
    eccentric = term("encoder_eccentricity", cos1q2=40e-6, sin1q2=-30e-6)
    draws = np.array([[1e-6, 0.0], [-1e-6, 0.0], [0.0, 1e-6], [0.0, -1e-6]])
    posterior = PosteriorDraws((), np.zeros((4, 0)), (draws,), 0.0)
    (chart,) = charts_of(replace(model, effects=(eccentric,), posterior=posterior), readings)
    (curve,) = chart.series
    angle = np.radians(curve.x)
    assert curve.y == pytest.approx(40.0 * np.cos(angle) - 30.0 * np.sin(angle), abs=1e-6)
    # the mean square of the draws is half of (cos^2 + sin^2) urad^2
    assert curve.band == pytest.approx(np.full(len(angle), 1.959964 * np.sqrt(0.5)))
    low, high = np.degrees([readings.q[:, 1].min(), readings.q[:, 1].max()])
    assert [limit.value for limit in chart.limits] == pytest.approx([low, high])
    assert curve.x[0] < low < high < curve.x[-1]
    assert chart.title == "Arm only: what effects turn joint 2 by, over its angle"
    assert "Offset of joint 2 over the measured angles" in chart.message


def test_play_is_shown_after_motions_in_either_direction(arm: tuple[ArmModel, Readings]) -> None:
    model, readings = arm
    (chart,) = charts_of(replace(model, effects=(term("backlash", half_play1=1e-4),), posterior=None), readings)
    up, down = chart.series
    assert np.ptp(up.y) == np.ptp(down.y) == 0.0
    assert up.y[0] == pytest.approx(-down.y[0])
    assert abs(up.y[0]) == pytest.approx(100.0)
    assert up.band is None
    assert up.name == "backlash after upward motion"


def test_a_model_without_effects_has_no_curves(arm: tuple[ArmModel, Readings]) -> None:
    model, readings = arm
    assert charts_of(model, readings) == []


# -- residuals over the run -------------------------------------------------------------------------------------------


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
