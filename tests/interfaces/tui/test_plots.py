"""Plots in the terminal: readable at every size, in every theme, without colour, whatever the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rich.cells import cell_len
from textual.app import App, ComposeResult
from textual.color import Color

from cellapp.commands.collect.charts import NO_READINGS, live_residual_chart
from cellapp.commands.discover.charts import candidates_chart, gap_chart, picture_chart
from cellapp.commands.view.charts import Axis, Chart, Limit, Series, bar_chart, series
from cellapp.ground.progress import StopReport
from cellapp.interfaces.render.chart import equal_scales, scale_of
from cellapp.interfaces.tui.app import HIGH_CONTRAST
from cellapp.interfaces.tui.plots import ChartPlot
from cellapp.interfaces.tui.plots.drawing import (
    MARKS,
    braille,
    draw,
    no_dots,
    occupied_cells,
    set_bars,
    set_line,
    set_points,
    thinned,
)
from cellapp.interfaces.tui.plots.widget import ON_DARK, ON_LIGHT
from tests.interfaces.page.cases import picture, unknown_effect

pytestmark = pytest.mark.fast

SIZES = [(80, 24), (120, 40), (200, 60)]
NARROW = (38, 18)
"""One of four plots on a terminal of 80 x 24, with its words."""
THEMES = ["textual-dark", "textual-light", "ansi-dark", "ansi-light", HIGH_CONTRAST.name, "gruvbox", "solarized-light"]
REPORTS = [
    StopReport(stop, arm, 0.02 + 0.01 * (arm == "right") + 0.001 * (stop % 7), 0.1)
    for stop in range(40)
    for arm in ("left", "right")
]
CHARTS = [
    gap_chart("left", unknown_effect("left")),
    candidates_chart("left", unknown_effect("left")),
    picture_chart("left", picture("transmission_error", 1, curve=True)),
    picture_chart("left", picture("joint_compliance", 2)),
    live_residual_chart(REPORTS),
]


class PlotApp(App[None]):
    """One plot on a whole screen."""

    def __init__(self, chart: Chart | None) -> None:
        super().__init__()
        self.register_theme(HIGH_CONTRAST)
        self.plot = ChartPlot(chart)

    def compose(self) -> ComposeResult:
        yield self.plot


def screen_lines(app: App[None]) -> list[str]:
    """What stands on the screen, line by line."""
    return [strip.text for strip in app.screen._compositor.render_strips()]


def texts(chart: Chart, width: int, height: int) -> list[str]:
    return ["".join(text for text, _ in line) for line in draw(chart, width, height)]


def one_line(lines: Sequence[str]) -> str:
    return " ".join(" ".join(lines).split())


def simple(*drawn: Series, **more) -> Chart:
    return Chart("Title", Axis("stop"), Axis("error", "mm"), drawn, "The message.", **more)


def data_rows(lines: Sequence[str]) -> list[str]:
    """What stands to the right of the y axis, row by row."""
    return [line[max(line.find("│"), line.find("┤")) + 1 :] for line in lines if "│" in line or "┤" in line]


def is_drawn(character: str) -> bool:
    return 0x2800 < ord(character) < 0x2900 or character in MARKS


def has_data(lines: Sequence[str]) -> bool:
    return any(is_drawn(character) for row in data_rows(lines) for character in row)


# -- on the screen ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("chart", CHARTS, ids=lambda chart: chart.title)
async def test_a_plot_fills_the_screen_and_says_its_message(chart: Chart, size: tuple[int, int]) -> None:
    app = PlotApp(chart)
    async with app.run_test(size=size) as pilot:
        await pilot.pause()
        lines = screen_lines(app)
    assert lines[0].rstrip() == chart.title
    assert chart.message in one_line(lines)
    assert {len(line) for line in lines} == {size[0]}
    if not chart.categories:
        assert has_data(lines)
        assert chart.y.words in one_line(lines)
        assert chart.x.words in one_line(lines)
        assert lines[-1].strip(), "the plot takes the whole height"


@pytest.mark.parametrize("theme", THEMES)
async def test_every_theme_shows_the_same_characters_in_its_own_colours(theme: str) -> None:
    app = PlotApp(live_residual_chart(REPORTS))
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause()
        before = screen_lines(app)
        app.theme = theme
        await pilot.pause()
        assert screen_lines(app) == before
        colours = ON_DARK if app.current_theme.dark else ON_LIGHT
        shown = {
            segment.style.color.get_truecolor().hex
            for strip in app.plot._strips
            for segment in strip
            if segment.style is not None and segment.style.color is not None
        }
        assert set(colours[:2]) <= shown


async def test_a_new_chart_and_a_new_size_are_drawn() -> None:
    app = PlotApp(None)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause()
        assert not one_line(screen_lines(app))
        app.plot.chart = live_residual_chart([])
        await pilot.pause()
        assert NO_READINGS in one_line(screen_lines(app))
        app.plot.chart = live_residual_chart(REPORTS)
        await pilot.pause()
        assert "Last residual: left 0.024 mm at stop 40" in one_line(screen_lines(app))
        await pilot.resize_terminal(120, 40)
        await pilot.pause()
        lines = screen_lines(app)
        assert {len(line) for line in lines} == {120}
        assert has_data(lines[20:])


async def test_two_plots_share_nothing() -> None:
    class TwoPlots(App[None]):
        def compose(self) -> ComposeResult:
            yield ChartPlot(CHARTS[0])
            yield ChartPlot(CHARTS[4])

    app = TwoPlots()
    async with app.run_test(size=(80, 50)) as pilot:
        await pilot.pause()
        lines = screen_lines(app)
    for chart, half in ((CHARTS[0], lines[:25]), (CHARTS[4], lines[25:])):
        assert half[0].rstrip() == chart.title
        assert chart.message in one_line(half)


def test_colours_stand_out_from_their_backgrounds() -> None:
    """A contrast of 3 to 1, as WCAG 2.1 asks of graphics, on the darkest and lightest backgrounds of terminals."""

    def luminance(colour: Color) -> float:
        parts = np.array(colour.normalized)
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722))

    for colours, backgrounds in ((ON_DARK, ("#000000", "#1e1e1e", "#282828")), (ON_LIGHT, ("#ffffff", "#e0e0e0"))):
        for background in backgrounds:
            ground = luminance(Color.parse(background))
            for colour in colours:
                low, high = sorted((ground, luminance(Color.parse(colour))))
                assert (high + 0.05) / (low + 0.05) >= 3.0, (colour, background)


# -- the drawing ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("chart", CHARTS, ids=lambda chart: chart.title)
def test_a_narrow_plot_still_has_axes_with_numbers_and_its_message(chart: Chart) -> None:
    lines = texts(chart, *NARROW)
    assert len(lines) <= NARROW[1]
    assert max(map(cell_len, lines)) <= NARROW[0]
    assert chart.message in one_line(lines)
    if not chart.categories:
        assert sum("┤" in line for line in lines) >= 1
        (bottom,) = [line for line in lines if "└" in line]
        assert bottom.count("┬") >= 2


@pytest.mark.parametrize("chart", [chart for chart in CHARTS if not chart.categories], ids=lambda chart: chart.title)
def test_a_quarter_of_a_small_terminal_still_shows_data_and_the_first_sentence(chart: Chart) -> None:
    lines = texts(chart, 38, 10)
    assert len(lines) <= 10
    assert has_data(lines)
    assert chart.message.partition(". ")[0] in one_line(lines)


def test_series_differ_without_colour() -> None:
    x = np.linspace(0.0, 1.0, 200)
    several = [series(f"s{style}", x, x + style, style=style) for style in range(len(MARKS))]
    lines = texts(simple(*several), 80, 40)
    for mark in MARKS:
        assert sum(row.count(mark) for row in data_rows(lines)) >= 3
        assert any(line.startswith(mark) or f"  {mark} " in line for line in lines), "the key names it"


def test_limits_are_drawn_and_named() -> None:
    flat = series("left", [0.0, 10.0], [0.1, 0.2])
    lines = texts(simple(flat, limits=(Limit("noise floor", 0.05), Limit("half", 5.0, "x"))), 60, 20)
    assert any(line.count("╌") > 30 for line in lines)
    assert sum("╎" in line for line in lines) > 5
    assert "╌ noise floor 0.05 mm" in one_line(lines)
    assert "╎ half 5" in one_line(lines)


def test_a_band_is_shaded_around_its_line() -> None:
    banded = series("curve", [2.0, 0.0, 1.0], [1.0, 1.0, 1.0], band=[1.0, 0.0, 1.0])
    lines = texts(simple(banded), 60, 20)
    shaded = [line for line in lines if line.count("░") > 3]
    assert len(shaded) > 5
    assert all(line.rindex("░") > 40 for line in shaded), "it widens to the right"


def test_circles_of_a_map_are_round() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 400)
    wide = Chart("Map", Axis("x", "m"), Axis("y", "m"), (series("", np.cos(turn), np.sin(turn)),), "", equal=True)
    used = [row for row in data_rows(texts(wide, 100, 30)) if has_data([f"│{row}"])]
    columns = [k for row in used for k, character in enumerate(row) if is_drawn(character)]
    assert max(columns) - min(columns) + 1 == pytest.approx(2 * len(used), abs=2)


def test_bars_have_names_and_values() -> None:
    bars = {"backlash": (97.0, "97 %"), "a very long name of an effect": (0.4, "< 1 %")}
    chart = bar_chart("Probability", bars, Axis("p", "%"), "Words.")
    assert texts(chart, 40, 10) == [
        "Probability",
        "                   backlash ██████  97 %",
        "a very long name of an eff…        < 1 %",
        "Words.",
    ]
    many = bar_chart("Many", {f"effect {k}": (float(k), str(k)) for k in range(20)}, Axis("p", "%"), "Words.")
    lines = texts(many, 40, 8)
    assert len(lines) == 8
    assert lines[-2] == "and 15 more"


def test_where_there_is_no_room_the_message_stays() -> None:
    assert texts(CHARTS[0], 38, 5)[1:] == texts(CHARTS[0], 38, 18)[-4:]
    assert one_line(texts(simple(series("left", [0.0], [1.0])), 20, 2)) == "Title The message."
    assert texts(simple(series("left", [0.0], [1.0])), 20, 1) == ["The message."]
    assert texts(CHARTS[0], 0, 0) == []


def test_gaps_are_not_joined() -> None:
    line = series("left", np.arange(60.0), np.where(np.abs(np.arange(60.0) - 30.0) < 10.0, np.nan, 1.0))
    (row,) = [row for row in data_rows(texts(simple(line), 70, 20)) if has_data([f"│{row}"])]
    drawn = [is_drawn(character) for character in row]
    middle = len(row) // 2
    assert not any(drawn[middle - 5 : middle + 5])
    assert any(drawn[: middle - 15])
    assert any(drawn[middle + 15 :])


NUMBERS = st.one_of(
    st.floats(-1e6, 1e6), st.floats(0.0, 1e-9), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1e300, -1e300])
)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(
    x=arrays(np.float64, st.integers(0, 30), elements=NUMBERS, fill=st.nothing()),
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(["line", "points", "steps", "bars"]),
    size=st.tuples(st.integers(0, 90), st.integers(0, 30)),
    logarithmic=st.booleans(),
    equal=st.booleans(),
)
def test_whatever_the_numbers_nothing_leaves_the_room(x, seed, kind, size, logarithmic, equal) -> None:
    y = np.random.default_rng(seed).permutation(x)
    one = series("left", x, y, kind, band=np.abs(np.nan_to_num(y, posinf=1.0, neginf=1.0)))
    axis = Axis("error", "mm", logarithmic and not equal)
    chart = Chart("Title", axis, axis, (one, replace(one, style=1)), "Message.", (Limit("limit", 1.0),), equal=equal)
    width, height = size
    lines = texts(chart, width, height)
    assert len(lines) <= height
    assert all(cell_len(line) <= width for line in lines)


# -- dots and scales --------------------------------------------------------------------------------------------------


def test_braille_dots() -> None:
    dots = no_dots(1, 3)
    set_points(dots, np.array([0.0, 1.0, 2.0, np.nan, 9.0]), np.array([0.0, 3.0, 1.0, 0.0, 0.0]))
    assert "".join(braille(dots)[0]) == "⢁⠂⠀"
    assert occupied_cells(dots).tolist() == [[True, True, False]]


def test_lines_have_no_holes_and_bars_reach_zero() -> None:
    dots = no_dots(5, 10)
    set_line(dots, np.array([0.0, 19.0, 19.0]), np.array([19.0, 10.0, 0.0]))
    assert dots.any(axis=0).all()
    assert dots[:11, 19].all()
    dots = no_dots(5, 10)
    set_bars(dots, np.array([4.0, 14.0]), np.array([10.0, 19.0]), 19.0)
    assert dots[10:, 4].all()
    assert not dots[:10].any()
    assert not dots[:, 9].any(), "a gap between the bars"
    assert dots[19, 14]


def test_many_points_are_thinned_to_the_same_line() -> None:
    rng = np.random.default_rng(1)
    column, row = np.sort(rng.uniform(0.0, 59.0, 5000)), rng.uniform(0.0, 39.0, 5000)
    row[2000:2200] = np.nan
    fewer = thinned(column, row)
    assert len(fewer[0]) <= 4 * 62
    assert np.nanmax(fewer[1]) == np.nanmax(row)
    assert np.isnan(fewer[1]).any(), "the gap stays"
    thick, thin = no_dots(10, 30), no_dots(10, 30)
    set_points(thick, column, row)
    set_line(thin, column, row)
    assert thin[thick].all()


def test_scales_and_ticks() -> None:
    axis = Axis("error", "mm")
    assert scale_of(axis, np.array([0.1, 0.9]), 0.0, 99.0).low == 0.0
    assert scale_of(axis, np.array([8.0, 9.0]), 0.0, 99.0).low == pytest.approx(7.95)
    assert scale_of(axis, np.array([8.0, 9.0]), 0.0, 99.0, zero=True).low == 0.0
    labels = scale_of(axis, np.array([0.0, 0.043]), 0.0, 99.0).labels(5)
    assert [text for _, text in labels] == ["0.00", "0.01", "0.02", "0.03", "0.04"]
    assert scale_of(Axis("stop"), np.array([0.0, 2.0]), 0.0, 99.0).ticks(8) == [0.0, 1.0, 2.0]
    assert scale_of(Axis("joint 1", "deg"), np.array([-180.0, 180.0]), 0.0, 99.0).ticks(5) == [
        -180.0,
        -90.0,
        0.0,
        90.0,
        180.0,
    ]
    decades = scale_of(Axis("error", "mm", True), np.array([1e-3, 10.0]), 0.0, 99.0)
    assert decades.ticks(5) == [0.001, 0.01, 0.1, 1.0, 10.0]
    assert [text for _, text in decades.labels(5)] == ["0.001", "0.01", "0.1", "1", "10"]
    assert np.isnan(decades.place(np.array([0.0, -1.0, np.nan]))).all()
    x, y = equal_scales(
        scale_of(axis, np.array([-1.0, 1.0]), 0.0, 199.0), scale_of(axis, np.array([-1.0, 1.0]), 0.0, 49.0)
    )
    assert (x.high - x.low) / 199 == pytest.approx((y.high - y.low) / 49)
