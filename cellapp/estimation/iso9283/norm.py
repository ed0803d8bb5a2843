"""Names and lengths of the tests of ISO 9283. It imports nothing heavy: every start of the program loads it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, get_args

IsoTest = Literal["pose", "multidirectional", "distance", "drift", "path", "cooperative"]
ISO_TESTS: tuple[IsoTest, ...] = get_args(IsoTest)

IsoCommands = Literal["nominal", "calibrated"]
"""Kind of commands: joint positions by the published geometry (as found), or by the calibrated model (as left)."""
ISO_COMMANDS: tuple[IsoCommands, ...] = get_args(IsoCommands)

NORM_CYCLES: Mapping[IsoTest, int] = MappingProxyType(
    {"pose": 30, "multidirectional": 30, "distance": 30, "drift": 10, "path": 10, "cooperative": 30}
)
"""Number of cycles that the standard requires; for drift, in each group. Cooperative tests take those of pose tests."""
NORM_DRIFT_MIN = 480.0
"""Duration of the standard's drift test [min]: 8 h, or until drift slows down (7.6)."""
NORM_SPEEDS = (1.0, 0.5, 0.1)
"""Shares of the rated speed: characteristics are required at the first, and may be given at the others, too."""


def wanted_cycles(test: IsoTest, cycles: int) -> int:
    """Return the number of cycles of a test if ``cycles`` were requested: some take no more than the standard's."""
    return min(cycles, NORM_CYCLES[test]) if test in ("drift", "path") else cycles
