"""How the tracker sees an SMR, and each condition under which it can be measured."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.bodies import Placed
from cellapp.robot.kinematics.transforms import Array

_ACCEPTANCE_MARGIN = math.radians(3.0)
"""Subtracted from the SMR's acceptance angle, as base and flange are not known exactly before calibration."""

RANGE, AZIMUTH, ELEVATION, FACING = "range", "azimuth", "elevation", "facing"
"""Names of the conditions on an SMR that do not depend on bodies."""


@dataclass(frozen=True, eq=False)
class Sight:
    """SMRs as the tracker sees them; n stands for any shape.

    Attributes
    ----------
    smr_M : array, shape (3, n)
        SMR centres in the tracker frame M [m].
    distance : array, shape (n)
        From the tracker [m].
    cosine : array, shape (n)
        Cosine of the incidence.
    """

    smr_M: Array
    distance: Array
    cosine: Array

    @property
    def azimuth(self) -> Array:
        """Azimuth in the tracker frame [rad]."""
        return np.asarray(np.arctan2(self.smr_M[1], self.smr_M[0]))

    @property
    def sine_of_elevation(self) -> Array:
        """Sine of the elevation; NaN at the tracker itself."""
        return np.asarray(self.smr_M[2] / self.distance)

    @property
    def incidence(self) -> Array:
        """Angle between the SMR's viewing direction and the direction to the tracker [rad]."""
        return np.asarray(np.arccos(np.clip(self.cosine, -1.0, 1.0)))


def sight_of(T_C_M: Array, placed: Placed) -> Sight:
    """Compute how the tracker at ``T_C_M`` (4, 4) sees the SMRs of an arm at n configurations."""
    from_tracker = placed.smr - T_C_M[:3, 3]
    distance = np.linalg.norm(from_tracker, axis=1)
    with np.errstate(invalid="ignore"):  # an SMR at the tracker gives NaN, which counts as not seen
        cosine = -np.einsum("na,na->n", from_tracker, placed.normal) / distance
    return Sight((from_tracker @ T_C_M[:3, :3]).T, distance, cosine)


def usable_acceptance(acceptance: float) -> float:
    """Return the largest incidence that is planned for an SMR with half the acceptance angle ``acceptance`` [rad]."""
    return max(0.0, acceptance - _ACCEPTANCE_MARGIN)


def sight_conditions(field: TrackerField, acceptance: float, sight: Sight) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield each condition on the SMRs and where it holds, shape (n): distance, directions, incidence. NaN fails."""
    low, high = field.distance
    yield RANGE, (sight.distance >= low) & (sight.distance <= high)
    left, right = field.azimuth
    if right - left < 2.0 * math.pi:
        yield AZIMUTH, np.asarray(np.mod(sight.azimuth - left, 2.0 * math.pi) <= right - left)
    lowest, highest = np.sin(np.clip(field.elevation, -0.5 * math.pi, 0.5 * math.pi))
    sine = sight.sine_of_elevation
    yield ELEVATION, (sine >= lowest) & (sine <= highest)
    yield FACING, sight.cosine > math.cos(usable_acceptance(acceptance))


@dataclass(frozen=True)
class TrackerField:
    """Field of view of the tracker at pose ``T_C_M`` (4, 4) in the cell frame C: ranges in the tracker frame.

    ``azimuth`` and ``elevation`` in [rad], the azimuth range may cross the cut at pi; ``distance`` in [m].
    """

    T_C_M: Array
    azimuth: tuple[float, float]
    elevation: tuple[float, float]
    distance: tuple[float, float]
