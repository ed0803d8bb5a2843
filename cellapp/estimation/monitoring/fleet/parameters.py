"""Geometric parameters of one arm over its runs, and their differences from the first run.

The covariance of an estimate includes what its priors leave open, so that single parameters of a redundant chain have
large standard errors. Compared are the combinations that the data of the first run determine, of all runs alike: each
kept parameter with the shares of those that are merged into it.

The geometry of a run is that at its mean temperatures. Between runs at different ones links grow, which is no change of
the arm: lengths have an uncertainty for it. The zero of a joint that drifts within a run is of the day and not tested.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtr

from cellapp.estimation.monitoring.fleet.record import ArmRecord, GeometryRecord
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import BASE_NAMES, PROBE_NAMES, TOOL_NAMES

Array = NDArray[np.float64]

MODEL_CHOICE = 1.25
"""Factor on standard errors of differences. They hold for the effects that were named; a weak effect that one run names
and another does not moves the geometry a little. Over unchanged twins with other plans the differences scatter 0.8 to
1.25 times as widely as the standard errors say."""


EXPANSION = 23e-6
"""Standard uncertainty of how much a length grows from run to run [1/K]: the expansion of aluminium, the largest of the
usual materials of arms."""
HOUSING_M = 0.1
"""Least length that grows with a length of the chain [m]: the housing of a joint, where the chain's own is nearly 0."""


@dataclass(frozen=True)
class Determined:
    """A parameter that the data determine: its estimate, and the length [m] that grows with it, 0 for an angle."""

    value: float
    standard_error: float
    length_m: float = 0.0


@dataclass(frozen=True)
class Comparison:
    """The difference of a value from that of the first run, and its chance without a change (None: not tested).

    ``growth`` is the part of the standard uncertainty that is due to other temperatures.
    """

    value: float
    standard_error: float
    difference: float
    growth: float
    standard_uncertainty: float
    p_value: float | None


def is_installation(name: str) -> bool:
    """Whether a geometric parameter is of the base or of the tool, which a person may move."""
    return name in BASE_NAMES + TOOL_NAMES + PROBE_NAMES


def determined_values(geometry: GeometryRecord, first: GeometryRecord) -> dict[str, Determined]:
    """The combinations that the data of the ``first`` run determine, in another run.

    Parameters that the other run did not estimate are left out.
    """
    names = list(geometry.values)
    place = {name: k for k, name in enumerate(names)}
    kept = [name for name in first.determined if name in place]
    shares = np.zeros((len(kept), len(names)))
    for row, name in enumerate(kept):
        shares[row, place[name]] = 1.0
        for dropped, takers in first.merged.items():
            if dropped in place:
                shares[row, place[dropped]] = takers.get(name, 0.0)
    nominal = np.array([geometry.nominal[name] for name in names])
    deviations = np.array(list(geometry.values.values())) - nominal
    values = shares @ deviations + np.array([geometry.nominal[name] for name in kept])
    variances = np.einsum("ki,ij,kj->k", shares, _full(geometry.covariance, len(names)), shares)
    errors = np.sqrt(np.maximum(variances, 0.0))
    grows = np.where([is_angle(name) for name in names], 0.0, np.maximum(np.abs(nominal), HOUSING_M))
    lengths = np.where([is_angle(name) for name in kept], 0.0, np.abs(shares) @ grows)
    rows = zip(kept, values.tolist(), errors.tolist(), lengths.tolist(), strict=True)
    return {name: Determined(value, error, length) for name, value, error, length in rows}


def compare(
    own: Determined, first: Determined, freedom: int | None, *, angle: bool, tested: bool = True, warmer_K: float = 0.0
) -> Comparison:
    """The difference of two independent estimates (JCGM 100:2008, 5.1.2), ``warmer_K`` apart in temperature.

    ``freedom`` are the degrees of freedom of Student's t, None for a normal distribution.
    """
    difference = own.value - first.value
    if angle:
        difference = math.remainder(difference, math.tau)  # an angle near half a turn may have either sign
    estimated = MODEL_CHOICE * math.hypot(own.standard_error, first.standard_error)
    growth = EXPANSION * own.length_m * warmer_K
    uncertainty = math.hypot(estimated, growth)
    known = tested and uncertainty > 0.0 and math.isfinite(uncertainty)
    p_value = two_sided(difference / uncertainty, freedom) if known else None
    return Comparison(own.value, own.standard_error, difference, growth, uncertainty, p_value)


def two_sided(z: float, freedom: int | None) -> float:
    """Chance of a deviation as large as ``z`` standard uncertainties, of either sign."""
    return float(2.0 * (ndtr(-abs(z)) if freedom is None else stdtr(freedom, -abs(z))))


def compared_parameters(
    arms: Sequence[ArmRecord],
) -> Mapping[str, tuple[Determined, list[tuple[int, Comparison]]]]:
    """Parameter -> estimate in the first run, and comparisons of later runs with their place; all have a geometry."""
    geometries = [arm.geometry for arm in arms if arm.geometry is not None]
    first = geometries[0]
    compared: dict[str, tuple[Determined, list[tuple[int, Comparison]]]] = {
        name: (own, []) for name, own in determined_values(first, first).items()
    }
    for place in range(1, len(geometries)):
        warmer_K = temperature_difference(arms[0], arms[place])
        drifting = _drifting_zeros(arms[0]) | _drifting_zeros(arms[place])
        freedom = max(1, min(first.degrees_of_freedom, geometries[place].degrees_of_freedom))
        for name, found in determined_values(geometries[place], first).items():
            own, rows = compared[name]
            tested = not is_installation(name) and name not in drifting
            row = compare(found, own, freedom, angle=is_angle(name), tested=tested, warmer_K=warmer_K)
            rows.append((place, row))
    return compared


def temperature_difference(a: ArmRecord, b: ArmRecord) -> float:
    """Largest difference of the mean temperatures of two runs [K], of the air or of a joint; 0 where none is known."""
    common = a.temperatures_c.keys() & b.temperatures_c.keys()
    return max((abs(a.temperatures_c[where] - b.temperatures_c[where]) for where in common), default=0.0)


def _drifting_zeros(arm: ArmRecord) -> set[str]:
    """Zeros of joints that drift within a run."""
    return {
        f"theta{joint}"
        for effect in arm.effects or ()
        if effect.effect in EFFECTS and EFFECTS[effect.effect].shifts_zero
        for joint in effect.where.joints
    }


def is_angle(name: str) -> bool:
    """Whether a geometric parameter is an angle [rad]; the others are lengths [m]."""
    return name.startswith(("alpha", "beta", "theta"))


def _full(lower: Sequence[float], k: int) -> Array:
    """The symmetric matrix (k, k) of its lower triangle."""
    matrix = np.zeros((k, k))
    matrix[np.tril_indices(k)] = lower
    return matrix + np.tril(matrix, -1).T
