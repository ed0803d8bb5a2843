"""Thermal effects: growth of links and housings, drift of joint zeros."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import (
    NOT_NEGATIVE,
    NUMBER,
    NUMBERS,
    POSITIVE,
    POSITIVES,
    SEED,
    Offset,
    Parameters,
    PlantEffect,
    Read,
    Situation,
    by,
    by_law,
    made,
)
from drivers.plant.mechanism import Deflection, combined
from drivers.plant.random_functions import RandomPaths
from drivers.plant.transforms import inverse, transform_points

_REFERENCE_C = 20.0
"""Default temperature at which the arm has its ideal shape [degC]."""


@dataclass(frozen=True, eq=False)
class TrueGrowth(PlantEffect):
    """Each link is a tube heated by the joints at its ends, with a first-order lag; each housing grows with its motor.

    The tube's steady temperature is that of the air plus a share of the mean rise of the two joints. Aluminium:
    23e-6/K; 0.6 m and 5 to 10 K give 70 to 140 um per link. The memory is the temperature of the tubes; NaN stands for
    the steady state.
    """

    expansion: float
    share: float
    lag: float
    motor: float
    reference: float

    def _steady_temperature(self, air_c: Array, joints_c: Array) -> Array:
        """Return the steady temperatures (n, N) of the tubes [degC]."""
        ends = 0.5 * (joints_c + np.concatenate([joints_c[:, 1:], joints_c[:, -1:]], axis=1))
        steady: Array = air_c[:, None] + self.share * (ends - air_c[:, None])
        return steady

    def initial_memory(self, q: Array) -> Array | None:
        return np.full_like(q, np.nan)

    def memory_after_time(self, memory: Array | None, air_c: float, joints_c: Array, duration_s: float) -> Array | None:
        assert memory is not None
        end = self._steady_temperature(np.array([air_c]), joints_c[None])
        settled = np.isnan(memory)
        return np.where(settled, end, end + (memory - end) * np.exp(-duration_s / self.lag))

    def assumed_memory(self, situation: Situation) -> Array | None:
        ends = self._steady_temperature(situation.air_c, situation.joints_c)
        order = np.argsort(situation.time_s, kind="stable")
        remaining = np.exp(-np.diff(situation.time_s[order]) / self.lag)
        if not (remaining < 1.0).any():
            return ends
        ends, tubes = ends[order], np.empty_like(ends)
        tubes[order[0]] = ends[0]
        for k, keep in enumerate(remaining):
            mean = 0.5 * (ends[k] + ends[k + 1])
            tubes[order[k + 1]] = mean + (tubes[order[k]] - mean) * keep
        return tubes

    def _strain(self, tubes: Array) -> Array:
        """Return the strains (n, N) of tubes of these temperatures."""
        strain: Array = self.expansion * (tubes - self.reference)
        return strain

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        assert memory is not None
        now = self._steady_temperature(situation.air_c, situation.joints_c)
        tubes = np.where(np.isnan(memory), now, memory)
        arm = situation.mechanism
        home = inverse(arm.frames[1:])
        lengths = -transform_points(home, arm.frames[:-1, :3, 3])
        axes = (home[:, :3, :3] @ arm.directions[..., None])[..., 0]
        twists = np.zeros((*situation.q.shape, 6))
        twists[..., :3] = self._strain(tubes)[..., None] * lengths
        twists[..., :3] += self.motor * (situation.joints_c - self.reference)[..., None] * axes
        return Deflection(links=twists)


@dataclass(frozen=True, eq=False)
class SaturatingGrowth(TrueGrowth):
    """Growth that is restrained as it becomes large, as of a tube clamped in one of lower expansion.

    The strain is ``expansion limit tanh((T - reference) / limit)``, ``limit`` in K.
    """

    limit: float

    def _strain(self, tubes: Array) -> Array:
        strain: Array = self.expansion * self.limit * np.tanh((tubes - self.reference) / self.limit)
        return strain


@dataclass(frozen=True, eq=False)
class TwoLagGrowth(PlantEffect):
    """Links of a thin shell and a heavy core: one part of the growth follows quickly, the rest slowly."""

    quick: TrueGrowth
    slow: TrueGrowth

    def initial_memory(self, q: Array) -> Array | None:
        return np.full((2, *q.shape), np.nan)

    def memory_after_time(self, memory: Array | None, air_c: float, joints_c: Array, duration_s: float) -> Array | None:
        assert memory is not None
        parts = zip((self.quick, self.slow), memory, strict=True)
        return _stacked([part.memory_after_time(own, air_c, joints_c, duration_s) for part, own in parts])

    def assumed_memory(self, situation: Situation) -> Array | None:
        return _stacked([part.assumed_memory(situation) for part in (self.quick, self.slow)])

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        assert memory is not None
        parts = zip((self.quick, self.slow), memory, strict=True)
        return combined([part.offset(situation, own) for part, own in parts])


def _stacked(memories: Sequence[Array | None]) -> Array:
    return np.stack([memory for memory in memories if memory is not None])


def _two_lags(slow_lag: float, slow_share: float, **plain: Any) -> PlantEffect:
    growth = TrueGrowth(**plain)
    slow = replace(growth, expansion=slow_share * growth.expansion, lag=slow_lag, motor=0.0)
    return TwoLagGrowth(replace(growth, expansion=(1.0 - slow_share) * growth.expansion), slow)


def _share(parameters: Parameters, key: str) -> float:
    share = parameters.number(key, least=0.0)
    if share > 1.0:
        raise parameters.error(key, f"must be from 0 to 1, not {share:g}")
    return share


_REFERENCE = {"reference": partial(NUMBER, default=_REFERENCE_C)}
_MORE: Mapping[str, Read] = {"motor": partial(NUMBER, default=0.0), **_REFERENCE}
_GROWTH: Mapping[str, Read] = {"expansion": NOT_NEGATIVE, "share": _share, "lag": POSITIVE}

thermal_growth = by_law(
    lag=made(TrueGrowth, _MORE, **_GROWTH),
    two_lags=made(_two_lags, _MORE, **_GROWTH, slow_lag=POSITIVE, slow_share=NOT_NEGATIVE),
    saturating=made(SaturatingGrowth, _MORE, **_GROWTH, limit=POSITIVE),
)
"""``expansion`` [1/K], ``share`` (0 to 1) of the joints' rise in a link, ``lag`` [s].

Optional: ``motor``, growth of each joint's housing along its axis [m/K]; ``reference`` [degC], 20 by default. Other
laws: ``law`` two_lags with ``slow_lag`` [s] and ``slow_share`` (0 to 1) of the growth; saturating with ``limit`` [K], a
temperature rise beyond which growth is held back.
"""


def _warm_up(situation: Situation, drift: Array, time_constant: Array) -> Deflection:
    """The zero of each joint's encoder drifts as the joint warms up after switching on at time 0.

    The published drift of a small industrial arm could be removed to 90 % by a model of its temperatures; 20 to 50 urad
    and an hour are estimates.
    """
    return Deflection(joints=drift * -np.expm1(-situation.time_s[:, None] / time_constant))


def _bracket(situation: Situation, per_kelvin: Array, reference: float) -> Deflection:
    """The bracket of each joint's reading head expands with the joint temperature: ``per_kelvin`` [rad/K]."""
    return Deflection(joints=per_kelvin * (situation.joints_c - reference))


def _wandering_zeros(situation: Situation, drift: Array, paths: RandomPaths) -> Deflection:
    """The zero of each joint's encoder wanders along a smooth random path of its own, scaled by ``drift``."""
    return Deflection(joints=drift * paths.at(np.maximum(situation.time_s, 0.0)))


def _warm_up_or_bracket(parameters: Parameters) -> PlantEffect:
    if parameters.all_or_none("per_kelvin"):
        return made(by(Offset, _bracket), _REFERENCE, per_kelvin=NUMBERS)(parameters)
    return made(by(Offset, _warm_up), drift=NUMBERS, time_constant=POSITIVES)(parameters)


def _wandering(drift: Array, time: float, seed: int) -> PlantEffect:
    return Offset(_wandering_zeros, {"drift": drift, "paths": RandomPaths.sampled(seed, len(drift), time)})


joint_drift = by_law(warm_up=_warm_up_or_bracket, wandering=made(_wandering, drift=NUMBERS, time=POSITIVE, seed=SEED))
"""Per joint final ``drift`` [rad] and ``time_constant`` [s]; or ``per_kelvin`` [rad/K].

Optional with the latter: ``reference`` [degC], 20 by default, at which the zeros are correct. With ``law`` wandering:
``drift`` [rad] per joint, the ``time`` [s] of the paths' quickest wave, and their ``seed``.
"""
