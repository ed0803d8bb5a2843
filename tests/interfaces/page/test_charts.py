"""Charts: the values that the results have, limits, and a message that says what a person should see."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from cellapp.cell.planning.records import PlanDesignResult
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.records import ReferenceDrift
from cellapp.commands.calibrate.charts_accuracy import (
    error_histogram_chart,
)
from cellapp.commands.calibrate.held_out import HeldOutArm
from cellapp.commands.collect.charts import (
    drift_chart,
    live_residual_chart,
    standard_error_chart,
)
from cellapp.commands.discover.charts import picture_chart
from cellapp.commands.plan.charts import coverage_chart, design_charts
from cellapp.commands.report.data import ReportData, read_report_data
from cellapp.commands.view.charts import Axis, Chart, Limit, mm, series
from cellapp.ground.profile import Profile
from cellapp.ground.progress import StopReport
from cellapp.interfaces.page.drawn import chart_figure
from cellapp.interfaces.render.chart import Look
from tests.interfaces.page.cases import picture
from tests.interfaces.page.plan_cases import TIME, plan_design
from tests.twin import PROFILES


def values(chart: Chart, name: str) -> list[tuple[float, float]]:
    (one,) = [one for one in chart.series if one.name == name]
    return list(zip(one.x.tolist(), one.y.tolist(), strict=True))


# -- the dataclasses --------------------------------------------------------------------------------------------------


# -- collection -------------------------------------------------------------------------------------------------------


def report(stop: int, arm: str, residual_mm: float, standard_error_mm: float = 0.1) -> StopReport:
    return StopReport(stop, arm, residual_mm, standard_error_mm)


REPORTS = [report(0, "left", 0.02, 0.4), report(0, "right", 0.03), report(1, "left", 0.06, 0.2)]


def test_residuals_and_standard_errors_of_each_arm_over_the_stops() -> None:
    chart = live_residual_chart(REPORTS)
    assert values(chart, "left") == [(1.0, 0.02), (2.0, 0.06)]
    assert values(chart, "right") == [(1.0, 0.03)]
    assert "left 0.060 mm at stop 2 (median 0.040 mm) and right 0.030 mm at stop 1" in chart.message
    chart = standard_error_chart(REPORTS)
    assert values(chart, "left") == [(1.0, 0.4), (2.0, 0.2)]
    assert "left 0.200 mm (at stop 1: 0.400 mm)" in chart.message


def test_drift_of_the_references_against_the_limit() -> None:
    rows = [
        ReferenceDrift(name=name, stops_done=stops, drift_mm=drift)
        for name, stops, drift in [("nest", 0, 0.0), ("left", 0, 0.0), ("nest", 20, 0.011), ("left", 20, 0.004)]
    ]
    chart = drift_chart(rows, 0.05)
    assert values(chart, "nest") == [(0.0, 0.0), (20.0, 0.011)]
    assert [limit.value for limit in chart.limits] == [0.05]
    assert chart.message == "nest moved farthest, 0.011 mm from its first measurement; the limit is 0.050 mm."
    beyond = drift_chart(rows, 0.01)
    assert "beyond the limit of 0.010 mm" in beyond.message


# -- discovery --------------------------------------------------------------------------------------------------------


def test_a_picture_has_its_curve_with_a_band_of_two_standard_deviations() -> None:
    shown = picture("transmission_error", 1, curve=True)
    chart = picture_chart("left", shown)
    measured, computed = chart.series
    assert (measured.kind, computed.kind) == ("points", "line")
    assert shown.curve is not None
    assert computed.band is not None
    assert computed.band.tolist() == [2.0 * sigma for sigma in shown.curve.band]
    assert chart.x == Axis("joint 1", "deg")
    assert chart.y == Axis("offset of joint 1", "µrad")
    assert chart.message.startswith("The effect is 212 µrad rms at these readings, which scatter 20 µrad rms about it.")
    assert "No reading was taken from 128° to -170°." in chart.message


# -- accuracy ---------------------------------------------------------------------------------------------------------


def test_a_histogram_counts_every_error_once() -> None:
    rng = np.random.default_rng(3)
    errors = {"nominal": rng.lognormal(0.0, 0.5, 100), "effects": np.append(rng.lognormal(-4.0, 0.5, 60), np.nan)}
    chart = error_histogram_chart("left", errors, 0.02)
    for one, count in zip(chart.series, (100, 60), strict=True):
        assert one.kind == "steps"
        assert one.y.sum() == count
        assert one.y[0] == one.y[-1] == 0.0
        assert np.all(np.diff(one.x) >= 0.0)
    assert [one.style for one in chart.series] == [0, 3]
    assert [(limit.axis, limit.value) for limit in chart.limits] == [("x", 0.02)]
    medians = [mm(float(np.nanmedian(values))) for values in errors.values()]
    assert f"Median error: {medians[0]} (nominal), {medians[1]} (geometry and effects)." in chart.message


# -- maps -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def twin() -> Profile:
    return load_profile(PROFILES / "twin.yaml")


# -- Charts of held-out errors over joints and in space, of a small calibrated run -------------------------------------


@pytest.fixture
def data(single: RunFile) -> ReportData:
    return read_report_data(single)


@pytest.fixture
def held_out(data: ReportData) -> HeldOutArm:
    return data.held_out["only"]


def test_the_histogram_of_a_run(data: ReportData, held_out: HeldOutArm) -> None:
    chart = error_histogram_chart("only", held_out.errors_mm, data.calibrate.arms["only"].tracker_mm)
    assert [one.y.sum() for one in chart.series] == [len(held_out.readings)] * 2
    assert chart.limits[0].value == pytest.approx(np.sqrt(3.0) * 0.02)


# -- Charts of a designed plan: what they draw, what their messages say, and that the page draws the same --------------


def test_the_page_draws_the_same_charts_with_names_escaped() -> None:
    design: PlanDesignResult = plan_design(arms=("<left>", "right"))
    q = np.radians(np.random.default_rng(1).uniform(-90.0, 90.0, (40, 6)))
    charts = [*design_charts(design, TIME), coverage_chart("<left>", np.tile([-3.2, 3.2], (6, 1)), q)]
    for number, chart in enumerate(charts):
        figure = chart_figure(f"plan{number}", chart)
        drawing = ElementTree.fromstring(figure.svg)
        assert drawing.tag.endswith("svg")
        assert "<left" not in figure.svg
        assert (figure.caption, figure.note) == (chart.title, chart.message)
        assert len(figure.legend) == (0 if chart.categories else len(chart.series))
        assert "".join(drawing.itertext()).count("left") == sum("left" in name for name in chart.categories)
        assert figure == chart_figure(f"plan{number}", chart)


def test_maps_limits_and_steps_are_drawn_too() -> None:
    drawn = (
        series("rays", [0.0, 1.0], [0.0, 1.0], style=4, mark="·"),
        series("base", [0.0], [0.0], "points", style=4, mark="B"),
        series("stops", np.arange(100.0), np.arange(100.0), "points"),
        series("level", [0.0, 50.0], [1.0, 2.0], "steps", style=1),
    )
    chart = Chart("A map", Axis("x", "m"), Axis("y", "m"), drawn, "", (Limit("floor", 2.0),), equal=True)
    looks = [(entry.text, entry.look) for entry in chart_figure("map", chart).legend]
    assert looks == [
        ("rays", Look("soft", "dot")),
        ("base", Look("ink", "square")),
        ("stops", Look("arm1", "round")),
        ("level", Look("arm2", "line")),
        ("floor", Look("ink", "limit")),
    ]
