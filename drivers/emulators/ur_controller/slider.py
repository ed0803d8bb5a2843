"""The speed slider of a controller: it scales every motion, also one in progress."""

from __future__ import annotations

import math

from drivers.emulators.ur_controller.motion import Motions

_FULL_RANGE_S = 0.5
"""Time in which the scaling follows the slider from one end to the other [s]; an assumption, no faster than a stop."""


class SpeedSlider:
    """The slider and the speed scaling that follows it, both from 0 to 1. At 0 the arm stands; the program runs."""

    def __init__(self) -> None:
        self.fraction = 1.0
        self.scaling = 1.0

    def set(self, fraction: float) -> bool:
        """Move the slider, at most to its ends; return False for a value that is not a finite number."""
        if not math.isfinite(fraction):
            return False
        self.fraction = min(max(fraction, 0.0), 1.0)
        return True

    def cycle(self, name: str, motions: Motions, elapsed_s: float) -> None:
        """Let the scaling follow the slider for ``elapsed_s`` [s] and apply it to the motion of an arm."""
        if self.scaling == self.fraction:
            return
        step = elapsed_s / _FULL_RANGE_S
        self.scaling = min(max(self.fraction, self.scaling - step), self.scaling + step)
        motions.scale_speed(name, self.scaling)
