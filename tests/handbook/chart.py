"""Charts of the handbook as small stand-alone SVG files, drawn by matplotlib."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from typing import Any, Literal
from xml.etree import ElementTree

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cellapp.robot.kinematics.transforms import Array

_SIZE_IN = (5.6, 3.2)
_AXES = (0.125, 0.165, 0.845, 0.72)
"""Left, bottom, width and height of the axes as shares of the figure: no font decides where values are drawn."""
_STYLES: tuple[tuple[str, str | tuple[float, tuple[float, ...]]], ...] = (
    ("#0072b2", "-"), ("#d55e00", (0.0, (5.0, 2.5))), ("#007a5a", (0.0, (1.5, 1.5))),
)  # fmt: skip
"""Colours that differ for colour-blind readers too (Okabe and Ito), and dashes for prints without colour."""
_DEGREES = (1, 1.5, 3, 6, 9, 10)
"""Steps between ticks of angles [deg], but for powers of ten."""
_SERIES = "series"
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # words stay words
    "svg.hashsalt": "cellapp",  # the same names in the file each time
    "path.simplify": False,
    "font.family": "sans-serif",
    "font.size": 9.5,
    "axes.edgecolor": "#999999",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "lines.linewidth": 1.6,
    "legend.frameon": False,
}
_LONG_NUMBER = re.compile(r"-?\d+\.\d{2,}")


@dataclass(frozen=True)
class Series:
    """Values ``y`` (n,) over ``x`` (n,), as a line in the order given, NaN being a gap, or as points."""

    label: str
    x: Array
    y: Array
    kind: Literal["line", "points"] = "line"


@dataclass(frozen=True)
class Chart:
    """Up to three series over one variable; ``title`` says for people what is drawn.

    ``equal``: a map, in which one unit has the same length along both axes.
    """

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    equal: bool = False


def chart_svg(chart: Chart) -> str:
    """The chart as the text of an SVG file; coordinates are rounded to a tenth of a point."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=_SIZE_IN)
        axes = figure.add_axes(_AXES)
        axes.margins(x=0.0 if all(one.kind == "line" for one in chart.series) else 0.05)
        for number, one in enumerate(chart.series):
            colour, dashes = _STYLES[number]
            drawn = {"linestyle": dashes} if one.kind == "line" else {"linestyle": "", "marker": "o", "markersize": 2.6}
            axes.plot(one.x, one.y, color=colour, label=one.label, gid=f"{_SERIES}{number}", **drawn)
        axes.set(xlabel=chart.x_label, ylabel=chart.y_label)
        if chart.x_label.endswith("[deg]"):
            axes.xaxis.set_major_locator(MaxNLocator(nbins=8, steps=list(_DEGREES)))
        if chart.equal:
            axes.set_aspect("equal", adjustable="datalim")
        else:
            axes.axhline(0.0, color="#999999", linewidth=0.8, zorder=1.0)  # an effect is a deviation from nothing
        figure.legend(loc="upper left", bbox_to_anchor=(_AXES[0], 1.0), ncols=3, borderaxespad=0.3, columnspacing=1.2)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Title": chart.title, "Date": None, "Creator": None})
    return _LONG_NUMBER.sub(lambda number: f"{float(number[0]):.1f}", text.getvalue())


def shown(svg: str) -> tuple[list[str], list[str]]:
    """The words of a chart and the paths of its series: what must be the same when it is drawn again."""
    root = ElementTree.fromstring(svg)
    words = [" ".join("".join(one.itertext()).split()) for one in root.iter("{http://www.w3.org/2000/svg}text")]
    series = [one for one in root.iter() if one.get("id", "").startswith(_SERIES)]
    parts = [part for one in series for part in one.iter() if part.get("d") or part.get("x")]
    return words, [part.get("d") or f"{part.get('x')} {part.get('y')}" for part in parts]
