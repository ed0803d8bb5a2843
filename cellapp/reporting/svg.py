"""Drawing primitives: matplotlib figures as inline SVG in the colours of the page.

Only the figure modules import this one: it loads matplotlib. Figures contain no name that a user gave; such names are
in captions and legends, where the template escapes them.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from cellapp.kinematics.transforms import Array

ARM_COLOURS = 4
"""Number of arm colours in the style sheet; further arms repeat them."""

# Placeholder colours, replaced by colours of the style sheet, which also has a dark scheme.
INK, SOFT, GRID = "#010101", "#010102", "#010103"
STAGE_COLOURS = {
    "nominal": "#010111",
    "geometry": "#010112",
    "effects": "#010113",
    "network": "#010114",
    "tracker-network": "#010115",
}
ARM_COLOUR = tuple(f"#01012{number}" for number in range(1, ARM_COLOURS + 1))
_PAGE_COLOURS = {
    INK: "currentColor",
    SOFT: "var(--soft)",
    GRID: "var(--grid)",
    **{colour: f"var(--{stage})" for stage, colour in STAGE_COLOURS.items()},
    **{colour: f"var(--arm{number})" for number, colour in enumerate(ARM_COLOUR, start=1)},
}
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
    "axes.edgecolor": SOFT,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "axes.axisbelow": True,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "figure.dpi": 72.0,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
}
_FAMILIES = frozenset(
    {"axes", "axes3d", "figure", "font", "grid", "lines", "patch", "path", "savefig", "svg", "text", "xtick", "ytick"}
)
SIZE = (5.2, 3.3)
WIDE = (8.0, 6.0)
"""Width and height of a figure [inch]; the page scales them."""


def drawing_settings(key: str) -> Any:
    """Context with matplotlib's defaults (not the user's settings) and those of the page; ids in the SVG depend on
    ``key`` alone."""
    defaults: Mapping[Any, Any] = matplotlib.rcParamsDefault
    own = {name: value for name, value in defaults.items() if name.split(".")[0] in _FAMILIES}
    settings: Any = {**own, **_SETTINGS, "svg.hashsalt": key}
    return matplotlib.rc_context(settings)


def new_axes() -> tuple[Figure, Any]:
    """A figure of the usual size with one pair of axes."""
    figure = Figure(figsize=SIZE, layout="constrained")
    axes = figure.add_subplot()
    axes.grid(color=GRID, linewidth=0.6)
    return figure, axes


def draw_marks(axes: Any, x: NDArray[Any], y: Array, colour: str, cap: str, *, width: float, half: float = 0.0) -> None:
    """Draw many small marks as one path of strokes from ``x - half`` to ``x + half``; ``cap`` gives their shape.

    The SVG text is a tenth of that of single markers.
    """
    ends = np.column_stack([x - half, y, x + half, y]).reshape(-1, 2)
    codes = np.tile(np.array([Outline.MOVETO, Outline.LINETO], dtype=np.uint8), len(x))
    outline = Outline(ends, codes)
    outline.should_simplify = False
    patch = PathPatch(outline, facecolor="none", edgecolor=colour, linewidth=width, capstyle=cap, snap=False)
    axes.add_patch(patch)


def draw_arrows(axes: Any, starts: Array, steps: Array, colour: str, head: float) -> None:
    """Draw arrows (n, 2) as one path of strokes; heads have at most the length ``head``."""
    length = np.linalg.norm(steps, axis=1, keepdims=True)
    along = steps / np.maximum(length, 1e-12) * np.minimum(head, 0.5 * length)
    across = np.column_stack([-along[:, 1], along[:, 0]]) * 0.5
    tips = starts + steps
    ends = np.stack([starts, tips, tips - along + across, tips, tips - along - across], axis=1).reshape(-1, 2)
    codes = np.tile(np.array([Outline.MOVETO, *[Outline.LINETO] * 4], dtype=np.uint8), len(starts))
    outline = Outline(ends, codes)
    outline.should_simplify = False
    axes.add_patch(PathPatch(outline, facecolor="none", edgecolor=colour, linewidth=0.8, snap=False))


def padded_limits(values: NDArray[Any]) -> tuple[float, float]:
    """Axis limits around values with 5 % of room at either end."""
    low, high = float(np.min(values)), float(np.max(values))
    room = 0.05 * (high - low) or 0.5
    return low - room, high + room


def set_log_axis(axis: Any, values: Array, also: float | None) -> None:
    """Make an axis logarithmic around positive values, with plain numbers and at least one labelled tick."""
    shown = values if also is None else np.append(values, also)
    low, high = float(shown.min()) / 1.25, float(shown.max()) * 1.25
    decades = np.log10(high / low)
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})
    axis.axes.set(**{f"{axis.axis_name}lim": (low, high)})
    subs = (1.0,) if decades > 3.0 else (1.0, 3.0) if decades > 1.5 else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(10.0, subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def to_svg(figure: Figure, key: str, part: Bbox | None = None) -> str:
    """The figure (or ``part`` of it [inch]) as an ``svg`` element for HTML.

    It has no XML declaration, ids that begin with ``key``, and the colours of the style sheet.
    """
    stream = io.StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    FigureCanvasSVG(figure).print_figure(stream, format="svg", metadata=nothing, bbox_inches=part)
    text = stream.getvalue()
    head, _, body = text[text.index("<svg") :].partition(">")
    text = re.sub(r'\s(?:xmlns(?::\w+)?|width|height|version)="[^"]*"', "", head) + ">" + body
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = text.replace("xlink:href=", "href=")
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{key}-", text)
    for placeholder, colour in _PAGE_COLOURS.items():
        text = text.replace(placeholder, colour)
    return text.replace("<svg", '<svg aria-hidden="true" focusable="false"', 1)
