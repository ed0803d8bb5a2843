"""Charts: values that the results have, maps, curves of models; whatever the numbers and names, they can be drawn."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cellapp.commands.calibrate.charts import scale_length_mm, vector_chart
from cellapp.commands.collect.charts import residual_drift_chart
from cellapp.commands.discover.view import is_line
from cellapp.commands.plan.charts import cell_map_chart, outlined_obstacles, surface_points
from cellapp.commands.plan.result import PlannedStop
from cellapp.commands.view.charts import Axis, Chart, Kind, Limit, Series, series
from cellapp.estimation.discovery.records import Picture
from cellapp.interfaces.page.figures import chart_svg
from cellapp.interfaces.render.chart import scale_of
from tests.interfaces.page.cases import picture
from tests.sure import sure
from tests.twin import with_obstacles

HOME = np.radians([0.0, -90.0, 0.0, -90.0, 0.0, 0.0])


def stops(count: int = 3) -> list[PlannedStop]:
    rotated = [HOME + 0.6 * k * np.eye(6)[0] for k in range(count)]
    return [
        PlannedStop(configuration=k, measured=False, q={"left": tuple(q), "right": tuple(q)})
        for k, q in enumerate(rotated)
    ]


def named(chart: Chart, name: str) -> Series | None:
    return next((one for one in chart.series if one.name == name), None)


def test_a_mesh_is_drawn_as_its_hull_and_a_missing_one_is_left_out(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((1000.0, 2000.0, 3000.0)).export(tmp_path / "box.stl")
    mesh, missing = (
        with_obstacles(f"guard: {{shape: mesh, file: {file}, scale: 0.001}}")
        for file in (tmp_path / "box.stl", "nowhere.stl")
    )
    assert np.allclose(np.ptp(surface_points("guard", mesh.obstacles["guard"]), axis=0), (1.0, 2.0, 3.0))
    assert named(cell_map_chart(missing, stops()), "obstacles") is None


def test_what_is_mounted_on_a_flange_is_drawn_where_the_arm_stands_at_home() -> None:
    ball = "{shape: sphere, radius: 0.05, arm: left, fixed_to: "
    profile = with_obstacles(f"knob: {ball}flange}}\nfoot: {ball}base}}")
    found = {name: p_C.mean(axis=0) for name, p_C in outlined_obstacles(profile).items()}
    base = sure(profile.arms["left"].base)
    assert np.allclose(found["foot"], base.position, atol=0.01)
    assert 0.3 < np.linalg.norm(found["knob"] - found["foot"]) < 2.0


# -- residuals over the run -------------------------------------------------------------------------------------------


def test_a_drift_is_told_from_noise() -> None:
    rng = np.random.default_rng(0)
    time_s, noise = np.linspace(0.0, 7200.0, 400), rng.normal(scale=2e-5, size=(400, 3))
    still = residual_drift_chart("left", time_s, noise)
    assert "no more than by chance" in still.message
    assert (len(still.series), still.x.unit, len(still.series[0].x)) == (3, "h", 20)
    slow = noise + np.outer(time_s / 7200.0 - 0.5, [5e-5, 0.0, 0.0])
    moving = residual_drift_chart("left", time_s, slow)
    assert "they drift" in moving.message
    assert moving.series[0].y[-1] - moving.series[0].y[0] == pytest.approx(0.05, abs=0.02)


def test_the_bands_hold_what_they_promise() -> None:
    rng = np.random.default_rng(1)
    outside = 0
    for _ in range(40):
        chart = residual_drift_chart("left", np.arange(200.0), rng.normal(size=(200, 3)))
        outside += sum(int(np.count_nonzero(np.abs(one.y) > one.band)) for one in chart.series if one.band is not None)
    assert 0.03 < outside / (40 * 30) < 0.07


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
    kind=st.sampled_from(("line", "points")),
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


# -- data for the script ----------------------------------------------------------------------------------------------


def test_names_that_a_person_wrote_are_no_markup() -> None:
    drawn = series(HOSTILE, [1.0], [2.0], "points")
    chart = Chart(HOSTILE, Axis(HOSTILE), Axis("y"), (drawn,), HOSTILE, (Limit(HOSTILE, 1.0),))
    assert "<b" not in chart_svg(chart)


def test_arrows_have_a_round_scale() -> None:
    vectors = np.array([[3.0e-4, 0.0, 0.0]] * 9 + [[0.0, 9.0e-4, 0.0]])
    assert scale_length_mm(vectors) == pytest.approx(0.2)
    assert scale_length_mm(np.zeros((2, 3))) > 0.0
    chart = vector_chart("t", np.eye(3), vectors[:3], 2)
    arrows, _, scale = chart.series
    assert scale.name == "scale: 0.2 mm"
    assert arrows.x[1] - arrows.x[0] == pytest.approx(1.5 * (scale.x[1] - scale.x[0]))
    assert "most point the same way" in chart.message
