"""Calibration in motion: recordings of joints and of points, each with a clock of its own. Arrays in, arrays out."""

from cellapp.estimation.motion.effects import MotionDiscovery, MotionEffect, effects_in_motion
from cellapp.estimation.motion.identify import identify_from_motion
from cellapp.estimation.motion.observe import Stops
from cellapp.estimation.motion.records import ClockFit, ClockSegment, MotionFit, RecordingFit
from cellapp.estimation.motion.stamps import ClockStep
from cellapp.estimation.motion.streams import JointStream, PointStream, Recording

__all__ = [
    "ClockFit",
    "ClockSegment",
    "ClockStep",
    "JointStream",
    "MotionDiscovery",
    "MotionEffect",
    "MotionFit",
    "PointStream",
    "Recording",
    "RecordingFit",
    "Stops",
    "effects_in_motion",
    "identify_from_motion",
]
