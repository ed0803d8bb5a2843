"""Memory that repeated computations of the same size reuse.

The operating system provides a large array as new pages each time. The first access to these takes longer than the
arithmetic that fills the Jacobian of some hundred configurations.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from cellapp.robot.kinematics.transforms import Array


class Workspace:
    """Cache of uninitialised arrays by purpose and shapes. Only one computation at a time may use it."""

    def __init__(self) -> None:
        self._arrays: dict[tuple[str, tuple[tuple[int, ...], ...]], tuple[Array, ...]] = {}

    def arrays(self, purpose: str, *shapes: tuple[int, ...]) -> tuple[Array, ...]:
        """Return arrays of these shapes; the next call with the same purpose and shapes returns the same arrays.

        They share one block, which each of them keeps alive. When it is freed, C libraries keep a block of this size
        for the process, so that the next workspace reuses its pages; many smaller blocks they return to the system.
        """
        found = self._arrays.get((purpose, shapes))
        if found is None:
            ends = list(itertools.accumulate(map(math.prod, shapes)))
            parts = np.split(np.empty(ends[-1]), ends[:-1])
            found = tuple(part.reshape(shape) for part, shape in zip(parts, shapes, strict=True))
            self._arrays[purpose, shapes] = found
        return found
