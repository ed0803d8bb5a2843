"""Combine readings of several nests into one reading per stop: position of the first nest, orientation from all.

A nest's row at a stop is p_k = p + R s_k, where s are the nests' positions in the rigid figure. Position p and
orientation R of a stop follow from three or more nests by weighted least squares, with their covariance. Two nests fix
no orientation.

Both are stated with full covariances: an orientation is several times less certain about the beam than across it.
The correlation of p and R is neglected: they are taken as two readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.nests.shape import NestShape, UnseenPair, fit_shape, laid_on
from cellapp.estimation.nests.stop_groups import StopGroups, covariances
from cellapp.estimation.readings import Readings
from cellapp.robot.kinematics.transforms import Array, quaternions_of, twist_columns


@dataclass(frozen=True, eq=False)
class NestStops:
    """One reading per stop, with the data that it was made from.

    Attributes
    ----------
    readings : Readings
        Readings of the first nest, with orientations if three nests were measured; rows in the order of the stops.
    shape : NestShape or None
        None if the figure cannot be determined.
    groups : StopGroups
    left_out : array, shape (S,)
        Mask of stops without a reading: neither the first nest nor three others were measured.
    """

    readings: Readings
    shape: NestShape | None
    groups: StopGroups
    left_out: NDArray[np.bool_]


def by_stop(readings: Readings, names: Sequence[str], offsets_F: Array) -> NestStops:
    """Combine rows of nests into one reading per stop.

    Parameters
    ----------
    readings : Readings
        Rows whose ``smr`` is one of ``names``; None means the first.
    names : sequence of K str
    offsets_F : array, shape (K, 3)
        Positions of the nests on the flange [m], NaN where unknown. If three are known, S has the flange's axes.
    """
    groups = StopGroups.of(readings, names)
    try:
        shape: NestShape | None = fit_shape(groups)[0].turned_like(offsets_F)
    except UnseenPair:
        shape = None
    turned = groups.seen.sum(axis=1) >= 3
    if shape is None or not shape.spans:
        turned = np.zeros(len(turned), dtype=np.bool_)
    kept = turned | groups.seen[:, 0]
    first = np.where(groups.seen[:, 0], groups.row[:, 0], groups.first_rows)
    one = replace(_means(readings, groups, first), smr=None)
    if shape is not None and turned.any():
        one = _with_poses(one, shape, groups, turned)
    return NestStops(one.take(np.flatnonzero(kept)), shape, groups, ~kept)


def _means(readings: Readings, groups: StopGroups, first: NDArray[np.intp]) -> Readings:
    """Return the rows ``first`` (S,), with joint positions, times and dwell averaged over the rows of each stop."""
    one = readings.take(first)
    count = groups.seen.sum(axis=1)
    means: dict[str, Any] = {}
    for name in ("q", "time_s", "dwell_s", "sequence"):
        values = getattr(readings, name)
        if values is not None:
            own = np.where(groups.seen.reshape(*groups.seen.shape, *(1,) * (values.ndim - 1)), values[groups.row], 0.0)
            means[name] = own.sum(axis=1) / count.reshape(-1, *(1,) * (values.ndim - 1))
    return replace(one, **means)


def _with_poses(one: Readings, shape: NestShape, groups: StopGroups, turned: NDArray[np.bool_]) -> Readings:
    """Set position, orientation and their uncertainty in the readings (S,) that the mask ``turned`` (S,) selects."""
    p_M, information = groups.p_M[turned], groups.information[turned]
    if not groups.stated:
        information = information / (shape.noise_m**2 if np.isfinite(shape.noise_m) and shape.noise_m > 0.0 else 1e-10)
    rotation, origin, covariance = poses(shape.points_S, p_M, information)
    S = len(one)
    points, quaternion = one.p_M.copy(), np.full((S, 4), np.nan)
    sigma_rad, turning = np.full(S, np.nan), np.full((S, 3, 3), np.nan)
    points[turned] = origin
    quaternion[turned] = quaternions_of(rotation)
    turning[turned] = covariance[:, 3:, 3:]
    sigma_rad[turned] = np.sqrt(np.linalg.eigvalsh(turning[turned])[:, -1])  # about the least certain axis
    stated: dict[str, Any] = {"turning_covariance_M": turning}
    of_rows = covariances(one)
    if of_rows is not None:
        of_rows[turned] = covariance[:, :3, :3]
        stated |= {"covariance_M": of_rows, "sigma_m": None}
    return replace(one, p_M=points, quaternion_M=quaternion, sigma_rad=sigma_rad, **stated)


def poses(points_S: Array, p_M: Array, information: Array) -> tuple[Array, Array, Array]:
    """Fit rotations (S, 3, 3) and origins (S, 3) of a figure (K, 3) at S stops, with the covariances (S, 6, 6) of both.

    Weighted least squares on points ``p_M`` (S, K, 3), NaN where not measured, with ``information`` (S, K, 3, 3).
    """
    rotation, origin = laid_on(points_S, p_M)
    arms = np.einsum("sab,kb->ska", rotation, points_S)
    J = twist_columns(arms)
    left = np.nan_to_num(p_M - origin[:, None] - arms)
    weighed = np.einsum("skab,skbi->skai", information, J)
    unit = np.array([1.0, 1.0, 1.0, *(1.0 / max(np.abs(points_S).max(), 1e-6),) * 3])
    normal = np.einsum("skai,skaj->sij", J, weighed) * unit * unit[:, None]
    covariance = np.linalg.inv(normal) * unit * unit[:, None]
    step = np.einsum("sij,skaj,ska->si", covariance, weighed, left)
    turned = scipy.spatial.transform.Rotation.from_rotvec(step[:, 3:]).as_matrix() @ rotation
    return turned, origin + step[:, :3], covariance
