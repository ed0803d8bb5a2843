"""Figures of the page on accuracy: errors by stage, residual vectors, the pair."""

from __future__ import annotations

from dataclasses import replace

from cellapp.commands.calibrate.charts_accuracy import (
    error_histogram_chart,
    pair_held_out,
    pair_histogram_chart,
    pair_stop_chart,
    stop_error_chart,
)
from cellapp.commands.calibrate.charts_joints import joint_curve_charts
from cellapp.commands.calibrate.charts_vectors import vector_charts
from cellapp.commands.collect.charts_drift import residual_drift_chart
from cellapp.commands.report.data import ReportData
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.interfaces.page.captioned import CaptionedFigure
from cellapp.interfaces.page.cell_scene import typical_stops
from cellapp.interfaces.page.chart_figure import chart_figure
from cellapp.interfaces.render.chart_style import LegendEntry


def accuracy_figures(data: ReportData) -> list[CaptionedFigure]:
    """Position errors by configuration and as a histogram, two figures for each arm."""
    drawn = []
    for number, (name, held_out) in enumerate(data.held_out.items(), start=1):
        floor, absent = data.calibrate.arms[name].tracker_mm, _absent_stages(data, name)
        for key, chart in (
            (f"errors{number}", stop_error_chart(name, held_out, floor)),
            (f"histogram{number}", error_histogram_chart(name, held_out.errors_mm, floor)),
        ):
            figure = chart_figure(key, chart)
            drawn.append(replace(figure, legend=(*figure.legend, *absent)))
    return drawn


def _absent_stages(data: ReportData, name: str) -> tuple[LegendEntry, ...]:
    """Why a stage is not drawn."""
    errors = data.held_out[name].errors_mm
    if "geometry" not in errors:
        words = "models of later stages: not stored by the older version of cellapp that calibrated"
    elif "effects" not in errors:
        words = f"no effects: {_why_no_effects(data)}"
    else:
        return ()
    return (LegendEntry(None, words),)


def _why_no_effects(data: ReportData) -> str:
    if data.discover is not None:
        return "none was found"
    return "not searched for yet" if data.results.discover is None else "the search is out of date"


def pair_figures(calibrate: CalibrateResult) -> list[CaptionedFigure]:
    """Cooperative errors by method, by stop and as a histogram; empty if they were not stored for each stop."""
    if not pair_held_out(calibrate):
        return []
    return [
        chart_figure("pair-errors", pair_stop_chart(calibrate)),
        chart_figure("pair-histogram", pair_histogram_chart(calibrate)),
    ]


def residual_figures(data: ReportData) -> list[CaptionedFigure]:
    """Residuals of the newest model over the run, and those of the identified geometry as vectors in two frames."""
    return [
        *(
            chart_figure(f"run{number}", residual_drift_chart(name, data.readings[name].time_s, residuals))
            for number, (name, residuals) in enumerate(data.residuals_M.items(), start=1)
        ),
        *(
            chart_figure(f"vectors{number}-{place}", chart)
            for number, (name, held_out) in enumerate(data.held_out.items(), start=1)
            if "geometry" in held_out.errors_mm
            for place, chart in enumerate(vector_charts(name, held_out), start=1)
        ),
    ]


def joint_curve_figures(data: ReportData) -> dict[str, tuple[CaptionedFigure, ...]]:
    """What the effects of the newest model turn each joint by, for every arm."""
    stops = typical_stops(data.readings)
    return {
        name: tuple(
            chart_figure(f"joint{number}-{place}", chart)
            for place, chart in enumerate(
                joint_curve_charts(name, arm, data.readings[name], data.conditions[name], stops[name]), start=1
            )
        )
        for number, (name, arm) in enumerate(data.model.arms.items(), start=1)
    }
