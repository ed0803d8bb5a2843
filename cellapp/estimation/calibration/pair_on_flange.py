"""Inter-base transform without a tracker: the ball of one arm rests in a socket on the flange of the other.

With p_k the ball position from its calibrated arm in its base frame, (R_k, o_k) the flange of the other arm in its own
base frame, and s the socket's unknown position on that flange,

    minimise  sum_k |r_k|^2,   r_k = x_R,k - (R x_L,k + b),

over R, b and s of every socket, where x is p_k for the arm with the ball, and R_k s + o_k for the one with the socket.
The covariance of the solution follows from that of r: the scatter of touches, and the uncertainty of both arms'
parameters, which moves all touches together. (Weighting by that covariance gave no better ties of simulated arms: it
has directions of millimetres that no touch of an arm shows, and they are known to first order only.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.gauss_newton import LeastSquares
from cellapp.estimation.calibration.inter_base_transform import after_twist
from cellapp.estimation.calibration.pair_by_touching import (
    LEAST_NOISE_M,
    UNSEEN,
    TouchedPair,
    identification_of,
    identified_columns,
)
from cellapp.estimation.calibration.weights import added_variance
from cellapp.estimation.readings import Readings
from cellapp.robot.kinematics.chain import Geometry, JointAngles, flange_poses, jacobian, smr_positions
from cellapp.robot.kinematics.transforms import Array, apply, invert, twist_columns
from cellapp.robot.model import ArmModel

_FOLDS = 5
_ROBUST_ROUNDS = 20
_LEAST_OFF_M = 1e-3


@dataclass(frozen=True, eq=False)
class FlangeRows:
    """n touches from both arms, each in its own base frame.

    Attributes
    ----------
    socket : array, shape (n,)
        Index of the socket, from 0.
    on_right : array of bool, shape (n,)
        Whether the right arm carries the socket and the left arm the ball.
    ball : array, shape (n, 3) [m]
    rotation, origin : arrays, shapes (n, 3, 3), (n, 3) [m]
        Flange pose of the arm with the socket.
    """

    socket: NDArray[np.intp]
    on_right: NDArray[np.bool_]
    ball: Array
    rotation: Array
    origin: Array

    def take(self, rows: NDArray[np.bool_]) -> FlangeRows:
        """Return the touches that the mask ``rows`` (n,) selects."""
        return FlangeRows(
            self.socket[rows], self.on_right[rows], self.ball[rows], self.rotation[rows], self.origin[rows]
        )

    def ends(self, sockets_F: Array) -> tuple[Array, Array]:
        """Compute each touch (n, 3) [m] by the right arm and by the left arm, with sockets (P, 3) on their flanges."""
        carried = self.origin + np.einsum("nab,nb->na", self.rotation, sockets_F[self.socket])
        right = self.on_right[:, None]
        return np.where(right, carried, self.ball), np.where(right, self.ball, carried)

    def linearised(self, fit: FlangeFit) -> tuple[Array, Array]:
        """Compute residuals (3 n,) and their columns (3 n, 6 + 3 P): shift and rotation of R, b, then each socket."""
        T, sockets_F = fit.T_R_L, fit.sockets_F
        right, left = self.ends(sockets_F)
        n, rotated = len(left), left @ T[:3, :3].T
        A = np.zeros((n, 3, 6 + sockets_F.size))
        A[:, :, :6] = twist_columns(rotated)
        by_socket = np.where(self.on_right[:, None, None], -self.rotation, T[:3, :3] @ self.rotation)
        for axis in range(3):
            A[np.arange(n), :, 6 + 3 * self.socket + axis] = by_socket[:, :, axis]
        return (right - rotated - T[:3, 3]).ravel(), A.reshape(3 * n, A.shape[2])


@dataclass(frozen=True, eq=False)
class FlangeFit:
    """Transform T_R_L (4, 4), positions of the sockets on their flanges (P, 3) [m], and number of steps."""

    T_R_L: Array
    sockets_F: Array
    steps: int = 0

    def after(self, step: Array) -> FlangeFit:
        """Return the fit after a step (6 + 3 P,): shift and rotation of T_R_L, then each socket."""
        return FlangeFit(after_twist(self.T_R_L, step[:6]), self.sockets_F + step[6:].reshape(-1, 3))


def nominal_flange_rows(both: Sequence[Readings], chains: Sequence[Geometry]) -> FlangeRows:
    """Compute the touches of both arms of a pair (left, right) from their chains, without effects."""
    chains = [one.with_T_M_B(np.eye(4)) for one in chains]
    return _rows(both, lambda arm, q: smr_positions(chains[arm], q), lambda arm, q: flange_poses(chains[arm], q))


def flange_rows(both: Sequence[Readings], models: Sequence[ArmModel]) -> FlangeRows:
    """Compute the touches of both arms of a pair (left, right) from their models."""
    bases = [np.asarray(invert(model.geometry.T_M_B())) for model in models]

    def flange(arm: int, q: Array) -> tuple[Array, Array]:
        R, o = models[arm].flange(q)
        return bases[arm][:3, :3] @ R, apply(bases[arm], o)

    return _rows(both, lambda arm, q: apply(bases[arm], models[arm].predict(q)), flange)


def moved_by_parameters(
    rows: FlangeRows, both: Sequence[Readings], models: Sequence[ArmModel], tie: FlangeFit
) -> Array:
    """Compute the change (3 n, m) [m] of a ``tie``'s residuals by each of the m independent standard deviations of both
    arms' parameters."""
    found, first = [], 0
    for mine, its in enumerate(both):
        touches = its.on_flange
        if touches is None:
            continue
        tool = tie.sockets_F[rows.socket[first : first + len(touches)]].mean(axis=0)
        first += len(touches)
        of_arm = [np.zeros(0), np.zeros(0)]
        of_arm[mine] = _of_parameters(models[mine], touches.q, None)
        of_arm[1 - mine] = _of_parameters(models[1 - mine], touches.other_q, tool)
        whole = np.concatenate([tie.T_R_L[:3, :3] @ of_arm[0], -of_arm[1]], axis=2)
        found.append(whole.reshape(3 * len(touches), -1))
    return np.concatenate(found)


def fit_on_flange(rows: FlangeRows, start: Array) -> FlangeFit | None:
    """Fit to all touches; ``start`` (4, 4) is T_R_L from the profile. None if a direction is undetermined."""
    return _fitted(rows, _guess(rows, start))


def tie_on_flange(rows: FlangeRows, found: FlangeFit, of_parameters: Array | None = None) -> TouchedPair:
    """Tie the bases of two arms by the fit ``found`` from all touches.

    ``of_parameters`` are from ``moved_by_parameters``; None if the parameters' covariance is unknown. Errors are held
    out: a fifth of the touches at a time, by a fit to the others.
    """
    errors, fold, held_out = np.full(len(rows.socket), np.nan), np.arange(len(rows.socket)) % _FOLDS, True
    for one in range(_FOLDS):
        left_out = fold == one
        kept = rows.take(~left_out)
        without = _fitted(kept, found) if len(np.unique(kept.socket)) == len(found.sockets_F) else None
        held_out = held_out and without is not None
        errors[left_out] = _off_m(rows.take(left_out), without or found)
    scale = float(np.sqrt(np.mean(errors**2) / 3.0))
    covariance = _covariance(rows, found, of_parameters)[:6, :6]
    identification = identification_of(found.T_R_L, covariance, found.steps, scale)
    return TouchedPair(identification, errors, held_out)


def doubtful_touches(rows: FlangeRows, start: Array) -> Array | None:
    """Compute each touch's distance (n,) [m] from a robust fit to all touches; None if a direction is undetermined."""
    found = _guess(rows, start)
    off_m = np.ones(len(rows.socket))
    for _ in range(_ROBUST_ROUNDS):
        better = _fitted(rows, found, 1.0 / np.maximum(off_m, _LEAST_OFF_M))
        if better is None:
            return None
        found, off_m = better, _off_m(rows, better)
    return off_m


# -- inside -----------------------------------------------------------------------------------------------------------


def _rows(
    both: Sequence[Readings], ball: Callable[[int, Array], Array], flange: Callable[[int, Array], tuple[Array, Array]]
) -> FlangeRows:
    """Build the touches from functions that give the ball and the flange of an arm, 0 or 1, in its base frame."""
    places = {name: k for k, name in enumerate(dict.fromkeys(_names(both)))}
    parts = [
        (np.full(len(its.on_flange), arm == 0), ball(arm, its.on_flange.q), *flange(1 - arm, its.on_flange.other_q))
        for arm, its in enumerate(both)
        if its.on_flange is not None
    ]
    socket = np.array([places[name] for name in _names(both)], dtype=np.intp)
    return FlangeRows(socket, *(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _names(both: Sequence[Readings]) -> list[str]:
    """Name the socket of each touch, with the index of the arm that has the ball: names may repeat on both flanges."""
    return [f"{k} {name}" for k, its in enumerate(both) if its.on_flange is not None for name in its.on_flange.socket]


def _of_parameters(model: ArmModel, q: Array, tool: Array | None) -> Array:
    """Compute the motion (n, 3, m) [m] of the ball, or of a point ``tool`` (3,) on the flange, in the base frame by
    each of the m independent standard deviations of the arm's parameters. Tool parameters move the ball only."""
    columns, covariance = identified_columns(model)
    if not columns:
        return np.zeros((len(q), 3, 0))
    geometry = model.geometry if tool is None else replace(model.geometry, tool=tool)
    _, J = jacobian(geometry, JointAngles.of(q), columns)
    if tool is not None:
        J = J * ~np.isin(columns, 6 + 5 * geometry.joints + np.arange(3))[None, :, None]
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(np.einsum("ba,bkn,km->nam", model.geometry.T_M_B()[:3, :3], J, root, optimize=True))


def _guess(rows: FlangeRows, start: Array) -> FlangeFit:
    """Start with the transform from the profile and the sockets in the middle of their flanges."""
    return FlangeFit(start, np.zeros((int(rows.socket.max()) + 1, 3)))


def _off_m(rows: FlangeRows, fit: FlangeFit) -> Array:
    """Compute the distance (n,) [m] of the ball from its socket at each touch."""
    return np.asarray(np.linalg.norm(rows.linearised(fit)[0].reshape(-1, 3), axis=1))


def _covariance(rows: FlangeRows, found: FlangeFit, of_parameters: Array | None) -> Array:
    """Compute the covariance (6 + 3 P, 6 + 3 P) of the fit."""
    r, A = rows.linearised(found)
    inverse = np.linalg.pinv(A)
    covariance = _scatter(r, A, of_parameters) * inverse @ inverse.T
    if of_parameters is not None:
        moved = inverse @ of_parameters
        covariance += moved @ moved.T
    return np.asarray(covariance)


def _fitted(rows: FlangeRows, guess: FlangeFit, weights: Array | None = None) -> FlangeFit | None:
    """Fit to the touches, each with its weight (n,); None if a direction is undetermined."""
    L = None if weights is None else np.diag(np.repeat(weights**-0.5, 3))

    def seen(fit: FlangeFit) -> bool:
        _, A = rows.linearised(fit)
        sizes = np.linalg.svd(A, compute_uv=False)
        return bool(len(A) > A.shape[1] and sizes[-1] >= UNSEEN * sizes[0])

    if not seen(guess):
        return None
    problem = LeastSquares(rows.linearised, FlangeFit.after, L)
    best = problem.best("tie of the bases by sockets on a flange", guess)
    fit: FlangeFit = replace(best.point.state, steps=len(best.steps))
    return fit if seen(fit) else None


def _scatter(r: Array, A: Array, of_parameters: Array | None) -> float:
    """Estimate the variance [m^2] of a touch's coordinate such that the residuals orthogonal to A have their expected
    size."""
    behind = np.linalg.qr(A, mode="complete")[0][:, A.shape[1] :]
    left = behind.T @ r
    values, along = np.zeros(len(left)), left**2
    if of_parameters is not None:
        moved = behind.T @ of_parameters
        values, vectors = np.linalg.eigh(moved @ moved.T)
        along = (vectors.T @ left) ** 2
    return added_variance(along, np.maximum(values, 0.0), len(along), LEAST_NOISE_M**2)
