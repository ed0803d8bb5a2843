"""Figures of the report as inline SVG; pure drawing, from arrays to text.

Import this module only where a figure is drawn: it loads matplotlib. No name that a user gave is drawn here, so that
any alphabet will do and nothing needs escaping: names stand in the page's captions and legends.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, MultipleLocator, NullFormatter
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from cellapp.kinematics.transforms import Array

ARM_COLOURS = 4
"""Arms beyond these share colours."""

# Drawn with colours that stand for the page's own, so that the style sheet decides them, also in the dark.
_INK, _SOFT, _GRID = "#010101", "#010102", "#010103"
_STAGES = {
    "nominal": "#010111",
    "geometry": "#010112",
    "effects": "#010113",
    "network": "#010114",
    "tracker-network": "#010115",
}
_ARMS = tuple(f"#01012{number}" for number in range(1, ARM_COLOURS + 1))
_PAGE_COLOURS = {
    _INK: "currentColor",
    _SOFT: "var(--soft)",
    _GRID: "var(--grid)",
    **{colour: f"var(--{stage})" for stage, colour in _STAGES.items()},
    **{colour: f"var(--arm{number})" for number, colour in enumerate(_ARMS, start=1)},
}
# ends of strokes: dash, dot, square
_CAPS = {
    "nominal": "butt",
    "geometry": "round",
    "network": "round",
    "tracker-network": "butt",
    "effects": "projecting",
}
_DASHES = ("nominal", "tracker-network")
_SETTINGS = {
    "svg.fonttype": "none",
    "text.parse_math": False,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": _SOFT,
    "axes.labelcolor": _INK,
    "text.color": _INK,
    "xtick.color": _SOFT,
    "ytick.color": _SOFT,
    "xtick.labelcolor": _INK,
    "ytick.labelcolor": _INK,
    "axes.axisbelow": True,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "figure.dpi": 72.0,
    "grid.color": _GRID,
    "grid.linewidth": 0.5,
}
_FAMILIES = frozenset(
    {"axes", "axes3d", "figure", "font", "grid", "lines", "patch", "path", "savefig", "svg", "text", "xtick", "ytick"}
)
_SIZE = (5.2, 3.3)
_WIDE = (8.0, 6.0)
_SMOOTH = 0.02  # what lies farther off the line between its neighbours, as a share of the range, is a cloud
_TURN = 360.0
_LEAST_MM = 1e-6  # what a logarithmic axis shows for no error at all


@dataclass(frozen=True)
class ArmInCell:
    """What the drawing of the cell shows of one arm, all levelled [m].

    Measured points (n, 3), the base (3,), and the chain (k, 3) from the base over the joints to the SMR at one
    configuration.
    """

    points: Array
    base: Array
    chain: Array


def error_figure(
    key: str,
    configurations: NDArray[np.int64],
    errors_mm: Mapping[str, Array],
    floor_mm: float | None,
    label: str = "position error [mm]",
) -> str:
    """Error (n,) [mm] of each configuration by stage, on a logarithmic axis; ids in the SVG are of ``key``."""
    with _settings(key):
        figure, axes = _axes()
        width = 2.6 if len(configurations) < 500 else 1.5
        for stage, errors in errors_mm.items():
            half = 0.005 * float(np.ptp(configurations)) if stage in _DASHES else 0.0
            _dots(
                axes,
                configurations,
                np.maximum(errors, _LEAST_MM),
                _STAGES[stage],
                _CAPS[stage],
                width=width,
                half=half,
            )
        shown = np.maximum(np.concatenate(list(errors_mm.values())), _LEAST_MM)
        axes.set_xlim(*_padded(configurations))
        _log_axis(axes.yaxis, shown, floor_mm)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("configuration")
        axes.set_ylabel(label)
        if floor_mm is not None:
            axes.axhline(floor_mm, color=_INK, linewidth=1.0, linestyle="--")
        return _svg(figure, key)


def residual_figure(
    key: str, errors_mm: Mapping[str, Array], floor_mm: float | None, label: str = "position error [mm]"
) -> str:
    """Histogram of the errors [mm] of some stages on a logarithmic axis, with the noise floor."""
    with _settings(key):
        figure, axes = _axes()
        shown = np.maximum(np.concatenate(list(errors_mm.values())), _LEAST_MM)
        _log_axis(axes.xaxis, shown, floor_mm)
        low, high = axes.get_xlim()
        edges = np.geomspace(low, high, 41)
        for stage, errors in errors_mm.items():
            counts, _ = np.histogram(np.maximum(errors, _LEAST_MM), edges)
            axes.stairs(counts, edges, fill=True, color=_STAGES[stage], alpha=0.3)
            axes.stairs(counts, edges, color=_STAGES[stage], linewidth=1.3)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel(label)
        axes.set_ylabel("configurations")
        if floor_mm is not None:
            axes.axvline(floor_mm, color=_INK, linewidth=1.0, linestyle="--")
        return _svg(figure, key)


def steps_figure(key: str, gaps_mm: Array, floor_mm: float | None) -> str:
    """Held-out rms (n,) [mm] before any step and after each, on a logarithmic axis, against the noise floor."""
    with _settings(key):
        figure, axes = _axes()
        number = np.arange(len(gaps_mm))
        shown = np.maximum(gaps_mm, _LEAST_MM)
        axes.plot(number, shown, color=_STAGES["geometry"], linewidth=1.3)
        axes.plot(number, shown, "o", color=_STAGES["geometry"], markersize=5.0)
        _log_axis(axes.yaxis, shown, floor_mm)
        axes.set_xlim(-0.4, max(len(gaps_mm) - 1, 1) + 0.4)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("step")
        axes.set_ylabel("held-out rms [mm]")
        if floor_mm is not None:
            axes.axhline(floor_mm, color=_INK, linewidth=1.0, linestyle="--")
        return _svg(figure, key)


@dataclass(frozen=True)
class Seen:
    """What a figure of an effect shows: dots at x (n,), measured and computed there, and the band of the latter (n,).

    ``curve`` is (x, value, band) of a curve over a whole turn where there is one.
    """

    x: Array
    measured: Array
    computed: Array
    band: Array
    curve: tuple[Array, Array, Array] | None = None

    @property
    def is_line(self) -> bool:
        """Whether what was computed is a function of x that a line can show, and not a cloud."""
        if self.curve is not None or len(self.x) < 3:
            return self.curve is not None
        x, y = self.x, self.computed
        share = np.diff(x)[:-1] / np.maximum(x[2:] - x[:-2], 1e-12)
        between = y[:-2] + share * (y[2:] - y[:-2])
        return float(np.median(np.abs(y[1:-1] - between))) <= _SMOOTH * float(np.ptp(y)) + 1e-12


def effect_figure(key: str, seen: Seen, x_label: str, y_label: str) -> str:
    """Measured points of one effect, the computed curve with two standard deviations to either side, or points."""
    with _settings(key):
        figure, axes = _axes()
        width = 2.6 if len(seen.x) < 400 else 1.8
        _dots(axes, seen.x, seen.measured, _STAGES["nominal"], "round", width=width)
        colour = _STAGES["effects"]
        x, value, band = seen.curve if seen.curve is not None else (seen.x, seen.computed, seen.band)
        if seen.is_line:
            if len(band):
                axes.fill_between(x, value - 2.0 * band, value + 2.0 * band, color=colour, alpha=0.25, linewidth=0.0)
            axes.plot(x, value, color=colour, linewidth=1.3)
        else:
            _dots(axes, x, value, colour, "projecting", width=width)
        low, high = _typical_range(np.concatenate([seen.measured, value]), seen.computed)
        axes.set_ylim(low, high)
        axes.set_xlim(*_padded(seen.x) if seen.curve is None else (float(x[0]), float(x[-1])))
        if seen.curve is not None and x[-1] - x[0] == _TURN:
            axes.xaxis.set_major_locator(MultipleLocator(60.0))
        axes.set_xlabel(x_label.replace("[urad]", "[µrad]").replace("[um]", "[µm]"))
        axes.set_ylabel(y_label.replace("[urad]", "[µrad]").replace("[um]", "[µm]"))
        return _svg(figure, key)


def _typical_range(values: Array, always: Array) -> tuple[float, float]:
    """Limits that leave out the few farthest of ``values``, but none of ``always``."""
    low, high = np.quantile(values, (0.01, 0.99))
    low, high = min(float(low), float(always.min())), max(float(high), float(always.max()))
    room = 0.08 * (high - low) or 1.0
    return low - room, high + room


def certainty_figure(key: str, predicted_mm: Array, errors_mm: Array) -> str:
    """Position error (n,) [mm] against the standard deviation of a coordinate (n,) that the model predicts for it.

    The line is where the error is the root mean square length that the prediction stands for.
    """
    with _settings(key):
        figure, axes = _axes()
        predicted, errors = np.maximum(predicted_mm, _LEAST_MM), np.maximum(errors_mm, _LEAST_MM)
        _log_axis(axes.xaxis, predicted, None)
        _log_axis(axes.yaxis, errors, None)
        _dots(axes, predicted, errors, _STAGES["effects"], "round", width=2.6 if len(errors) < 500 else 1.5)
        ends = np.array(axes.get_xlim())
        axes.plot(ends, np.sqrt(3.0) * ends, color=_INK, linewidth=1.0, linestyle="--")
        axes.set_xlabel("predicted standard deviation of a coordinate [mm]")
        axes.set_ylabel("position error [mm]")
        return _svg(figure, key)


def target_figure(key: str, before_mm: Array, after_mm: Array, floor_mm: float | None) -> str:
    """Measured error [mm] at each target (n,) without and with compensation, joined by a line."""
    with _settings(key):
        figure, axes = _axes()
        number = np.arange(1, len(before_mm) + 1)
        before, after = np.maximum(before_mm, _LEAST_MM), np.maximum(after_mm, _LEAST_MM)
        axes.vlines(number, before, after, color=_GRID, linewidth=1.5)
        axes.plot(number, before, "o", color=_STAGES["nominal"], markersize=4.5)
        axes.plot(number, after, "s", color=_STAGES["effects"], markersize=4.5)
        _log_axis(axes.yaxis, np.concatenate([before, after]), floor_mm)
        axes.set_xlim(0.0, len(number) + 1.0)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("target, in the order of the table")
        axes.set_ylabel("measured error [mm]")
        if floor_mm is not None:
            axes.axhline(floor_mm, color=_INK, linewidth=1.0, linestyle="--")
        return _svg(figure, key)


def vector_figure(key: str, points: Array, vectors: Array, length_mm: float) -> str:
    """Vectors (n, 3) [m] at points (n, 3) [m], seen along z and along y, hugely enlarged.

    The arrow of ``length_mm`` above each view tells the scale; ``scale_length_mm`` finds one.
    """
    with _settings(key):
        figure = Figure(figsize=_SIZE, layout="constrained")
        reach = float(np.max(np.ptp(points, axis=0))) or 1.0
        enlarged = 0.18 * reach / (length_mm * 1e-3)
        for place, up in enumerate((1, 2)):
            axes = figure.add_subplot(1, 2, place + 1)
            axes.grid(color=_GRID, linewidth=0.6)
            axes.set_aspect("equal", adjustable="datalim")
            flat = points[:, (0, up)]
            _arrows(axes, flat, vectors[:, (0, up)] * enlarged, _STAGES["geometry"], 0.03 * reach)
            ends = np.vstack([flat, flat + vectors[:, (0, up)] * enlarged])
            low, high = ends.min(axis=0), ends.max(axis=0)
            key_at = np.array([[low[0], high[1] + 0.1 * reach]])
            _arrows(axes, key_at, np.array([[0.18 * reach, 0.0]]), _INK, 0.03 * reach)
            axes.text(key_at[0, 0] + 0.22 * reach, key_at[0, 1], f"{length_mm:g} mm", va="center", fontsize=8.5)
            axes.update_datalim(np.vstack([low, high, key_at + np.array([0.0, 0.06 * reach])]))
            axes.margins(0.06)
            axes.autoscale_view()
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(MaxNLocator(4))
            axes.set_xlabel("x [m]")
            axes.set_ylabel(f"{'xyz'[up]} [m]")
        return _svg(figure, key)


def scale_length_mm(vectors: Array) -> float:
    """A round length [mm] near that of the larger ones of ``vectors`` (n, 3) [m]."""
    large = max(float(np.quantile(np.linalg.norm(vectors, axis=1), 0.9)) * 1e3, _LEAST_MM)
    decade = 10.0 ** np.floor(np.log10(large))
    return float(f"{decade * max(step for step in (1.0, 2.0, 5.0) if step * decade <= large * (1.0 + 1e-9)):.3g}")


def _arrows(axes: Any, starts: Array, steps: Array, colour: str, head: float) -> None:
    """Arrows (n, 2) as one path of strokes; heads at most of length ``head``."""
    length = np.linalg.norm(steps, axis=1, keepdims=True)
    along = steps / np.maximum(length, 1e-12) * np.minimum(head, 0.5 * length)
    across = np.column_stack([-along[:, 1], along[:, 0]]) * 0.5
    tips = starts + steps
    ends = np.stack([starts, tips, tips - along + across, tips, tips - along - across], axis=1).reshape(-1, 2)
    codes = np.tile(np.array([Outline.MOVETO, *[Outline.LINETO] * 4], dtype=np.uint8), len(starts))
    outline = Outline(ends, codes)
    outline.should_simplify = False
    axes.add_patch(PathPatch(outline, facecolor="none", edgecolor=colour, linewidth=0.8, snap=False))


def cell_figure(key: str, arms: Sequence[ArmInCell], across: int, up: int) -> str:
    """The cell seen along one axis: coordinate ``across`` to the right, ``up`` upwards; the tracker at the origin."""
    with _settings(key):
        figure, axes = _axes()
        axes.set_aspect("equal", adjustable="datalim")
        for number, arm in enumerate(arms):
            colour = _ARMS[number % ARM_COLOURS]
            _dots(axes, arm.points[:, across], arm.points[:, up], colour, "round", width=1.8)
            axes.plot(
                [0.0, arm.base[across]], [0.0, arm.base[up]], color=_SOFT, linewidth=0.8, linestyle=":", zorder=1.0
            )
            axes.plot(arm.base[across], arm.base[up], "s", color=colour, markersize=9, markeredgecolor=_INK)
        axes.plot(0.0, 0.0, "^", color=_INK, markersize=9)
        axes.margins(0.06)
        axes.autoscale_view()
        axes.set_xlabel(f"{'xyz'[across]} [m]")
        axes.set_ylabel(f"{'xyz'[up]} [m]")
        return _svg(figure, key)


def space_figure(key: str, arms: Sequence[ArmInCell]) -> str:
    """The cell in space: tracker at the origin, arms at one configuration, their measured points."""
    with _settings(key), matplotlib.rc_context({"path.simplify": False}):
        figure = Figure(figsize=_WIDE)
        axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
        middle = np.mean([arm.base for arm in arms], axis=0)
        # look across the way from the tracker to the arms, so that it is seen in full
        axes.view_init(elev=24.0, azim=float(np.degrees(np.arctan2(middle[1], middle[0]))) - 65.0)
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.pane.set_visible(False)
        corners = [np.zeros((1, 3))]
        for number, arm in enumerate(arms):
            colour = _ARMS[number % ARM_COLOURS]
            # all dots as one line with gaps: a tenth of the text of single markers
            gap = np.full_like(arm.points, np.nan)
            dots = np.stack([arm.points, arm.points + np.array([0.0, 0.0, 1e-4]), gap], axis=1).reshape(-1, 3)
            axes.plot(*dots.T, color=colour, linewidth=1.8, solid_capstyle="round", alpha=0.5)
            axes.plot(*np.array([np.zeros(3), arm.chain[-1]]).T, color=_SOFT, linewidth=0.7, linestyle=":")
            axes.plot(*arm.chain.T, color=colour, linewidth=3.0, solid_capstyle="round")
            axes.plot(*arm.chain[1:-1].T, "o", color=_INK, markersize=2.4)
            axes.plot(*arm.chain[-1:].T, "o", color=_INK, markersize=4.5)
            axes.plot(*arm.base[None].T, "s", color=colour, markersize=8, markeredgecolor=_INK)
            corners += [arm.points, arm.chain]
        axes.plot([0.0], [0.0], [0.0], "^", color=_INK, markersize=10)
        every = np.vstack(corners)
        low, high = every.min(axis=0), every.max(axis=0)
        room = 0.04 * float(np.max(high - low))
        span = (high - low) / float(np.max(high - low))
        for name, a, b, share in zip("xyz", low - room, high + room, span, strict=True):
            axes.set(**{f"{name}lim": (a, b), f"{name}label": f"{name} [m]"})
            getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(max(2, round(6.0 * float(share)))))
        axes.set_box_aspect(high - low + 2.0 * room)
        return _svg(figure, key, _around_box(axes, low - room, high + room))


def _around_box(axes: Any, low: Array, high: Array) -> Bbox:
    """The part of the figure [inch] that shows the box of a 3-D drawing with the labels around it."""
    axes.apply_aspect()
    corners = np.array([[*corner, 1.0] for corner in product(*zip(low, high, strict=True))]) @ axes.get_proj().T
    inches = axes.transData.transform(corners[:, :2] / corners[:, 3:]) / 72.0
    room = np.array([0.8, 0.55])
    return Bbox([inches.min(axis=0) - room, inches.max(axis=0) + room])


def _settings(key: str) -> Any:
    """Matplotlib's own defaults (not a user's) with ours; ids in the SVG follow from ``key`` alone."""
    defaults: Mapping[Any, Any] = matplotlib.rcParamsDefault
    own = {name: value for name, value in defaults.items() if name.split(".")[0] in _FAMILIES}
    settings: Any = {**own, **_SETTINGS, "svg.hashsalt": key}
    return matplotlib.rc_context(settings)


def _axes() -> tuple[Figure, Any]:
    figure = Figure(figsize=_SIZE, layout="constrained")
    axes = figure.add_subplot()
    axes.grid(color=_GRID, linewidth=0.6)
    return figure, axes


def _dots(axes: Any, x: NDArray[Any], y: Array, colour: str, cap: str, *, width: float, half: float = 0.0) -> None:
    """Many small marks as one path of strokes, ``half`` to either side of x: a tenth of the text of single markers."""
    ends = np.column_stack([x - half, y, x + half, y]).reshape(-1, 2)
    codes = np.tile(np.array([Outline.MOVETO, Outline.LINETO], dtype=np.uint8), len(x))
    outline = Outline(ends, codes)
    outline.should_simplify = False
    patch = PathPatch(outline, facecolor="none", edgecolor=colour, linewidth=width, capstyle=cap, snap=False)
    axes.add_patch(patch)


def _padded(values: NDArray[Any]) -> tuple[float, float]:
    low, high = float(np.min(values)), float(np.max(values))
    room = 0.05 * (high - low) or 0.5
    return low - room, high + room


def _log_axis(axis: Any, values: Array, also: float | None) -> None:
    """A logarithmic axis around positive values with plain numbers and at least one of them to read."""
    shown = values if also is None else np.append(values, also)
    low, high = float(shown.min()) / 1.25, float(shown.max()) * 1.25
    decades = np.log10(high / low)
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})
    axis.axes.set(**{f"{axis.axis_name}lim": (low, high)})
    subs = (1.0,) if decades > 3.0 else (1.0, 3.0) if decades > 1.5 else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(10.0, subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _svg(figure: Figure, key: str, part: Bbox | None = None) -> str:
    """The figure as an ``svg`` element for HTML: no declarations, ids that start with ``key``, the page's colours."""
    stream = io.StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    FigureCanvasSVG(figure).print_figure(stream, format="svg", metadata=nothing, bbox_inches=part)
    text = stream.getvalue()
    head, _, body = text[text.index("<svg") :].partition(">")
    text = re.sub(r'\s(?:xmlns(?::\w+)?|width|height|version)="[^"]*"', "", head) + ">" + body
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = text.replace("xlink:href=", "href=")
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{key}-", text)
    for drawn, on_page in _PAGE_COLOURS.items():
        text = text.replace(drawn, on_page)
    return text.replace("<svg", '<svg aria-hidden="true" focusable="false"', 1)
