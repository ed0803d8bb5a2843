"""Sections as the page draws them: charts as figures with anchors, and parts grouped by kind."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellapp.commands.plan.charts_obstacles import outline
from cellapp.commands.view.charts import Chart, mm
from cellapp.commands.view.parts import Capsules, CellScene, ErrorVectors, Facts, Parts, SceneArm, Section
from cellapp.commands.view.table import Table
from cellapp.commands.view.words import STAGE_WORDS
from cellapp.interfaces.page.chart_svg import Figure, chart_figure, dots, in_colour, polyline, svg_element, text
from cellapp.interfaces.render.chart_style import ARM_COLOURS, Json, LegendEntry, Look, script_json
from cellapp.robot.kinematics.transforms import Array

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
