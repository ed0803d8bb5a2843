"""An encoder disc whose centre is off its axis of rotation, read by one head."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import (
    JOINTS,
    NOT_NEGATIVES,
    NUMBERS,
    Effect,
    Parameters,
    Read,
    Situation,
    by_law,
    made,
    on_joints,
)
from drivers.plant.mechanism import Deflection


@dataclass(frozen=True, eq=False)
class EncoderEccentricity(Effect):
    """The servo drives the encoder reading to the commanded angle, so the shaft angle has the error.

    The axis is the origin, the head is at distance r from it. With the shaft at angle s the disc's centre is at
    ``e (cos(s + phase), sin(s + phase))``; the reading is the head's direction from the disc's centre, on the disc:
    ``reading = s + atan2(e sin(s + phase), r - e cos(s + phase))``. It is solved for s in the triangle of centre, axis
    and head, whose angle at the centre follows from the reading: ``s = reading - atan2(h, sqrt(r^2 - h^2))`` with
    ``h = e sin(reading + phase)``. A disc that is also tilted by t against the shaft looks elliptic to the head: its
    reading has an error of two cycles per revolution with amplitude ``tan^2(t / 2)``.
    """

    joints: np.ndarray
    eccentricity: Array
    radius: Array
    phase: Array
    tilt: Array | float = 0.0
    tilt_phase: Array | float = 0.0

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        joint = situation.q[:, self.joints]
        height = self.eccentricity * np.sin(joint + self.phase)
        ellipse = np.tan(self.tilt / 2.0) ** 2 * np.sin(2.0 * joint + self.tilt_phase)
        angles = -np.arctan2(height, np.sqrt(self.radius**2 - height**2)) - ellipse
        return on_joints(situation, self.joints, angles)


def _radius(parameters: Parameters, key: str) -> Array:
    radius = parameters.numbers(key, above=0.0)
    if (parameters.numbers("eccentricity") >= radius).any():
        raise parameters.error("eccentricity", "must be smaller than radius")
    return radius


_CENTRED: Mapping[str, Read] = {"joints": JOINTS, "eccentricity": NOT_NEGATIVES, "radius": _radius, "phase": NUMBERS}

encoder_eccentricity = by_law(
    centred=made(EncoderEccentricity, **_CENTRED),
    tilted=made(EncoderEccentricity, **_CENTRED, tilt=NUMBERS, tilt_phase=NUMBERS),
)
"""``joints``: numbers from 1; for each ``eccentricity``, ``radius`` [m], ``phase`` [rad].

With ``law`` tilted also ``tilt`` and ``tilt_phase`` [rad] of the disc.
"""
