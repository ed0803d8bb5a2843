"""Find all inverse solutions of a chain: in closed form if its structure allows, else from sampled configurations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.closed_form import closed_form_solutions
from cellapp.robot.kinematics.sampled_inverse import position_solutions, sampled_configurations, sampled_solutions
from cellapp.robot.kinematics.transforms import Array

_TURN = 2.0 * np.pi
_ROUNDING = 1e-9
"""Tolerance [rad] by which joint positions may exceed a limit, as in the safety gate."""


def all_branches(
    geometry: Geometry,
    position_M: Array,
    rotation_M: Array,
    limits: Array,
    near: Array,
    seed: int,
    liked: Array | None = None,
) -> Array:
    """Find joint positions (n, K, N) [rad] that reach n targets, regardless of limits; padded with NaN.

    Parameters
    ----------
    geometry : Geometry
    position_M : array, shape (n, 3)
        SMR centre in the tracker frame [m].
    rotation_M : array, shape (n, 3, 3)
        Rotation of the flange; NaN if it is free, which gives some solutions near ``near``.
    limits : array, shape (N, 2)
        Range of the samples for chains without a closed form [rad].
    near : array, shape (N,)
        Preferred configuration [rad].
    seed : int
        Seed of the samples.
    liked : array, shape (m, N), optional
        More preferred configurations for solutions with free rotation, besides ``near``.
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
    """Shift each joint of ``q`` (..., N) by whole turns to the position within ``limits`` (N, 2) nearest to ``to``.

    Returns
    -------
    q : array, shape (..., N)
        Joint positions [rad]; if no turn is within the limits, the one that exceeds them least.
    beyond : array, shape (..., N)
        Excess over the limits [rad]; zero within.
    """
    low, high = limits.T
    fewest, most = np.ceil((low - _ROUNDING - q) / _TURN), np.floor((high + _ROUNDING - q) / _TURN)
    inside = q + _TURN * np.clip(np.round((to - q) / _TURN), fewest, np.maximum(fewest, most))
    above, below = q + _TURN * fewest - high, low - q - _TURN * most
    outside = np.where(above <= below, q + _TURN * fewest, q + _TURN * most)
    fits = fewest <= most
    return np.where(fits, inside, outside), np.where(fits, 0.0, np.minimum(above, below))
