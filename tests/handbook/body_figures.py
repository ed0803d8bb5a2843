"""Figures of effects that move links, axes, base, target or readings, drawn from the models at a typical size."""

from __future__ import annotations

import numpy as np

from cellapp.robot.effects import EFFECTS, EffectContext, Law, MeasurementConditions
from cellapp.robot.kinematics.transforms import Array
from tests.handbook.chart import Chart, Series
from tests.handbook.joint_figures import TURN
from tests.handbook.scene import Scene, lengths, smr_shift, swept

_HOURS = np.linspace(0.0, 4.0, 161)
_SPAN = {"first_s": 0.0, "last_s": 14400.0}
_MICRO = 1e-6
_TIME = "time since the run began [h]"
_MOVED = "displacement of the SMR [µm]"
_STIFFNESS = 2e6
"""Of a pedestal [Nm/rad], estimate."""


def link_bending(scene: Scene) -> Chart:
    """Displacement over joint 2 with the elbow straight and bent: upper arm with EI = 1e5 N m^2."""
    angle = np.linspace(-180.0, 0.0, 91)
    law = EFFECTS["link_bending"].law("bending")
    series = []
    for label, elbow in (("elbow straight", 0.0), ("elbow at 90 deg", 90.0)):
        context = scene.context(swept(swept(scene.stretched(len(angle)), 2, angle), 3, np.full(len(angle), elbow)))
        series.append(Series(label, angle, lengths(smr_shift(context, "link_bending", law, {"flexibility2": 1e-5}))))
    return Chart("The upper arm bends under what it carries", "joint 2 [deg]", _MOVED, tuple(series))


def joint_axis_wobble(scene: Scene) -> Chart:
    """Height of the SMR over a turn of joint 1: its axis tilts by 15 µrad, twice a turn."""
    law = EFFECTS["joint_axis_wobble"].law()
    tilt = {"wobble_x1_cos": 15 * _MICRO}
    series = []
    for label, q in (("arm stretched", scene.stretched(len(TURN))), ("arm folded", scene.folded(len(TURN)))):
        context = scene.context(swept(q, 1, TURN))
        series.append(Series(label, TURN, smr_shift(context, "joint_axis_wobble", law, tilt) @ scene.up_M))
    return Chart("The axis of joint 1 tilts as it turns", "joint 1 [deg]", "rise of the SMR [µm]", tuple(series))


def joint_axis_runout(scene: Scene) -> Chart:
    """Displacement over a turn of joint 1: its axis shifts by 20 µm along itself once, across twice a turn."""
    law = EFFECTS["joint_axis_runout"].law()
    series = []
    for label, name in (("axial, 1 cycle", "runout_z1_cos1"), ("radial, 2 cycles", "runout_x1_cos2")):
        context = scene.context(swept(scene.stretched(len(TURN)), 1, TURN))
        shift = smr_shift(context, "joint_axis_runout", law, {name: 20 * _MICRO})
        series.append(Series(label, TURN, _along_largest(shift)))
    return Chart("The axis of joint 1 shifts as it turns", "joint 1 [deg]", _MOVED, tuple(series))


def thermal_growth(scene: Scene) -> Chart:
    """Displacement over time: aluminium links that warm up by 7 K with a time constant of 30 minutes."""
    law = EFFECTS["thermal_growth"].law("warm_up", {**_SPAN, "tau_s": 1800.0})
    return Chart(
        "Links grow as they warm up", _TIME, _MOVED, _both_poses(scene, "thermal_growth", law, {"growth": 7 * 23e-6})
    )


def base_drift(scene: Scene) -> Chart:
    """Displacement over time: 30 µm and 5 µrad, steadily, with a time constant of 30 minutes, and with a bow."""
    effect, twist = EFFECTS["base_drift"], {"base_drift_x": 30 * _MICRO, "base_drift_turn_z": 5 * _MICRO}
    context = _over_time(scene, scene.stretched(len(_HOURS)))
    laws = (
        ("steadily", effect.law("linear", _SPAN), twist),
        ("warming up", effect.law("warm_up", {**_SPAN, "tau_s": 1800.0}), twist),
        ("with a bow", effect.law("quadratic", _SPAN), {**twist, "base_drift_x_bow": 20 * _MICRO}),
    )
    series = [
        Series(label, _HOURS, lengths(smr_shift(context, "base_drift", law, values))) for label, law, values in laws
    ]
    return Chart("The base drifts against the tracker", _TIME, _MOVED, tuple(series))


def base_step(scene: Scene) -> Chart:
    """Displacement over time: the base shifts by 20 µm and turns by 20 µrad after an hour and a half."""
    law = EFFECTS["base_step"].law("onset", {"onset_s": 5400.0})
    twist = {"base_step_x": 20 * _MICRO, "base_step_turn_y": 20 * _MICRO}
    return Chart("The base moves at once", _TIME, _MOVED, _both_poses(scene, "base_step", law, twist))


def target_slip(scene: Scene) -> Chart:
    """Height of the SMR at random poses: it slips by 60 µm in the flange after an hour and a half."""
    law = EFFECTS["target_slip"].law("onset", {"onset_s": 5400.0})
    shift = smr_shift(_over_time(scene, scene.anywhere(len(_HOURS))), "target_slip", law, {"slip_x": 60 * _MICRO})
    return Chart(
        "The target slips: its displacement turns with the wrist",
        _TIME,
        "rise of the SMR [µm]",
        (Series("random poses", _HOURS, shift @ scene.up_M, "points"),),
    )


def pedestal_compliance(scene: Scene) -> Chart:
    """Displacement at random poses over the arm's own moment about its base: 2e6 Nm/rad."""
    context = scene.context(scene.anywhere(160))
    law = EFFECTS["pedestal_compliance"].law("isotropic")
    shift = smr_shift(context, "pedestal_compliance", law, {"pedestal_tilt": 1.0 / _STIFFNESS})
    moment = lengths(context.loads.beyond(0)[1])
    return Chart(
        "The pedestal tilts under the arm's own weight",
        "moment of the arm about its base [Nm]",
        _MOVED,
        (Series("random poses", moment, lengths(shift), "points"),),
    )


def pedestal_coupling(scene: Scene) -> Chart:
    """Displacement over the other arm's moment, this arm at rest: 2e6 Nm/rad."""
    moment = np.linspace(-60.0, 60.0, 61)
    other_M = moment[:, None] * np.array([1.0, 0.0, 0.0])
    law = EFFECTS["pedestal_coupling"].law("isotropic", {"mean_x": 0.0, "mean_y": 0.0, "mean_z": 0.0})
    series = []
    for label, q in (("arm stretched", scene.stretched(len(moment))), ("arm folded", scene.folded(len(moment)))):
        context = scene.context(q, MeasurementConditions(other_moment_M=other_M))
        shift = smr_shift(context, "pedestal_coupling", law, {"coupling": 1.0 / _STIFFNESS})
        series.append(Series(label, moment, _along_largest(shift)))
    return Chart("The base tilts under the other arm's weight", "moment of the other arm [Nm]", _MOVED, tuple(series))


def tracker_scale(scene: Scene) -> Chart:
    """Error along the beam over the distance: 5 ppm."""
    return _along_beam(scene, "tracker_scale", {"scale": 5 * _MICRO}, "The tracker's scale is wrong", "5 µm/m")


def tracker_distance_offset(scene: Scene) -> Chart:
    """Error along the beam over the distance: 10 µm."""
    title = "All distances are off by the same length"
    return _along_beam(scene, "tracker_distance_offset", {"distance_offset": 10 * _MICRO}, title, "10 µm")


def tracker_angle_error(scene: Scene) -> Chart:
    """Error across the beam over the azimuth: 5 µrad in the first and in the second order."""
    context = scene.context(scene.anywhere(160))
    law = EFFECTS["tracker_angle_error"].law("orders")
    azimuth, _, horizontal, _ = context.across
    series = []
    for label, name in (("one cycle per revolution", "azimuth_sin1"), ("two cycles per revolution", "azimuth_sin2")):
        shift = smr_shift(context, "tracker_angle_error", law, {name: 5 * _MICRO})
        series.append(Series(label, np.degrees(azimuth), np.einsum("na,na->n", shift, horizontal), "points"))
    return Chart(
        "The tracker's azimuth errs: a cell sees only a part of the turn",
        "azimuth of the tracker [deg]",
        "error across the beam [µm]",
        tuple(series),
    )


def target_incidence(scene: Scene) -> Chart:
    """Error along and across the beam over the angle of incidence: 20 µm and 10 µm."""
    context = scene.context(scene.anywhere(400))
    _, beam = context.beam
    angle = np.degrees(np.arccos(-np.einsum("na,na->n", context.frames[0][-1] @ scene.smr_normal, beam)))
    rows = np.argsort(angle)
    rows = rows[angle[rows] < 60.0]
    law = EFFECTS["target_incidence"].law("lateral")
    parts = (("along the beam", "incidence_radial", 20e-6), ("across the beam", "incidence_lateral", 10e-6))
    return Chart(
        "The reading changes with the angle of incidence",
        "angle of incidence [deg]",
        _MOVED,
        tuple(
            Series(label, angle[rows], lengths(smr_shift(context, "target_incidence", law, {name: size}))[rows])
            for label, name, size in parts
        ),
    )


def _along_beam(scene: Scene, slug: str, parameters: dict[str, float], title: str, label: str) -> Chart:
    context = scene.context(scene.anywhere(60))
    distance, beam = context.beam
    error = np.einsum("na,na->n", smr_shift(context, slug, EFFECTS[slug].law(), parameters), beam)
    order = np.argsort(distance)
    series = Series(label, distance[order], error[order])
    return Chart(title, "distance from the tracker [m]", "error along the beam [µm]", (series,))


def _over_time(scene: Scene, q: Array) -> EffectContext:
    return scene.context(q, MeasurementConditions(time_s=3600.0 * _HOURS))


def _both_poses(scene: Scene, slug: str, law: Law, parameters: dict[str, float]) -> tuple[Series, ...]:
    """Displacement over time in the stretched and in the folded pose."""
    poses = (("arm stretched", scene.stretched(len(_HOURS))), ("arm folded", scene.folded(len(_HOURS))))
    return tuple(
        Series(label, _HOURS, lengths(smr_shift(_over_time(scene, q), slug, law, parameters))) for label, q in poses
    )


def _along_largest(shift: Array) -> Array:
    """Component (n,) of shifts (n, 3) along the direction of the first, with its sign."""
    return np.asarray(shift @ (shift[0] / np.linalg.norm(shift[0])))
