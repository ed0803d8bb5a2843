"""Figures: whatever the numbers and the names, they can be drawn, in the colours of the page."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cellapp.commands.calibrate.charts_vectors import scale_length_mm, vector_chart
from cellapp.commands.discover.charts import is_line
from cellapp.commands.view.charts import Axis, Chart, Kind, Limit, bar_chart, series
from cellapp.estimation.discovery.records import Picture
from cellapp.interfaces.page.drawn import chart_svg
from cellapp.interfaces.render.chart import scale_of
from tests.interfaces.page.cases import picture

HOSTILE = "</script><b onclick='x'>%{y} & 'it'</b>\u2028"


def cloud_or_line(x: np.ndarray, y: np.ndarray) -> Picture:
    values = tuple(y.tolist())
    return Picture(title="", effect="", x_label="", y_label="", x=tuple(x.tolist()), measured=values, computed=values)


def test_a_line_is_drawn_through_a_function_and_none_through_a_cloud() -> None:
    x = np.linspace(0.0, 5.0, 200)
    rng = np.random.default_rng(0)
    for function in (np.sin(12.0 * x), np.sign(x - 2.0), x**2, np.ones(200)):
        assert is_line(cloud_or_line(x, function))
    for cloud in (rng.uniform(0.0, 1.0, 200), x * rng.uniform(0.5, 1.0, 200)):
        assert not is_line(cloud_or_line(x, cloud))
    assert is_line(picture("transmission_error", 1, curve=True))


# -- any numbers ------------------------------------------------------------------------------------------------------

numbers = st.one_of(st.floats(min_value=-1e9, max_value=1e9), st.just(float("nan")))
values = st.lists(numbers, min_size=1, max_size=80)


@example(y=[5e-324], kind="line", logarithmic=True, equal=False, band=False)
@example(y=[0.0, 5e-324], kind="points", logarithmic=False, equal=True, band=False)
@given(
    y=values,
    kind=st.sampled_from(("line", "points", "steps")),
    logarithmic=st.booleans(),
    equal=st.booleans(),
    band=st.booleans(),
)
def test_whatever_the_numbers_a_chart_can_be_drawn(
    y: list[float], kind: Kind, logarithmic: bool, equal: bool, band: bool
) -> None:
    width = np.abs(y) if band and kind == "line" else None
    drawn = series("a", np.arange(float(len(y))), y, kind, band=width)
    equal = equal and not logarithmic
    chart = Chart("t", Axis("x"), Axis("y", "mm", logarithmic), (drawn,), "m", (Limit("l", 1.0),), equal=equal)
    svg = chart_svg(chart)
    ElementTree.fromstring(svg)
    assert "nan" not in svg
    assert "inf" not in svg


@given(
    low=st.floats(min_value=-1e6, max_value=1e6),
    span=st.floats(min_value=1e-3, max_value=1e6),
    logarithmic=st.booleans(),
)
def test_every_axis_has_some_ticks_inside_of_it_and_not_too_many(low: float, span: float, logarithmic: bool) -> None:
    ends = np.array([abs(low) + 1e-3, abs(low) + 1e-3 + span] if logarithmic else [low, low + span])
    scale = scale_of(Axis("x", "", logarithmic), ends, 50.0, 350.0)
    pixels = [pixel for pixel, _ in scale.labels(6)]
    assert 2 <= len(pixels) <= 21
    assert pixels == sorted(pixels)
    assert pixels[0] >= 49.9
    assert pixels[-1] <= 350.1
    assert scale.place(ends)[0] < scale.place(ends)[1]


def test_names_that_a_person_wrote_are_no_markup() -> None:
    drawn = series(HOSTILE, [1.0], [2.0], "points")
    chart = Chart(HOSTILE, Axis(HOSTILE), Axis("y"), (drawn,), HOSTILE, (Limit(HOSTILE, 1.0),))
    assert "<b" not in chart_svg(chart)
    assert "<b" not in chart_svg(bar_chart("t", {HOSTILE: (1.0, HOSTILE)}, Axis("y"), "m"))


# -- single charts ----------------------------------------------------------------------------------------------------


def test_arrows_have_a_round_scale() -> None:
    vectors = np.array([[3.0e-4, 0.0, 0.0]] * 9 + [[0.0, 9.0e-4, 0.0]])
    assert scale_length_mm(vectors) == pytest.approx(0.2)
    assert scale_length_mm(np.zeros((2, 3))) > 0.0
    chart = vector_chart("t", np.eye(3), vectors[:3], 2)
    arrows, _, scale = chart.series
    assert scale.name == "scale: 0.2 mm"
    assert arrows.x[1] - arrows.x[0] == pytest.approx(1.5 * (scale.x[1] - scale.x[0]))
    assert "most point the same way" in chart.message
