"""Bearings whose centre moves as the joint turns: radial and axial run-out of an axis."""

from __future__ import annotations

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import JOINTS, NOT_NEGATIVES, Offset, PlantEffect
from drivers.plant.effects.joint_axis_wobble import waving, with_waves
from drivers.plant.random_functions import RandomWaves


def _runout(joints: np.ndarray, radial: Array, axial: Array, waves: tuple[RandomWaves, ...]) -> PlantEffect:
    """Make an axis that shifts with harmonics of its own angle, across itself by ``radial`` and along itself by
    ``axial`` [m].

    Error motions of a rotary axis (ISO 230-7). The shift is in the frame before the joint. The circular part of one
    cycle per revolution across the axis belongs to the geometry. Sizes: 5 to 30 um for bearings of this class (an
    estimate).
    """
    sizes = np.column_stack([radial, radial, axial])
    return Offset(waving, {"joints": joints, "sizes": sizes, "waves": waves, "part": slice(3)})


joint_axis_runout = with_waves(_runout, directions=3, joints=JOINTS, radial=NOT_NEGATIVES, axial=NOT_NEGATIVES)
"""``joints``: numbers from 1; for each ``radial`` and ``axial`` [m].

All joints share ``harmonics`` (cycles per revolution), as many ``shares``, and a ``seed`` of the phases.
"""
