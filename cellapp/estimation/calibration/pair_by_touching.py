"""Inter-base transform without a tracker: both arms rest their balls in the same sockets.

With c_R,k and c_L,k the centre of socket k from either calibrated arm in its own base frame, and known distances d_m
between a socket of one arm and one of the other,

    minimise  r^T S^-1 r,   r = (c_R,k - (R c_L,k + b) for all k,  d_m - |c_R,m - (R c_L,m + b)| for all m)

over R, b. The covariance S holds the scatter of touches, the uncertainty of both arms' parameters, which moves all
their sockets together, and that of the distances. If r is larger than S allows, S is scaled up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.gauss_newton import LeastSquares
from cellapp.estimation.calibration.inter_base_transform import PairIdentification, after_twist
from cellapp.estimation.readings import Distance, Readings
from cellapp.estimation.sockets.contacts import Contacts
from cellapp.robot.kinematics.chain import JointAngles, jacobian
from cellapp.robot.kinematics.transforms import (
    Array,
    apply,
    register,
    twist_columns,
    zyx_angles,
)
from cellapp.robot.model import ArmModel

UNSEEN = 3e-3
"""Ratio of the smallest to the largest singular value from which all six directions count as determined: sockets half a
metre apart are then some millimetres off one line."""
LEAST_NOISE_M = 1e-6


@dataclass(frozen=True, eq=False)
class TouchedPoints:
    """The points that one arm touched, in its base frame.

    Attributes
    ----------
    place : mapping
        Name -> row index.
    at_B : array, shape (P, 3) [m]
    covariance : array, shape (3 P, 3 P) [m^2]
    rms_m : array, shape (P,)
        Rms distance of the touches of a point from their mean [m].
    first : array, shape (P,)
        Configuration of the first touch.
    """

    place: Mapping[str, int]
    at_B: Array
    covariance: Array
    rms_m: Array
    first: NDArray[np.int64]

    @classmethod
    def of(cls, readings: Readings, p_B: Array, model: ArmModel | None) -> TouchedPoints:
        """Average ball centres ``p_B`` (n, 3) [m]; include the uncertainty of the parameters if ``model`` states it."""
        contacts = Contacts.of(readings)
        count, own = len(contacts.names), contacts.index
        touches = np.bincount(own, minlength=count)
        at_B = contacts.centres(p_B)
        square = np.bincount(own, np.sum((p_B - at_B[own]) ** 2, axis=1), minlength=count)
        noise = max(float(square.sum()) / (3.0 * max(len(own) - count, 1)), LEAST_NOISE_M**2)
        covariance = np.diag(np.repeat(noise / touches, 3))
        if model is not None and model.covariance is not None:
            covariance += _of_parameters(model, readings, contacts)
        first = np.array([readings.configuration[own == k][0] for k in range(count)])
        places = {name: k for k, name in enumerate(contacts.names)}
        return cls(places, at_B, covariance, np.sqrt(square / touches), first)


@dataclass(frozen=True, eq=False)
class TouchedPair:
    """Inter-base transform and the error at each common point.

    Attributes
    ----------
    identification : PairIdentification
    errors_m : array, shape (C,)
        Distance between both arms' centres of a common point [m]; if ``held_out``, by a fit without that point.
    held_out : bool
        Whether every common point could be left out in turn: four that fix the transform without any one are enough.
    """

    identification: PairIdentification
    errors_m: Array
    held_out: bool


def common_points(left: TouchedPoints, right: TouchedPoints) -> tuple[str, ...]:
    """Return the names of the points that both arms touched."""
    return tuple(name for name in left.place if name in right.place)


def cross_distances(left: TouchedPoints, right: TouchedPoints, known: Sequence[Distance]) -> list[Distance]:
    """Select known distances from a point of the left arm (first) to one of the right; omit those within one arm."""
    found = []
    for one in dict.fromkeys(known):
        a, b = one.point_a, one.point_b
        if {a, b} <= left.place.keys() or {a, b} <= right.place.keys():
            continue
        if a in left.place and b in right.place:
            found.append(one)
        elif b in left.place and a in right.place:
            found.append(Distance(b, a, one.distance_m, one.sigma_m))
    return found


def tie_by_touching(
    left: TouchedPoints, right: TouchedPoints, known: Sequence[Distance], start: Array
) -> TouchedPair | None:
    """Tie the bases of two arms; ``start`` (4, 4) is T_R_L from the profile. None if a direction is undetermined."""
    common, crossing = common_points(left, right), cross_distances(left, right, known)
    problem = _Problem(left, right, common, crossing)
    found = problem.solved(start)
    if found is None:
        return None
    T, covariance, steps = found
    without = [_Problem(left, right, tuple(n for n in common if n != name), crossing).solved(T) for name in common]
    tied = [one[0] for one in without if one is not None]
    held_out = len(common) > 0 and len(tied) == len(common)
    errors = [
        np.linalg.norm(right.at_B[right.place[name]] - apply(tied[k] if held_out else T, left.at_B[left.place[name]]))
        for k, name in enumerate(common)
    ]
    scale = float(np.sqrt(np.mean(np.square(errors)) / 3.0)) if errors else float("nan")
    identification = identification_of(T, covariance, steps, scale)
    return TouchedPair(identification, np.array(errors), held_out)


def identification_of(T: Array, covariance: Array, steps: int, scale: float) -> PairIdentification:
    """Return T_R_L with standard errors of x, y, z and three angles; ``covariance`` (6, 6) is of shift and rotation."""
    size = np.sqrt(np.diag(covariance))
    return PairIdentification(
        T_R_L=T,
        values=np.concatenate([T[:3, 3], zyx_angles(T[:3, :3])]),
        standard_errors=np.concatenate([size[:3], size[:2:-1]]),
        iterations=steps,
        scale=scale,
    )


def identified_columns(model: ArmModel) -> tuple[tuple[int, ...], Array]:
    """Return the identified columns (m,) of the geometry with their covariance (m, m); empty if that is unknown."""
    if model.covariance is None:
        return (), np.zeros((0, 0))
    names = model.geometry.names
    known = [k for k, name in enumerate(model.identified) if name in names]
    return tuple(names.index(model.identified[k]) for k in known), model.covariance[np.ix_(known, known)]


@dataclass(frozen=True, eq=False)
class _Problem:
    left: TouchedPoints
    right: TouchedPoints
    common: tuple[str, ...]
    crossing: Sequence[Distance]

    def solved(self, start: Array) -> tuple[Array, Array, int] | None:
        """Solve for T_R_L, the covariance (6, 6) of a shift and a small rotation in the right base, and the number of
        steps; None if a direction is undetermined."""
        ends = [(name, name) for name in self.common] + [(one.point_a, one.point_b) for one in self.crossing]
        if not ends:
            return None
        rows_L, rows_R = [self.left.place[a] for a, _ in ends], [self.right.place[b] for _, b in ends]
        p_L, p_R, n = self.left.at_B[rows_L], self.right.at_B[rows_R], len(self.common)
        T = np.asarray(register(p_R[:n], p_L[:n])) if n >= 3 else start
        lever = np.array([1.0, 1.0, 1.0, *[max(float(np.ptp(p_R, axis=0).max()), 1e-3)] * 3])

        def seen(T: Array) -> bool:
            _, A, _ = self._linearised(T, p_L, p_R, rows_L, rows_R)
            sizes = np.linalg.svd(A / lever, compute_uv=False)
            return len(A) >= 6 and bool(sizes[5] >= UNSEEN * sizes[0])

        if not seen(T):
            return None
        best = LeastSquares(
            lambda T: self._linearised(T, p_L, p_R, rows_L, rows_R)[:2],
            after_twist,
            lambda T: np.asarray(
                np.linalg.cholesky(self._linearised(T, p_L, p_R, rows_L, rows_R)[2]), dtype=np.float64
            ),
        ).best("tie of the bases by touched points", T)
        if not seen(best.point.state):
            return None
        left, A = best.point.white
        excess = max(float(left @ left) / max(len(left) - 6, 1), 1.0)
        return best.point.state, np.asarray(excess * np.linalg.inv(A.T @ A), dtype=np.float64), len(best.steps)

    def _linearised(
        self, T: Array, p_L: Array, p_R: Array, rows_L: Sequence[int], rows_R: Sequence[int]
    ) -> tuple[Array, Array, Array]:
        """Compute residuals, their derivatives by a shift and a rotation after R, and the residuals' covariance."""
        n, m, R = len(self.common), len(self.crossing), T[:3, :3]
        rotated = p_L @ R.T
        off = p_R - rotated - T[:3, 3]
        length = np.maximum(np.linalg.norm(off, axis=1), 1e-12)
        along = off[n:] / length[n:, None]
        select = np.zeros((3 * n + m, 3 * (n + m)))
        select[: 3 * n, : 3 * n] = np.eye(3 * n)
        for k in range(m):
            select[3 * n + k, 3 * (n + k) : 3 * (n + k) + 3] = along[k]
        known = np.array([one.distance_m for one in self.crossing])
        r = np.concatenate([off[:n].ravel(), length[n:] - known])
        A = select @ twist_columns(rotated).reshape(-1, 6)
        block = np.kron(np.eye(n + m), R)
        of_ends = _taken(self.right.covariance, rows_R) + block @ _taken(self.left.covariance, rows_L) @ block.T
        S = select @ of_ends @ select.T
        S[range(3 * n, 3 * n + m), range(3 * n, 3 * n + m)] += np.array([one.sigma_m for one in self.crossing]) ** 2
        return r, A, S


def _of_parameters(model: ArmModel, readings: Readings, contacts: Contacts) -> Array:
    """Compute the covariance (3 P, 3 P) [m^2] of all points in the base frame from that of the arm's parameters."""
    columns, covariance = identified_columns(model)
    _, J = jacobian(model.geometry, JointAngles.of(readings.q), columns)
    R_B_M = model.geometry.T_M_B()[:3, :3].T
    means = [J[:, :, contacts.index == k].mean(axis=2) for k in range(len(contacts.names))]
    rows = np.concatenate([R_B_M @ one for one in means])
    return np.asarray(rows @ covariance @ rows.T)


def _taken(covariance: Array, rows: Sequence[int]) -> Array:
    """Return the covariance of the points ``rows``."""
    places = (3 * np.asarray(rows)[:, None] + np.arange(3)).ravel()
    return np.asarray(covariance[np.ix_(places, places)])
