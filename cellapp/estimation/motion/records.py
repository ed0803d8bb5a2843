"""Results of a fit of recordings: clocks, geometry, lost motion, errors of held-out blocks, undetermined parameters."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellapp.estimation.calibration.identification import Identification
from cellapp.estimation.motion.stamps import ClockStep, TriggerCheck
from cellapp.estimation.motion.tracks import Track
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True)
class ClockSegment:
    """The tracker's clock relative to the controller's between two steps of either.

    ``offset_s`` is the tracker's timestamp less the controller's at the same instant, at the timestamp ``middle_s`` of
    the recording (steps removed); ``first_s`` and ``last_s`` are the first and the last of its points.
    """

    offset_s: float
    offset_standard_error_s: float
    offset_interval_s: tuple[float, float]
    first_s: float
    last_s: float


@dataclass(frozen=True)
class ClockFit:
    """Clocks of one recording: a point with timestamp t was measured at controller time ``t - offset_s - 1e-6 rate_ppm
    (t - middle_s)``.

    Attributes
    ----------
    offset_s, offset_standard_error_s, offset_interval_s
        Offset of the first segment; the interval holds with 95 %.
    rate_ppm, rate_standard_error_ppm, rate_interval_ppm
        Rate of the tracker's clock less that of the controller's, relative to the latter.
    middle_s : float
        Timestamp at which offsets are stated: in the middle of the recording, where offset and rate are independent.
    segments : tuple of ClockSegment
    steps_of_joints, steps_of_points : tuple of ClockStep
        Steps of the controller's and of the tracker's clock.
    correlation : float
        Correlation of the speeds at the start of the fit.
    trigger : TriggerCheck or None
        Comparison of the offset from pulses of a hardware trigger with that from the motion.
    """

    offset_s: float
    offset_standard_error_s: float
    offset_interval_s: tuple[float, float]
    rate_ppm: float
    rate_standard_error_ppm: float
    rate_interval_ppm: tuple[float, float]
    middle_s: float
    segments: tuple[ClockSegment, ...]
    steps_of_joints: tuple[ClockStep, ...]
    steps_of_points: tuple[ClockStep, ...]
    correlation: float
    trigger: TriggerCheck | None = None


@dataclass(frozen=True, eq=False)
class RecordingFit:
    """One recording after the fit.

    Attributes
    ----------
    clock : ClockFit
    points, learnt, held_out, gross : int
        Numbers of all points, of training points, of held-out points, and of gross errors left out of either.
    in_gaps : int
        Number of points at times without known joint positions.
    effective : float
        Number of independent points with the same information on the parameters.
    scatter_m : float
        Standard deviation of a coordinate of the residuals [m].
    heldout_mm, heldout_nominal_mm : array, shape (h,)
        Distances of held-out points from the model and from the nominal arm at its base with the same clock [mm].
    track : Track
        Path and points at the fitted clock, for later steps.
    offsets_s : array, shape (S,)
        Offsets of the segments, including the mean lag of the joints.
    rate : float
    """

    clock: ClockFit
    points: int
    learnt: int
    held_out: int
    gross: int
    in_gaps: int
    effective: float
    scatter_m: float
    heldout_mm: Array = field(repr=False)
    heldout_nominal_mm: Array = field(repr=False)
    track: Track = field(repr=False)
    offsets_s: Array = field(repr=False)
    rate: float

    @property
    def heldout_rms_mm(self) -> float:
        """Rms distance of held-out points from the model [mm]; NaN without any."""
        return rms(self.heldout_mm)


@dataclass(frozen=True, eq=False)
class MotionFit:
    """One arm identified from recordings of its motion, and from stops if there are any.

    Attributes
    ----------
    identification : Identification
        Geometry, with standard errors from the noise model. Its residuals and weights are those of the stops.
    half_play : array, shape (N,)
        Lost motion in motion, by joint [rad]: a joint lies this far behind its motor, against its last motion.
    half_play_standard_error : array, shape (N,)
    recordings : mapping-like dict of RecordingFit
    half_widths : array
        Half widths of the 95 % intervals in standard errors, for the names of ``identification``.
    effective : float
        Number of independent points of all recordings together.
    stops_scatter_m : float or None
        Standard deviation of a coordinate of the stops' residuals.
    undetermined : tuple of str
        Sentences on what these data cannot determine.
    """

    identification: Identification
    half_play: Array
    half_play_standard_error: Array
    recordings: dict[str, RecordingFit]
    half_widths: Array = field(repr=False)
    effective: float
    stops_scatter_m: float | None
    undetermined: tuple[str, ...]

    @property
    def clocks(self) -> dict[str, ClockFit]:
        """Clocks by recording."""
        return {name: one.clock for name, one in self.recordings.items()}

    @property
    def heldout_rms_mm(self) -> float:
        """Rms distance of all held-out points from the model [mm]."""
        return rms(np.concatenate([one.heldout_mm for one in self.recordings.values()]))


def rms(values: Array) -> float:
    """Return the root mean square; NaN without values."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
