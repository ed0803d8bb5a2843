"""Inter-base transform without a tracker: the ball of one arm rests in a socket on the flange of the other.

With p_k the ball as its calibrated arm finds it in its base, (R_k, o_k) the flange of the other arm in its own base,
and s the socket's unknown place on that flange,

    minimise  sum_k |r_k|^2,   r_k = x_R,k - (R x_L,k + b),

where x is p_k for the arm with the ball, and R_k s + o_k for the one with the socket, over R, b and s of every socket.
The covariance of what is found follows from that of r: the scatter of touches, and the uncertainty of both arms'
parameters, which moves all touches together. (Weighed by that covariance, ties of simulated arms were no better: it
has directions of millimetres that no touch of an arm shows, and they are known to first order only.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.pair_by_touching import UNSEEN, TouchedPair, identification_of
from cellapp.estimation.readings import Readings
from cellapp.robot.kinematics.chain import Geometry, JointAngles, flange_poses, jacobian, smr_positions
from cellapp.robot.kinematics.transforms import Array, apply, invert, rotation_from_vector, transform, twist_columns
from cellapp.robot.model import ArmModel

_MOST_STEPS = 50
_SETTLED = 1e-10
_FOLDS = 5
_LEAST_NOISE_M = 1e-6
_HALVINGS = 40
"""Of the logarithm of a variance: from a metre to a micrometre they leave nothing."""
_ROBUST_ROUNDS = 20
_LEAST_OFF_M = 1e-3


@dataclass(frozen=True, eq=False)
class FlangeRows:
    """n touches as both arms have them, each in its base.

    Attributes
    ----------
    socket : array, shape (n,)
        Number of the socket, from 0.
    on_right : array of bool, shape (n,)
        Whether the right arm carries it, so that the ball is the left arm's.
    ball : array, shape (n, 3) [m]
    rotation, origin : arrays, shapes (n, 3, 3), (n, 3) [m]
        Flange of the arm with the socket.
    of_parameters : array, shape (3 n, m), or None
        How the residuals move by each standard deviation of both arms' parameters [m]; None if nothing is known.
    """

    socket: NDArray[np.intp]
    on_right: NDArray[np.bool_]
    ball: Array
    rotation: Array
    origin: Array
    of_parameters: Array | None = None

    def take(self, rows: NDArray[np.intp]) -> FlangeRows:
        """Some of the touches."""
        of_parameters = self.of_parameters
        if of_parameters is not None:
            of_parameters = of_parameters.reshape(len(self.socket), 3, -1)[rows].reshape(3 * len(rows), -1)
        arrays = {name: getattr(self, name)[rows] for name in ("socket", "on_right", "ball", "rotation", "origin")}
        return FlangeRows(**arrays, of_parameters=of_parameters)

    def ends(self, sockets_F: Array) -> tuple[Array, Array]:
        """Where the right arm and the left arm have each touch (n, 3) [m], with sockets (P, 3) on their flanges."""
        carried = self.origin + np.einsum("nab,nb->na", self.rotation, sockets_F[self.socket])
        right = self.on_right[:, None]
        return np.where(right, carried, self.ball), np.where(right, self.ball, carried)

    def linearised(self, T: Array, sockets_F: Array) -> tuple[Array, Array]:
        """Residuals (3 n,) and what a shift and a turn of R, b, then every socket, explain of them (3 n, 6 + 3 P)."""
        right, left = self.ends(sockets_F)
        n, rotated = len(left), left @ T[:3, :3].T
        A = np.zeros((n, 3, 6 + sockets_F.size))
        A[:, :, :6] = twist_columns(rotated)
        by_socket = np.where(self.on_right[:, None, None], -self.rotation, T[:3, :3] @ self.rotation)
        for axis in range(3):
            A[np.arange(n), :, 6 + 3 * self.socket + axis] = by_socket[:, :, axis]
        return (right - rotated - T[:3, 3]).ravel(), A.reshape(3 * n, -1)


@dataclass(frozen=True, eq=False)
class _Solved:
    T: Array
    sockets_F: Array
    steps: int
    covariance: Array | None = None


def nominal_flange_rows(both: Sequence[Readings], chains: Sequence[Geometry]) -> FlangeRows:
    """The touches of both arms of a pair (left, right) by their chains, without effects."""
    chains = [one.with_T_M_B(np.eye(4)) for one in chains]
    return _rows(both, lambda arm, q: smr_positions(chains[arm], q), lambda arm, q: flange_poses(chains[arm], q))


def flange_rows(both: Sequence[Readings], models: Sequence[ArmModel]) -> FlangeRows:
    """The touches of both arms of a pair (left, right) by their models."""
    bases = [np.asarray(invert(model.geometry.T_M_B())) for model in models]

    def flange(arm: int, q: Array) -> tuple[Array, Array]:
        R, o = models[arm].flange(q)
        return bases[arm][:3, :3] @ R, apply(bases[arm], o)

    return _rows(both, lambda arm, q: apply(bases[arm], models[arm].predict(q)), flange)


def with_parameters(
    rows: FlangeRows, both: Sequence[Readings], models: Sequence[ArmModel], start: Array, sockets_F: Array
) -> FlangeRows:
    """The touches with what the uncertainty of both arms' parameters does to them; ``sockets_F`` (P, 3) [m]."""
    found, first = [], 0
    for mine, its in enumerate(both):
        touches = its.on_flange
        if touches is None:
            continue
        tool = sockets_F[rows.socket[first : first + len(touches)]].mean(axis=0)
        first += len(touches)
        of_arm = [np.zeros(0), np.zeros(0)]
        of_arm[mine] = _of_parameters(models[mine], touches.q, None)
        of_arm[1 - mine] = _of_parameters(models[1 - mine], touches.other_q, tool)
        whole = np.concatenate([start[:3, :3] @ of_arm[0], -of_arm[1]], axis=2)
        found.append(whole.reshape(3 * len(touches), -1))
    return replace(rows, of_parameters=np.concatenate(found))


def tie_on_flange(rows: FlangeRows, start: Array) -> TouchedPair | None:
    """Tie the bases of two arms; ``start`` (4, 4) is T_R_L from the profile. None where a direction is not seen.

    The errors are those of touches that a fit to the others never had, a fifth at a time.
    """
    count = int(rows.socket.max()) + 1
    found = _solved(rows, start, np.zeros((count, 3)))
    if found is None or found.covariance is None:
        return None
    errors, fold, held_out = np.full(len(rows.socket), np.nan), np.arange(len(rows.socket)) % _FOLDS, True
    for one in range(_FOLDS):
        left_out = np.flatnonzero(fold == one)
        kept = rows.take(np.flatnonzero(fold != one))
        without = _solved(kept, found.T, found.sockets_F) if {*kept.socket.tolist()} == {*range(count)} else None
        held_out = held_out and without is not None
        r, _ = rows.take(left_out).linearised(*((without or found).T, (without or found).sockets_F))
        errors[left_out] = np.linalg.norm(r.reshape(-1, 3), axis=1)
    scale = float(np.sqrt(np.mean(errors**2) / 3.0))
    identification = identification_of(found.T, found.covariance[:6, :6], found.steps, found.steps < _MOST_STEPS, scale)
    return TouchedPair(identification, errors, held_out)


def sockets_on_flange(rows: FlangeRows, start: Array) -> Array | None:
    """Where the sockets are on their flanges (P, 3) [m]; None where a direction is not seen."""
    found = _fitted(rows, start, np.zeros((int(rows.socket.max()) + 1, 3)), np.ones(len(rows.socket)))
    return None if found is None else found.sockets_F


def doubtful_touches(rows: FlangeRows, start: Array) -> Array | None:
    """Distance (n,) [m] of each touch from where most others have it, by published arms; None if not seen."""
    found = _Solved(start, np.zeros((int(rows.socket.max()) + 1, 3)), 0)
    off_m = np.ones(len(rows.socket))
    for _ in range(_ROBUST_ROUNDS):
        better = _fitted(rows, found.T, found.sockets_F, 1.0 / np.maximum(off_m, _LEAST_OFF_M))
        if better is None:
            return None
        found = better
        off_m = np.linalg.norm(rows.linearised(found.T, found.sockets_F)[0].reshape(-1, 3), axis=1)
    return np.asarray(off_m)


# -- inside -----------------------------------------------------------------------------------------------------------


def _rows(
    both: Sequence[Readings], ball: Callable[[int, Array], Array], flange: Callable[[int, Array], tuple[Array, Array]]
) -> FlangeRows:
    """The touches by what says where an arm, 0 or 1, has its ball and its flange in its base."""
    places = {name: k for k, name in enumerate(dict.fromkeys(_names(both)))}
    parts = [
        (np.full(len(its.on_flange), arm == 0), ball(arm, its.on_flange.q), *flange(1 - arm, its.on_flange.other_q))
        for arm, its in enumerate(both)
        if its.on_flange is not None
    ]
    socket = np.array([places[name] for name in _names(both)], dtype=np.intp)
    return FlangeRows(socket, *(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _names(both: Sequence[Readings]) -> list[str]:
    """The socket of each touch, with the arm that has the ball: names may repeat on both flanges."""
    return [f"{k} {name}" for k, its in enumerate(both) if its.on_flange is not None for name in its.on_flange.socket]


def _of_parameters(model: ArmModel, q: Array, tool: Array | None) -> Array:
    """Motion (n, 3, m) [m] of the ball, or of a point ``tool`` (3,) on the flange, in the arm's base by each of the m
    independent standard deviations of its parameters. Its own place on the flange is that of the ball alone."""
    names = model.geometry.names
    known = [k for k, name in enumerate(model.identified) if name in names]
    if model.covariance is None or not known:
        return np.zeros((len(q), 3, 0))
    columns = tuple(names.index(model.identified[k]) for k in known)
    geometry = model.geometry if tool is None else replace(model.geometry, tool=tool)
    _, J = jacobian(geometry, JointAngles.of(q), columns)
    if tool is not None:
        J = J * ~np.isin(columns, 6 + 5 * geometry.joints + np.arange(3))[None, :, None]
    values, vectors = np.linalg.eigh(model.covariance[np.ix_(known, known)])
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(np.einsum("ba,bkn,km->nam", model.geometry.T_M_B()[:3, :3], J, root, optimize=True))


def _solved(rows: FlangeRows, T: Array, sockets_F: Array) -> _Solved | None:
    """The fit from a guess, with the covariance of what it found; None where a direction is not seen."""
    found = _fitted(rows, T, sockets_F, np.ones(len(rows.socket)))
    if found is None:
        return None
    r, A = rows.linearised(found.T, found.sockets_F)
    inverse = np.linalg.pinv(A)
    covariance = _scatter(r, A, rows.of_parameters) * inverse @ inverse.T
    if rows.of_parameters is not None:
        moved = inverse @ rows.of_parameters
        covariance += moved @ moved.T
    return replace(found, covariance=covariance)


def _fitted(rows: FlangeRows, T: Array, sockets_F: Array, weights: Array) -> _Solved | None:
    """Gauss-Newton steps in least squares, each touch with its weight (n,); None where a direction is not seen."""
    root, steps = np.repeat(np.sqrt(weights), 3), 0
    while steps < _MOST_STEPS:
        steps += 1
        r, A = rows.linearised(T, sockets_F)
        sizes = np.linalg.svd(A, compute_uv=False)
        if len(r) <= A.shape[1] or sizes[-1] < UNSEEN * sizes[0]:
            return None
        move = np.linalg.lstsq(A * root[:, None], r * root, rcond=None)[0]
        T = transform(rotation_from_vector(move[3:6]) @ T[:3, :3], T[:3, 3] + move[:3])
        sockets_F = sockets_F + move[6:].reshape(-1, 3)
        if float(np.abs(move).max()) <= _SETTLED:
            break
    return _Solved(T, sockets_F, steps)


def _scatter(r: Array, A: Array, of_parameters: Array | None) -> float:
    """Variance of a touch's coordinate [m^2]: with it, residuals behind A are as large as they should be."""
    behind = np.linalg.qr(A, mode="complete")[0][:, A.shape[1] :]
    values, along = np.zeros(behind.shape[1]), (behind.T @ r) ** 2
    if of_parameters is not None:
        values, vectors = np.linalg.eigh((moved := behind.T @ of_parameters) @ moved.T)
        along = (vectors.T @ (behind.T @ r)) ** 2
    low, high = _LEAST_NOISE_M**2, max(float(np.mean(along)), _LEAST_NOISE_M**2)
    for _ in range(_HALVINGS):  # the sum falls as the variance grows
        middle = math.sqrt(low * high)
        low, high = (middle, high) if np.sum(along / (middle + np.maximum(values, 0.0))) > len(along) else (low, middle)
    return high
