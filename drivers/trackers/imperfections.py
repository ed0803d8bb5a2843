"""Errors of the simulated tracker itself, and the refraction that a tracker corrects for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.transforms import rigid, transform_points


@dataclass(frozen=True)
class Imperfections:
    """Errors of the tracker itself. The defaults describe a tracker with only the noise of its specification.

    Attributes
    ----------
    warm_up_rad, warm_up_m : array (3,), float
        Pointing error as a rotation vector in M [rad], and distance error [m], just after switching on; both decay with
        the time constant ``warm_up_s``.
    laser_s : float
        Warm-up time of the laser, before which nothing can be measured [s].
    weather_station : bool
        Whether it measures the air. Otherwise it corrects for the values of ``prepare``, or for standard air.
    pressure_hpa, humidity_percent : float
        Pressure and humidity of the true air; its temperature is the plant's.
    clock_offset_s, clock_rate : float
        Its own clock against the plant's: ``offset + (1 + rate) t``.
    packet_jitter_s : float
        Largest delay of the packets of a stream [s].
    lost_beams_per_min, longest_loss_s : float
        How often the beam to a moving SMR breaks, and the longest time until it can be locked again [s].
    saturated : float
        Share of packets of a stream whose points are lost because the receiver is too slow.
    """

    warm_up_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    warm_up_m: float = 0.0
    warm_up_s: float = 2400.0
    laser_s: float = 0.0
    weather_station: bool = True
    pressure_hpa: float = 1013.25
    humidity_percent: float = 50.0
    clock_offset_s: float = 0.0
    clock_rate: float = 0.0
    packet_jitter_s: float = 0.0
    lost_beams_per_min: float = 0.0
    longest_loss_s: float = 1.0
    saturated: float = 0.0

    def own_time_s(self, time_s: Array) -> Array:
        """Return the tracker's own clock (n,) at times (n,) of the plant [s]."""
        return self.clock_offset_s + (1.0 + self.clock_rate) * time_s

    def pointed(self, p_M: Array, cold: float) -> Array:
        """Return the point (3,) [m] at which the head points; ``cold`` is the share of the warm-up left."""
        if any(self.warm_up_rad) and cold > 0.0:
            p_M = transform_points(rigid(np.array([0.0, 0.0, 0.0, *self.warm_up_rad]) * cold), p_M)
        return p_M


PERFECT = Imperfections()
"""A tracker with only the noise of its specification."""


def refractivity(temperature_c: float, pressure_hpa: float, humidity_percent: float) -> float:
    """Return n - 1 of moist air at 633 nm: density of an ideal gas, and Edlen's term for water vapour.

    Within 0.3 ppm of Ciddor (1996) between 10 and 30 degC: 271.4e-6 at 20 degC, 1013.25 hPa, 50 %.
    """
    vapour_hpa = 0.01 * humidity_percent * 6.1078 * math.exp(17.27 * temperature_c / (temperature_c + 237.3))
    dry = 271.8e-6 * (pressure_hpa / 1013.25) * 293.15 / (273.15 + temperature_c)
    return dry - 3.63e-8 * vapour_hpa
