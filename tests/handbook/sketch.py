"""Line drawings of frames and bodies in space as small stand-alone SVG files, for light and dark pages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from cellapp.robot.kinematics.transforms import Array, rotation_from_vector

Axis = Literal["x", "y", "z"]
Ink = Literal["ink", "faint", "turn"] | Axis
"""What a line is: of a body, of a construction, of an axis, or an angle or length that a parameter states."""

_WIDTH, _MOST_HEIGHT = 560.0, 340.0
_SIDE, _TOP, _BOTTOM = 64.0, 26.0, 22.0
"""Room around the drawing for labels at its rim [px]."""
_HEAD = 8.0
"""Length of an arrow's head [px]."""
_ARC_POINTS = 25
_DASHES = ' stroke-dasharray="5 4"'
_LIGHT = {"ink": "#333", "faint": "#767676", "x": "#c04a00", "y": "#00745a", "z": "#0068ab", "turn": "#a0307a"}
_DARK = {"ink": "#dcdfe2", "faint": "#8d949b", "x": "#ff9a5c", "y": "#3fd0a4", "z": "#6cbcff", "turn": "#f08cc8"}
"""Axes differ for colour-blind readers too, and each is named at its tip."""


@dataclass(frozen=True)
class Line:
    """A line through points (n, 3) [m]; ``arrow``: with a head at its end."""

    points: Array
    ink: Ink = "ink"
    arrow: bool = False
    dashed: bool = False
    width: float = 1.6


@dataclass(frozen=True)
class Label:
    """Words at a point (3,) [m], moved by ``shift`` (right, down) [px]."""

    at: Array
    text: str
    ink: Ink = "ink"
    shift: tuple[float, float] = (0.0, 0.0)
    anchor: Literal["start", "middle", "end"] = "middle"


Mark = Line | Label


@dataclass(frozen=True)
class Sketch:
    """Lines and words in space, seen from ``azimuth`` and ``elevation`` [deg]; z is up in the picture."""

    title: str
    marks: tuple[Mark, ...]
    azimuth: float = 35.0
    elevation: float = 22.0


def line(*points: ArrayLike, ink: Ink = "ink", arrow: bool = False, dashed: bool = False, width: float = 1.6) -> Line:
    """A line through single points (3,)."""
    return Line(np.array(points, dtype=np.float64), ink, arrow, dashed, width)


def arrow(start: ArrayLike, end: ArrayLike, ink: Ink = "turn", dashed: bool = False) -> Line:
    """A line from ``start`` to ``end`` (3,) with a head."""
    return line(start, end, ink=ink, arrow=True, dashed=dashed)


def label(
    at: ArrayLike,
    text: str,
    ink: Ink = "ink",
    shift: tuple[float, float] = (0.0, 0.0),
    anchor: Literal["start", "middle", "end"] = "middle",
) -> Label:
    """Words at a point (3,)."""
    return Label(np.asarray(at, dtype=np.float64), text, ink, shift, anchor)


def dot(at: ArrayLike, ink: Ink = "ink") -> Line:
    """A point (3,): a line without length and with round ends."""
    return line(at, at, ink=ink, width=7.0)


def triad(
    T: Array, name: str, length: float, shift: tuple[float, float] = (0.0, 16.0), axes: Sequence[Axis] = ("x", "y", "z")
) -> list[Mark]:
    """Some axes of a frame ``T`` (4, 4), each with its letter, and its name beside the origin."""
    origin, marks = T[:3, 3], list[Mark]()
    for axis in axes:
        reach = length * T[:3, "xyz".index(axis)]
        marks += [arrow(origin, origin + reach, axis), label(origin + 1.17 * reach, axis, axis, (0.0, 4.0))]
    return [*marks, label(origin, name, "ink", shift)] if name else marks


def arc(center: ArrayLike, axis: ArrayLike, begin: ArrayLike, angle: float, ink: Ink = "turn") -> Line:
    """An arc with a head about ``axis`` (3,), from ``center`` + ``begin`` on by ``angle`` [rad]."""
    unit = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    start = np.asarray(begin, dtype=np.float64)
    turns = [rotation_from_vector(unit * part) @ start for part in np.linspace(0.0, angle, _ARC_POINTS)]
    return Line(np.asarray(center, dtype=np.float64) + np.array(turns), ink, arrow=True)


def circle(center: ArrayLike, axis: ArrayLike, radius: float, ink: Ink = "faint") -> Line:
    """A circle (closed) of ``radius`` [m] about an axis (3,) through ``center``."""
    unit = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    across = np.cross(unit, [0.0, 0.0, 1.0] if abs(unit[2]) < 0.9 else [1.0, 0.0, 0.0])
    begin = radius * across / np.linalg.norm(across)
    turns = [rotation_from_vector(unit * part) @ begin for part in np.linspace(0.0, 2.0 * math.pi, 2 * _ARC_POINTS)]
    return Line(np.asarray(center, dtype=np.float64) + np.array(turns), ink)


def sketch_svg(sketch: Sketch) -> str:
    """The drawing as the text of an SVG file; coordinates are rounded to a tenth of a pixel."""
    flat = _projection(sketch.azimuth, sketch.elevation)
    points = np.vstack([mark.points if isinstance(mark, Line) else mark.at[None] for mark in sketch.marks]) @ flat.T
    low, high = points.min(axis=0), points.max(axis=0)
    room = np.array([_WIDTH - 2.0 * _SIDE, _MOST_HEIGHT - _TOP - _BOTTOM])
    scale = float(np.min(room / np.maximum(high - low, 1e-9)))
    height = math.ceil(_TOP + scale * (high[1] - low[1]) + _BOTTOM)
    middle = np.array([0.5 * _WIDTH, 0.5 * (height + _TOP - _BOTTOM)])

    def pixels(at: Array) -> Array:
        return np.asarray(middle + scale * (at @ flat.T - 0.5 * (low + high)))

    drawn = [_line(mark, pixels(mark.points)) for mark in sketch.marks if isinstance(mark, Line)]
    words = [_label(mark, pixels(mark.at[None])[0]) for mark in sketch.marks if isinstance(mark, Label)]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:.0f} {height}" role="img"'
            ' font-family="sans-serif" font-size="13">',
            f"<title>{escape(sketch.title)}</title>",
            _style(),
            '<rect width="100%" height="100%"/>',
            *drawn,
            *words,
            "</svg>",
            "",
        ]
    )


def _style() -> str:
    """Colours of lines and words on a light page, and where the reader's system asks for it, on a dark one."""

    def colours(ground: str, inks: dict[str, str]) -> str:
        rules = "".join(f"path.{ink}{{stroke:{colour}}}text.{ink}{{fill:{colour}}}" for ink, colour in inks.items())
        return f"rect{{fill:{ground}}}text{{stroke:{ground}}}{rules}"

    dark = f"@media(prefers-color-scheme:dark){{{colours('#16191d', _DARK)}}}"
    return f"<style>path{{fill:none}}text{{paint-order:stroke;stroke-width:4px}}{colours('#fff', _LIGHT)}{dark}</style>"


def _projection(azimuth: float, elevation: float) -> Array:
    """Right and down (2, 3) of the picture for a viewer at these angles [deg], infinitely far away."""
    a, e = math.radians(azimuth), math.radians(elevation)
    right = [-math.sin(a), math.cos(a), 0.0]
    up = [-math.sin(e) * math.cos(a), -math.sin(e) * math.sin(a), math.cos(e)]
    return np.array([right, [-part for part in up]])


def _line(mark: Line, at: Array) -> str:
    path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in at.tolist())
    if mark.arrow:
        path += _head(at)
    dashes = _DASHES if mark.dashed else ""
    return (
        f'<path class="{mark.ink}" d="{path}" stroke-width="{mark.width:g}" stroke-linecap="round"'
        f' stroke-linejoin="round"{dashes}/>'
    )


def _head(at: Array) -> str:
    """Two short strokes at the end of a line; nothing where the line points at the viewer."""
    back = at[-2] - at[-1]
    length = float(np.hypot(*back))
    if float(np.hypot(*(at[0] - at[-1]))) < 1.0 or length < 1e-6:
        return ""
    along, across = _HEAD * back / length, 0.4 * _HEAD * np.array([-back[1], back[0]]) / length
    left, right, tip = at[-1] + along + across, at[-1] + along - across, at[-1]
    return f"M{left[0]:.1f} {left[1]:.1f}L{tip[0]:.1f} {tip[1]:.1f}L{right[0]:.1f} {right[1]:.1f}"


def _label(mark: Label, at: Array) -> str:
    x, y = at + np.array(mark.shift)
    return f'<text class="{mark.ink}" x="{x:.1f}" y="{y:.1f}" text-anchor="{mark.anchor}">{escape(mark.text)}</text>'
