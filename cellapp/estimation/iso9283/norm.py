"""What ISO 9283 calls its tests, and how long they are. Imports nothing: every start of the program loads it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, get_args

IsoTest = Literal["pose", "multidirectional", "distance", "drift", "path", "stabilisation", "cooperative", "compliance"]
ISO_TESTS: tuple[IsoTest, ...] = get_args(IsoTest)
UNATTENDED_TESTS: tuple[IsoTest, ...] = tuple(test for test in ISO_TESTS if test != "compliance")
"""For which no person has to do anything at the arm."""

IsoCommands = Literal["nominal", "calibrated"]
"""What is commanded: joint positions by the published geometry (as found), or by the calibrated model (as left)."""
ISO_COMMANDS: tuple[IsoCommands, ...] = get_args(IsoCommands)

NORM_CYCLES: Mapping[IsoTest, int] = MappingProxyType(
    {
        "pose": 30,
        "multidirectional": 30,
        "distance": 30,
        "drift": 10,
        "path": 10,
        "stabilisation": 3,
        "cooperative": 30,
        "compliance": 3,
    }
)
"""Cycles that the norm asks for; of drift in each group. Cooperative tests take those of the pose test."""
REORIENTED_LINE = "line P2 to P4, turning"
"""Path along which the flange turns, as the norm's path accuracy on reorientation asks (8.4)."""
NORM_DRIFT_MIN = 480.0
"""The norm observes drift for 8 h, or until it slows down (7.6)."""
NORM_SPEEDS = (1.0, 0.5, 0.1)
"""Shares of the rated speed: characteristics are asked for at the first, and may be given at the others, too."""
