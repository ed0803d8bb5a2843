"""Checks of a motion or of a stream of joint positions before they are sent: finite numbers, limits, steps, start."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import JointLimits, LimitExceeded

AT_START_RAD = 1e-3
"""Largest distance of the arm from the first position: well above repeatability, well below a visible jump."""
_ROUNDING_RAD = 1e-9
_SLACK = 1e-3
"""Relative excess of speed and acceleration that is taken for rounding of the samples."""


_RATE_SLACK = 1e-6
"""Relative excess of a stated speed or acceleration that is taken for rounding."""


def checked_move(
    name: str,
    q: NDArray[np.float64],
    speed: NDArray[np.float64],
    acceleration: NDArray[np.float64],
    limits: JointLimits,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Check goal, speed and acceleration (N,) of a motion of arm ``name``; return arrays. Raises ``LimitExceeded``."""
    goal = _per_joint(name, "position", q, len(limits.speed))
    low, high = limits.position.T
    for joint in np.flatnonzero((goal < low - _ROUNDING_RAD) | (goal > high + _ROUNDING_RAD)):
        raise LimitExceeded(
            f"arm {name}: position {goal[joint]:.4f} rad of joint {joint + 1} is outside"
            f" [{low[joint]:.4f}, {high[joint]:.4f}] rad"
        )
    rates = []
    for what, unit, value, most in (
        ("speed", "rad/s", speed, limits.speed),
        ("acceleration", "rad/s^2", acceleration, limits.acceleration),
    ):
        rate = _per_joint(name, what, value, len(most))
        for joint in np.flatnonzero((rate <= 0.0) | (rate > most * (1.0 + _RATE_SLACK))):
            raise LimitExceeded(
                f"arm {name}: {what} {rate[joint]:g} {unit} of joint {joint + 1} is not above 0 and at most"
                f" {most[joint]:g} {unit}"
            )
        rates.append(rate)
    return goal, rates[0], rates[1]


def _per_joint(name: str, what: str, value: NDArray[np.float64], joints: int) -> NDArray[np.float64]:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise LimitExceeded(f"arm {name}: {what}: expected {joints} numbers") from None
    if array.shape != (joints,):
        raise LimitExceeded(
            f"arm {name}: {what} has shape {array.shape}, expected one number for each of {joints} joints"
        )
    if not np.isfinite(array).all():
        joint = int(np.argmin(np.isfinite(array))) + 1
        raise LimitExceeded(f"arm {name}: {what} of joint {joint} is not a finite number")
    return array


def checked_path(
    name: str,
    q: NDArray[np.float64],
    period_s: float,
    controller_period_s: float,
    limits: JointLimits,
    here: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Check a stream of joint positions (m, N) [rad] for arm ``name``, which rests at ``here`` (N,); return an array.

    Raises ``LimitExceeded`` with the first place that must not be sent. The stream begins and ends at rest.
    """
    path = np.array(q, dtype=np.float64)
    joints = len(here)
    if path.ndim != 2 or path.shape[1] != joints or len(path) < 2:
        raise LimitExceeded(
            f"arm {name}: a path has shape {path.shape}, expected two or more rows of {joints} joint positions"
        )
    if period_s != controller_period_s:
        raise LimitExceeded(
            f"arm {name}: a path with a position each {period_s * 1e3:g} ms; its controller takes one each"
            f" {controller_period_s * 1e3:g} ms"
        )
    low, high = limits.position.T
    _refuse(name, ~np.isfinite(path), path, "position", "is not a finite number")
    outside = (path < low - _ROUNDING_RAD) | (path > high + _ROUNDING_RAD)
    _refuse(name, outside, path, "position", "is outside its limits")
    padded = np.concatenate([path[:1], path, path[-1:]])
    speed = np.diff(padded, axis=0) / period_s
    acceleration = np.diff(speed, axis=0) / period_s
    _refuse(name, np.abs(speed[1:]) > limits.speed * (1.0 + _SLACK), speed[1:], "speed", "is beyond its limit")
    beyond = np.abs(acceleration) > limits.acceleration * (1.0 + _SLACK)
    _refuse(name, beyond, acceleration, "acceleration", "is beyond its limit")
    away = np.abs(path[0] - here)
    if not away.max() <= AT_START_RAD:
        joint = int(np.argmax(away))
        raise LimitExceeded(
            f"arm {name}: joint {joint + 1} is {np.degrees(away[joint]):.3f} deg from the beginning of the path; move"
            " there first"
        )
    return path


def driven(path: NDArray[np.float64], reached: float) -> NDArray[np.float64]:
    """Return the part of ``path`` (m, N) up to the row (with a fraction) ``reached``, at which the arm came to rest."""
    if reached >= len(path) - 1:
        return path
    last = int(reached)
    share = reached - last
    return np.concatenate([path[: last + 1], ((1.0 - share) * path[last] + share * path[last + 1])[None]])


def _refuse(name: str, wrong: NDArray[np.bool_], values: NDArray[np.float64], what: str, problem: str) -> None:
    if wrong.any():
        row, joint = (int(k) for k in np.argwhere(wrong)[0])
        value = f"{what} {values[row, joint]:.4g} of joint {joint + 1}"
        raise LimitExceeded(f"arm {name}: position {row} of the path: {value} {problem}")
