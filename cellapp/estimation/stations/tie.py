"""Poses of tracker stations in the frame of the first one, from reference nests, all in one fit.

The unknowns are the nest positions x (3 each) in the frame of the first station and the pose T of every other station.
A nest that a station measured at p gives x - T p = 0, whitened by the uncertainty of p. The fit starts from pairwise
ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.estimation.calibration.least_squares import LeastSquares
from cellapp.robot.kinematics.transforms import Array, apply, register, rotation_from_vector, transform, twist_columns

FEWEST_NESTS = 3
"""Least number of common nests that fix a station's pose, if they are not on one line."""

_Places = tuple[dict[str, Array], Array]
"""Poses (4, 4) of all stations, and nests (k, 3) [m] in the first frame."""


@dataclass(frozen=True, eq=False)
class NestPoint:
    """A reference nest as one station measured it: position (3,) in its frame and standard uncertainty [m]."""

    station: str
    nest: str
    p: Array
    sigma_m: float


@dataclass(frozen=True, eq=False)
class StationTie:
    """Pose of a station in the frame of the first one.

    Attributes
    ----------
    T : array, shape (4, 4)
        Maps points of this station's frame into that of the first one.
    covariance : array, shape (6, 6)
        Covariance of its shift [m] and its rotation about the axes of the first frame at that frame's origin [rad].
    nests : tuple of str
        Nests that this and another station measured.
    residual_m : array, shape (n,)
        Distance of each of these nests from its fitted position [m].
    """

    station: str
    T: Array
    covariance: Array
    nests: tuple[str, ...]
    residual_m: Array

    def uncertainty(self, p_M: Array) -> Array:
        """Return the coordinate standard deviation (n,) that the tie adds to points (n, 3) in the first frame [m]."""
        J = twist_columns(p_M)
        return np.asarray(np.sqrt(np.einsum("nai,ij,naj->n", J, self.covariance, J) / 3.0))


class TooFewNests(ValueError):
    """Error for a station that cannot be tied to the first one; ``station`` is its name."""

    def __init__(self, station: str) -> None:
        super().__init__(f"station {station} shares fewer than {FEWEST_NESTS} nests with stations that are tied")
        self.station = station


def tie_stations(first: str, points: Sequence[NestPoint]) -> dict[str, StationTie]:
    """Fit the pose of every station but the first. Raise ``TooFewNests`` if one cannot be tied, or ``NotConverged``."""
    stations = [first, *(one for one in dict.fromkeys(p.station for p in points) if one != first)]
    T = _pairwise(stations, points)
    nests = list(dict.fromkeys(one.nest for one in points))
    placed = [apply(T[one.station], one.p[None])[0] for one in points]
    x: Array = np.array(
        [np.mean([p for one, p in zip(points, placed, strict=True) if one.nest == n], axis=0) for n in nests]
    )
    free = 6 * (len(stations) - 1)

    def linearised(one: _Places) -> tuple[Array, Array]:
        return _equations(stations, nests, points, *one)

    def after(one: _Places, step: Array) -> _Places:
        twists = step[:free].reshape(-1, 2, 3)
        moved = {n: transform(rotation_from_vector(w), v) @ one[0][n] for n, (v, w) in zip(stations[1:], twists)}
        return {**one[0], **moved}, one[1] + step[free:].reshape(-1, 3)

    best = LeastSquares(linearised, after).best("fit of the tracker's stations to reference nests", (T, x)).point
    (T, x), b, A = best.state, best.r, best.A
    left = len(b) - A.shape[1]
    scatter = max(1.0, math.sqrt(float(b @ b) / left)) if left > 0 else 1.0
    covariance: Array = np.asarray(np.linalg.inv(A.T @ A) * scatter**2, dtype=np.float64)
    places: dict[str, Array] = {nest: np.asarray(at, dtype=np.float64) for nest, at in zip(nests, x, strict=True)}
    return {
        name: _tie(name, T[name], covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], points, places)
        for k, name in enumerate(stations[1:])
    }


def _pairwise(stations: Sequence[str], points: Sequence[NestPoint]) -> dict[str, Array]:
    """Register the stations one by one, each by the nests that it shares with those already registered."""
    T: dict[str, Array] = {stations[0]: np.eye(4)}
    left = list(stations[1:])
    while left:
        known = {one.nest: apply(T[one.station], one.p[None])[0] for one in points if one.station in T}
        for name in left:
            own = [one for one in points if one.station == name and one.nest in known]
            if len(own) >= FEWEST_NESTS and _spans(np.array([one.p for one in own])):
                T[name] = register(np.array([known[one.nest] for one in own]), np.array([one.p for one in own]))
                left.remove(name)
                break
        else:
            raise TooFewNests(left[0])
    return T


def _spans(p: Array) -> bool:
    """Return whether points (n, 3) are not on one line."""
    singular = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    return bool(singular[1] > 1e-3 * singular[0])


def _equations(
    stations: Sequence[str], nests: Sequence[str], points: Sequence[NestPoint], T: dict[str, Array], x: Array
) -> tuple[Array, Array]:
    """Compute the whitened residuals (3 m,) of m points and their derivatives (3 m, k)."""
    free = 6 * (len(stations) - 1)
    A = np.zeros((len(points), 3, free + 3 * len(nests)))
    b = np.zeros((len(points), 3))
    for row, one in enumerate(points):
        place = apply(T[one.station], one.p[None])[0]
        at = free + 3 * nests.index(one.nest)
        A[row, :, at : at + 3] = -np.eye(3)
        if one.station != stations[0]:
            k = 6 * (stations.index(one.station) - 1)
            A[row, :, k : k + 6] = twist_columns(place)
        b[row] = x[nests.index(one.nest)] - place
        A[row], b[row] = A[row] / one.sigma_m, b[row] / one.sigma_m
    return b.ravel(), A.reshape(-1, A.shape[2])


def _tie(name: str, T: Array, covariance: Array, points: Sequence[NestPoint], x: dict[str, Array]) -> StationTie:
    elsewhere = {one.nest for one in points if one.station != name}
    own = [one for one in points if one.station == name and one.nest in elsewhere]
    residual = [float(np.linalg.norm(apply(T, one.p[None])[0] - x[one.nest])) for one in own]
    return StationTie(name, T, covariance, tuple(one.nest for one in own), np.array(residual))
