"""Residuals and normal equations of recordings, in chunks: memory does not grow with the number of points.

A point with timestamp t was measured at controller time ``u = t - o - r (t - t_m)``, with offset o of its segment and
rate r of its recording. The model is ``P(q(u) + sum_k b_k o_k(u); g)``: geometry g, and joint offsets o_k (``terms``).
Its columns are those of the geometry; ``o_k dP/dq_j`` for b_k; ``-J qd`` for o and ``-(t - t_m) J qd`` for r.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.motion.noise import Bands, bands_of
from cellapp.estimation.motion.terms import CHUNK, JointState, JointTerm, Masses, state_at_rest, state_in_motion
from cellapp.estimation.motion.tracks import Track
from cellapp.robot.kinematics.chain import Geometry, JointAngles, Workspace, jacobian, smr_positions
from cellapp.robot.kinematics.transforms import Array

_BLOCK_RATE = 25.0
"""Averaged residuals per second for estimating the noise: motion and its correlation are slower."""
_MOST_BLOCKS = 8000


@dataclass(frozen=True, eq=False)
class Stops:
    """Readings at rest: joint positions (n, N) [rad], points (n, 3) [m], their standard uncertainty (n,) [m], the sign
    of each joint's last motion (n, N), 0 if unknown, and that motion (n, N) [rad], NaN if unknown."""

    q: Array
    p_M: Array
    sigma_m: Array | None = None
    approach: Array | None = None
    step: Array | None = None


@dataclass(frozen=True)
class Layout:
    """Indices of the parameters: geometry, terms of joints, then the offsets and the rate of each recording."""

    parameters: ParameterSet
    terms: tuple[JointTerm, ...]
    segments: tuple[int, ...]

    @property
    def geometric(self) -> int:
        """Number of parameters of the geometry."""
        return len(self.parameters.columns)

    @property
    def arm(self) -> int:
        """Number of parameters of the arm: geometry and terms."""
        return self.geometric + len(self.terms)

    @property
    def size(self) -> int:
        """Number of all parameters."""
        return self.arm + sum(self.segments) + len(self.segments)

    def offsets(self, number: int) -> slice:
        """Return the slice of the offsets of one recording."""
        first = self.arm + sum(self.segments[:number]) + number
        return slice(first, first + self.segments[number])

    def rate(self, number: int) -> int:
        """Return the index of the rate of one recording."""
        return int(self.offsets(number).stop)

    def clock(self, number: int) -> NDArray[np.intp]:
        """Return the indices of the offsets and the rate of one recording."""
        return np.arange(self.offsets(number).start, self.rate(number) + 1)

    def columns_of(self, number: int) -> NDArray[np.intp]:
        """Return the indices of the parameters that move the points of one recording."""
        return np.concatenate([np.arange(self.arm), np.arange(self.offsets(number).start, self.rate(number) + 1)])


@dataclass(frozen=True, eq=False)
class Sums:
    """Normal equations of one source in its own columns, in total and by frequency band."""

    A: Array
    b: Array
    bands: Bands


@dataclass(frozen=True, eq=False)
class Model:
    """The arm and its clocks at one set of values."""

    start: Geometry
    layout: Layout
    values: Array = field(repr=False)
    masses: Masses | None = None

    @property
    def geometry(self) -> Geometry:
        """Geometry at these values."""
        vector = self.start.vector()
        vector[list(self.layout.parameters.columns)] = self.values[: self.layout.geometric]
        return self.start.with_vector(vector)

    @property
    def of_terms(self) -> Array:
        """Values of the terms."""
        return self.values[self.layout.geometric : self.layout.arm]

    @property
    def needs_torques(self) -> bool:
        """Whether a term depends on torques."""
        return any(term.needs_torques for term in self.layout.terms)

    def clock(self, number: int) -> tuple[Array, float]:
        """Return the offsets [s] of the segments of one recording, and its rate."""
        return self.values[self.layout.offsets(number)], float(self.values[self.layout.rate(number)])


def residuals(model: Model, track: Track, number: int, rows: NDArray[np.intp]) -> Array:
    """Return measured less computed points (n, 3) [m] of some rows of one recording."""
    left = np.empty((len(rows), 3))
    geometry, (offsets, rate) = model.geometry, model.clock(number)
    for first in range(0, len(rows), CHUNK):
        part = rows[first : first + CHUNK]
        u = track.controller_times(part, offsets, rate)
        state = state_in_motion(track.path, u, model.masses, torques=model.needs_torques)
        q = state.q + state.offsets(model.layout.terms, model.of_terms)
        left[first : first + CHUNK] = track.p_M[part] - smr_positions(geometry, q)
    return left


@dataclass(frozen=True, eq=False)
class Averages:
    """Weighted columns ``X`` (m, 3, k) at indices ``columns``, residuals ``r`` (m, 3) and joint positions ``q`` (m, N)
    of one recording, averaged over neighbours so that sums are preserved."""

    X: Array
    columns: NDArray[np.intp]
    r: Array
    q: Array


def track_sums(
    model: Model, track: Track, number: int, rows: NDArray[np.intp], root: Array, whitening: Array | None = None
) -> Sums:
    """Sum over ``rows`` of one recording, each weighted by the square of ``root`` (n,) [1/m].

    ``whitening`` is a filter in time, applied to columns and residuals.
    """
    from scipy.signal import lfilter  # it loads scipy.stats: commands without recordings need not wait for that

    k = len(model.layout.columns_of(number))
    A, b = np.zeros((k, k)), np.zeros(k)
    past = 0 if whitening is None else len(whitening) - 1
    memory_X, memory_r = np.zeros((3, k, past)), np.zeros((3, past))
    parts, each = [], _block_length(track, len(rows), _MOST_BLOCKS)
    for X, left, weight, q in _chunks(model, track, number, rows, root, each):
        if whitening is not None:
            X, memory_X = lfilter(whitening, [1.0], X, zi=memory_X)
            left, memory_r = lfilter(whitening, [1.0], left, zi=memory_r)
        flat = X.swapaxes(0, 1).reshape(k, -1)
        A += flat @ flat.T
        b += flat @ left.ravel()
        parts.append(_averaged(X, left, weight, q, each))
    found = _joined(parts, model.layout.columns_of(number))
    return Sums(A, b, bands_of(found.X, found.columns, found.r, in_time=True))


def track_averages(model: Model, track: Track, number: int, rows: NDArray[np.intp], root: Array, most: int) -> Averages:
    """Return up to ``most`` averages of ``rows`` of a recording, weighted by the square of ``root`` (n,) [1/m]."""
    each = _block_length(track, len(rows), most)
    parts = [_averaged(*chunk, each) for chunk in _chunks(model, track, number, rows, root, each)]
    return _joined(parts, model.layout.columns_of(number))


def _chunks(
    model: Model, track: Track, number: int, rows: NDArray[np.intp], root: Array, each: int
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Yield weighted columns (3, k, n) and residuals (3, n), weights (n,) and joint positions (n, N), in chunks of
    whole averages of ``each`` points."""
    k, arm = len(model.layout.columns_of(number)), model.layout.arm
    geometry, (offsets, rate), work = model.geometry, model.clock(number), Workspace()
    step = max(1, CHUNK // each) * each
    for first in range(0, len(rows), step):
        part, weight = rows[first : first + step], root[first : first + step]
        u = track.controller_times(part, offsets, rate)
        state = state_in_motion(track.path, u, model.masses, torques=model.needs_torques)
        X = np.empty((3, k, len(part)))
        P, by_joint = _arm_columns(model, geometry, state, X[:, :arm], work)
        moved = np.einsum("ajn,nj->an", by_joint, state.qd)
        segment = track.segment[part]
        for place in range(len(offsets)):
            np.multiply(moved, -(segment == place).astype(np.float64), out=X[:, arm + place])
        np.multiply(moved, track.middle_s - track.time_s[part], out=X[:, -1])
        X *= weight
        yield X, (track.p_M[part].T - P) * weight, weight, state.q


def _averaged(X: Array, left: Array, weight: Array, q: Array, each: int) -> tuple[Array, Array, Array]:
    """Average one chunk over ``each`` neighbours."""
    starts = np.arange(0, len(weight), each)
    total = np.sqrt(np.maximum(np.add.reduceat(weight**2, starts), 1e-300))
    share = weight / total.repeat(each)[: len(weight)]
    return (
        np.add.reduceat(X * share, starts, axis=2).transpose(2, 0, 1),
        np.add.reduceat(left * share, starts, axis=1).T,
        q[starts],
    )


def _joined(parts: Sequence[tuple[Array, Array, Array]], columns: NDArray[np.intp]) -> Averages:
    X, r, q = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Averages(X, columns, r, q)


def stop_sums(model: Model, stops: Stops, rows: NDArray[np.intp], root: Array) -> Sums:
    """Sum over some of the stops, each weighted by the square of ``root`` (n,) [1/m]."""
    X, left = _stop_columns(model, stops, rows, root)
    flat = X.swapaxes(0, 1).reshape(model.layout.arm, -1)
    bands = bands_of(X.transpose(2, 0, 1), np.arange(model.layout.arm), left.T, in_time=False)
    return Sums(flat @ flat.T, flat @ left.ravel(), bands)


def stop_averages(model: Model, stops: Stops, rows: NDArray[np.intp], root: Array) -> Averages:
    """Return some of the stops without averaging, each weighted by the square of ``root`` (n,) [1/m]."""
    X, left = _stop_columns(model, stops, rows, root)
    return Averages(X.transpose(2, 0, 1), np.arange(model.layout.arm), left.T, stops.q[rows])


def _stop_columns(model: Model, stops: Stops, rows: NDArray[np.intp], root: Array) -> tuple[Array, Array]:
    """Return weighted columns (3, k, n) and residuals (3, n)."""
    X = np.empty((3, model.layout.arm, len(rows)))
    P, _ = _arm_columns(model, model.geometry, _at_stops(model, stops, rows), X, Workspace())
    X *= root
    return X, (stops.p_M[rows].T - P) * root


def stop_residuals(model: Model, stops: Stops) -> Array:
    """Return measured less computed points (n, 3) [m] of all stops."""
    state = _at_stops(model, stops, np.arange(len(stops.q)))
    q = state.q + state.offsets(model.layout.terms, model.of_terms)
    return np.asarray(stops.p_M - smr_positions(model.geometry, q))


def _at_stops(model: Model, stops: Stops, rows: NDArray[np.intp]) -> JointState:
    q = stops.q[rows]
    direction = np.zeros_like(q) if stops.approach is None else stops.approach[rows]
    step = None if stops.step is None else stops.step[rows]
    return state_at_rest(q, direction, model.masses if model.needs_torques else None, step)


def _arm_columns(
    model: Model, geometry: Geometry, state: JointState, out: Array, work: Workspace
) -> tuple[Array, Array]:
    """Return computed points (3, n) and derivatives by the joints (3, N, n); write those by parameters to ``out``."""
    size, joints = model.layout.geometric, model.layout.parameters.joints
    units = [term.offset(state) for term in model.layout.terms]
    angles = JointAngles.of(state.q + state.offsets(model.layout.terms, model.of_terms, units))
    thetas = tuple(6 + 5 * joint for joint in range(joints))
    wanted = model.layout.parameters.columns
    added = tuple(theta for theta in thetas if theta not in wanted)
    P, J = jacobian(geometry, angles, added + wanted, work)
    out[:, :size] = J[:, len(added) :]
    place = {column: i for i, column in enumerate(added + wanted)}
    by_joint = J[:, [place[theta] for theta in thetas]]
    for number, (term, unit) in enumerate(zip(model.layout.terms, units, strict=True)):
        np.multiply(by_joint[:, term.joint], unit, out=out[:, size + number])
    return P, by_joint


def _block_length(track: Track, count: int, most: int) -> int:
    """Return the number of neighbours to average for the noise estimate, in at most ``most`` blocks."""
    return min(max(round(1.0 / track.stamps.period_s / _BLOCK_RATE), -(-count // most), 1), CHUNK)
