"""Memory that repeated computations of the same size use again.

A large array comes from the operating system as fresh pages each time. To touch these for the first time takes longer
than the arithmetic that fills the Jacobian of some hundred configurations.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from cellapp.robot.kinematics.transforms import Array


class Workspace:
    """Uninitialised arrays by their purpose and shapes. One computation at a time may use them."""

    def __init__(self) -> None:
        self._arrays: dict[tuple[str, tuple[tuple[int, ...], ...]], tuple[Array, ...]] = {}

    def arrays(self, purpose: str, *shapes: tuple[int, ...]) -> tuple[Array, ...]:
        """Arrays of these shapes; the next call for the same purpose with the same shapes returns the same arrays.

        They lie in one block, which each of them keeps alive. C libraries keep a block of this size for the process
        when it is freed, so that the next workspace gets pages that are there already; many smaller ones they return.
        """
        found = self._arrays.get((purpose, shapes))
        if found is None:
            ends = list(itertools.accumulate(map(math.prod, shapes)))
            parts = np.split(np.empty(ends[-1]), ends[:-1])
            found = tuple(part.reshape(shape) for part, shape in zip(parts, shapes, strict=True))
            self._arrays[purpose, shapes] = found
        return found
