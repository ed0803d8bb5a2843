"""Joint positions and speeds of a recording at any time, by cubic Hermite interpolation.

Recorded speeds are the slopes if they agree with the positions; else slopes are those of a cubic spline through the
positions. Joints are interpolated to the tracker's times, not the reverse, as joints move smoothly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.motion.streams import JointStream, Stamps, read_stamps
from cellapp.robot.kinematics.transforms import Array, rows_at

_WINDOW_S = 0.2
"""Time over which recorded speeds are integrated to compare them with positions."""
_AGREES = 0.03
"""Share of the motion by which integrated speeds may differ from positions; filtered or late ones differ more."""
BEND_S = 0.02
"""Step of the second difference that gives accelerations: short against any motion, long against noise and jitter."""
_PLAY = 5e-5
"""Half gap of the play operator for the direction of motion [rad]: above the noise of an encoder, and crossed within a
few samples of any sweep."""
_BEGUN = 1e-3
"""Travel of a joint [rad] after which it has crossed its gap."""
_SLOWEST_S = 2.0
"""Longest wait until the last joint has crossed its gap after the first: joints may move one after the other."""

_WIDTHS = np.geomspace(0.008, 3.2, 14)
"""Half gaps [rad] of parallel plays, which model lost motion with memory."""


@dataclass(frozen=True)
class Fading:
    """Change of lost motion with the travel x since a joint reversed: ``exp(-x / reach)`` of it is left, ``reach`` in
    rad. ``kept``: it adds to what the joint had taken up before the reversal; else it starts anew at each reversal and
    after each gap of the recording.

    If kept, it is that of parallel plays (Prandtl, Ishlinskii; Masing's rules follow) with half gaps w in such shares,
    ``w / reach^2 exp(-w / reach)``, that a joint starting in the middle of all of them takes up ``1 - exp(-x /
    reach)``. ``bell``: ``exp(-(x / reach)^2)`` of it is left, anew at each reversal: a gear under friction that is
    larger at low speed (Stribeck).
    """

    reach: float
    kept: bool
    bell: bool = False

    def shares(self) -> Array:
        """Return the shares (W,) of the plays of ``_WIDTHS``."""
        edges = np.concatenate([[0.0], np.sqrt(_WIDTHS[1:] * _WIDTHS[:-1]), [np.inf]]) / self.reach
        with np.errstate(invalid="ignore"):
            beyond = np.nan_to_num((1.0 + edges) * np.exp(-edges))
        return np.asarray(-np.diff(beyond))


@dataclass(frozen=True, eq=False)
class JointPath:
    """Path of N joints between its first and its last sample.

    Attributes
    ----------
    stamps : Stamps
    direction : array, shape (m, N)
        Output of a play operator of small gap, -1 to 1, at the samples: a joint with lost motion lags against it.
    inertia : callable, optional
        Mass matrices (n, N, N) [kg m^2] at joint positions (n, N), None if masses are unknown.
    beside : array, shape (m, K), optional
        Joint positions of the other arm of the cell at the samples [rad].
    """

    stamps: Stamps
    direction: Array = field(repr=False)
    _position: scipy.interpolate.PPoly = field(repr=False)
    _speed: scipy.interpolate.PPoly = field(repr=False)
    inertia: Callable[[Array], Array] | None = field(default=None, repr=False)
    beside: Array | None = field(default=None, repr=False)

    def known(self, time_s: Array) -> NDArray[np.bool_]:
        """Return a mask of the times (n,) [s] that lie between samples, and not in a gap or at a step of the clock."""
        t = self.stamps.time_s
        place = np.searchsorted(t, time_s, side="right")
        inside = (place > 0) & (place < len(t))
        after = np.clip(place, 1, len(t) - 1)
        short = t[after] - t[after - 1] <= self.stamps.longest_s
        return np.asarray(inside & short & (self.stamps.segment[after] == self.stamps.segment[after - 1]))

    def begun(self, time_s: Array) -> NDArray[np.bool_]:
        """Return a mask of the times (n,) [s] at which the joints have moved since the recording or its last gap began.

        Before that, the side of their lost motion is unknown: a gap hides the last motion. Joints that do not move
        before the next gap are ignored.
        """
        t, q = self.stamps.time_s, self._position(self.stamps.time_s)
        begun = np.ones(len(t), dtype=np.bool_)
        for first, last in _runs(self.stamps):
            moved = np.abs(q[first:last] - q[first]) > _BEGUN
            starts = t[first + moved.argmax(axis=0)[moved.any(axis=0)]]
            if len(starts):
                begun[first:last] = t[first:last] >= min(starts.max(), starts.min() + _SLOWEST_S)
        return begun[self.samples_at(time_s)]

    def samples_at(self, time_s: Array) -> NDArray[np.intp]:
        """Return the indices of the last samples (n,) before times (n,) [s]; the first sample for earlier times."""
        return np.clip(np.searchsorted(self.stamps.time_s, time_s, side="right") - 1, 0, len(self.stamps.time_s) - 1)

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Return positions [rad] and speeds [rad/s] at times (n,) [s], each (n, N)."""
        return np.asarray(self._position(time_s)), np.asarray(self._speed(time_s))

    @cached_property
    def even(self) -> EvenPath:
        """The path on even grids between gaps."""
        t = self.stamps.time_s
        runs = [(float(t[first]), float(t[last - 1])) for first, last in _runs(self.stamps)]
        time_s, inside_s, first = even_grid(runs, BEND_S)
        q, bent = self.at(time_s)[0], [self.at(inside_s + step)[0] for step in (-BEND_S, 0.0, BEND_S)]
        qdd = (bent[0] - 2.0 * bent[1] + bent[2]) / BEND_S**2
        inertia = None if self.inertia is None else self.inertia(q[first[:-1]])
        return EvenPath(time_s, inside_s, q, qdd, first, inertia)

    def beside_at(self, time_s: Array) -> Array | None:
        """Return the joint positions (n, K) [rad] of the other arm at times (n,) [s]; None if not recorded."""
        return None if self.beside is None else rows_at(time_s, self.stamps.time_s, self.beside)

    def direction_at(self, time_s: Array) -> Array:
        """Return the side of the lost motion of each joint at times (n,) [s], (n, N), -1 to 1; 0 before any motion."""
        t = self.stamps.time_s
        place = np.clip(np.searchsorted(t, time_s), 1, len(t) - 1)
        share = np.clip((time_s - t[place - 1]) / (t[place] - t[place - 1]), 0.0, 1.0)[:, None]
        return np.asarray(self.direction[place - 1] * (1.0 - share) + self.direction[place] * share)

    def fading_at(self, samples: NDArray[np.intp], q: Array, joint: int, fading: Fading) -> Array:
        """Return the lost motion (n,) that a joint at positions ``q`` (n,) after ``samples`` (n,) has not yet taken up:
        ``d`` just after a start from the middle, 0 after a long travel; up to ``2 d`` after a reversal from the other
        edge, if kept."""
        turns = self._turns[joint]
        number = turns.number[samples]
        side = turns.side[number]
        if not fading.kept:
            travel = np.abs(q - turns.q[number]) / fading.reach
            return np.asarray(side * np.exp(-(travel**2 if fading.bell else travel)))
        taken_up = q[:, None] / _WIDTHS
        taken_up -= turns.plays[number]
        return np.asarray(side - np.clip(taken_up, -1.0, 1.0, out=taken_up) @ fading.shares())

    def travel_at(self, time_s: Array, q: Array) -> Array:
        """Return the travel (n, N) [rad] of joints at positions ``q`` (n, N) at times (n,) [s] since each of them
        reversed, or began to move after a gap of the recording. At rest it is the last motion."""
        samples = self.samples_at(time_s)
        return np.column_stack(
            [q[:, joint] - turns.q[turns.number[samples]] for joint, turns in enumerate(self._turns)]
        )

    @cached_property
    def _turns(self) -> tuple[_Turns, ...]:
        """Reversals of each joint."""
        begun = np.zeros(len(self.direction), dtype=np.bool_)
        begun[[first for first, _ in _runs(self.stamps)]] = True
        found = []
        for joint, direction in enumerate(self.direction.T):
            turned, sides = begun.copy(), np.sign(direction)
            turned[1:] |= (sides[1:] != sides[:-1]) & (sides[:-1] != 0.0)
            first = np.flatnonzero(turned)
            side = sides[np.append(first[1:], len(sides)) - 1]
            q = np.asarray(self._position(self.stamps.time_s[first])[:, joint])
            plays = play(np.repeat(q[:, None], len(_WIDTHS), axis=1), _WIDTHS)
            found.append(_Turns(np.cumsum(turned) - 1, q, side, plays / _WIDTHS))
        return tuple(found)


@dataclass(frozen=True, eq=False)
class _Turns:
    """Reversals of a joint and starts of runs: index (m,) of the last one at each sample; for each the position (K,)
    [rad], the direction after it (K,), and the plays of ``_WIDTHS`` there (K, W), relative to these."""

    number: NDArray[np.intp]
    q: Array
    side: Array
    plays: Array


def joint_path(joints: JointStream) -> JointPath:
    """Build the path through the samples of a recording.

    Raises
    ------
    ValueError
        If fewer than four different samples are left.
    """
    stamps = read_stamps(joints.time_s, joints.q)
    if len(stamps.rows) < 4:
        raise ValueError("fewer than four joint samples with different stamps")
    t, q = stamps.time_s, stamps.averaged(joints.q)
    qd = None if joints.qd is None else stamps.averaged(joints.qd)
    slopes = qd if qd is not None and _agree(t, q, qd, stamps) else _slopes(t, q, stamps)
    position = scipy.interpolate.CubicHermiteSpline(t, q, slopes)
    speed = position.derivative()
    sides = play(q, np.full(q.shape[1], _PLAY))
    beside = None if joints.other_q is None else stamps.averaged(joints.other_q)
    return JointPath(stamps, (q - sides) / _PLAY, position, speed, beside=beside)


def play(q: Array, half_gap: Array) -> Array:
    """Compute the output (n, N) of a play operator along a path ``q`` (n, N) [rad] with ``half_gap`` (N,) [rad].

    The output stays until the input has crossed the gap: ``w_i = min(max(w_(i-1), q_i - h), q_i + h)``, ``w_0 = q_0``.
    Each step is a clamp, and clamps compose to clamps: a scan of log2(n) array operations, not a loop over samples.
    Source: Visintin, Differential Models of Hysteresis (1994), chapter III.
    """
    low, high = q - half_gap, q + half_gap
    low[0] = high[0] = q[0]
    reach = 1
    while reach < len(q):
        first_low, first_high = low[:-reach], high[:-reach]
        new_low = np.clip(first_low, low[reach:], high[reach:])
        new_high = np.clip(first_high, low[reach:], high[reach:])
        low = np.concatenate([low[:reach], new_low])
        high = np.concatenate([high[:reach], new_high])
        reach *= 2
    return low


def _runs(stamps: Stamps) -> list[tuple[int, int]]:
    """Return the first and one past the last sample of each run between gaps and steps of the clock."""
    cut = (np.diff(stamps.time_s) > stamps.longest_s) | (np.diff(stamps.segment) != 0)
    cuts = (np.flatnonzero(cut) + 1).tolist()
    return list(zip([0, *cuts], [*cuts, len(stamps.time_s)], strict=True))


def _slopes(t: Array, q: Array, stamps: Stamps) -> Array:
    """Return slopes (n, N) [rad/s] of cubic splines through the positions between gaps."""
    slopes = np.zeros_like(q)
    for first, last in _runs(stamps):
        if last - first >= 4:
            slopes[first:last] = scipy.interpolate.CubicSpline(t[first:last], q[first:last]).derivative()(t[first:last])
        elif last - first >= 2:
            slopes[first:last] = np.gradient(q[first:last], t[first:last], axis=0)
    return slopes


def _agree(t: Array, q: Array, qd: Array, stamps: Stamps) -> bool:
    """Return whether integrated speeds agree with the motion of the positions."""
    if not np.isfinite(qd).all():
        return False
    width = max(2, round(_WINDOW_S / stamps.period_s))
    if len(t) <= 2 * width:
        return False
    moved = np.concatenate([np.zeros((1, q.shape[1])), np.cumsum((qd[1:] + qd[:-1]) / 2 * np.diff(t)[:, None], axis=0)])
    whole = t[width:] - t[:-width] < 1.5 * width * stamps.period_s  # no gap and no pause between
    by_speed, by_position = (moved[width:] - moved[:-width])[whole], (q[width:] - q[:-width])[whole]
    return bool(np.sum((by_speed - by_position) ** 2) <= _AGREES**2 * np.sum(by_position**2))


# -- Responses of joints to the whole course of a motion: time constants and vibration, by filters along the path -----
#
#     time constant   x' = (q - x) / T;                             the joint is at x(T), not at q
#     vibration       y'' + 2 d w y' + w^2 y = -w^2 q'',  w = 2 pi f   a joint on a damped spring, driven by q''
#
# ``y`` is the answer of a spring of unit gain: for slow motions it is ``-q''``, which is the deflection under the
# joint's own acceleration (``inertia``). Vibration is what comes beside that after changes of acceleration: ``y +
# q''``, with accelerations from the same differences as those of ``inertia`` and of torques. Where masses are known,
# accelerations of other joints count by their inertia about the joint, and a spring is the slower the more inertia the
# arm has in the posture in which a run begins. Filters are solved on an even grid of times between gaps, by the
# bilinear transform; each begins as if the motion before had the first speed and acceleration for ever.


_STEP_S = 2e-3
"""Step of the grid: a hundredth of the period of 5 Hz, 12 steps of 40 Hz."""
_SHARE = 0.05
"""Relative steps for derivatives: frequency relative to the width of the resonance, damping to itself."""
_BILINEAR = {1: np.array([[1.0, -1.0], [1.0, 1.0]]), 2: np.array([[1.0, -2.0, 1.0], [1.0, 0.0, -1.0], [1.0, 2.0, 1.0]])}
"""By degree n: (z - 1)^(n - i) (z + 1)^i of each term of a polynomial of s = 2 rate (z - 1) / (z + 1)."""
_MOST_KEPT = 60
"""Largest number of cached responses of one path."""


@dataclass(frozen=True, eq=False)
class EvenPath:
    """Joint positions and accelerations on even grids, one run after the other: times (G,) [s], (G, N) [rad], (G, N)
    [rad/s^2]. ``runs`` are the first rows of the runs, and G. ``inside_s`` (G,) [s] are the nearest times with known
    second differences. ``inertia`` (R, N, N) [kg m^2] are the mass matrices of the runs, None if masses are unknown."""

    time_s: Array
    inside_s: Array
    q: Array
    qdd: Array
    runs: NDArray[np.intp]
    inertia: Array | None = None
    _known: dict[tuple[object, ...], Array] = field(default_factory=dict, repr=False)

    def lagging(self, joint: int, T: float) -> tuple[Array, Array]:
        """Return ``x(T) - q`` (G,) [rad] of a joint, and its derivative with respect to T."""
        answers = (((-T, 0.0), (T, 1.0), -T), ((0.0, -1.0, 0.0), (T * T, 2.0 * T, 1.0), -1.0))

        def answer(above: tuple[float, ...], below: tuple[float, ...], ramp: float) -> Array:
            parts = pairwise(self.runs.tolist())
            return np.concatenate([_filtered(self.q[a:b, joint], above, below, ramp=ramp) for a, b in parts])

        late, by_T = (self.kept((n, joint, T), partial(answer, *one)) for n, one in enumerate(answers))
        return late, by_T

    def vibrating(self, joint: int, frequency: float, damping: float) -> Array:
        """Return ``y + q''`` (G,) [rad/s^2] of a joint for unit gain; ``frequency`` [Hz], gain at median inertia."""
        found = np.empty(len(self.time_s))
        for run, (first, last) in enumerate(pairwise(self.runs.tolist())):
            shares, more = self._driven(run, joint)
            w = 2.0 * math.pi * frequency / math.sqrt(more)
            # filter y alone, so that slow motions leave nothing beside q''
            answer = _filtered(
                self.q[first:last] @ shares,
                (-w * w, 0.0, 0.0),
                (1.0, 2.0 * damping * w, w * w),
                bend=float(self.qdd[first] @ shares) if last > first else 0.0,
                warped=w,
            )
            found[first:last] = more * (answer + self.qdd[first:last] @ shares)
        return found

    def _driven(self, run: int, joint: int) -> tuple[Array, float]:
        """Return the factors (N,) of all joints' accelerations on one spring, and its inertia over the median."""
        if self.inertia is None:
            return np.eye(self.q.shape[1])[joint], 1.0
        own = self.inertia[:, joint, joint]
        return self.inertia[run, joint] / own[run], float(own[run] / np.median(own))

    def of_shape(self, joint: int, frequency: float, damping: float, part: int) -> Array:
        """Return ``vibrating`` (``part`` 0), or its derivative with respect to frequency (1) or damping (2)."""

        def answer() -> Array:
            if not part:
                return self.vibrating(joint, frequency, damping)
            step = _SHARE * damping * (frequency if part == 1 else 1.0)
            more, less = (
                self.vibrating(joint, frequency + (part == 1) * sign * step, damping + (part == 2) * sign * step)
                for sign in (1.0, -1.0)
            )
            return np.asarray((more - less) / (2.0 * step))

        return self.kept(("vibration", joint, frequency, damping, part), answer)

    def at(self, values: Array, time_s: Array) -> Array:
        """Interpolate values (G,) at times (n,) [s]."""
        return np.asarray(np.interp(time_s, self.time_s, values))

    def kept(self, key: tuple[object, ...], answer: Callable[[], Array]) -> Array:
        """Return the response for a key, computed once and cached: fits request the same again and again."""
        found = self._known.pop(key, None)
        if found is None:
            found = answer()
        if len(self._known) >= _MOST_KEPT:
            del self._known[next(iter(self._known))]  # least recently used
        self._known[key] = found
        return found


def _filtered(
    q: Array,
    above: tuple[float, ...],
    below: tuple[float, ...],
    *,
    ramp: float = 0.0,
    bend: float = 0.0,
    warped: float = 0.0,
) -> Array:
    """Apply a transfer function to even positions ``q`` (G,) that had the first speed and the acceleration ``bend`` for
    ever. ``ramp`` is its response to unit speed. ``warped`` is the frequency [rad/s] at which a quadratic one is exact;
    its response to acceleration is -1."""
    from scipy.signal import lfilter  # it loads scipy.stats: not for commands without recordings

    rate = 0.5 * warped / math.tan(0.5 * warped * _STEP_S) if warped else 1.0 / _STEP_S
    by_z = _BILINEAR[len(below) - 1] * (2.0 * rate) ** np.arange(len(below) - 1.0, -1.0, -1.0)[:, None]
    b, a = np.array(above) @ by_z, np.array(below) @ by_z
    if warped:  # unit response to slow accelerations
        b = b / (rate * _STEP_S) ** 2
    t = _STEP_S * np.arange(len(q))
    speed = (q[1] - q[0]) / _STEP_S - 0.5 * bend * _STEP_S if len(q) > 1 else 0.0
    return np.asarray(lfilter(b, a, q - q[0] - t * (speed + 0.5 * bend * t)) + ramp * speed - bend)


def even_grid(runs: list[tuple[float, float]], margin_s: float) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return times (G,) of even grids between the first and the last time [s] of each run; the nearest times at least
    the margin inside; and the first rows of the runs."""
    runs = [(first, last) for first, last in runs if last - first > 2.0 * margin_s]
    parts = [np.arange(first, last, _STEP_S) for first, last in runs]
    inside = [np.clip(part, first + margin_s, last - margin_s) for part, (first, last) in zip(parts, runs, strict=True)]
    return np.concatenate(parts), np.concatenate(inside), np.cumsum([0, *map(len, parts)]).astype(np.intp)
