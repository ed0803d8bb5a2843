"""Charts of held-out errors over joints and in space, of a small calibrated run."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.charts_accuracy import error_histogram_chart, residual_joint_chart, residual_space_chart
from cellapp.commands.calibrate.held_out import HeldOutArm
from cellapp.commands.report.data import ReportData, read_report_data


@pytest.fixture
def data(single: RunFile) -> ReportData:
    return read_report_data(single)


@pytest.fixture
def held_out(data: ReportData) -> HeldOutArm:
    return data.held_out["only"]


def test_errors_over_a_joint_of_each_stage(held_out: HeldOutArm) -> None:
    chart = residual_joint_chart("only", held_out, 3)
    assert [one.name for one in chart.series] == ["nominal", "geometry"]
    assert chart.series[0].x == pytest.approx(np.degrees(held_out.readings.q[:, 2]))
    assert chart.series[1].y == pytest.approx(held_out.errors_mm["geometry"])
    assert chart.message.startswith("Identified geometry: mean error ")
    assert chart.series[1].style == 1


@pytest.mark.parametrize("view", ["above", "side"])
def test_errors_in_space_are_drawn_once_each(held_out: HeldOutArm, view) -> None:
    chart = residual_space_chart("only", held_out, "geometry", view)
    errors = held_out.errors_mm["geometry"]
    assert sum(len(one.x) for one in chart.series) == len(errors)
    worst = held_out.readings.p_M[np.argmax(errors)]
    (largest,) = [one for one in chart.series if one.name == "larger"]
    assert np.isclose(largest.x, worst[0]).any()
    assert chart.equal
    assert residual_space_chart("only", held_out, "effects", view).is_empty


def test_the_histogram_of_a_run(data: ReportData, held_out: HeldOutArm) -> None:
    chart = error_histogram_chart("only", held_out.errors_mm, data.calibrate.arms["only"].tracker_mm)
    assert [one.y.sum() for one in chart.series] == [len(held_out.readings)] * 2
    assert chart.limits[0].value == pytest.approx(np.sqrt(3.0) * 0.02)
