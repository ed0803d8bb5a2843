"""Measuring noise at any point: with the shape that the tracker states and the size of the readings' scatter.

A laser tracker measures distances better than directions; both errors grow with the distance. The repeatability of the
arm is isotropic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.estimation.readings import Readings
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True)
class MeasuringNoise:
    """Standard uncertainties that the tracker states: a constant [m] and a part proportional to distance [m/m].

    ``along`` and ``across`` are relative to the beam; ``typical`` is their mean square [m^2] over the readings.
    """

    along: tuple[float, float]
    across: tuple[float, float]
    typical: float

    @classmethod
    def of(cls, readings: Readings) -> MeasuringNoise | None:
        """Fit to the covariances that an arm's readings state; None if they state none."""
        stated = readings.covariance_M
        if stated is None or not np.isfinite(stated).all():
            return None
        distance = np.linalg.norm(readings.p_M, axis=1)
        beam = readings.p_M / distance[:, None]
        along = np.einsum("na,nab,nb->n", beam, stated, beam)
        whole = np.trace(stated, axis1=1, axis2=2)
        across = np.sqrt(np.maximum(0.5 * (whole - along), 0.0))
        return cls(_line(distance, np.sqrt(along)), _line(distance, across), float(np.mean(whole)) / 3.0)

    def excess(self, noise_m: float) -> float:
        """Return the variance [m^2] of a coordinate by which readings scatter more than the tracker states.

        It is repeatability or a deficiency of the model: the SMR itself deviates by as much.
        """
        return max(noise_m**2 - self.typical, 0.0)

    def covariance(self, p_M: Array, noise_m: float) -> Array:
        """Return the covariance (n, 3, 3) [m^2] of readings at ``p_M`` (n, 3) [m] with the run's scatter ``noise_m``.

        Scatter beyond what the tracker states is added isotropically.
        """
        distance = np.linalg.norm(p_M, axis=1)
        beam = p_M / distance[:, None]
        along, across = (
            (constant + proportional * distance)[:, None, None] ** 2
            for constant, proportional in (self.along, self.across)
        )
        outer = beam[:, :, None] * beam[:, None]
        stated = along * outer + across * (np.eye(3) - outer)
        excess = self.excess(noise_m)
        if excess == 0.0:
            return np.asarray(stated * (noise_m**2 / self.typical))
        return np.asarray(stated + excess * np.eye(3))


def _line(distance: Array, sigma: Array) -> tuple[float, float]:
    """Fit constant and proportional part of standard uncertainties (n,) [m]; a constant if distances hardly differ."""
    if np.ptp(distance) < 0.1 * distance.mean():
        return float(sigma.mean()), 0.0
    slope, constant = np.polyfit(distance, sigma, 1)
    return float(constant), float(slope)
