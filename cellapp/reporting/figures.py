"""Figures of errors, residuals and effects as inline SVG. Pure drawing, from arrays to text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import NDArray

from cellapp.kinematics.transforms import Array
from cellapp.reporting.charts import SMALLEST_MM, drawable_mm, error_counts
from cellapp.reporting.charts_discovery import is_line, typical_range, with_micro_sign
from cellapp.reporting.svg import (
    ARM_COLOUR,
    ARM_COLOURS,
    GRID,
    INK,
    SIZE,
    STAGE_COLOURS,
    draw_arrows,
    draw_marks,
    drawing_settings,
    new_axes,
    padded_limits,
    set_log_axis,
    to_svg,
)
from cellapp.results import Picture

_CAPS = {
    "nominal": "butt",
    "geometry": "round",
    "network": "round",
    "tracker-network": "butt",
    "effects": "projecting",
}
"""Shape of the marks of each stage: dash, dot or square, so that they differ without colour too."""
_DASHES = ("nominal", "tracker-network")
_TURN = 360.0
_ARROW = 0.18
"""Length of the scale arrow as a share of the drawn range: shorter ones hide differences, longer ones overlap."""


def error_figure(
    key: str,
    configurations: NDArray[np.int64],
    errors_mm: Mapping[str, Array],
    floor_mm: float | None,
    label: str = "position error [mm]",
) -> str:
    """Error (n,) [mm] of each configuration by stage, on a logarithmic axis; ids in the SVG begin with ``key``."""
    with drawing_settings(key):
        figure, axes = new_axes()
        width = 2.6 if len(configurations) < 500 else 1.5
        for stage, errors in errors_mm.items():
            half = 0.005 * float(np.ptp(configurations)) if stage in _DASHES else 0.0
            draw_marks(
                axes,
                configurations,
                drawable_mm(errors),
                STAGE_COLOURS[stage],
                _CAPS[stage],
                width=width,
                half=half,
            )
        shown = drawable_mm(np.concatenate(list(errors_mm.values())))
        axes.set_xlim(*padded_limits(configurations))
        set_log_axis(axes.yaxis, shown, floor_mm)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("configuration")
        axes.set_ylabel(label)
        if floor_mm is not None:
            axes.axhline(floor_mm, color=INK, linewidth=1.0, linestyle="--")
        return to_svg(figure, key)


def error_histogram(
    key: str, errors_mm: Mapping[str, Array], floor_mm: float | None, label: str = "position error [mm]"
) -> str:
    """Histogram of the errors [mm] of some stages on a logarithmic axis, with the noise floor."""
    with drawing_settings(key):
        figure, axes = new_axes()
        shown = drawable_mm(np.concatenate(list(errors_mm.values())))
        set_log_axis(axes.xaxis, shown, floor_mm)
        low, high = axes.get_xlim()
        edges, histograms = error_counts(errors_mm, low, high)
        for stage, counts in histograms.items():
            axes.stairs(counts, edges, fill=True, color=STAGE_COLOURS[stage], alpha=0.3)
            axes.stairs(counts, edges, color=STAGE_COLOURS[stage], linewidth=1.3)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel(label)
        axes.set_ylabel("configurations")
        if floor_mm is not None:
            axes.axvline(floor_mm, color=INK, linewidth=1.0, linestyle="--")
        return to_svg(figure, key)


def steps_figure(key: str, gaps_mm: Array, floor_mm: float | None) -> str:
    """Held-out rms (n,) [mm] before any step and after each, on a logarithmic axis, against the noise floor."""
    with drawing_settings(key):
        figure, axes = new_axes()
        number = np.arange(len(gaps_mm))
        shown = drawable_mm(gaps_mm)
        axes.plot(number, shown, color=STAGE_COLOURS["geometry"], linewidth=1.3)
        axes.plot(number, shown, "o", color=STAGE_COLOURS["geometry"], markersize=5.0)
        set_log_axis(axes.yaxis, shown, floor_mm)
        axes.set_xlim(-0.4, max(len(gaps_mm) - 1, 1) + 0.4)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("step")
        axes.set_ylabel("held-out rms [mm]")
        if floor_mm is not None:
            axes.axhline(floor_mm, color=INK, linewidth=1.0, linestyle="--")
        return to_svg(figure, key)


def drift_figure(key: str, drift_mm: Sequence[Sequence[tuple[int, float]]], limit_mm: float) -> str:
    """Drift of each reference, as pairs of stops done and drift [mm], against the limit."""
    with drawing_settings(key):
        figure, axes = new_axes()
        for number, rows in enumerate(drift_mm):
            stops, drift = zip(*rows, strict=True)
            axes.plot(stops, drift, "o-", color=ARM_COLOUR[number % ARM_COLOURS], linewidth=1.3, markersize=3.5)
        axes.axhline(limit_mm, color=INK, linewidth=1.0, linestyle="--")
        axes.set_ylim(bottom=0.0)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("stops done")
        axes.set_ylabel("distance from the first one [mm]")
        return to_svg(figure, key)


def effect_figure(key: str, picture: Picture) -> str:
    """Measured points of one effect, and the computed curve with two standard deviations to either side, or points."""
    measured, computed, at = np.array(picture.measured), np.array(picture.computed), np.array(picture.x)
    shown = picture if picture.curve is None else picture.curve
    x, band = np.array(shown.x), np.array(shown.band)
    value = computed if picture.curve is None else np.array(picture.curve.value)
    with drawing_settings(key):
        figure, axes = new_axes()
        width = 2.6 if len(at) < 400 else 1.8
        draw_marks(axes, at, measured, STAGE_COLOURS["nominal"], "round", width=width)
        colour = STAGE_COLOURS["effects"]
        if is_line(picture):
            if len(band):
                axes.fill_between(x, value - 2.0 * band, value + 2.0 * band, color=colour, alpha=0.25, linewidth=0.0)
            axes.plot(x, value, color=colour, linewidth=1.3)
        else:
            draw_marks(axes, x, value, colour, "projecting", width=width)
        axes.set_ylim(*typical_range(np.concatenate([measured, value]), computed))
        axes.set_xlim(*padded_limits(at) if picture.curve is None else (float(x[0]), float(x[-1])))
        if picture.curve is not None and x[-1] - x[0] == _TURN:
            axes.xaxis.set_major_locator(MultipleLocator(60.0))
        axes.set_xlabel(with_micro_sign(picture.x_label))
        axes.set_ylabel(with_micro_sign(picture.y_label))
        return to_svg(figure, key)


def certainty_figure(key: str, predicted_mm: Array, errors_mm: Array) -> str:
    """Position error (n,) [mm] against the standard deviation of a coordinate (n,) that the model predicts for it.

    The line is where the error is the root mean square length that the prediction stands for.
    """
    with drawing_settings(key):
        figure, axes = new_axes()
        predicted, errors = drawable_mm(predicted_mm), drawable_mm(errors_mm)
        set_log_axis(axes.xaxis, predicted, None)
        set_log_axis(axes.yaxis, errors, None)
        draw_marks(axes, predicted, errors, STAGE_COLOURS["effects"], "round", width=2.6 if len(errors) < 500 else 1.5)
        ends = np.array(axes.get_xlim())
        axes.plot(ends, np.sqrt(3.0) * ends, color=INK, linewidth=1.0, linestyle="--")
        axes.set_xlabel("predicted standard deviation of a coordinate [mm]")
        axes.set_ylabel("position error [mm]")
        return to_svg(figure, key)


def vector_figure(key: str, points: Array, vectors: Array, length_mm: float) -> str:
    """Vectors (n, 3) [m] at points (n, 3) [m], seen along z and along y, enlarged.

    The arrow of ``length_mm`` above each view gives the scale; ``scale_length_mm`` finds one.
    """
    with drawing_settings(key):
        figure = Figure(figsize=SIZE, layout="constrained")
        reach = float(np.max(np.ptp(points, axis=0))) or 1.0
        enlarged = _ARROW * reach / (length_mm * 1e-3)
        for place, up in enumerate((1, 2)):
            axes = figure.add_subplot(1, 2, place + 1)
            axes.grid(color=GRID, linewidth=0.6)
            axes.set_aspect("equal", adjustable="datalim")
            flat = points[:, (0, up)]
            draw_arrows(axes, flat, vectors[:, (0, up)] * enlarged, STAGE_COLOURS["geometry"], 0.03 * reach)
            ends = np.vstack([flat, flat + vectors[:, (0, up)] * enlarged])
            low, high = ends.min(axis=0), ends.max(axis=0)
            key_at = np.array([[low[0], high[1] + 0.1 * reach]])
            draw_arrows(axes, key_at, np.array([[_ARROW * reach, 0.0]]), INK, 0.03 * reach)
            axes.text(key_at[0, 0] + 0.22 * reach, key_at[0, 1], f"{length_mm:g} mm", va="center", fontsize=8.5)
            axes.update_datalim(np.vstack([low, high, key_at + np.array([0.0, 0.06 * reach])]))
            axes.margins(0.06)
            axes.autoscale_view()
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(MaxNLocator(4))
            axes.set_xlabel("x [m]")
            axes.set_ylabel(f"{'xyz'[up]} [m]")
        return to_svg(figure, key)


def scale_length_mm(vectors: Array) -> float:
    """A round length [mm] near that of the larger ones of ``vectors`` (n, 3) [m]."""
    large = max(float(np.quantile(np.linalg.norm(vectors, axis=1), 0.9)) * 1e3, SMALLEST_MM)
    decade = 10.0 ** np.floor(np.log10(large))
    return float(f"{decade * max(step for step in (1.0, 2.0, 5.0) if step * decade <= large * (1.0 + 1e-9)):.3g}")
