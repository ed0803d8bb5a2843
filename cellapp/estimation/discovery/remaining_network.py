"""Residual network after discovery: size of its remaining correction, and a model of unnamed effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellapp.estimation.calibration.learning import learn
from cellapp.estimation.discovery.held_out import HeldOut
from cellapp.estimation.discovery.outcome import Discovery
from cellapp.estimation.discovery.records import BeforeAfter, GapStep
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Report, ignore_report
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, ResidualNetwork

_READINGS_A_FOLD = 2
"""Least number of readings for each fold of a network's training: one reading has no scatter."""


def needs_network(profile: Profile, discovery: Discovery) -> bool:
    """Return whether the profile asks for a network beside the effects of this outcome.

    There is none beside effects from recordings: samples of motion contain what no pose at rest has.
    """
    motion = discovery.result.motion
    if profile.network.kind == "none" or (motion is not None and motion.used):
        return False
    asked = profile.discovery.network
    return asked == "always" or (asked == "unknown" and discovery.result.verdict == "unknown effect")


def with_network(
    profile: Profile,
    calibrated: ArmModel,
    discovery: Discovery,
    readings: Readings,
    conditions: MeasurementConditions,
    cancel: CancelToken,
    report: Report = ignore_report,
) -> Discovery:
    """Add to the outcome the corrections of a network before and after the accepted effects.

    The network joins the model only if an effect stays unknown and the network predicts the left-out folds of its
    training readings better than none. Held-out readings judge the result; they do not select it.
    """
    held_out = HeldOut.of(readings, conditions)
    network = discovery.model.network
    if discovery.terms:
        rows = np.concatenate([readings.in_split("identify"), readings.in_split("train")])
        network = _train(profile, discovery.model, readings.take(rows), conditions.take(rows), cancel, report)
    q = held_out.readings.q
    corrections = BeforeAfter(before=_correction_mm(calibrated.network, q), after=_correction_mm(network, q))
    found = discovery.result.model_copy(update={"network_mm": corrections})
    discovery = replace(discovery, result=found)
    if not discovery.terms or found.verdict != "unknown effect" or network is None:
        return discovery
    model = replace(discovery.model, network=network)
    step = GapStep(what="a network for the rest", effect="", heldout_mm=held_out.position_mm(model).rms)
    return discovery.with_model(model, held_out, steps=(*found.steps, step))


def _train(
    profile: Profile,
    model: ArmModel,
    readings: Readings,
    conditions: MeasurementConditions,
    cancel: CancelToken,
    report: Report,
) -> ResidualNetwork | None:
    """Train a network on the residuals of ``model``; None if it does not predict left-out readings better than none."""
    if len(readings) < _READINGS_A_FOLD * profile.network.folds:
        return None
    residual_M = readings.p_M - model.predict(readings.q, conditions=conditions)
    return learn(
        profile.network,
        readings.q,
        residual_M @ model.geometry.T_M_B()[:3, :3],
        readings.time_s,
        seed=profile.seed,
        cancel=cancel,
        report=report,
    ).network


def _correction_mm(network: ResidualNetwork | None, q: Array) -> float:
    """Return the rms length of a network's corrections [mm]."""
    if network is None:
        return 0.0
    return float(np.sqrt(np.mean(np.sum(network.correct(q) ** 2, axis=1)))) * 1e3
