"""Figures of the page on accuracy: errors by stage, residual vectors, the pair, verified targets.

Functions import the drawing modules themselves: those load matplotlib, which only writing a page needs.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.kinematics.chain import smr_positions
from cellapp.kinematics.transforms import apply, invert
from cellapp.reporting.captioned import CaptionedFigure
from cellapp.reporting.cell_views import evenly_spread
from cellapp.reporting.charts_accuracy import pair_held_out
from cellapp.reporting.report_data import HeldOutArm, ReportData
from cellapp.reporting.tables import cooperative_noise_mm
from cellapp.reporting.words import METHOD_WORDS, STAGE_WORDS
from cellapp.results import CalibrateResult, Method

_MOST_ARROWS = 150
"""Residuals drawn as arrows of each arm: more overlap."""
_METHOD_COLOURS: Mapping[Method, str] = {
    "method_1": "geometry",
    "method_2": "tracker-network",
    "proposed": "network",
    "effects": "effects",
}
"""Methods of the pair that are drawn, with their colours in the style sheet."""


def accuracy_figures(data: ReportData) -> list[CaptionedFigure]:
    """Position errors by configuration and as a histogram, two figures for each arm."""
    from cellapp.reporting import figures

    drawn = []
    for number, (name, held_out) in enumerate(data.held_out.items(), start=1):
        errors, floor = held_out.errors_mm, data.calibrate.arms[name].tracker_mm
        legend = [(stage, STAGE_WORDS[stage]) for stage in errors] + _floor_legend(floor)
        if "geometry" not in errors:
            legend.append(("", "models of later stages: not stored by the older version of cellapp that calibrated"))
        elif "effects" not in errors:
            legend.append(("", f"no effects: {_why_no_effects(data)}"))
        svg = figures.error_figure(f"errors{number}", held_out.readings.configuration, errors, floor)
        caption = f"Arm {name}: position error of each held-out configuration"
        drawn.append(CaptionedFigure(svg, caption, tuple(legend)))
        svg = figures.error_histogram(f"residuals{number}", errors, floor)
        drawn.append(CaptionedFigure(svg, f"Arm {name}: distribution of the position errors", tuple(legend)))
    return drawn


def _why_no_effects(data: ReportData) -> str:
    if data.discover is not None:
        return "none was found"
    return "not searched for yet" if data.results.discover is None else "the search is out of date"


def pair_figures(calibrate: CalibrateResult) -> list[CaptionedFigure]:
    """Cooperative errors by method, by stop and as a histogram; empty if they were not stored for each stop."""
    from cellapp.reporting import figures

    stored = pair_held_out(calibrate)
    if not stored:
        return []
    errors = {_METHOD_COLOURS[method]: np.array(stops.cooperative_mm) for method, stops in stored.items()}
    stops = np.array(next(iter(stored.values())).configuration, dtype=np.int64)
    floor = cooperative_noise_mm(calibrate)
    legend = [(_METHOD_COLOURS[method], f"{method}: {METHOD_WORDS[method]}") for method in stored]
    legend += _floor_legend(floor)
    label = "cooperative error [mm]"
    return [
        CaptionedFigure(
            figures.error_figure("pair-errors", stops, errors, floor, label),
            "Pair: cooperative error of each held-out stop",
            tuple(legend),
        ),
        CaptionedFigure(
            figures.error_histogram("pair-residuals", errors, floor, label),
            "Pair: distribution of the cooperative errors",
            tuple(legend),
        ),
    ]


def residual_vector_figures(data: ReportData) -> list[CaptionedFigure]:
    """Residuals of the identified geometry as vectors, in the tracker frame and in the base frame of each arm."""
    return [
        figure
        for number, (name, held_out) in enumerate(data.held_out.items(), start=1)
        if "geometry" in held_out.errors_mm
        for figure in _vector_figures(number, name, held_out)
    ]


def _vector_figures(number: int, name: str, held_out: HeldOutArm) -> list[CaptionedFigure]:
    from cellapp.reporting import figures

    readings, geometry = held_out.readings, held_out.calibrated.geometry
    shown = readings.take(evenly_spread(len(readings), _MOST_ARROWS))
    residual_M = shown.p_M - smr_positions(geometry, shown.q)
    T_B_M = invert(geometry.T_M_B())
    residual_B = residual_M @ T_B_M[:3, :3].T
    length = figures.scale_length_mm(residual_M)
    count = f"{len(shown)} of {len(readings)} held-out configurations"
    legend = (("geometry", "measured minus computed position"), ("", count))
    return [
        CaptionedFigure(
            figures.vector_figure(f"vectors-tracker{number}", shown.p_M, residual_M, length),
            f"Arm {name}: residuals of the geometry in the tracker frame",
            legend,
        ),
        CaptionedFigure(
            figures.vector_figure(f"vectors-base{number}", apply(T_B_M, shown.p_M), residual_B, length),
            f"Arm {name}: residuals of the geometry in its base frame",
            legend,
        ),
    ]


def _floor_legend(floor_mm: float | None) -> list[tuple[str, str]]:
    return [] if floor_mm is None else [("floor", f"noise floor, {floor_mm:.3f} mm")]
