"""Plots in the terminal: readable at every size, in every theme, without colour, whatever the numbers."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rich.cells import cell_len
from rich.text import Text
from textual.app import App, ComposeResult
from textual.color import Color
from textual.widgets import DataTable

from cellapp.commands.collect.charts import live_residual_chart
from cellapp.commands.discover.charts import candidates_chart, gap_chart, picture_chart
from cellapp.commands.view.charts import Axis, Chart, Limit, Series, series
from cellapp.ground.progress import StopReport
from cellapp.interfaces.tui.app import HIGH_CONTRAST
from cellapp.interfaces.tui.plots import ChartPlot
from cellapp.interfaces.tui.plots.drawing import (
    MARKS,
    draw,
)
from cellapp.interfaces.tui.plots.widget import ON_DARK, ON_LIGHT
from cellapp.interfaces.tui.widgets.charts_view import PartsView
from cellapp.interfaces.tui.widgets.tables import TablesView, TextTable, WrappedTables
from tests.interfaces.page.cases import picture, unknown_effect
from tests.interfaces.tui.pilot import WAIT_S

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


def test_limits_are_drawn_and_named() -> None:
    flat = series("left", [0.0, 10.0], [0.1, 0.2])
    lines = texts(simple(flat, limits=(Limit("noise floor", 0.05), Limit("half", 5.0, "x"))), 60, 20)
    assert any(line.count("╌") > 30 for line in lines)
    assert sum("╎" in line for line in lines) > 5
    assert "╌ noise floor 0.05 mm" in one_line(lines)
    assert "╎ half 5" in one_line(lines)


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


# -- Tables have all their rows and columns as wide as their texts, also where a busy computer draws them early --------


class TableApp(App[None]):
    """One table."""

    def compose(self) -> ComposeResult:
        yield TextTable()


async def test_rows_that_were_drawn_before_they_were_measured_are_drawn_again() -> None:
    app = TableApp()
    async with app.run_test() as pilot:
        table = app.query_one(DataTable)
        table.add_column("id")
        for text in ("short", "a longer text", "a text that is longer still"):
            table.clear()
            table.add_row(Text("a"))
            table.add_row(Text(text))
            table.render_line(2)  # too early: the column is as wide as the texts before
            await pilot.pause()
            assert text in table.render_line(2).text


async def test_a_table_whose_place_is_asked_for_before_the_layout_has_its_rows() -> None:
    """The layout that follows takes such a table for shown already and sends it no message."""
    app: App[None] = App()
    async with app.run_test() as pilot:
        table = TextTable(cursor_type="none")
        table.add_column("id")
        table.add_row(Text("a text"))
        app.screen.mount(table)
        async with asyncio.timeout(WAIT_S):
            while not table.is_mounted:
                await asyncio.sleep(0)
        compositor = app.screen._compositor
        compositor._full_map_invalidated = True  # as a widget does that is drawn before it has its place
        assert table in compositor.full_map
        await pilot.pause()
        assert table.virtual_size.height == 2


# -- Tables of a screen that is drawn while it is being made, or goes away: they are there once there is a place -------


def shown(view: TablesView) -> list[str]:
    return [str(child.render()) for child in view.children]


@pytest.mark.parametrize("kind", [TablesView, WrappedTables, PartsView])
async def test_what_is_said_before_there_is_a_place_for_it_is_said_then(kind: type[TablesView]) -> None:
    app: App[None] = App()
    async with app.run_test() as pilot:
        view = kind("at first")
        view.say_empty("No run is open.")
        await app.mount(view)
        await pilot.pause()
        assert shown(view) == ["No run is open."]
        view.show((), ["out of date"])
        await pilot.pause()
        assert shown(view) == ["out of date"]
        await view.remove()
        view.show((), ["it goes away"])


async def test_parts_that_come_before_there_is_a_place_for_them_are_drawn_then() -> None:
    app: App[None] = App()
    async with app.run_test() as pilot:
        view = PartsView("at first")
        view.show_parts(("a sentence",), ["a mark"])
        await app.mount(view)
        await pilot.pause()
        assert shown(view) == ["a mark", "a sentence"]
