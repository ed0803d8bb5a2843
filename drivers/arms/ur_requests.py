"""Checks of a motion request for a UR arm before anything is sent: goals, speeds, accelerations and their limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import JointLimits, LimitExceeded
from drivers.arms.ur_checks import JOINTS

_ROUNDING_RAD = 1e-9
_LIMIT_SLACK = 1e-6
"""Relative tolerance of a speed or acceleration limit for rounding."""


def checked_goal(name: str, q: NDArray[np.float64], limits: JointLimits) -> NDArray[np.float64]:
    """Check a goal of arm ``name``; return its joint positions (6,) [rad]. Raises ``LimitExceeded``."""
    goal = _checked_vector(name, "position", q)
    low, high = limits.position.T
    for joint in np.flatnonzero((goal < low - _ROUNDING_RAD) | (goal > high + _ROUNDING_RAD)):
        raise LimitExceeded(
            f"arm {name}: position {goal[joint]:.4f} rad of joint {joint + 1} is outside"
            f" [{low[joint]:.4f}, {high[joint]:.4f}] rad"
        )
    return goal


def checked_rows(name: str, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Check joint positions; return them, (n, 6) [rad]. Raises ``LimitExceeded``."""
    rows = np.asarray(q, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != JOINTS:
        raise LimitExceeded(f"arm {name}: positions have shape {rows.shape}, expected rows of {JOINTS} joints")
    if not np.isfinite(rows).all():
        raise LimitExceeded(f"arm {name}: row {int(np.argmin(np.isfinite(rows).all(axis=1)))} is not finite numbers")
    return rows


def checked_speed(name: str, speed: NDArray[np.float64], limits: JointLimits) -> NDArray[np.float64]:
    """Check speeds; return them, (6,) [rad/s]. Raises ``LimitExceeded``."""
    return _checked_rates(name, "speed", "rad/s", speed, limits.speed)


def checked_acceleration(name: str, acceleration: NDArray[np.float64], limits: JointLimits) -> NDArray[np.float64]:
    """Check accelerations; return them, (6,) [rad/s^2]. Raises ``LimitExceeded``."""
    return _checked_rates(name, "acceleration", "rad/s^2", acceleration, limits.acceleration)


def narrower(asked: JointLimits, allowed: JointLimits | None) -> JointLimits:
    """Return the intersection of the limits. They differ only by rounding: ``checks`` refuses anything more."""
    if allowed is None:
        return asked
    position = np.column_stack(
        [
            np.maximum(asked.position[:, 0], allowed.position[:, 0]),
            np.minimum(asked.position[:, 1], allowed.position[:, 1]),
        ]
    )
    return replace(asked, position=position, speed=np.minimum(asked.speed, allowed.speed))


def _checked_vector(name: str, what: str, value: NDArray[np.float64]) -> NDArray[np.float64]:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise LimitExceeded(f"arm {name}: {what}: expected {JOINTS} numbers") from None
    if array.shape != (JOINTS,):
        raise LimitExceeded(
            f"arm {name}: {what} has shape {array.shape}, expected one number for each of {JOINTS} joints"
        )
    if not np.isfinite(array).all():
        joint = int(np.argmin(np.isfinite(array))) + 1
        raise LimitExceeded(f"arm {name}: {what} of joint {joint} is not a finite number")
    return array


def _checked_rates(
    name: str, what: str, unit: str, value: NDArray[np.float64], limit: NDArray[np.float64]
) -> NDArray[np.float64]:
    rate = _checked_vector(name, what, value)
    for joint in np.flatnonzero((rate <= 0.0) | (rate > limit * (1.0 + _LIMIT_SLACK))):
        raise LimitExceeded(
            f"arm {name}: {what} {rate[joint]:g} {unit} of joint {joint + 1} is not above 0 and at most"
            f" {limit[joint]:g} {unit}"
        )
    return rate
