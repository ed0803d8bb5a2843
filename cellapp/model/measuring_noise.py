"""Scatter of measured SMR positions about the model, in the directions of the tracker's beam.

A laser tracker measures along its beam three to four times as well as across it, and both grow with the distance. One
number for all directions states too little across the beam and too much along it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellapp.kinematics.transforms import Array


@dataclass(frozen=True)
class MeasuringNoise:
    """Standard deviations along the beam and of each direction across it: constant [m] + proportional * distance."""

    along: tuple[float, float]
    across: tuple[float, float]

    @classmethod
    def of_readings(cls, sigma: Array, p_M: Array) -> MeasuringNoise:
        """That of readings at ``p_M`` (n, 3) [m] with standard uncertainties (n,) [m] or covariances (n, 3, 3) [m^2].

        Uncertainties of a coordinate are alike in all directions.
        """
        distance, covariance = np.linalg.norm(p_M, axis=1), sigma
        if sigma.ndim == 1:
            covariance = sigma[:, None, None] ** 2 * np.eye(3)
        beam = p_M / np.maximum(distance, 1e-12)[:, None]
        along = np.einsum("na,nab,nb->n", beam, covariance, beam)
        across = 0.5 * (np.trace(covariance, axis1=1, axis2=2) - along)
        return cls(_line(distance, along), _line(distance, across))

    def covariance(self, p_M: Array) -> Array:
        """Covariances (n, 3, 3) [m^2] of measurements at ``p_M`` (n, 3) [m] in the tracker frame."""
        distance = np.linalg.norm(p_M, axis=1)
        beam = p_M / np.maximum(distance, 1e-12)[:, None]
        along, across = (
            np.maximum(constant + proportional * distance, 0.0)[:, None, None] ** 2
            for constant, proportional in (self.along, self.across)
        )
        beams = beam[:, :, None] * beam[:, None]
        return np.asarray(along * beams + across * (np.eye(3) - beams))

    def scaled(self, factor: float) -> MeasuringNoise:
        """With all standard deviations times ``factor``."""
        return MeasuringNoise(
            (self.along[0] * factor, self.along[1] * factor), (self.across[0] * factor, self.across[1] * factor)
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"along_beam": list(self.along), "across_beam": list(self.across)}

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> MeasuringNoise:
        """Read what ``to_json`` wrote. Raises ``ValueError``, ``KeyError`` or ``TypeError``."""
        (a, b), (c, d) = content["along_beam"], content["across_beam"]
        return cls((float(a), float(b)), (float(c), float(d)))


_LEAST_SPREAD = 0.1
"""Spread of the distances, as a share of their mean, below which no growth with distance can be seen."""


def _line(distance: Array, variance: Array) -> tuple[float, float]:
    """Standard deviation as a line over distances (n,) [m] that fits variances (n,) [m^2]; it does not fall."""
    sd, middle = np.sqrt(np.maximum(variance, 0.0)), float(distance.mean())
    spread = distance - middle
    slope = 0.0
    if float(np.ptp(distance)) > _LEAST_SPREAD * middle:
        slope = max(float(spread @ sd / (spread @ spread)), 0.0)
    line = float(sd.mean()) + slope * spread
    scale = (
        math.sqrt(float(np.mean(variance) / np.mean(line**2))) if np.any(line) else 1.0
    )  # mean square of the readings
    return float(sd.mean() - slope * middle) * scale, slope * scale
