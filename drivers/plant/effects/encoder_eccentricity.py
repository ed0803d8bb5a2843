"""An encoder disc whose centre is off its axis of rotation, read by one head."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import (
    JOINTS,
    NOT_NEGATIVES,
    NUMBERS,
    Offset,
    Parameters,
    Read,
    Situation,
    by,
    by_law,
    made,
    on_joints,
)
from drivers.plant.mechanism import Deflection


def _off_axis(
    situation: Situation,
    joints: np.ndarray,
    eccentricity: Array,
    radius: Array,
    phase: Array,
    tilt: Array | float = 0.0,
    tilt_phase: Array | float = 0.0,
) -> Deflection:
    """The servo drives the encoder reading to the commanded angle, so the shaft angle has the error.

    The axis is the origin, the head is at distance r from it. With the shaft at angle s the disc's centre is at
    ``e (cos(s + phase), sin(s + phase))``; the reading is the head's direction from the disc's centre, on the disc:
    ``reading = s + atan2(e sin(s + phase), r - e cos(s + phase))``. It is solved for s in the triangle of centre, axis
    and head, whose angle at the centre follows from the reading: ``s = reading - atan2(h, sqrt(r^2 - h^2))`` with
    ``h = e sin(reading + phase)``. A disc that is also tilted by t against the shaft looks elliptic to the head: its
    reading has an error of two cycles per revolution with amplitude ``tan^2(t / 2)``.
    """
    joint = situation.q[:, joints]
    height = eccentricity * np.sin(joint + phase)
    ellipse = np.tan(tilt / 2.0) ** 2 * np.sin(2.0 * joint + tilt_phase)
    angles = -np.arctan2(height, np.sqrt(radius**2 - height**2)) - ellipse
    return on_joints(situation, joints, angles)


def _radius(parameters: Parameters, key: str) -> Array:
    radius = parameters.numbers(key, above=0.0)
    if (parameters.numbers("eccentricity") >= radius).any():
        raise parameters.error("eccentricity", "must be smaller than radius")
    return radius


_CENTRED: Mapping[str, Read] = {"joints": JOINTS, "eccentricity": NOT_NEGATIVES, "radius": _radius, "phase": NUMBERS}

encoder_eccentricity = by_law(
    centred=made(by(Offset, _off_axis), **_CENTRED),
    tilted=made(by(Offset, _off_axis), **_CENTRED, tilt=NUMBERS, tilt_phase=NUMBERS),
)
"""``joints``: numbers from 1; for each ``eccentricity``, ``radius`` [m], ``phase`` [rad].

With ``law`` tilted also ``tilt`` and ``tilt_phase`` [rad] of the disc.
"""
