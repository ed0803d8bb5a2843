"""Figures of effects that offset joints, drawn from the models at a typical size."""

from __future__ import annotations

import numpy as np

from cellapp.robot.effects import EFFECTS, MeasurementConditions
from cellapp.robot.kinematics.transforms import Array
from tests.handbook.chart import Chart, Series
from tests.handbook.scene import Scene, joint_offset, swept

TURN = np.linspace(-180.0, 180.0, 181)
"""Angles [deg] over a whole turn."""
_HOURS = np.linspace(0.0, 4.0, 161)
_MICRO = 1e-6
_OFFSET = "offset of the joint [µrad]"


def joint_compliance(scene: Scene) -> Chart:
    """Offset of joint 2 over its torque: 9e4 Nm/rad, and half as much again below a knee of 40 Nm."""
    context = scene.context(scene.anywhere(120))
    torque = context.torques[:, 1]
    order = np.argsort(torque)
    linear = EFFECTS["joint_compliance"].law("linear")
    knee = EFFECTS["joint_compliance"].law("two_slope", {"knee2": 40.0})
    stiff = {"compliance2": 1.0 / 9e4}
    return Chart(
        "Joint 2 deflects with the gravity torque on it",
        "gravity torque on joint 2 [Nm]",
        _OFFSET,
        (
            Series("90 kNm/rad", torque[order], joint_offset(context, "joint_compliance", linear, stiff)[order]),
            Series(
                "softer below 40 Nm",
                torque[order],
                joint_offset(context, "joint_compliance", knee, {**stiff, "soft2": 0.5 / 9e4})[order],
            ),
        ),
    )


def payload_compliance(scene: Scene) -> Chart:
    """Offset of joint 2 over its angle with three payloads, 9e4 Nm/rad, elbow straight."""
    angle = np.linspace(-180.0, 0.0, 91)
    q = swept(scene.stretched(len(angle)), 2, angle)
    law = EFFECTS["payload_compliance"].law()
    series = []
    for mass in (0.0, 5.0, 10.0):
        context = scene.context(q, MeasurementConditions(payload_kg=np.full(len(angle), mass)))
        offset = joint_offset(context, "payload_compliance", law, {"payload_compliance2": 1.0 / 9e4})
        series.append(Series(f"payload {mass:.0f} kg", angle, offset))
    return Chart("Joint 2 deflects with the payload alone", "joint 2 [deg]", _OFFSET, tuple(series))


def encoder_eccentricity(scene: Scene) -> Chart:
    """Offset over a turn of joint 1: a disc of 25 mm radius, 2 µm off its axis."""
    context = scene.context(swept(scene.stretched(len(TURN)), 1, TURN))
    law = EFFECTS["encoder_eccentricity"].law()
    offset = joint_offset(context, "encoder_eccentricity", law, {"sin1q1": 80 * _MICRO})
    return Chart(
        "One cycle per revolution of the joint", "joint 1 [deg]", _OFFSET, (Series("2 µm on 25 mm", TURN, offset),)
    )


def transmission_error(scene: Scene) -> Chart:
    """Offset over a quarter of a turn of joint 1: two cycles per revolution, and the line of a 1:50 gear on it."""
    angle = np.linspace(-45.0, 45.0, 271)
    context = scene.context(swept(scene.stretched(len(angle)), 1, angle))
    effect = EFFECTS["transmission_error"]
    two = {"cos2q1": 40 * _MICRO}
    smooth = joint_offset(context, "transmission_error", effect.law("two"), two)
    lines = joint_offset(context, "transmission_error", effect.law("gear", {"ratio": 50.0}), two | {"sin50q1": 20e-6})
    return Chart(
        "Two cycles per revolution, and 50 cycles per revolution of the gear",
        "joint 1 [deg]",
        _OFFSET,
        (Series("with 50 cycles per revolution", angle, lines), Series("two cycles per revolution", angle, smooth)),
    )


def backlash(scene: Scene) -> Chart:
    """Offset of joint 2 over its last step: half play of 40 µrad, the same after any step or taken up gradually."""
    degrees = np.concatenate([np.linspace(-60.0, -0.5, 60), np.linspace(0.5, 60.0, 60)])
    step = _one_joint(1, np.radians(degrees))
    context = scene.context(scene.stretched(len(degrees)), MeasurementConditions(approach=np.sign(step), step=step))
    effect, play = EFFECTS["backlash"], {"half_play2": 40 * _MICRO}
    saturating = effect.law("saturating", {"width": 0.2})
    return Chart(
        "The joint lags behind its last motion",
        "last step of joint 2 [deg]",
        _OFFSET,
        (
            Series("play", degrees, joint_offset(context, "backlash", effect.law("constant"), play)),
            Series("hysteresis", degrees, joint_offset(context, "backlash", saturating, play)),
        ),
    )


def friction_windup(scene: Scene) -> Chart:
    """Offset of joint 2 over its torque after a motion up and one down: 20 µrad dry, 2 µrad/Nm under load."""
    q = scene.anywhere(120)
    law = EFFECTS["friction_windup"].law("both")
    series = []
    for sign, label in ((1.0, "last motion up"), (-1.0, "last motion down")):
        context = scene.context(q, MeasurementConditions(approach=np.full(q.shape, sign)))
        order = np.argsort(context.torques[:, 1])
        offset = joint_offset(context, "friction_windup", law, {"dry2": 20 * _MICRO, "windup2": 2 * _MICRO})
        series.append(Series(label, context.torques[order, 1], offset[order]))
    return Chart("Two bands that open with the load", "gravity torque on joint 2 [Nm]", _OFFSET, tuple(series))


def unsettled_measurement(scene: Scene) -> Chart:
    """Offset of joint 2 over the dwell after steps of 1 rad: 1.5e-4 missing at rest, time constant 2 s."""
    dwell = np.linspace(0.0, 10.0, 101)
    law = EFFECTS["unsettled_measurement"].law("creep", {"tau_s": 2.0, "dwell_s": 2.0})
    series = []
    for step, label in ((1.0, "after +1 rad"), (-1.0, "after -1 rad")):
        conditions = MeasurementConditions(step=_one_joint(1, np.full(len(dwell), step)), dwell_s=dwell)
        context = scene.context(scene.stretched(len(dwell)), conditions)
        series.append(Series(label, dwell, joint_offset(context, "unsettled_measurement", law, {"lag2": 1.5e-4})))
    return Chart("What is missing dies away while the arm rests", "dwell [s]", _OFFSET, tuple(series))


def joint_drift(scene: Scene) -> Chart:
    """Offset of joint 2 over time: 40 µrad in four hours, steadily or with a time constant of 30 minutes."""
    seconds = 3600.0 * _HOURS
    context = scene.context(scene.stretched(len(_HOURS)), MeasurementConditions(time_s=seconds))
    effect, span = EFFECTS["joint_drift"], {"first_s": 0.0, "last_s": float(seconds[-1])}
    laws = {"steadily": effect.law("linear", span), "warming up": effect.law("warm_up", {**span, "tau_s": 1800.0})}
    return Chart(
        "The zero of a joint drifts",
        "time since the run began [h]",
        _OFFSET,
        tuple(
            Series(label, _HOURS, joint_offset(context, "joint_drift", law, {"drift2": 40 * _MICRO}))
            for label, law in laws.items()
        ),
    )


def unknown(scene: Scene) -> Chart:
    """A data-driven term: joint 4 is driven by three times the angle of joint 5."""
    context = scene.context(swept(scene.stretched(len(TURN)), 5, TURN))
    law = EFFECTS["unknown"].law("joint 4|q5", {"order": 4.0})
    terms = {"joint_4.cos1_q5": 30 * _MICRO, "joint_4.sin3_q5": 100 * _MICRO}
    return Chart(
        "A curve that the library has no name for: joint 4 depends on joint 5",
        "joint 5 [deg]",
        "offset of joint 4 [µrad]",
        (Series("joint 4|q5", TURN, joint_offset(context, "unknown", law, terms)),),
    )


def _one_joint(joint: int, values: Array, joints: int = 6) -> Array:
    """Values (n,) of one joint (from 0), zero for the others (n, N)."""
    every = np.zeros((len(values), joints))
    every[:, joint] = values
    return every
