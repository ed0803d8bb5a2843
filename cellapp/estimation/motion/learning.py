"""Residual network from all points of an arm's recordings, and from its readings at rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellapp.estimation.calibration.calibrate import ArmCalibration, with_networks
from cellapp.estimation.calibration.gross_errors import without
from cellapp.estimation.motion.identify import no_gross_errors
from cellapp.estimation.motion.records import MotionFit, RecordingFit
from cellapp.estimation.motion.summary import error_summary
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Told, ignore_words
from cellapp.ground.results import StageErrors
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, eq=False)
class _Left:
    """Residuals of geometry and lost motion at some points: joints (n, N) [rad] and differences (n, 3) [m]."""

    q: Array
    left_M: Array

    @classmethod
    def joined(cls, parts: list[_Left]) -> _Left:
        return cls(np.concatenate([part.q for part in parts]), np.concatenate([part.left_M for part in parts]))


def train_arm_in_motion(
    profile: Profile,
    arm: ArmCalibration,
    readings: Readings,
    fit: MotionFit,
    cancel: CancelToken | None = None,
    told: Told = ignore_words,
) -> ArmCalibration:
    """Train a network for an arm on all points of its recordings outside held-out blocks, and on those of its
    ``readings`` at rest that may teach. Its held-out errors are at rest if it has such readings, else in motion.

    Lost motion is subtracted: it depends on the direction of approach, which a function of posture cannot represent.
    """
    rows = readings.in_split("train")
    stops = without(readings.take(rows if len(rows) else readings.in_split("identify")), arm.left_out)
    parts = [_points(fit, one, held_out=False) for one in fit.recordings.values()]
    if len(stops):
        at_rest = stops.p_M - arm.model.predict(stops.q, stops.approach, stops.payload_kg)
        parts = [_Left(stops.q, at_rest), *parts]
    taught = _Left.joined(parts)
    in_order = np.arange(float(len(taught.q)))  # in order of time in each recording, by which blocks are cut
    arm = with_networks(profile, arm, taught.q, taught.left_M, in_order, cancel, report=lambda _, words: told(words))
    if arm.model.network is None:
        return arm
    held_out = _held_out(arm, readings, fit)
    correction = arm.model.network.correct(held_out.q) @ arm.model.geometry.T_M_B()[:3, :3].T
    mm = np.linalg.norm(held_out.left_M - correction, axis=1) * 1e3
    return replace(arm, validate={**arm.validate, "network": StageErrors(position_mm=error_summary(mm))})


def _held_out(arm: ArmCalibration, readings: Readings, fit: MotionFit) -> _Left:
    """Return the residuals where the other stages are judged: at held-out readings at rest, else in held-out blocks."""
    stops = without(readings.take(readings.in_split("validate")), arm.left_out)
    if len(stops):
        return _Left(stops.q, stops.p_M - smr_positions(arm.model.geometry, stops.q))
    return _Left.joined([_points(fit, one, held_out=True) for one in fit.recordings.values()])


def _points(fit: MotionFit, one: RecordingFit, *, held_out: bool) -> _Left:
    """Return the points of a recording without gross errors."""
    track = one.track
    rows = np.flatnonzero(track.held_out if held_out else track.learnt)
    time_s = track.controller_times(rows, one.offsets_s, one.rate)
    q, _ = track.path.at(time_s)
    moved = q - fit.half_play * track.path.direction_at(time_s)
    left_M = track.p_M[rows] - smr_positions(fit.identification.geometry, moved)
    good = no_gross_errors(np.linalg.norm(left_M, axis=1), one.scatter_m)
    return _Left(q[good], left_M[good])
