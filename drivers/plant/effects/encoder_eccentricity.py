"""An encoder disc whose centre is off its axis of rotation, read by one head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
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
    tilt: Array
    tilt_phase: Array

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        height = self.eccentricity * np.sin(situation.q[:, self.joints] + self.phase)
        offsets = np.zeros_like(situation.q)
        offsets[:, self.joints] = -np.arctan2(height, np.sqrt(self.radius**2 - height**2))
        if self.tilt.any():
            turned = 2.0 * situation.q[:, self.joints] + self.tilt_phase
            offsets[:, self.joints] -= np.tan(self.tilt / 2.0) ** 2 * np.sin(turned)
        return Deflection(joints=offsets)


def encoder_eccentricity(parameters: Parameters) -> Effect:
    """Build eccentricity. ``joints``: numbers from 1; for each ``eccentricity``, ``radius`` [m], ``phase`` [rad].

    With ``law`` tilted also ``tilt`` and ``tilt_phase`` [rad] of the disc.
    """
    law, parameters = parameters.by_law("centred", "tilted")
    extra = ("tilt", "tilt_phase") if law == "tilted" else ()
    parameters.require("joints", "eccentricity", "radius", "phase", *extra)
    joints = parameters.joint_numbers("joints")
    count = len(joints)
    eccentricity = parameters.numbers("eccentricity", count, least=0.0)
    radius = parameters.numbers("radius", count, above=0.0)
    if (eccentricity >= radius).any():
        raise parameters.error("eccentricity", "must be smaller than radius")
    tilt, tilt_phase = (parameters.numbers(key, count) for key in extra) if extra else np.zeros((2, count))
    return EncoderEccentricity(joints, eccentricity, radius, parameters.numbers("phase", count), tilt, tilt_phase)
