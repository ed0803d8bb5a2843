"""Smooth free functions of one variable: the spectrum of their prior, and the constants that their laws share.

A smooth law ``sum_k b_k f_k(z)``, ``b_k ~ N(0, a^2 w_k)``, is a Gaussian process of its variable z with standard
deviation a. On the circle the ``f_k`` are cosines and sines of k z with

    w_k proportional to (5 / l^2 + k^2)^-3,   sum over k = 1

the spectrum of a Matern-5/2 covariance of length scale l (Rasmussen, Williams, Gaussian Processes for Machine Learning,
2006, section 4.2). Amplitude and length are constants of the law: the search finds them by their evidence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from cellapp.robot.effects.column import EffectColumn
from cellapp.robot.effects.law import AMPLITUDE_NAME, FIXED, Constant
from cellapp.robot.kinematics.transforms import Array

AMPLITUDE = Constant(AMPLITUDE_NAME, "", FIXED)
"""Standard deviation of the free function, in the unit of its parameters."""
LENGTH = Constant("length", "rad", FIXED)
"""Length scale of a function of a joint angle."""
CYCLES = Constant("cycles", "", FIXED)
"""Highest cycle count of a function of a joint angle."""
_SPECTRUM_CYCLES = 4000
"""Cycle counts over which the spectrum is normalised. At a length scale of 1.5 degrees less than 1e-8 is beyond."""


@dataclass(frozen=True)
class LengthRange:
    """First guess and bounds of a length scale [rad], of a field over the workspace [m]."""

    start: float
    least: float
    most: float


@dataclass(frozen=True)
class SmoothLaw:
    """A smooth law with one amplitude.

    ``form`` is the name of its form, ``start`` a first guess of its amplitude; ``lengths`` are given where one length
    scale is found as well.
    """

    form: str
    start: float
    constants: Mapping[str, float] = field(default_factory=dict)
    lengths: LengthRange | None = None


@lru_cache(maxsize=256)
def _spectrum(length: float) -> Array:
    k = np.arange(1.0, _SPECTRUM_CYCLES + 1.0)
    spectrum = (5.0 / length**2 + k**2) ** -3
    return np.asarray(spectrum / spectrum.sum())


def circle_variances(length: float, cycles: int) -> Array:
    """Relative prior variances (cycles,) of the cosine, and of the sine, of 1 ... ``cycles`` cycles per revolution."""
    return _spectrum(float(length))[:cycles]


def with_prior_sd(column: EffectColumn, sd: float) -> EffectColumn:
    """The column with a prior on its parameter."""
    return replace(column, prior_sd=sd)
