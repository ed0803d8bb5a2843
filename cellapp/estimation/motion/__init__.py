"""Calibration in motion: recordings of joints and of points, each with a clock of its own. Arrays in, arrays out."""

from cellapp.estimation.motion.streams import JointStream, PointStream, Recording

__all__ = ["JointStream", "PointStream", "Recording"]
