"""Joint paths: controller readings at which the model's SMR follows a desired path, and periodic motions.

Effects that depend on the direction of approach (backlash) follow the sign of a joint's motion. At a reversal, the
joint's command crosses the backlash within a short distance, while the link behind it rests.

    q(t) = c + sum_k a_k (sin(k w t) / k - sin((k + 1) w t) / (k + 1)) + b_k (1 - cos(k w t)),  k = 1 .. K

Every term and its first derivative vanish at t = 0 and after each period: the arm begins and ends at rest at ``c``, and
speed, acceleration and jerk follow in closed form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy

from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry, frame_poses
from cellapp.robot.kinematics.inverse import all_branches, shifted_into, solve_pose
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.inverse import invert
from cellapp.robot.paths.cartesian import CartesianPath

_FIRST_KNOTS_M = 2e-3
"""Initial spacing of knots: the distance of the tool at 250 mm/s in one cycle of a slow controller."""
_SHARE = 0.02
"""Share of the tolerance that interpolation between knots may use."""
_ROUNDS = 10
"""Most refinements; each halves the spacing where it is too wide."""
_MOVED_RAD = 2e-5
"""Least backward motion that counts as a reversal: some resolutions of an encoder."""
_NO_PLAY_RAD = 1e-8
"""Backlash below this is neglected."""

Conditions = Callable[[Array], MeasurementConditions]
"""Function that returns the conditions of n samples from their approach signs (n, N)."""


class PathError(Exception):
    """A path that cannot be followed; the message is the reason, ``at_m`` the arc length of the place [m]."""

    def __init__(self, reason: str, at_m: float) -> None:
        super().__init__(reason)
        self.at_m = at_m


@dataclass(frozen=True)
class Reversal:
    """A reversal of a joint's motion.

    Attributes
    ----------
    joint : int
        Number of the joint, from 1.
    at_m : float
        Arc length [m].
    jump_m : float
        Backlash that the joint's command crosses there, as displacement of the SMR [m].
    window_m : float
        Distance along the path in which it is crossed [m]; 0 at a stop of the path.
    """

    joint: int
    at_m: float
    jump_m: float
    window_m: float


@dataclass(frozen=True, eq=False)
class Stretch:
    """Joint path between two stops: knots ``s`` (m,) [m] with controller readings ``q`` (m, N) [rad], splines between.

    ``signs`` and ``end_signs`` (N,) are the approach signs at its start and end.
    """

    s: Array
    q: Array
    signs: Array
    end_signs: Array
    reversals: tuple[Reversal, ...]

    @property
    def spline(self) -> scipy.interpolate.CubicSpline:
        """Controller readings (n, N) [rad] and their derivatives by arc length."""
        return scipy.interpolate.CubicSpline(self.s, self.q)


@dataclass(frozen=True, eq=False)
class JointPath:
    """The joint path of one arm.

    Attributes
    ----------
    stretches : tuple of Stretch
    deviation_m : float
        Largest distance of the model's SMR from the wanted path between knots [m].
    deviation_at_m : float
        Arc length of that place [m].
    """

    stretches: tuple[Stretch, ...]
    deviation_m: float
    deviation_at_m: float

    @property
    def reversals(self) -> tuple[Reversal, ...]:
        """All reversals of joints."""
        return tuple(reversal for stretch in self.stretches for reversal in stretch.reversals)


def joint_path(
    arm: ArmModel, path: CartesianPath, branch: Branch, conditions: Conditions, tolerance_m: float, cross_s: float
) -> JointPath:
    """Compute the joint path of ``arm`` on one branch of its inverse kinematics.

    Parameters
    ----------
    tolerance_m : float
        Largest distance of the SMR from the path [m]; interpolation uses a small share of it.
    cross_s : float
        Seconds per root of radian of backlash: backlash p is crossed in ``cross_s * sqrt(p)`` at the desired speed.

    Raises
    ------
    PathError
        If the model cannot reach a place, or refinement does not bring the path within the tolerance.
    """
    guess = scipy.interpolate.CubicSpline(branch.s, branch.q)
    stretches, worst = [], (0.0, 0.0)
    for begin, end in zip(path.stops, path.stops[1:], strict=False):
        solver = _Solver(arm, path, conditions, guess, begin, end)
        stretch, deviation = _stretch(solver, tolerance_m, cross_s)
        worst = max(worst, deviation)
        stretches.append(stretch)
    return JointPath(tuple(_with_reversals_at_stops(arm, stretches, conditions)), *worst)


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Solver:
    """Inversion of the model at arc lengths of one stretch."""

    arm: ArmModel
    path: CartesianPath
    conditions: Conditions
    guess: scipy.interpolate.CubicSpline
    begin: float
    end: float

    def poses(self, s: Array) -> tuple[Array, Array]:
        """Return poses of this stretch; at its end, those of this stretch and not of the next one."""
        return self.path.poses(np.clip(s, self.begin, np.nextafter(self.end, self.begin)))

    def readings(self, s: Array, approach: Array) -> Array:
        """Find controller readings (n, N) [rad] that put the model's SMR on the path; raise ``PathError`` if none."""
        found = invert(self.arm, *self.poses(s), self.guess(s), self.conditions(approach))
        if not found.reached.all():
            raise PathError("the calibrated model does not reach it", float(s[int(np.argmin(found.reached))]))
        return found.q

    def deviation(self, s: Array, q: Array, approach: Array) -> Array:
        """Compute the distance (n,) [m] of the model's SMR at readings ``q`` from the path's points at ``s``."""
        return np.asarray(
            np.linalg.norm(self.arm.predict(q, conditions=self.conditions(approach)) - self.poses(s)[0], axis=1)
        )


def _stretch(solver: _Solver, tolerance_m: float, cross_s: float) -> tuple[Stretch, tuple[float, float]]:
    """Compute one stretch; also its largest deviation [m] and the arc length of that [m]."""
    count = max(8, int(np.ceil((solver.end - solver.begin) / _FIRST_KNOTS_M)))
    s = np.linspace(solver.begin, solver.end, count + 1)
    joints = solver.guess(s[:1]).shape[1]
    middle = solver.readings(s, np.zeros((len(s), joints)))
    reversals = _reversals(s, middle)
    crossings = _crossings(solver, s, middle, reversals, cross_s)
    for _ in range(_ROUNDS):
        approach = _approach(s, reversals, crossings)
        q = solver.readings(s, approach)
        between = 0.5 * (s[:-1] + s[1:])
        off = solver.deviation(
            between, scipy.interpolate.CubicSpline(s, q)(between), _approach(between, reversals, crossings)
        )
        coarse = off > _SHARE * tolerance_m
        if not coarse.any():
            signs = _approach(s[[0, -1]], reversals, [])
            stretch = Stretch(s, q, signs[0], signs[1], tuple(crossings))
            return stretch, (float(off.max()), float(between[int(np.argmax(off))]))
        s = np.sort(np.concatenate([s, between[coarse]]))
    worst = int(np.argmax(off))
    raise PathError(f"the path cannot be followed to {tolerance_m * 1e3:g} mm", float(between[worst]))


def _reversals(s: Array, q: Array) -> list[tuple[float, list[float]]]:
    """Find for each joint the sign of its first motion and the arc lengths of its reversals."""
    found = []
    for values in q.T:
        sign, extreme, reversals = 0.0, 0, []
        for k in range(1, len(values)):  # a joint turns at an extreme that it leaves by more than ``_MOVED_RAD``
            ahead = values[k] - values[extreme]
            if sign == 0.0 and abs(ahead) > _MOVED_RAD:
                sign = first = float(np.sign(ahead))
                extreme = k
            elif ahead * sign > 0.0:
                extreme = k
            elif abs(ahead) > _MOVED_RAD and sign != 0.0:
                reversals.append(float(s[extreme]))
                sign, extreme = -sign, k
        found.append((first if sign != 0.0 else 1.0, reversals))
    return found


def _crossings(
    solver: _Solver, s: Array, q: Array, reversals: list[tuple[float, list[float]]], cross_s: float
) -> list[Reversal]:
    """Find the reversals at which a joint's command crosses backlash."""
    found = []
    for j, (_, places) in enumerate(reversals):
        for at in places:
            reading = scipy.interpolate.CubicSpline(s, q)(np.array([at]))
            jump, lever = _play(solver.arm, reading, solver.conditions, j)
            if abs(jump) < _NO_PLAY_RAD:
                continue
            speed = float(solver.path.wanted_speed(np.array([at]))[0])
            found.append(Reversal(j + 1, at, abs(jump) * lever, cross_s * float(np.sqrt(abs(jump))) * speed))
    return found


def _play(arm: ArmModel, q: Array, conditions: Conditions, j: int) -> tuple[float, float]:
    """Return the backlash [rad] of joint ``j`` at ``q`` (1, N) [rad], and the SMR's distance from its axis [m]."""
    signs = np.zeros((2, q.shape[1]))
    signs[:, j] = 1.0, -1.0
    true = arm.true_joints(np.repeat(q, 2, axis=0), conditions=conditions(signs))
    rotations, origins = frame_poses(arm.geometry, q)
    smr = origins[-1, 0] + rotations[-1, 0] @ arm.geometry.tool
    lever = np.linalg.norm(np.cross(rotations[j, 0, :, 2], smr - origins[j, 0]))
    return float(true[0, j] - true[1, j]), float(lever)


def _approach(s: Array, reversals: list[tuple[float, list[float]]], crossings: list[Reversal]) -> Array:
    """Compute approach signs (n, N) along a stretch: smooth where backlash is crossed, elsewhere -1 or +1."""
    windows = {(crossing.joint - 1, crossing.at_m): crossing.window_m for crossing in crossings}
    signs = np.empty((len(s), len(reversals)))
    for j, (first, places) in enumerate(reversals):
        signs[:, j], sign = first, first
        for at in places:
            width = max(windows.get((j, at), 0.0), 1e-9)
            x = np.clip((s - at) / width + 0.5, 0.0, 1.0)
            signs[:, j] -= 2.0 * sign * x**3 * (10.0 - x * (15.0 - 6.0 * x))
            sign = -sign
    return signs


def _with_reversals_at_stops(arm: ArmModel, stretches: list[Stretch], conditions: Conditions) -> list[Stretch]:
    """Add to each stretch the reversals of joints at the stop before it."""
    found = stretches[:1]
    for before, after in pairwise(stretches):
        reversing = np.flatnonzero(before.end_signs != after.signs)
        at = float(after.s[0])
        plays = [(int(j), *_play(arm, after.q[:1], conditions, int(j))) for j in reversing]
        more = tuple(
            Reversal(j + 1, at, abs(jump) * lever, 0.0) for j, jump, lever in plays if abs(jump) >= _NO_PLAY_RAD
        )
        found.append(Stretch(after.s, after.q, after.signs, after.end_signs, (*more, *after.reversals)))
    return found


# -- Follow the branches of the inverse kinematics along a path, from each solution at its start, sample by sample ----


_COARSE_M = 0.01
_COARSE_ROTATION_RAD = 0.05
"""Spacing of the samples along which a branch is followed: close enough that Newton stays on it."""
_LARGEST_STEP_RAD = 0.35
"""Largest step of a joint between samples: a larger one means another branch or a singularity."""


@dataclass(frozen=True, eq=False)
class Branch:
    """One solution followed along the path.

    Attributes
    ----------
    s : array, shape (m,)
        Arc lengths [m].
    q : array, shape (m, N)
        Joint positions [rad] of the chain; invalid beyond ``failed_m``.
    failure : str
        Why it cannot be followed to the end; empty if it can.
    failed_m : float
        Arc length at which it fails [m]; infinite if it does not.
    """

    s: Array
    q: Array
    failure: str = ""
    failed_m: float = np.inf


def follow_branches(geometry: Geometry, path: CartesianPath, limits: Array, near: Array, seed: int) -> list[Branch]:
    """Follow all branches of ``geometry`` along a path; those that reach its end come first, nearest to ``near`` (N,).

    Then come those that fail, the latest failure first. ``limits`` (N, 2) [rad] hold on the whole path; ``seed`` is
    that of ``all_branches``. The list is empty if the start is out of reach.
    """
    s = _samples(path)
    positions, rotations = path.poses(s)
    start = _solutions(geometry, positions[0], rotations[0], limits, near, seed)
    q = np.empty((len(s), *start.shape))
    failed = np.full(len(start), len(s))
    reasons = [""] * len(start)
    if len(start):
        q[0] = start
    for k in range(1, len(s) if len(start) else 0):
        guess = q[k - 1] if k < 2 else 2.0 * q[k - 1] - q[k - 2]
        target = np.broadcast_to(positions[k], (len(start), 3)), np.broadcast_to(rotations[k], (len(start), 3, 3))
        found = solve_pose(geometry, *target, guess, max_iterations=12)
        q[k] = np.where(found.reached[:, None], found.q, q[k - 1])
        for b in np.flatnonzero(failed == len(s)):
            reasons[b] = _why_not(q[k - 1, b], q[k, b], bool(found.reached[b]), limits)
            failed[b] = k if reasons[b] else len(s)
        if (failed < len(s)).all():
            break
    branches = [
        Branch(s, q[:, b], reasons[b], float(s[failed[b]]) if reasons[b] else np.inf) for b in range(len(start))
    ]
    return sorted(branches, key=lambda branch: (-branch.failed_m, round(float(np.abs(branch.q[0] - near).max()), 6)))


def _samples(path: CartesianPath) -> Array:
    """Choose arc lengths (m,) [m] of samples from start to end, with every stop, and dense enough in between."""
    found = [np.zeros(1)]
    for begin, end in zip(path.stops, path.stops[1:], strict=False):
        trial = np.linspace(begin, end, max(9, int(np.ceil((end - begin) / _COARSE_M)) + 1))
        R = path.poses(np.minimum(trial, np.nextafter(end, begin)))[1]
        angle = np.arccos(np.clip(0.5 * (np.einsum("nij,nij->n", R[1:], R[:-1]) - 1.0), -1.0, 1.0))
        finer = max(1, int(np.ceil(angle.max() / _COARSE_ROTATION_RAD)))
        found.append(np.linspace(begin, end, (len(trial) - 1) * finer + 1)[1:])
    return np.concatenate(found)


def _solutions(geometry: Geometry, position: Array, rotation: Array, limits: Array, near: Array, seed: int) -> Array:
    """Find distinct solutions (b, N) [rad] within the limits at one pose."""
    (found,) = all_branches(geometry, position[None], rotation[None], limits, near, seed)
    q, _ = shifted_into(found[np.isfinite(found[:, 0])], limits, np.zeros(len(limits)))
    return np.asarray(q[np.all((q >= limits[:, 0]) & (q <= limits[:, 1]), axis=1)])


def _why_not(before: Array, here: Array, reached: bool, limits: Array) -> str:
    """Say why a branch cannot be followed from one sample to the next; empty if it can."""
    if not reached:
        return "out of reach"
    step = np.abs(here - before)
    if step.max() > _LARGEST_STEP_RAD:
        return f"a singularity: joint {int(np.argmax(step)) + 1} would rotate by {np.degrees(step.max()):.0f} deg"
    outside = (here < limits[:, 0]) | (here > limits[:, 1])
    if outside.any():
        j = int(np.argmax(outside))
        low, high = np.degrees(limits[j])
        return f"joint {j + 1} at {np.degrees(here[j]):.1f} deg is outside its limits {low:.1f} to {high:.1f} deg"
    return ""


# -- Time a joint path: desired speed if the limits allow it, ramps at stops, samples at the controller's rate --------
#
# With the speed ``v(s)`` along the path, joint speeds are ``q' v`` and joint accelerations ``q' a + q'' v^2``, where a
# prime is the derivative by arc length. Both terms get half of the acceleration limit each, so that the largest
# ``v^2`` follows from two running minima, without a search (compare Bobrow, Dubowsky, Gibson, Int. J. Robotics Res. 4
# (1985) 3).

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
    by_curvature = np.sqrt(0.5 * _USED * rates.acceleration / np.maximum(second, tiny))
    by_joint = np.minimum(by_speed, by_curvature)
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


# -- Periodic motions -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Sweep:
    """A periodic motion of N joints.

    Attributes
    ----------
    center : array, shape (N,)
        Positions at its start and end [rad].
    sine, cosine : array, shape (K, N)
        Coefficients a and b [rad].
    period_s : float
    """

    center: Array
    sine: Array
    cosine: Array
    period_s: float

    def at(self, time_s: Array, derivative: int = 0) -> Array:
        """Positions (n, N) at times (n,) [s], or their 1st, 2nd or 3rd derivative."""
        w = 2.0 * np.pi / self.period_s * np.arange(1, len(self.sine) + 2)
        # the n-th derivative of a sine is w^n times a sine whose phase is n quarter turns further
        phase = np.outer(time_s, w) + 0.5 * np.pi * derivative
        sines, cosines = np.sin(phase) * w**derivative, np.cos(phase) * w**derivative
        sines = sines / np.arange(1, len(w) + 1)
        moved = (sines[:, :-1] - sines[:, 1:]) @ self.sine - cosines[:, :-1] @ self.cosine
        return np.asarray(moved if derivative else self.center + self.cosine.sum(axis=0) + moved)

    def times(self, step_s: float) -> Array:
        """Times of one period at most ``step_s`` apart, both ends included [s]."""
        return np.linspace(0.0, self.period_s, int(np.ceil(self.period_s / step_s)) + 1)

    def scaled(self, factor: float) -> Sweep:
        """Return the motion with its amplitude scaled by ``factor``."""
        return replace(self, sine=self.sine * factor, cosine=self.cosine * factor)

    def slowed(self, speed: Array, acceleration: Array, jerk: Array) -> Sweep:
        """Return the motion slowed so that no joint exceeds these limits (N,) [rad/s, rad/s^2, rad/s^3]."""
        time_s, slower = self.times(self.period_s / 400.0), 1.0
        for order, limit in enumerate((speed, acceleration, jerk), start=1):
            excess = float((np.abs(self.at(time_s, order)).max(axis=0) / limit).max())
            slower = max(slower, excess ** (1.0 / order))
        return replace(self, period_s=self.period_s * slower)
