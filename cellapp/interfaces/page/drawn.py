"""Sections as the page draws them: charts as figures with anchors, and parts grouped by kind.

A chart as inline SVG for the page: readable without a script and in print; names from users are escaped.

One path for each series: a few kilobytes and a millisecond per chart, where a plotting library takes fifty.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from html import escape
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.commands.plan.charts_obstacles import outline
from cellapp.commands.view.charts import Array, Chart, Limit, Series, mm
from cellapp.commands.view.parts import Capsules, CellScene, ErrorVectors, Facts, Parts, SceneArm, Section
from cellapp.commands.view.table import Table
from cellapp.commands.view.words import STAGE_WORDS
from cellapp.interfaces.render.chart import (
    ARM_COLOURS,
    FEW,
    Json,
    LegendEntry,
    Look,
    Scale,
    chart_data,
    chart_scale,
    css_colour,
    equal_scales,
    is_marked,
    legend_of,
    look_of,
    script_json,
)

_SVG_WIDTH, _HEIGHT = 400.0, 250.0
_TOP, _RIGHT, _BOTTOM = 8.0, 12.0, 36.0
_FONT = 9.5
_CHARACTER = 0.58
"""Mean width of a digit relative to the font size."""
_BAR, _BAR_STEP = 8.0, 26.0
_MOST_TICKS = 6
"""Largest number of ticks of an axis."""
_MANY = 1000
"""Number of points above which dots are smaller."""


def chart_svg(chart: Chart) -> str:
    """Return the chart as an ``svg`` element with colours of the style sheet."""
    if chart.categories:
        return svg_element(_SVG_WIDTH, _BAR_STEP * len(chart.categories) + 4.0, _bars(chart))
    x_axis, y_axis = _scales(chart)
    parts = [*_frame(chart, x_axis, y_axis)]
    for one in chart.series:
        parts.append(_drawn(one, look_of(chart, one), x_axis, y_axis))
    parts += [_limit(limit, x_axis, y_axis) for limit in chart.limits]
    return svg_element(_SVG_WIDTH, _HEIGHT, parts)


def svg_element(width: float, height: float, parts: Iterator[str] | list[str]) -> str:
    """Return an ``svg`` element that screen readers skip: the figure's caption and message describe it."""
    head = f'<svg viewBox="0 0 {width:g} {height:g}" font-size="{_FONT}" aria-hidden="true" focusable="false"'
    return f'{head} fill="none" stroke="currentColor" stroke-width="1.4">{"".join(parts)}</svg>'


def in_colour(colour: str, body: str, attributes: str = "") -> str:
    """Return a group in one colour of the style sheet."""
    return f'<g style="color:{css_colour(colour)}"{attributes}>{body}</g>'


def text(x: float, y: float, words: str, anchor: str = "start", attributes: str = "") -> str:
    """Return a line of text in the colour of its group."""
    placed = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return f'<text x="{x:.1f}" y="{y:.1f}"{placed} stroke="none" fill="currentColor"{attributes}>{escape(words)}</text>'


def polyline(pixels: Array) -> str:
    """Return path data of points (n, 2) [px] joined by lines, with gaps at NaN."""
    finite = np.asarray(np.isfinite(pixels).all(axis=1))
    starts = finite & ~np.concatenate([[False], finite[:-1]])
    rows = zip(pixels[finite].tolist(), starts[finite].tolist(), strict=True)
    return "".join(f"{'M' if start else 'L'}{x:.1f} {y:.1f}" for (x, y), start in rows)


def dots(pixels: Array) -> str:
    """Return path data of points (n, 2) [px] as strokes of zero length, which round caps turn into dots."""
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in pixels[np.isfinite(pixels).all(axis=1)].tolist())


# -- axes -------------------------------------------------------------------------------------------------------------


def _scales(chart: Chart) -> tuple[Scale, Scale]:
    y_axis = chart_scale(chart, "y", _HEIGHT - _BOTTOM, _TOP)
    left = 27.0 + _FONT * _CHARACTER * max((len(label) for _, label in y_axis.labels(_MOST_TICKS)), default=1)
    x_axis = chart_scale(chart, "x", left, _SVG_WIDTH - _RIGHT)
    return equal_scales(x_axis, y_axis) if chart.equal else (x_axis, y_axis)


def _frame(chart: Chart, x_axis: Scale, y_axis: Scale) -> Iterator[str]:
    """Yield grid, tick labels and axis labels."""
    left, right, bottom, top = x_axis.begin, x_axis.end, y_axis.begin, y_axis.end
    x_ticks, y_ticks = x_axis.labels(_MOST_TICKS), y_axis.labels(_MOST_TICKS)
    lines = [f"M{pixel:.1f} {bottom:.1f}V{top:.1f}" for pixel, _ in x_ticks]
    lines += [f"M{left:.1f} {pixel:.1f}H{right:.1f}" for pixel, _ in y_ticks]
    yield in_colour("grid", f'<path d="{"".join(lines)}" stroke-width=".7"/>')
    yield in_colour("soft", f'<path d="M{left:.1f} {top:.1f}V{bottom:.1f}H{right:.1f}" stroke-width=".8"/>')
    yield from (text(pixel, bottom + 12.0, label, "middle") for pixel, label in x_ticks)
    yield from (text(left - 4.0, pixel + 3.3, label, "end") for pixel, label in y_ticks)
    yield text(0.5 * (left + right), bottom + 27.0, chart.x.words, "middle")
    middle = 0.5 * (top + bottom)
    yield text(10.0, middle, chart.y.words, "middle", f' transform="rotate(-90 10 {middle:.1f})"')


def _limit(limit: Limit, x_axis: Scale, y_axis: Scale) -> str:
    at = float((x_axis if limit.axis == "x" else y_axis).place(np.array(limit.value)))
    line = f"M{at:.1f} {y_axis.begin:.1f}V{y_axis.end:.1f}" if limit.axis == "x" else ""
    line = line or f"M{x_axis.begin:.1f} {at:.1f}H{x_axis.end:.1f}"
    return f'<path d="{line}" stroke-dasharray="4 3" stroke-width="1"/>'


# -- series -----------------------------------------------------------------------------------------------------------


def _drawn(one: Series, look: Look, x_axis: Scale, y_axis: Scale) -> str:
    pixels = np.column_stack([x_axis.place(one.x), _within(y_axis.place(one.y), y_axis)])
    if one.kind == "points":
        return in_colour(look.colour, _points(pixels, look))
    band = "" if one.band is None else _band(one, x_axis, y_axis)
    if one.kind == "steps":
        pixels = np.column_stack([np.repeat(pixels[:, 0], 2)[1:], np.repeat(pixels[:, 1], 2)[:-1]])
    dashes = {"dot": ' stroke-dasharray="1 3" stroke-width="1"', "dash": ' stroke-dasharray="4 3" stroke-width="1"'}
    path = f'<path d="{polyline(pixels)}" stroke-linejoin="round"{dashes.get(look.swatch, "")}/>'
    marks = f'<path d="{dots(pixels)}" stroke-linecap="round" stroke-width="4"/>' if is_marked(one) else ""
    return in_colour(look.colour, band + path + marks)


def _within(pixels: Array, y_axis: Scale) -> Array:
    """Replace positions outside the plot by NaN, so that values beyond the range are not drawn."""
    outside = (pixels < y_axis.end - 1.0) | (pixels > y_axis.begin + 1.0)
    return np.where(outside, np.nan, pixels)


def _band(one: Series, x_axis: Scale, y_axis: Scale) -> str:
    assert one.band is not None
    seen = np.isfinite(one.x + one.y + one.band)
    x = x_axis.place(one.x[seen])
    ends = np.clip(y_axis.place(np.stack(one.edges)[:, seen]), y_axis.end, y_axis.begin)
    around = np.vstack([np.column_stack([x, ends[0]]), np.column_stack([x, ends[1]])[::-1]])
    return f'<path d="{polyline(around)}" stroke="none" fill="currentColor" opacity=".22"/>'


def _points(pixels: Array, look: Look) -> str:
    if len(pixels) <= FEW and (look.swatch != "round" or look.hollow):
        shapes = "".join(_MARKERS[look.swatch].format(x=x, y=y) for x, y in pixels[np.isfinite(pixels).all(axis=1)])
        fill = "" if look.hollow or look.swatch == "cross" else ' fill="currentColor"'
        return f'<path d="{shapes}"{fill} stroke-width="1.2"/>'
    width = 5.0 if len(pixels) <= FEW else 3.0 if len(pixels) <= _MANY else 2.0
    return f'<path d="{dots(pixels)}" stroke-linecap="round" stroke-width="{width}"/>'


_MARKERS = {
    "round": "M{x:.1f} {y:.1f}m-2.5 0a2.5 2.5 0 1 0 5 0a2.5 2.5 0 1 0-5 0",
    "square": "M{x:.1f} {y:.1f}m-3-3h6v6h-6z",
    "triangle": "M{x:.1f} {y:.1f}m0-4l4 7h-8z",
    "diamond": "M{x:.1f} {y:.1f}m0-4l3.5 4l-3.5 4l-3.5-4z",
    "cross": "M{x:.1f} {y:.1f}m-3-3l6 6m0-6l-6 6",
}


# -- bars -------------------------------------------------------------------------------------------------------------


def _bars(chart: Chart) -> Iterator[str]:
    """Yield horizontal bars, the first on top, each with its name above and its value behind."""
    values: NDArray[np.float64] = np.nan_to_num(chart.series[0].y)
    if chart.y.logarithmic:  # begin at a tenth of the smallest value, so that its bar has a length too
        positive = values[values > 0.0]
        low = 0.1 * float(positive.min(initial=1.0))
        values = np.log10(np.maximum(values, low) / low)
    longest = max(float(values.max(initial=0.0)), 1e-300)
    room = 8.0 + _FONT * _CHARACTER * max(map(len, chart.bar_texts))
    for row, (value, name, words) in enumerate(zip(values.tolist(), chart.categories, chart.bar_texts, strict=True)):
        top, length = _BAR_STEP * row, max(value / longest, 0.0) * (_SVG_WIDTH - room)
        yield text(0.0, top + 10.0, name)
        yield in_colour("geometry", f'<path d="M0 {top + 18.0:.1f}h{length:.1f}" stroke-width="{_BAR}"/>')
        yield text(length + 5.0, top + 21.5, words)


# -- A chart as a figure of the page, with the same content as in the terminal ----------------------------------------


@dataclass(frozen=True)
class Figure:
    """A figure: static picture, caption, message, legend, and its values for the page's script.

    ``note`` is its message: one or two sentences that say what the reader should see. ``data`` (JSON) lets the script
    redraw the figure with values under the pointer. ``key`` is its anchor on the page. ``css_class`` is ``wide`` for a
    figure over the whole width.
    """

    svg: str
    caption: str
    legend: tuple[LegendEntry, ...]
    css_class: str = ""
    note: str = ""
    data: str = ""
    key: str = ""


def chart_figure(key: str, chart: Chart) -> Figure:
    """Return a chart's figure: message, legend, and values for the script; ``key`` is its anchor on the page.

    An empty chart has only its message; bars show their values and need no script.
    """
    if chart.is_empty:
        return Figure("", chart.title, (), note=chart.message, key=key)
    drawn, data = chart_svg(chart), "" if chart.categories else chart_data(chart)
    return Figure(drawn, chart.title, legend_of(chart), note=chart.message, data=data, key=key)


_HALF, _GAP, _SENTENCE = 60, 2, 30
"""Characters: of a table in half of a screen, between two columns, and of a line of a sentence in a cell."""


@dataclass(frozen=True)
class DrawnParts:
    """Parts in the order of the page; each table comes with whether it needs the whole width."""

    sentences: tuple[str, ...]
    facts: tuple[Facts, ...]
    figures: tuple[Figure, ...]
    tables: tuple[tuple[Table, bool], ...]
    sections: tuple[DrawnSection, ...]


@dataclass(frozen=True)
class DrawnSection:
    """A section and its content."""

    told: Section
    parts: DrawnParts


def drawn_sections(sections: Iterable[Section], key: str = "") -> tuple[DrawnSection, ...]:
    """Return sections with their content; those without an anchor number their figures below ``key``."""
    return tuple(
        DrawnSection(one, drawn_parts(one.parts, one.key or f"{key}-{place}")) for place, one in enumerate(sections, 1)
    )


def drawn_parts(parts: Parts, key: str) -> DrawnParts:
    """Group parts by kind; anchors of figures are ``key`` and a number. Charts without values are omitted."""
    charts = [one for one in parts if isinstance(one, CellScene) or (isinstance(one, Chart) and not one.is_empty)]
    return DrawnParts(
        sentences=tuple(one for one in parts if isinstance(one, str) and one),
        facts=tuple(one for one in parts if isinstance(one, Facts)),
        figures=tuple(_figure(f"{key}-{place}", chart) for place, chart in enumerate(charts, start=1)),
        tables=tuple((one, _is_wide(one)) for one in parts if isinstance(one, Table)),
        sections=drawn_sections((one for one in parts if isinstance(one, Section)), f"{key}-part"),
    )


def _is_wide(table: Table) -> bool:
    """Return whether the cells of a table need more than half of a screen."""
    rows = [table.headings, *table.text_rows()]
    longest = [max(max(map(len, word.split()), default=0) for word in column) for column in zip(*rows, strict=True)]
    texts = [min(max(map(len, column)), _SENTENCE) for column in zip(*table.text_rows(), strict=True)]
    return sum(map(max, longest, texts or longest)) + _GAP * len(longest) > _HALF


def _figure(key: str, chart: Chart | CellScene) -> Figure:
    return scene_figure(key, chart) if isinstance(chart, CellScene) else chart_figure(key, chart)


# -- The cell in space as a figure: a static picture, and the same layers as data for the page's rotatable figure -----


_WIDTH, _MARGIN = 640.0, 24.0
_ELEVATION = np.radians(24.0)
_BESIDE = np.radians(65.0)
"""Viewing azimuth relative to the line from the tracker to the arms: across it, so that its full length is visible."""
_EYE = 1.5
"""Distance of the eye in the rotatable figure, in the unit of its library: the cell fills the width."""
_GRID_M = 1.0
_ROOM_M = 0.3


@dataclass(frozen=True, eq=False)
class _Layer:
    """The objects that one entry of the legend switches on and off."""

    kind: Literal["arm", "stops", "errors", "obstacles", "tracker"]
    words: str
    look: Look
    arms: tuple[SceneArm, ...] = ()
    errors: tuple[ErrorVectors, ...] = ()
    when: str = ""


def scene_figure(key: str, scene: CellScene) -> Figure:
    """Return the figure of the cell in space, over the whole width."""
    layers = _layers(scene)
    entries = [LegendEntry(layer.look, layer.words, (number,)) for number, layer in enumerate(layers)]
    if any(layer.errors for layer in layers):
        entries.append(LegendEntry(None, f"errors are drawn {scene.enlarged:g} times longer than they are"))
    return Figure(
        svg=_scene_svg(scene, layers),
        caption="The cell in space, with errors before and after",
        legend=tuple(entries),
        css_class="wide",
        note=scene.message,
        data=_scene_data(scene, layers),
        key=key,
    )


def _layers(scene: CellScene) -> list[_Layer]:
    colours = [f"arm{1 + number % ARM_COLOURS}" for number in range(len(scene.arms))]
    layers = [
        _Layer("arm", f"arm {arm.name} at a measured stop", Look(colour, "line"), (arm,))
        for arm, colour in zip(scene.arms, colours, strict=True)
    ]
    layers += [
        _Layer("stops", f"measured SMR positions of {arm.name}", Look(colour, "round"), (arm,))
        for arm, colour in zip(scene.arms, colours, strict=True)
    ]
    for place, when in ((0, "before"), (1, "after")):
        vectors = tuple(arm.errors[place] for arm in scene.arms if len(arm.errors) > place)
        stages = dict.fromkeys(one.stage for one in vectors)
        if vectors:
            words = f"errors {when}: {', '.join(STAGE_WORDS[stage] for stage in stages)}"
            layers.append(_Layer("errors", words, Look(next(iter(stages)), "line"), errors=vectors, when=when))
    if scene.obstacles:
        layers.append(_Layer("obstacles", "obstacles", Look("soft", "bar")))
    return [*layers, _Layer("tracker", "tracker and its lines of sight", Look("ink", "triangle"), scene.arms)]


# -- data -------------------------------------------------------------------------------------------------------------


def _scene_data(scene: CellScene, layers: list[_Layer]) -> str:
    content: dict[str, Json] = {
        "kind": "scene",
        "enlarged": scene.enlarged,
        "eye": np.round(_EYE * _towards(scene), 3).tolist(),
        "layers": [_described(layer) | _content(scene, layer) for layer in layers],
    }
    return script_json(content)


def _described(layer: _Layer) -> dict[str, Json]:
    return {"kind": layer.kind, "name": layer.words, "colour": layer.look.colour}


def _content(scene: CellScene, layer: _Layer) -> dict[str, Json]:
    match layer.kind:
        case "arm":
            (arm,) = layer.arms
            bodies = {"start": _places(arm.bodies.start), "end": _places(arm.bodies.end)}
            return bodies | {"radius": np.round(arm.bodies.radius, 3).tolist(), "chain": _columns(arm.chain)}
        case "stops":
            (arm,) = layer.arms
            return {"at": _columns(arm.points), "hints": [f"stop {stop}" for stop in arm.stops.tolist()]}
        case "errors":
            points = np.vstack([one.points for one in layer.errors])
            steps = np.vstack([one.steps for one in layer.errors])
            stops = np.concatenate([one.stops for one in layer.errors]).tolist()
            sizes = (np.linalg.norm(steps, axis=1) * 1e3).tolist()
            hints: list[Json] = [
                f"{layer.when}, stop {stop}: {mm(size)}" for stop, size in zip(stops, sizes, strict=True)
            ]
            return {"at": _columns(points), "step_mm": _columns(steps * 1e3, 4), "hints": hints}
        case "obstacles":
            return {"bodies": [{"name": name, "at": _columns(p)} for name, p in scene.obstacles.items()]}
        case "tracker":
            return {"at": [[0.0], [0.0], [0.0]], "sights": _places(np.array([arm.chain[-1] for arm in layer.arms]))}


def _columns(points: Array, decimals: int = 3) -> Json:
    """Return coordinates x, y, z of points (n, 3) as three lists; default: points in metres to the millimetre."""
    columns: Json = np.round(points, decimals).T.tolist()
    return columns


def _places(points: Array) -> Json:
    rows: Json = np.round(points, 3).tolist()
    return rows


# -- static picture ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _View:
    """A parallel projection: ``axes`` (2, 3) to the right and upwards [px/m], the origin at ``offset`` (2,) [px]."""

    axes: Array
    offset: Array
    scale: float

    def __call__(self, points: Array) -> Array:
        """Return pixels (..., 2) of points (..., 3) [m]."""
        return np.asarray(points @ self.axes.T * np.array([1.0, -1.0]) + self.offset)


def _scene_svg(scene: CellScene, layers: list[_Layer]) -> str:
    floor = _floor(scene)
    view, height = _view(scene, floor)
    parts = [in_colour("grid", f'<path d="{polyline(view(floor))}" stroke-width=".8"/>')]
    drawn = {layer.kind: "" for layer in layers}
    for layer in layers:
        drawn[layer.kind] += in_colour(layer.look.colour, "".join(_pictures(scene, layer, view)))
    parts += [drawn.get(kind, "") for kind in ("obstacles", "tracker", "stops", "errors", "arm")]
    parts.append(text(_MARGIN, height - 8.0, f"grid: {_GRID_M:g} m"))
    return svg_element(_WIDTH, height, parts)


def _view(scene: CellScene, floor: Array) -> tuple[_View, float]:
    """Return the projection that fits scene and floor (k, 3) [m] into the picture's width, and its height [px]."""
    towards = _towards(scene)
    right = np.array([-towards[1], towards[0], 0.0]) / np.cos(_ELEVATION)
    axes = np.stack([right, np.cross(towards, right)])
    flat = np.vstack([scene.points, floor]) @ axes.T
    low, high = np.nanmin(flat, axis=0), np.nanmax(flat, axis=0)
    scale = (_WIDTH - 2.0 * _MARGIN) / float(high[0] - low[0])
    offset = np.array([_MARGIN - low[0] * scale, _MARGIN + high[1] * scale])
    return _View(axes * scale, offset, scale), float(high[1] - low[1]) * scale + 2.0 * _MARGIN


def _towards(scene: CellScene) -> Array:
    """Return the direction (3,) from the cell to the eye."""
    middle = np.mean([arm.base for arm in scene.arms], axis=0)
    azimuth = np.arctan2(middle[1], middle[0]) - _BESIDE
    level = np.cos(_ELEVATION)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(_ELEVATION)])


def _floor(scene: CellScene) -> Array:
    """Return a grid at the lowest height as lines (3 k, 3) with gaps."""
    low, high = scene.points.min(axis=0) - _ROOM_M, scene.points.max(axis=0) + _ROOM_M
    lines = []
    for along, across in ((0, 1), (1, 0)):
        for at in np.arange(np.ceil(low[across] / _GRID_M), high[across] / _GRID_M) * _GRID_M:
            ends = np.full((3, 3), np.nan)
            ends[:2, along], ends[:2, across], ends[:2, 2] = (low[along], high[along]), at, low[2]
            lines.append(ends)
    return np.concatenate(lines) if lines else np.empty((0, 3))


def _pictures(scene: CellScene, layer: _Layer, view: _View) -> Iterator[str]:
    match layer.kind:
        case "arm":
            (arm,) = layer.arms
            yield from _body_pictures(arm.bodies, view)
            chain = view(arm.chain)
            yield f'<path d="{polyline(chain)}" stroke-width="2.5" stroke-linejoin="round"/>'
            yield in_colour("ink", f'<path d="{dots(chain)}" stroke-linecap="round" stroke-width="4"/>')
        case "stops":
            path = dots(view(layer.arms[0].points))
            yield f'<path d="{path}" stroke-linecap="round" stroke-width="2.4" opacity=".55"/>'
        case "errors":
            for one in layer.errors:
                ends = np.stack([one.points, one.points + scene.enlarged * one.steps], axis=1)
                gap = np.full((len(ends), 1, 2), np.nan)
                yield f'<path d="{polyline(np.concatenate([view(ends), gap], axis=1).reshape(-1, 2))}"/>'
                yield f'<path d="{dots(view(ends[:, 1]))}" stroke-linecap="round" stroke-width="3"/>'
        case "obstacles":
            for points in scene.obstacles.values():
                yield f'<path d="{polyline(outline(view(points)))}" fill="currentColor" fill-opacity=".12"/>'
        case "tracker":
            x, y = view(np.zeros(3))
            yield f'<path d="M{x:.1f} {y:.1f}m0-8l7 13h-14z" fill="currentColor"/>'
            for arm in layer.arms:
                sight = polyline(view(np.stack([np.zeros(3), arm.chain[-1]])))
                yield f'<path d="{sight}" stroke-dasharray="1 4" stroke-width="1"/>'


def _body_pictures(bodies: Capsules, view: _View) -> Iterator[str]:
    """Yield capsules as strokes with round caps, drawn to scale."""
    for start, end, radius in zip(view(bodies.start), view(bodies.end), bodies.radius.tolist(), strict=True):
        width = 2.0 * radius * view.scale
        path = polyline(np.stack([start, end]))
        yield f'<path d="{path}" stroke-linecap="round" stroke-width="{width:.1f}" opacity=".28"/>'
