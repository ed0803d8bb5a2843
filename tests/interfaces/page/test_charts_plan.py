"""Charts of a designed plan: what they draw, what their messages say, and that the page draws the same."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from cellapp.cell.planning.design_records import PlanDesignResult
from cellapp.commands.plan.charts import coverage_chart, design_charts
from cellapp.commands.view.charts import Axis, Chart, Limit, series
from cellapp.interfaces.page.chart_svg import chart_figure
from cellapp.interfaces.render.chart_style import Look
from tests.interfaces.page.plan_cases import TIME, plan_design


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
