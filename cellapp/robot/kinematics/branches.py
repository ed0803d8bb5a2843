"""All inverse solutions of a chain: in closed form where its structure allows, else from sampled configurations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.closed_form import closed_form_solutions
from cellapp.robot.kinematics.sampled_inverse import position_solutions, sampled_configurations, sampled_solutions
from cellapp.robot.kinematics.transforms import Array

_TURN = 2.0 * np.pi
_ROUNDING = 1e-9
"""Joint positions [rad] may exceed a limit by rounding, as the safety gate allows."""


def all_branches(
    geometry: Geometry,
    position_M: Array,
    rotation_M: Array,
    limits: Array,
    near: Array,
    seed: int,
    liked: Array | None = None,
) -> Array:
    """Joint positions (n, K, N) [rad] that reach n targets, without regard to limits; NaN where there are fewer.

    Parameters
    ----------
    geometry : Geometry
    position_M : array, shape (n, 3)
        SMR centre in the tracker frame [m].
    rotation_M : array, shape (n, 3, 3)
        Rotation of the flange; NaN where it is free, and some solutions near ``near`` are given.
    limits : array, shape (N, 2)
        Where samples are drawn for chains without a closed form [rad].
    near : array, shape (N,)
        Preferred configuration [rad].
    seed : int
        Of the samples.
    liked : array, shape (m, N), optional
        Configurations near which solutions with free rotation are welcome, besides those near ``near``.
    """
    free = np.isnan(rotation_M[:, 0, 0])
    parts: list[tuple[NDArray[np.bool_], Array]] = []
    if free.any():
        samples = sampled_configurations(limits, near, seed)
        parts.append((free, position_solutions(geometry, position_M[free], samples, near, liked)))
    if not free.all():
        P, R = position_M[~free], rotation_M[~free]
        closed = closed_form_solutions(geometry, P, R, near)
        found = sampled_solutions(geometry, P, R, limits, near, seed) if closed is None else closed
        parts.append((~free, found))
    q = np.full((len(free), max((one.shape[1] for _, one in parts), default=1), geometry.joints), np.nan)
    for rows, one in parts:
        q[rows, : one.shape[1]] = one
    return q


def turned_into(q: Array, limits: Array, to: Array) -> tuple[Array, Array]:
    """Each joint of ``q`` (..., N) moved by whole turns to its place within ``limits`` (N, 2) nearest to ``to``.

    Returns
    -------
    q : array, shape (..., N)
        Joint positions [rad]; where no turn is within the limits, the one least beyond them.
    beyond : array, shape (..., N)
        By how much that exceeds them [rad]; zero within.
    """
    low, high = limits.T
    fewest, most = np.ceil((low - _ROUNDING - q) / _TURN), np.floor((high + _ROUNDING - q) / _TURN)
    inside = q + _TURN * np.clip(np.round((to - q) / _TURN), fewest, np.maximum(fewest, most))
    above, below = q + _TURN * fewest - high, low - q - _TURN * most
    outside = np.where(above <= below, q + _TURN * fewest, q + _TURN * most)
    fits = fewest <= most
    return np.where(fits, inside, outside), np.where(fits, 0.0, np.minimum(above, below))
