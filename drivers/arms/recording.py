"""Recordings of an arm's joints at the rate of its controller."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class JointRecord:
    """Samples that a controller sent at its own rate.

    Attributes
    ----------
    time_s : array, shape (n,)
        Stamps of the controller's own clock [s].
    q, qd : arrays, shape (n, N)
        Joint positions [rad] and speeds [rad/s].
    period_s : float
        Time between two samples [s].
    current_a, torque_nm, temperature_c : arrays, shape (n, N), or None
        Motor currents [A], joint torques [Nm], joint temperatures [degC]; None: not reported.
    triggers_s : array, shape (k,)
        Stamps of the samples in which a pulse to the tracker began [s].
    """

    time_s: NDArray[np.float64]
    q: NDArray[np.float64]
    qd: NDArray[np.float64]
    period_s: float
    current_a: NDArray[np.float64] | None = None
    torque_nm: NDArray[np.float64] | None = None
    temperature_c: NDArray[np.float64] | None = None
    triggers_s: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    @property
    def missing(self) -> int:
        """How many samples did not come, by the controller's clock."""
        return int(np.maximum(np.rint(np.diff(self.time_s) / self.period_s) - 1.0, 0.0).sum())


def counts_so_far(count: int, began_s: float, latest_s: float, period_s: float) -> tuple[int, int]:
    """How many samples, or points, have come, and how many did not by the stamps of the first and newest one [s]."""
    return count, max(round((latest_s - began_s) / period_s) + 1 - count, 0)


@runtime_checkable
class RecordingArm(Protocol):
    """What an arm can do besides, if its driver records every sample of its controller."""

    def start_recording(self) -> None:
        """Record from now on, over a connection of its own; the first sample has come then. Raises ``LinkLost``."""

    def pulse(self) -> bool:
        """Send a pulse to the tracker's trigger input; False if the profile has no output for it.

        While a recording is on. Raises ``LinkLost``.
        """

    def recorded(self) -> tuple[int, int]:
        """How many samples have come of the recording that is on, and how many did not; never blocks."""

    def end_recording(self) -> JointRecord:
        """End recording and return all samples. Raises ``LinkLost`` if the connection ended before."""
