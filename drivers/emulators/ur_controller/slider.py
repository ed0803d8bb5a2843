"""The speed slider of a controller: it scales every motion, also one in progress, but not the braking of a stop."""

from __future__ import annotations

import math

_FULL_RANGE_S = 0.5
"""Time in which the scaling follows the slider over its full range [s]; an assumption, no faster than a stop."""


class SpeedSlider:
    """The slider and the speed scaling that follows it, both from 0 to 1. At 0 the arm stands; the program runs."""

    def __init__(self) -> None:
        self.fraction = 1.0
        self.scaling = 1.0

    def set(self, fraction: float) -> bool:
        """Move the slider, limited to its range; return False for a value that is not a finite number."""
        if not math.isfinite(fraction):
            return False
        self.fraction = min(max(fraction, 0.0), 1.0)
        return True

    def follow(self, elapsed_s: float) -> bool:
        """Update the scaling for ``elapsed_s`` [s]; return whether it has changed."""
        if self.scaling == self.fraction:
            return False
        step = elapsed_s / _FULL_RANGE_S
        self.scaling = min(max(self.fraction, self.scaling - step), self.scaling + step)
        return True
