"""Smooth random functions of time, of an angle and of a position, each sampled by a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array

_PERIODS = 2.0 ** np.arange(0.0, 3.5, 0.5)
"""Periods of a random path, in units of its shortest one: half an octave apart."""
_FIELD_WAVES = 48
"""Number of plane waves of a random field: enough that no single one is visible."""


@dataclass(frozen=True, eq=False)
class RandomPaths:
    """k paths in time that start at zero and wander like a random walk without its jumps.

    Each is a sum of sine waves with random phases and periods from ``period`` [s] to eight times that. The amplitude
    grows with the period, as the spectrum of a random walk falls with the square of the frequency. Each path has unit
    variance before its start is subtracted.
    """

    periods: Array  # (waves,) [s]
    amplitudes: Array  # (waves,)
    phases: Array  # (waves, k) [rad]

    @classmethod
    def sampled(cls, seed: int, count: int, period: float) -> RandomPaths:
        """Sample ``count`` paths."""
        amplitudes = _PERIODS * np.sqrt(2.0 / (_PERIODS**2).sum())
        phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, (len(_PERIODS), count))
        return cls(period * _PERIODS, amplitudes, phases)

    def at(self, time_s: Array) -> Array:
        """Return the paths (n, k) at times (n,) [s]."""
        angles = 2.0 * np.pi * time_s[:, None, None] / self.periods[:, None]
        waves = self.amplitudes[:, None] * (np.sin(angles + self.phases) - np.sin(self.phases))
        paths: Array = waves.sum(axis=1)
        return paths


@dataclass(frozen=True, eq=False)
class RandomWaves:
    """k sums of harmonics of one angle with random phases; ``shares`` (h,) are the amplitudes of the harmonics."""

    harmonics: Array  # (h,)
    shares: Array  # (h,)
    phases: Array  # (h, k) [rad]

    @classmethod
    def sampled(cls, rng: np.random.Generator, count: int, harmonics: Array, shares: Array) -> RandomWaves:
        """Sample the phases."""
        return cls(harmonics, shares, rng.uniform(0.0, 2.0 * np.pi, (len(harmonics), count)))

    def at(self, angle: Array) -> Array:
        """Return the sums (n, k) at angles (n,) [rad]."""
        waves = np.cos(angle[:, None, None] * self.harmonics[:, None] + self.phases)
        sums: Array = (self.shares[:, None] * waves).sum(axis=1)
        return sums


@dataclass(frozen=True, eq=False)
class RandomField:
    """A smooth random vector field in space: a Gaussian process with a squared exponential correlation.

    Random Fourier features (Rahimi and Recht 2007): plane waves with wave vectors from a normal distribution of
    standard deviation ``1 / length``. Unit variance in each component.
    """

    vectors: Array  # (waves, 3) [1/m]
    phases: Array  # (waves,) [rad]
    directions: Array  # (waves, 3)

    @classmethod
    def sampled(cls, seed: int, length: float) -> RandomField:
        """Sample a field of correlation length ``length`` [m]."""
        rng = np.random.default_rng(seed)
        vectors = rng.standard_normal((_FIELD_WAVES, 3)) / length
        phases = rng.uniform(0.0, 2.0 * np.pi, _FIELD_WAVES)
        return cls(vectors, phases, rng.standard_normal((_FIELD_WAVES, 3)) * np.sqrt(2.0 / _FIELD_WAVES))

    def at(self, position: Array) -> Array:
        """Return the vectors (n, 3) at positions (n, 3) [m]."""
        found: Array = np.cos(position @ self.vectors.T + self.phases) @ self.directions
        return found
