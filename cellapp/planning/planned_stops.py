"""A complete plan in memory: stops of all arms in their order, how each is reached, and what it is for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.kinematics.transforms import Array

Configuration = Mapping[str, Array]
"""Arm -> joint positions (N,) [rad]; on a leg, only the arms that move."""


@dataclass(frozen=True, eq=False)
class PlannedStops:
    """n stops of all arms in the order of measurement.

    Attributes
    ----------
    q : mapping
        Arm -> joint positions (n, N) [rad].
    approach_from : mapping
        Arm -> joint positions before the last motion to each stop (n, N) [rad]; rows of NaN: no planned approach.
    dwell_s : mapping
        Arm -> least rest before the measurement (n,) [s].
    legs : tuple
        For each stop the motions that lead from the stop before (home before the first) to where the last motion
        begins, without that end: empty where the straight way is free.
    block : array, shape (n,), int
        Part of the run to which the stop belongs.
    repeat_of : array, shape (n,), int
        Number of the stop whose configuration is visited again; -1 for none.
    frozen : array, shape (n,), bool
        Stops that a person chose; a new design leaves them.
    """

    q: Mapping[str, Array]
    approach_from: Mapping[str, Array]
    dwell_s: Mapping[str, Array]
    legs: tuple[tuple[Configuration, ...], ...]
    block: NDArray[np.intp]
    repeat_of: NDArray[np.intp]
    frozen: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.block)
