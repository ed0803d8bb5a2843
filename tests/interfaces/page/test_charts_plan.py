"""Charts of a designed plan: what they draw, what their messages say, and that the page draws the same."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from cellapp.cell.planning.records import PlanDesignResult
from cellapp.commands.plan.charts import coverage_chart, design_charts, information_chart, time_chart
from cellapp.commands.view.charts import Axis, Chart, Limit, series
from cellapp.interfaces.page.drawn import chart_figure
from cellapp.interfaces.render.chart import Look
from tests.interfaces.page.plan_cases import TIME, arm_design, correlation, plan_design

pytestmark = pytest.mark.fast


def test_errors_fall_with_the_stops_beside_random_ones() -> None:
    chart = information_chart("left", arm_design())
    mean, worst, random_mean, random_worst = chart.series
    assert mean.x.tolist() == [50, 100, 200, 400]
    assert np.all(np.diff(mean.y) < 0.0)
    assert np.all(worst.y > mean.y)
    assert (random_mean.x[0], random_mean.y[0]) == (400, 0.01)
    assert random_worst.y[0] > worst.y[-1]
    assert chart.message == (
        "Arm left: 400 stops give 0.0070 mm on average, 0.021 mm at the worst point. They tell as much as random stops:"
        " 840 in parameters, 640 in mean error and 1280 in worst error. After 100 stops 0.014 mm on average, 0.042 mm"
        " at the worst point."
    )


def test_a_gap_of_a_joint_is_where_stops_are_farthest_apart() -> None:
    allowed = np.radians([[-180.0, 180.0], [-90.0, 90.0]])
    q = np.radians([[-100.0, 0.0], [-90.0, 10.0], [50.0, 5.0]])
    chart = coverage_chart("left", allowed, q)
    limits, stops, gap = chart.series
    assert (np.nanmin(limits.x), np.nanmax(limits.x)) == pytest.approx((-180.0, 180.0))
    assert sorted(set(stops.y)) == [1.0, 2.0]
    assert np.allclose(gap.x[:2], [-90.0, 50.0])
    assert np.allclose(np.diff(gap.x[3:5]), 5.0)
    assert "140 deg, of joint 1; joint 2 uses the least of its range, 6 %" in chart.message
    assert coverage_chart("left", allowed, q[:0]).is_empty
    assert "0 deg" in coverage_chart("left", allowed, q[:1]).message


def test_time_says_what_is_known() -> None:
    design = plan_design()
    assert time_chart(design.travel, None).categories == ("motions", "in random order")
    assert time_chart(design.travel, TIME).message == (
        "Collecting takes about 1 h 30 min. The order of the stops saves 40 % of the motions' time."
    )
    assert time_chart(None, TIME).categories == ("motions", "rests", "measuring", "references", "warm-up")
    assert time_chart(None, None).is_empty


def test_the_largest_correlation_that_can_be_chosen_is_judged() -> None:
    chart = design_charts(plan_design(), None)[-1]
    assert chart.categories[0] == "q2 of left with q3 of right (given)"
    assert chart.bar_texts == ("0.35", "0.08", "0.04")
    assert chart.message.endswith("0.08, step of joint 3 of left with dwell; as wanted.")
    worse = plan_design().model_copy(update={"correlations": (correlation(0.4, "dwell", "time"),)})
    assert "more than wanted" in design_charts(worse, None)[-1].message
    none = plan_design().model_copy(update={"correlations": ()})
    assert "No factor" in design_charts(none, None)[-1].message


def test_the_page_draws_the_same_charts_with_names_escaped() -> None:
    design: PlanDesignResult = plan_design(arms=("<left>", "right"))
    q = np.radians(np.random.default_rng(1).uniform(-90.0, 90.0, (40, 6)))
    charts = [*design_charts(design, TIME), coverage_chart("<left>", np.tile([-3.2, 3.2], (6, 1)), q)]
    for number, chart in enumerate(charts):
        figure = chart_figure(f"plan{number}", chart)
        drawing = ElementTree.fromstring(figure.svg)
        assert drawing.tag.endswith("svg")
        assert "<left" not in figure.svg + figure.data
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
