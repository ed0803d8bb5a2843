"""Time a joint path: desired speed if the limits allow it, ramps at stops, samples at the controller's rate.

With the speed ``v(s)`` along the path, joint speeds are ``q' v`` and joint accelerations ``q' a + q'' v^2``, where a
prime is the derivative by arc length. Both terms get half of the acceleration limit each, so that the largest ``v^2``
follows from two running minima, without a search (compare Bobrow, Dubowsky, Gibson, Int. J. Robotics Res. 4 (1985) 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.paths.cartesian import CartesianPath
from cellapp.robot.paths.joint_path import JointPath, PathError, Stretch

_GRID_M = 5e-4
_LEAST_GRID = 64
"""Fewest samples of the speed along a stretch."""
_SLOWEST_SHARE = 0.02
"""Least share of the desired speed: if a joint limit allows less, the path passes too near a singularity."""
_TIMING_ROUNDS = 4
_USED = 0.97
"""Share of the limits that is used: differences of samples may slightly exceed the limited derivatives."""


@dataclass(frozen=True)
class Rates:
    """Limits of the motion: of the joints (N,) [rad/s, rad/s^2], and the SMR's acceleration [m/s^2]."""

    speed: Array
    acceleration: Array
    tool_acceleration: float


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A timed joint path, one sample each ``period_s``.

    Attributes
    ----------
    q : array, shape (m, N)
        Controller readings [rad].
    s : array, shape (m,)
        Arc lengths [m].
    period_s : float
    slowed : str
        Where and why the desired speed is not reached, apart from ramps at stops; empty if it is.
    at_speed : float
        Share of the path's length at the desired speed.
    """

    q: Array
    s: Array
    period_s: float
    slowed: str
    at_speed: float

    @property
    def time_s(self) -> Array:
        """Time of each sample [s]."""
        return np.asarray(np.arange(len(self.q)) * self.period_s)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return (len(self.q) - 1) * self.period_s

    def largest_rates(self) -> tuple[Array, Array]:
        """Largest speed and acceleration of each joint (N,), from differences of samples."""
        padded = np.concatenate([self.q[:1], self.q, self.q[-1:]])
        v = np.diff(padded, axis=0) / self.period_s
        return np.abs(v).max(axis=0), np.abs(np.diff(v, axis=0)).max(axis=0) / self.period_s


@dataclass(frozen=True, eq=False)
class _Profile:
    """Speed and time along a stretch: ``s``, ``v``, ``t`` (m,).

    ``bound`` (m,) is the largest speed without ramps, ``limit`` (m) what limits it, in words.
    """

    s: Array
    v: Array
    t: Array
    wanted: Array
    bound: Array
    limit: Sequence[str]


def timed(path: CartesianPath, joints: JointPath, rates: Rates, period_s: float) -> Trajectory:
    """Sample a joint path in time, at the desired speed if the limits allow it.

    Raises
    ------
    PathError
        If a joint limit allows almost no speed (near a singularity), or samples cannot be kept within the limits.
    """
    share = 1.0
    for _ in range(_TIMING_ROUNDS):
        profiles = [_profile(path, stretch, rates, share) for stretch in joints.stretches]
        trajectory = _sampled(joints, profiles, rates, period_s)
        speed, acceleration = trajectory.largest_rates()
        excess = max(
            float((speed / rates.speed).max()), float(np.sqrt((acceleration / rates.acceleration).max())), 1e-9
        )
        if excess <= 1.0:
            return trajectory
        share *= _USED / excess
    raise PathError("its joints cannot follow within their accelerations; widen blends or lower the speed", 0.0)


# -- inside -----------------------------------------------------------------------------------------------------------


def _profile(path: CartesianPath, stretch: Stretch, rates: Rates, share: float) -> _Profile:
    """Compute the speed along one stretch, from rest to rest; ``share`` scales it if samples exceed a limit."""
    begin, end = float(stretch.s[0]), float(stretch.s[-1])
    count = max(_LEAST_GRID, int(np.ceil((end - begin) / _GRID_M)))
    s = np.linspace(begin, end, count + 1)
    spline = stretch.spline
    first, second = np.abs(spline(s, 1)), np.abs(spline(s, 2))
    tiny = 1e-12
    by_speed = _USED * rates.speed / np.maximum(first, tiny)
    by_turning = np.sqrt(0.5 * _USED * rates.acceleration / np.maximum(second, tiny))
    by_joint = np.minimum(by_speed, by_turning)
    joint = np.argmin(by_joint, axis=1)
    wanted = path.wanted_speed(np.minimum(s, np.nextafter(end, begin)))
    by_curve = np.sqrt(0.5**0.5 * rates.tool_acceleration / np.maximum(_curvature(path, s), tiny))
    bound = np.minimum(by_joint.min(axis=1), by_curve)
    most = share * np.minimum(wanted, bound)
    ramp = share**2 * np.minimum(
        0.5**0.5 * rates.tool_acceleration, (0.5 * _USED * rates.acceleration / np.maximum(first, tiny)).min(axis=1)
    )
    if (slow := most < _SLOWEST_SHARE * wanted).any():
        k = int(np.argmax(slow))
        raise PathError(
            f"near a singularity: joint {joint[k] + 1} would leave {most[k] / wanted[k]:.1%} of the wanted speed",
            float(s[k]),
        )
    square = most**2
    square[[0, -1]] = 0.0
    gained = np.concatenate([[0.0], np.cumsum((ramp[1:] + ramp[:-1]) * np.diff(s))])  # of v^2, at full ramp
    square = gained + np.minimum.accumulate(square - gained)
    square = np.minimum.accumulate((square + gained)[::-1])[::-1] - gained
    v = np.sqrt(np.maximum(square, 0.0))
    t = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (v[1:] + v[:-1]))])
    by_tool = by_curve < by_joint.min(axis=1)
    limit = ["the tool's acceleration" if tool else f"joint {j + 1}" for tool, j in zip(by_tool, joint, strict=True)]
    return _Profile(s, v, t, wanted, bound, limit)


def _curvature(path: CartesianPath, s: Array) -> Array:
    """Compute the curvature (n,) of the path [1/m] by finite differences."""
    h = 1e-4
    inner = np.clip(s, s[0] + h, s[-1] - h)
    before, here, after = path.positions(inner - h), path.positions(inner), path.positions(inner + h)
    return np.asarray(np.linalg.norm(after - 2.0 * here + before, axis=1) / h**2)


def _sampled(joints: JointPath, profiles: list[_Profile], rates: Rates, period_s: float) -> Trajectory:
    q: list[Array] = []
    s: list[Array] = []
    for stretch, profile in zip(joints.stretches, profiles, strict=True):
        at = _arc_lengths(profile, period_s)
        rows = stretch.spline(at)
        if q:  # joints that reverse at the stop cross their backlash there
            rows = np.concatenate([_crossed(q[-1][-1], rows[0], rates, period_s), rows])
            at = np.concatenate([np.full(len(rows) - len(at), at[0]), at])
        q.append(rows)
        s.append(at)
    slowed, at_speed = _slowed(profiles)
    return Trajectory(np.concatenate(q), np.concatenate(s), period_s, slowed, at_speed)


def _arc_lengths(profile: _Profile, period_s: float) -> Array:
    """Return arc lengths [m] every ``period_s``; the last one is the end of the stretch."""
    t = np.append(np.arange(0.0, profile.t[-1], period_s), profile.t[-1])
    if len(t) > 2 and t[-1] - t[-2] < period_s:  # the end comes between two samples: stretch time by less than one
        t = np.linspace(0.0, profile.t[-1], len(t))
    k = np.clip(np.searchsorted(profile.t, t, side="right") - 1, 0, len(profile.t) - 2)
    tau = t - profile.t[k]
    a = (profile.v[k + 1] ** 2 - profile.v[k] ** 2) / (2.0 * (profile.s[k + 1] - profile.s[k]))
    return np.asarray(np.clip(profile.s[k] + tau * (profile.v[k] + 0.5 * tau * a), profile.s[0], profile.s[-1]))


def _crossed(start: Array, goal: Array, rates: Rates, period_s: float) -> Array:
    """Sample a motion from rest at ``start`` to rest at ``goal`` (N,) [rad]: (k, N), without both ends."""
    way = np.abs(goal - start)
    if way.max() < 1e-9:
        return np.empty((0, len(start)))
    # the largest speed of a quintic is 1.875 of the mean, its largest acceleration 5.774 of way / duration^2
    duration = max(float((1.875 * way / rates.speed).max()), float(np.sqrt(5.774 * way / rates.acceleration).max()))
    count = int(np.ceil(1.1 * duration / period_s)) + 2
    x = np.linspace(0.0, 1.0, count + 1)[1:-1, None]
    return np.asarray(start + x**3 * (10.0 - x * (15.0 - 6.0 * x)) * (goal - start))


def _slowed(profiles: list[_Profile]) -> tuple[str, float]:
    """Say where a limit slows the path most; also return the share of its length at the desired speed."""
    kept, total, worst, words = 0.0, 0.0, 1.0, ""
    for profile in profiles:
        step = np.diff(profile.s, append=profile.s[-1])
        kept += float(step[profile.v >= 0.995 * profile.wanted].sum())
        total += float(step.sum())
        share = profile.bound / profile.wanted
        k = int(np.argmin(share))
        if share[k] < min(worst, 1.0):
            worst = float(share[k])
            words = f"at {profile.s[k] * 1e3:.0f} mm {profile.limit[k]} allows {profile.bound[k] * 1e3:.0f} mm/s"
    return words, kept / total
