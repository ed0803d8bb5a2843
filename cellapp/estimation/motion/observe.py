"""Residuals and normal equations of recordings, chunk by chunk: memory does not grow with the number of points.

A point stamped t was measured at controller time ``u = t - o - r (t - t_m)``, offset o of its segment, rate r of its
recording. The model is ``P(q(u) - h d(u); g)``: geometry g, half play h and direction d of each joint. Its columns are
those of the geometry; ``-d_j dP/dq_j`` for h_j; ``-J qd`` for o and ``-(t - t_m) J qd`` for r.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.motion.noise import Bands, bands_of
from cellapp.estimation.motion.tracks import Track
from cellapp.robot.kinematics.chain import Geometry, JointAngles, jacobian, smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.kinematics.workspace import Workspace

_CHUNK = 2048
_BLOCK_RATE = 25.0
"""Averaged residuals a second from which the noise is read: motion and its correlation are slower."""
_MOST_BLOCKS = 20_000


@dataclass(frozen=True, eq=False)
class Stops:
    """Readings at rest: joint positions (n, N) [rad], points (n, 3) [m], their standard uncertainty (n,) [m] and the
    sign of each joint's last motion (n, N), 0 where unknown."""

    q: Array
    p_M: Array
    sigma_m: Array | None = None
    approach: Array | None = None


@dataclass(frozen=True)
class Layout:
    """Where each parameter stands: geometry, half play of N joints, then the offsets and the rate of each recording."""

    parameters: ParameterSet
    segments: tuple[int, ...]

    @property
    def geometric(self) -> int:
        """Number of parameters of the geometry."""
        return len(self.parameters.columns)

    @property
    def arm(self) -> int:
        """Number of parameters of the arm: geometry and half play."""
        return self.geometric + self.parameters.joints

    @property
    def size(self) -> int:
        """Number of all parameters."""
        return self.arm + sum(self.segments) + len(self.segments)

    def offsets(self, number: int) -> slice:
        """Places of the offsets of one recording."""
        first = self.arm + sum(self.segments[:number]) + number
        return slice(first, first + self.segments[number])

    def rate(self, number: int) -> int:
        """Place of the rate of one recording."""
        return int(self.offsets(number).stop)

    def columns_of(self, number: int) -> NDArray[np.intp]:
        """Places of the parameters that move the points of one recording."""
        return np.concatenate([np.arange(self.arm), np.arange(self.offsets(number).start, self.rate(number) + 1)])


@dataclass(frozen=True, eq=False)
class Sums:
    """Normal equations of one source by its own columns, and the same in bands of frequency."""

    A: Array
    b: Array
    bands: Bands


@dataclass(frozen=True, eq=False)
class Model:
    """The arm and its clocks at one set of values."""

    start: Geometry
    layout: Layout
    values: Array = field(repr=False)

    @property
    def geometry(self) -> Geometry:
        """The geometry of these values."""
        vector = self.start.vector()
        vector[list(self.layout.parameters.columns)] = self.values[: self.layout.geometric]
        return self.start.with_vector(vector)

    @property
    def half_play(self) -> Array:
        """Half play (N,) [rad]."""
        return self.values[self.layout.geometric : self.layout.arm]

    def clock(self, number: int) -> tuple[Array, float]:
        """Offsets [s] of the segments of one recording, and its rate."""
        return self.values[self.layout.offsets(number)], float(self.values[self.layout.rate(number)])


def residuals(model: Model, track: Track, number: int, rows: NDArray[np.intp]) -> Array:
    """Measured less computed points (n, 3) [m] of some rows of one recording."""
    left = np.empty((len(rows), 3))
    geometry, (offsets, rate) = model.geometry, model.clock(number)
    for first in range(0, len(rows), _CHUNK):
        part = rows[first : first + _CHUNK]
        u = track.controller_times(part, offsets, rate)
        q = track.path.at(u)[0] - track.path.direction_at(u) * model.half_play
        left[first : first + _CHUNK] = track.p_M[part] - smr_positions(geometry, q)
    return left


def track_sums(model: Model, track: Track, number: int, rows: NDArray[np.intp], root: Array) -> Sums:
    """Sums over ``rows`` of one recording, each weighted by the square of ``root`` (n,) [1/m]."""
    columns, arm = model.layout.columns_of(number), model.layout.arm
    k, geometry, (offsets, rate), work = len(columns), model.geometry, model.clock(number), Workspace()
    A, b = np.zeros((k, k)), np.zeros(k)
    each = _block_length(track, len(rows))
    step = max(1, _CHUNK // each) * each
    X_blocks, r_blocks = [], []
    for first in range(0, len(rows), step):
        part, weight = rows[first : first + step], root[first : first + step]
        u = track.controller_times(part, offsets, rate)
        q, qd = track.path.at(u)
        X = np.empty((3, k, len(part)))
        P, by_joint = _arm_columns(model, geometry, q, track.path.direction_at(u), X[:, :arm], work)
        moved = np.einsum("ajn,nj->an", by_joint, qd)
        segment = track.segment[part]
        for place in range(len(offsets)):
            np.multiply(moved, -(segment == place).astype(np.float64), out=X[:, arm + place])
        np.multiply(moved, track.middle_s - track.time_s[part], out=X[:, -1])
        X *= weight
        left = (track.p_M[part].T - P) * weight
        flat = X.swapaxes(0, 1).reshape(k, -1)
        A += flat @ flat.T
        b += flat @ left.ravel()
        starts = np.arange(0, len(part), each)
        share = weight / np.sqrt(np.maximum(np.add.reduceat(weight**2, starts), 1e-300)).repeat(each)[: len(part)]
        X_blocks.append(np.add.reduceat(X * share, starts, axis=2).transpose(2, 0, 1))
        r_blocks.append(np.add.reduceat(left * share, starts, axis=1).T)
    return Sums(A, b, bands_of(np.concatenate(X_blocks), columns, np.concatenate(r_blocks), in_time=True))


def stop_sums(model: Model, stops: Stops, rows: NDArray[np.intp], root: Array) -> Sums:
    """Sums over some of the stops, each weighted by the square of ``root`` (n,) [1/m]."""
    X = np.empty((3, model.layout.arm, len(rows)))
    direction = np.zeros((len(rows), stops.q.shape[1])) if stops.approach is None else stops.approach[rows]
    P, _ = _arm_columns(model, model.geometry, stops.q[rows], direction, X, Workspace())
    X *= root
    left = (stops.p_M[rows].T - P) * root
    flat = X.swapaxes(0, 1).reshape(model.layout.arm, -1)
    bands = bands_of(X.transpose(2, 0, 1), np.arange(model.layout.arm), left.T, in_time=False)
    return Sums(flat @ flat.T, flat @ left.ravel(), bands)


def stop_residuals(model: Model, stops: Stops) -> Array:
    """Measured less computed points (n, 3) [m] of all stops."""
    q = stops.q if stops.approach is None else stops.q - stops.approach * model.half_play
    return np.asarray(stops.p_M - smr_positions(model.geometry, q))


def _arm_columns(
    model: Model, geometry: Geometry, q: Array, direction: Array, out: Array, work: Workspace
) -> tuple[Array, Array]:
    """Computed points (3, n) and their derivatives by the joints (3, N, n); ``out`` takes those by the parameters."""
    size, joints = model.layout.geometric, model.layout.parameters.joints
    angles = JointAngles.of(q - direction * model.half_play)
    thetas = tuple(6 + 5 * joint for joint in range(joints))
    wanted = model.layout.parameters.columns
    added = tuple(theta for theta in thetas if theta not in wanted)
    P, J = jacobian(geometry, angles, added + wanted, work)
    out[:, :size] = J[:, len(added) :]
    place = {column: i for i, column in enumerate(added + wanted)}
    by_joint = J[:, [place[theta] for theta in thetas]]
    np.multiply(by_joint, -direction.T, out=out[:, size:])
    return P, by_joint


def _block_length(track: Track, count: int) -> int:
    """Neighbours that are averaged before the noise is read."""
    return min(max(round(1.0 / track.stamps.period_s / _BLOCK_RATE), -(-count // _MOST_BLOCKS), 1), _CHUNK)
