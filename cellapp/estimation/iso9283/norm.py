"""Numbers that ISO 9283:1998 asks for: cycles of each test, how long drift is observed, speeds."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from cellapp.estimation.iso9283.records import IsoTest

NORM_CYCLES: Mapping[IsoTest, int] = MappingProxyType(
    {"pose": 30, "multidirectional": 30, "distance": 30, "drift": 10, "path": 10, "cooperative": 30}
)
"""Cycles that the norm asks for; of drift in each group. Cooperative tests take those of the pose test."""
NORM_DRIFT_MIN = 480.0
"""The norm observes drift for 8 h, or until it slows down (7.6)."""
NORM_SPEEDS = (1.0, 0.5, 0.1)
"""Shares of the rated speed: characteristics are asked for at the first, and may be given at the others, too."""
