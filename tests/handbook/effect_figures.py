"""The figure of every effect of the library."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from tests.handbook import body_figures, joint_figures
from tests.handbook.chart import Chart, chart_svg
from tests.handbook.scene import Scene

FIGURES: Mapping[str, Callable[[Scene], Chart]] = {
    "joint_compliance": joint_figures.joint_compliance,
    "payload_compliance": joint_figures.payload_compliance,
    "encoder_eccentricity": joint_figures.encoder_eccentricity,
    "transmission_error": joint_figures.transmission_error,
    "backlash": joint_figures.backlash,
    "friction_windup": joint_figures.friction_windup,
    "unsettled_measurement": joint_figures.unsettled_measurement,
    "joint_axis_wobble": body_figures.joint_axis_wobble,
    "joint_axis_runout": body_figures.joint_axis_runout,
    "thermal_growth": body_figures.thermal_growth,
    "joint_drift": joint_figures.joint_drift,
    "base_drift": body_figures.base_drift,
    "base_step": body_figures.base_step,
    "target_slip": body_figures.target_slip,
    "pedestal_compliance": body_figures.pedestal_compliance,
    "pedestal_coupling": body_figures.pedestal_coupling,
    "link_bending": body_figures.link_bending,
    "tracker_scale": body_figures.tracker_scale,
    "tracker_distance_offset": body_figures.tracker_distance_offset,
    "tracker_angle_error": body_figures.tracker_angle_error,
    "target_incidence": body_figures.target_incidence,
    "unknown": joint_figures.unknown,
}
"""What draws the figure of an effect, by its slug."""


def figure_svg(slug: str, scene: Scene) -> str:
    """The figure of an effect as the text of an SVG file."""
    return chart_svg(FIGURES[slug](scene))
