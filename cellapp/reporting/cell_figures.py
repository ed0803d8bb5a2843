"""Drawings of the cell: from above, from the side, in space. Pure drawing, from arrays to SVG text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox

from cellapp.kinematics.transforms import Array
from cellapp.reporting.svg import (
    ARM_COLOUR,
    ARM_COLOURS,
    INK,
    SOFT,
    WIDE,
    draw_marks,
    drawing_settings,
    new_axes,
    to_svg,
)


@dataclass(frozen=True)
class ArmDrawing:
    """One arm in the levelled tracker frame [m].

    Measured points (n, 3), the base (3,), and the chain (k, 3) from the base over the joints to the SMR at one
    configuration.
    """

    points: Array
    base: Array
    chain: Array


def plane_figure(key: str, arms: Sequence[ArmDrawing], across: int, up: int) -> str:
    """The cell along one axis: coordinate ``across`` to the right, ``up`` upwards; the tracker is at the origin."""
    with drawing_settings(key):
        figure, axes = new_axes()
        axes.set_aspect("equal", adjustable="datalim")
        for number, arm in enumerate(arms):
            colour = ARM_COLOUR[number % ARM_COLOURS]
            draw_marks(axes, arm.points[:, across], arm.points[:, up], colour, "round", width=1.8)
            axes.plot(
                [0.0, arm.base[across]], [0.0, arm.base[up]], color=SOFT, linewidth=0.8, linestyle=":", zorder=1.0
            )
            axes.plot(arm.base[across], arm.base[up], "s", color=colour, markersize=9, markeredgecolor=INK)
        axes.plot(0.0, 0.0, "^", color=INK, markersize=9)
        axes.margins(0.06)
        axes.autoscale_view()
        axes.set_xlabel(f"{'xyz'[across]} [m]")
        axes.set_ylabel(f"{'xyz'[up]} [m]")
        return to_svg(figure, key)


def space_figure(key: str, arms: Sequence[ArmDrawing]) -> str:
    """The cell in space: tracker at the origin, each arm at one configuration, and the measured points."""
    with drawing_settings(key), matplotlib.rc_context({"path.simplify": False}):
        figure = Figure(figsize=WIDE)
        axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
        middle = np.mean([arm.base for arm in arms], axis=0)
        # look across the line from the tracker to the arms, so that its full length shows
        axes.view_init(elev=24.0, azim=float(np.degrees(np.arctan2(middle[1], middle[0]))) - 65.0)
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.pane.set_visible(False)
        for number, arm in enumerate(arms):
            _draw_arm(axes, arm, ARM_COLOUR[number % ARM_COLOURS])
        axes.plot([0.0], [0.0], [0.0], "^", color=INK, markersize=10)
        everything = np.vstack([np.zeros((1, 3)), *(part for arm in arms for part in (arm.points, arm.chain))])
        low, high = everything.min(axis=0), everything.max(axis=0)
        room = 0.04 * float(np.max(high - low))
        span = (high - low) / float(np.max(high - low))
        for name, a, b, share in zip("xyz", low - room, high + room, span, strict=True):
            axes.set(**{f"{name}lim": (a, b), f"{name}label": f"{name} [m]"})
            getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(max(2, round(6.0 * float(share)))))
        axes.set_box_aspect(high - low + 2.0 * room)
        return to_svg(figure, key, _around_box(axes, low - room, high + room))


def _draw_arm(axes: Any, arm: ArmDrawing, colour: str) -> None:
    """Measured points, line of sight, links, joints, SMR and base."""
    # all points as one line with gaps: a tenth of the SVG text of single markers
    gap = np.full_like(arm.points, np.nan)
    dots = np.stack([arm.points, arm.points + np.array([0.0, 0.0, 1e-4]), gap], axis=1).reshape(-1, 3)
    axes.plot(*dots.T, color=colour, linewidth=1.8, solid_capstyle="round", alpha=0.5)
    axes.plot(*np.array([np.zeros(3), arm.chain[-1]]).T, color=SOFT, linewidth=0.7, linestyle=":")
    axes.plot(*arm.chain.T, color=colour, linewidth=3.0, solid_capstyle="round")
    axes.plot(*arm.chain[1:-1].T, "o", color=INK, markersize=2.4)
    axes.plot(*arm.chain[-1:].T, "o", color=INK, markersize=4.5)
    axes.plot(*arm.base[None].T, "s", color=colour, markersize=8, markeredgecolor=INK)


def _around_box(axes: Any, low: Array, high: Array) -> Bbox:
    """The part of the figure [inch] that holds the box of a 3-D drawing and the labels around it."""
    axes.apply_aspect()
    corners = np.array([[*corner, 1.0] for corner in product(*zip(low, high, strict=True))]) @ axes.get_proj().T
    inches = axes.transData.transform(corners[:, :2] / corners[:, 3:]) / 72.0
    room = np.array([0.8, 0.55])
    return Bbox([inches.min(axis=0) - room, inches.max(axis=0) + room])
