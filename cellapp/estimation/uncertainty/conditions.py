"""Conditions of an arm's measurements: distances from the tracker, temperatures, payload. No I/O."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.readings.readings import Readings

Range = tuple[float, float]


@dataclass(frozen=True)
class MeasuredConditions:
    """Smallest and largest values over the readings of one arm; None if no reading has the quantity.

    ``distance_m`` is from the tracker to the SMR, ``air_c`` the air or arm temperature of the readings, ``joints_c``
    that of the joints [degC], ``payload_kg`` the payload.
    """

    readings: int
    distance_m: Range | None = None
    air_c: Range | None = None
    joints_c: Range | None = None
    payload_kg: Range | None = None


def measured_conditions(readings: Mapping[str, Readings]) -> dict[str, MeasuredConditions]:
    """Return the conditions of the readings of each arm."""
    return {name: _of_arm(arm) for name, arm in readings.items()}


def _of_arm(readings: Readings) -> MeasuredConditions:
    return MeasuredConditions(
        readings=len(readings),
        distance_m=_range(np.linalg.norm(readings.p_M, axis=1)),
        air_c=_range(readings.temperature_c),
        joints_c=_range(readings.joint_temperature_c),
        payload_kg=_range(readings.payload_kg),
    )


def _range(values: NDArray[np.float64] | None) -> Range | None:
    known = np.empty(0) if values is None else values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if len(known) else None
