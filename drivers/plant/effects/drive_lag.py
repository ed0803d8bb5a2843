"""Drives that lag: the joint follows what its encoder reports after a delay and with creep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Parameters, PlantEffect, lagging
from drivers.plant.mechanism import Mechanism

_FASTER = 8.0
"""Ratio of the two time constants: the inertia behind the creeping coupling causes the second, faster one."""


@dataclass(frozen=True, eq=False)
class DriveLag(PlantEffect):
    """A viscous coupling with little inertia behind it: per joint (N,) a pure ``delay`` [s], then two time constants,
    the first of them ``time_constant`` [s]."""

    time_constant: Array
    delay: Array

    def response(self, time_s: Array, q: Array, mechanism: Mechanism) -> Array | None:
        late = np.column_stack([np.interp(time_s - d, time_s, own) for d, own in zip(self.delay, q.T, strict=True)])
        step_s = float(time_s[1] - time_s[0])
        for time_constant in (self.time_constant, self.time_constant / _FASTER):
            late = lagging(late, np.exp(-step_s / np.maximum(time_constant, 1e-6)))
        return np.asarray(late - q)


def drive_lag(parameters: Parameters) -> PlantEffect:
    """Build drive lag. Per joint: ``time_constant`` [s]; optional ``delay`` [s]."""
    parameters.require("time_constant", optional=("delay",))
    delay = np.zeros(parameters.joints)
    if parameters.all_or_none("delay"):
        delay = parameters.numbers("delay", least=0.0)
    return DriveLag(parameters.numbers("time_constant", least=0.0), delay)
