"""Capability of an instrument for each characteristic, before anything is measured.

A perfect arm is simulated: it reaches each commanded position exactly, cycle after cycle, and all scatter is the
tracker's stated covariance. Its characteristic and expanded uncertainty are computed by the same functions as for
measured cycles. If their sum is above the tolerance, the guarded rule (ISO 14253-1) cannot be expected to prove
conformity of any arm with this instrument at this distance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.estimation.iso9283.records import IsoAbility, IsoValue
from cellapp.estimation.iso9283.uncertainty import (
    Cycles,
    accuracy_value,
    directional_value,
    distance_values,
    drift_values,
    repeatability_value,
)
from cellapp.estimation.uncertainty.records import Characteristic
from cellapp.ground.counting import counted
from cellapp.robot.kinematics.transforms import Array

_ARMS = 5
"""Number of simulated arms, of which the median is taken."""
_CYCLES = (10, 30, 60, 100, 200)
"""Numbers of cycles that are tried."""
_HALVINGS = 5
"""Number of bisections: they find the sufficient distance to a thirtieth of the possible range."""
_SEED = 0x9283

CovarianceAt = Callable[[float], Array]
"""Covariance (3, 3) [m^2] of a measured position at a distance from the tracker [m], along the x axis."""


@dataclass(frozen=True, eq=False)
class Instrument:
    """Measuring instrument.

    Attributes
    ----------
    covariance : callable
        Distance [m] -> covariance of a point (3, 3) [m^2], the beam along x.
    shortest_m : float
        Shortest distance at which it measures [m].
    frame : array, shape (3, 3)
        Covariance of the commanded positions [m^2]; zero unless base and SMR are found by measuring.
    """

    covariance: CovarianceAt
    shortest_m: float
    frame: Array


_Shown = Callable[[Sequence[Cycles], np.random.Generator], IsoValue]
_FORMULAS: Mapping[Characteristic, tuple[int, _Shown]] = {
    "pose_accuracy": (1, lambda cycles, rng: accuracy_value(cycles[0], rng)),
    "pose_repeatability": (1, lambda cycles, rng: repeatability_value(cycles[0], rng)[0]),
    "multidirectional": (3, directional_value),
    "distance_accuracy": (2, lambda cycles, rng: distance_values(cycles[0], cycles[1], rng)[0]),
    "distance_repeatability": (2, lambda cycles, rng: distance_values(cycles[0], cycles[1], rng)[1]),
    "drift": (2, lambda cycles, rng: drift_values(cycles, rng)[0]),
    "cooperative": (2, lambda cycles, rng: distance_values(cycles[0], cycles[1], rng)[0]),
}
"""Number of positions of a characteristic, and its formula. Paths are missing: no scatter of a moving SMR is stated."""
_APART_M = 0.5
"""Distance between two simulated positions; its effect on their uncertainty is negligible."""


def least_shown_mm(characteristic: Characteristic, instrument: Instrument, distance_m: float, n: int) -> float:
    """Compute characteristic plus expanded uncertainty [mm] of a perfect arm in ``n`` cycles: the median of a few."""
    count, formula = _FORMULAS[characteristic]
    rng = np.random.default_rng([_SEED, n])
    tracker = instrument.covariance(distance_m)
    apart = np.array([0.0, _APART_M, 0.0]) if characteristic != "drift" and count == 2 else np.zeros(3)
    shown = []
    for _ in range(_ARMS):
        cycles = [_perfect(k * apart, tracker, instrument.frame, n, rng) for k in range(count)]
        value = formula(cycles, rng)
        shown.append(abs(value.value_mm) + (value.expanded_mm or 0.0))
    return float(np.median(shown))


def ability(
    characteristic: Characteristic,
    where: str,
    instrument: Instrument,
    distance_m: float,
    n: int,
    tolerance_mm: float,
) -> IsoAbility:
    """Compare a tolerance with the value of a perfect arm; if it is below, find a sufficient distance or cycle count.

    ``distance_m`` is the largest from the tracker to a pose of the test, ``n`` the requested number of cycles.
    """
    shown = least_shown_mm(characteristic, instrument, distance_m, n)
    found = IsoAbility(
        characteristic=characteristic,
        where=where,
        tolerance_mm=tolerance_mm,
        shown_mm=shown,
        distance_m=distance_m,
        cycles=n,
    )
    if shown <= tolerance_mm:
        return found
    return found.model_copy(
        update={
            "distance_that_does_m": _distance(characteristic, instrument, distance_m, n, tolerance_mm),
            "cycles_that_do": _cycles(characteristic, instrument, distance_m, n, tolerance_mm),
        }
    )


def ability_words(one: IsoAbility) -> str:
    """Explain why conformity with a tolerance cannot be proven, and the remedies; empty if it can be proven."""
    if one.shown_mm <= one.tolerance_mm:
        return ""
    said = (
        f"{one.characteristic.replace('_', ' ')} of {one.where}: the tolerance of {one.tolerance_mm:g} mm is below what"
        f" the tracker can tell at {one.distance_m:.1f} m with {counted(one.cycles, 'cycle')}: an arm without any"
        f" error would show {one.shown_mm:.3f} mm with its uncertainty, so that 'conforms' is not to be expected"
    )
    ways = []
    if one.distance_that_does_m is not None:
        ways.append(f"a tracker at {one.distance_that_does_m:.1f} m or nearer")
    if one.cycles_that_do is not None:
        ways.append(f"{one.cycles_that_do} cycles")
    if ways:
        return f"{said}; {' or '.join(ways)} would do"
    return f"{said}; neither a nearer tracker nor more cycles would do, but a wider tolerance or another instrument"


# -- inside -----------------------------------------------------------------------------------------------------------


def _perfect(commanded: Array, tracker: Array, frame: Array, n: int, rng: np.random.Generator) -> Cycles:
    scatter = rng.multivariate_normal(np.zeros(3), tracker, size=n, method="eigh")
    return Cycles(commanded + scatter, commanded, tracker, frame)


def _distance(
    characteristic: Characteristic, instrument: Instrument, distance_m: float, n: int, tolerance_mm: float
) -> float | None:
    """Find a shorter distance [m] that is sufficient; None if there is none."""
    does, does_not = instrument.shortest_m, distance_m
    if does >= does_not or least_shown_mm(characteristic, instrument, does, n) > tolerance_mm:
        return None
    for _ in range(_HALVINGS):
        middle = 0.5 * (does + does_not)
        if least_shown_mm(characteristic, instrument, middle, n) <= tolerance_mm:
            does = middle
        else:
            does_not = middle
    return does


def _cycles(
    characteristic: Characteristic, instrument: Instrument, distance_m: float, n: int, tolerance_mm: float
) -> int | None:
    """Find the smallest larger number of cycles that is sufficient; None if there is none."""
    for tried in _CYCLES:
        if tried > n and least_shown_mm(characteristic, instrument, distance_m, tried) <= tolerance_mm:
            return tried
    return None
