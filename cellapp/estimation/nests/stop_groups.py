"""Rows of nests, grouped by the stop and the station at which they were measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.readings import Readings, stated_uncertainty
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, eq=False)
class StopGroups:
    """S stops of one arm, at each of which some of K nests were measured.

    Attributes
    ----------
    names : tuple of K str
        Names of the nests; the first is the SMR of the profile.
    row : array, shape (S, K)
        Row index of the readings; -1 where a nest was not measured.
    p_M : array, shape (S, K, 3)
        Measured positions [m]; NaN where a nest was not measured.
    information : array, shape (S, K, 3, 3)
        Inverse of their stated covariances [1/m^2]; zero where a nest was not measured, unit matrices if not all
        covariances are stated.
    stated : bool
        Whether the readings state their uncertainty.
    """

    names: tuple[str, ...]
    row: NDArray[np.intp]
    p_M: Array
    information: Array
    stated: bool

    @classmethod
    def of(cls, readings: Readings, names: Sequence[str]) -> StopGroups:
        """Group readings, each with one of ``names`` as ``smr``; None means the first one.

        Raise ``ValueError`` for another name.
        """
        words = readings.smr or (None,) * len(readings)
        stations = readings.station or ("",) * len(readings)
        nest = np.array([0 if word is None else tuple(names).index(word) for word in words], dtype=np.intp)
        numbers = {station: number for number, station in enumerate(dict.fromkeys(stations))}
        keys = np.column_stack([readings.configuration, [numbers[station] for station in stations]])
        found, group = np.unique(keys, axis=0, return_inverse=True)
        row = np.full((len(found), len(names)), -1, dtype=np.intp)
        row[group.ravel(), nest] = np.arange(len(readings))
        seen = row >= 0
        p_M = np.where(seen[:, :, None], readings.p_M[row], np.nan)
        covariance = covariances(readings)
        information = np.tile(np.eye(3), (*row.shape, 1, 1)) if covariance is None else np.linalg.inv(covariance)[row]
        return cls(tuple(names), row, p_M, np.where(seen[:, :, None, None], information, 0.0), covariance is not None)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Mask (S, K) of the nests that were measured."""
        return self.row >= 0

    @property
    def first_rows(self) -> NDArray[np.intp]:
        """First row of each stop (S,)."""
        return np.asarray(np.where(self.seen, self.row, np.iinfo(np.intp).max).min(axis=1))


def covariances(readings: Readings) -> Array | None:
    """Return a copy of the stated covariances (n, 3, 3) [m^2] of all readings; None if one has none."""
    stated = stated_uncertainty(readings)
    if stated is None or stated.ndim == 3:
        return None if stated is None else stated.copy()
    return np.asarray(stated[:, None, None] ** 2 * np.eye(3))
