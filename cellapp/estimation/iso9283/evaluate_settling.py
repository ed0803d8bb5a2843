"""Compute stabilisation time, overshoot and posing time from records of motions to a pose."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellapp.estimation.iso9283.evaluate_paths import PathTrack
from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.iso9283.records import IsoValue, SettlingCharacteristics
from cellapp.estimation.iso9283.settling import settled
from cellapp.robot.kinematics.transforms import Array

_BAND_SIGMAS = 5.0
"""Least limit band in standard deviations of a coordinate: noise hardly ever moves a single point farther."""


@dataclass(frozen=True, eq=False)
class SettlingRuns:
    """Recorded motions to one pose.

    Attributes
    ----------
    arm, commands, pose, before : str
        ``before`` is the pose at which the motions began.
    commanded_M : array, shape (3,)
        Commanded position [m].
    distance : float
        Length of the motion [m].
    band : float
        Limit band that was agreed on [m].
    tracker : array, shape (3, 3)
        Covariance of a point [m^2].
    tracks : list of PathTrack
        One for each motion.
    wanted : int
        Requested number of motions.
    problems : list of str
        Why fewer were recorded.
    """

    arm: str
    commands: IsoCommands
    pose: str
    before: str
    commanded_M: Array
    distance: float
    band: float
    tracker: Array
    wanted: int
    tracks: list[PathTrack] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def settling_characteristics(runs: SettlingRuns) -> SettlingCharacteristics | None:
    """Compute mean stabilisation and posing time and the largest overshoot; None if no motion could be evaluated."""
    sigma = float(np.sqrt(np.trace(runs.tracker) / 3.0))
    band = max(runs.band, _BAND_SIGMAS * sigma)
    found = [one for track in runs.tracks if (one := settled(track.time_s, track.p_M, band)) is not None]
    if not found:
        return None
    return SettlingCharacteristics(
        pose=runs.pose,
        before=runs.before,
        distance_mm=1e3 * runs.distance,
        band_mm=1e3 * band,
        stabilisation_s=float(np.mean([one.stabilisation_s for one in found])),
        posing_s=float(np.mean([one.posing_s for one in found])),
        overshoot=IsoValue(value_mm=1e3 * max(one.overshoot_m for one in found), expanded_mm=2e3 * sigma, n=len(found)),
        step_s=float(np.median(np.concatenate([np.diff(track.time_s) for track in runs.tracks]))),
    )
