"""Reports of the steps of collecting: the same details and sentences live and from a stored run."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run import Outcome
from cellapp.estimation.readings import Reading
from cellapp.ground.progress import JobState, MotionEnded, PointMeasured, SweepLive
from drivers.arms.protocol import ArmState

_STATES: dict[str, JobState | None] = {
    "pause": "paused",
    "suspend": "suspended",
    "resume": "running",
    "give up": "running",
    "abort": "aborted",
    "reference": None,
}
"""Job state that each recorded kind begins, None if it changes nothing; any other kind is a cause of a halt."""


def state_of(kind: str) -> JobState | None:
    """Return the state of the job after a record of ``kind`` in a session; None if it did not change."""
    return _STATES.get(kind, "stopped")


def record_sentence(kind: str, reason: str) -> str:
    """Return the log line of a session record."""
    return f"{kind}: {reason}"


def missed_sentence(outcome: Outcome) -> str:
    """Return the log line of an SMR that was not measured."""
    return f"stop {outcome.stop + 1}, arm {outcome.arm}: {outcome.kind}: {outcome.reason}"


def sweep_sentence(live: SweepLive) -> str:
    """Return the progress of a sweep as a sentence: "stop 3: sweep of left 62%, 10 of 16 s, SMR 3.412 m"."""
    return f"stop {live.stop + 1}: sweep of {live.arm} {', '.join(live.words())}"


def vectors(q: Mapping[str, NDArray[np.float64]]) -> dict[str, tuple[float, ...]]:
    """Convert joint positions of arms, name -> (N,) [rad], into tuples."""
    return {name: tuple(one.tolist()) for name, one in q.items()}


def motion_ended(stop: int | None, states: Mapping[str, ArmState]) -> MotionEnded:
    """Return the report of a motion's end from the states of the arms at rest."""
    warm = {name: one.joint_temperature_c for name, one in states.items() if one.joint_temperature_c is not None}
    return MotionEnded(stop, vectors({name: one.q for name, one in states.items()}), vectors(warm))


def point_measured(stop: int, arm: str, reading: Reading) -> PointMeasured:
    """Return the detail of a reading."""
    x, y, z = reading.p_M.tolist()
    warm = reading.joint_temperature_c
    return PointMeasured(
        stop=stop,
        arm=arm,
        q=tuple(reading.q.tolist()),
        p_M=(x, y, z),
        sigma_mm=_sigma_mm(reading),
        temperature_c=reading.temperature_c,
        joint_temperature_c=None if warm is None else tuple(warm.tolist()),
    )


def _sigma_mm(reading: Reading) -> float | None:
    if reading.covariance_M is not None:
        return 1e3 * math.sqrt(float(np.trace(reading.covariance_M)))
    return None if reading.sigma_m is None else 1e3 * math.sqrt(3.0) * reading.sigma_m
