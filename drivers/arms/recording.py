"""Recordings of an arm's joints at the rate of its controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import Arm


@dataclass(frozen=True, eq=False)
class JointRecord:
    """Samples that a controller sent at its own rate.

    Attributes
    ----------
    time_s : array, shape (n,)
        Timestamps of the controller's own clock [s].
    q, qd : arrays, shape (n, N)
        Joint positions [rad] and speeds [rad/s].
    period_s : float
        Time between two samples [s].
    joint_temperature_c : array, shape (n, N), or None
        Joint temperatures [degC]; None if not reported.
    """

    time_s: NDArray[np.float64]
    q: NDArray[np.float64]
    qd: NDArray[np.float64]
    period_s: float
    joint_temperature_c: NDArray[np.float64] | None = None

    @property
    def missing(self) -> int:
        """Number of samples that were lost, by the controller's clock."""
        return int(np.maximum(np.rint(np.diff(self.time_s) / self.period_s) - 1.0, 0.0).sum())


@runtime_checkable
class RecordingArm(Protocol):
    """Additional interface of an arm whose driver records every sample of its controller."""

    def start_recording(self) -> None:
        """Start recording over a separate connection; return after the first sample. Raises ``LinkLost``."""

    def end_recording(self) -> JointRecord:
        """End the recording after one more sample; return all. Raises ``LinkLost`` if the connection ended before."""


@runtime_checkable
class SettlingArm(RecordingArm, Protocol):
    """Additional interface of a recorded arm that states when it counts as settled."""

    @property
    def settle_window(self) -> float:
        """Largest change of a joint at rest [rad]."""


def recording(arm: Arm) -> Callable[[], JointRecord]:
    """Begin to record an arm at rest; return the function that ends it. Both raise ``ArmError``.

    Of an arm that is not a ``SettlingArm``, the only sample is its state at the end.
    """
    if isinstance(arm, SettlingArm):
        arm.start_recording()
        return arm.end_recording

    def end() -> JointRecord:
        state = arm.state()
        return JointRecord(np.array([state.time_s]), state.q[np.newaxis], np.zeros((1, len(state.q))), 1.0)

    return end
