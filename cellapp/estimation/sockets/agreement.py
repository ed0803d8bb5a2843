"""Agreement of touches of sockets by a model of the arm, while they are being recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.readings import Readings
from cellapp.estimation.sockets.contacts import Contacts
from cellapp.robot.kinematics.chain import Geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, eq=False)
class PointAgreement:
    """Agreement of the touches of one point.

    Attributes
    ----------
    name : str
    rows : array, shape (k,)
        Row indices of its readings.
    off_m : array, shape (k,)
        Distance of each computed ball centre from the median of the point's others [m]; NaN for a single touch.
    turned_rad : array, shape (N,)
        Range of each joint over the touches [rad].
    """

    name: str
    rows: NDArray[np.intp]
    off_m: Array
    turned_rad: Array


def agreements(geometry: Geometry, readings: Readings) -> tuple[PointAgreement, ...]:
    """Compute the agreement of the touches of each point, in the order in which the points occur."""
    contacts = Contacts.of(readings)
    computed = smr_positions(geometry, readings.q)
    found = []
    for place, name in enumerate(contacts.names):
        rows = np.flatnonzero(contacts.index == place)
        off_m = np.array([_off(computed, rows[rows != row], row) for row in rows.tolist()])
        found.append(PointAgreement(name, rows, off_m, np.ptp(readings.q[rows], axis=0)))
    return tuple(found)


def nearest_point(geometry: Geometry, readings: Readings, row: int) -> tuple[str, float]:
    """Find the point nearest to touch ``row``, without that touch; return name and distance [m], "" and inf if none."""
    contacts = Contacts.of(readings)
    computed = smr_positions(geometry, readings.q)
    others = np.arange(len(readings)) != row
    near = {
        name: _off(computed, rows, row)
        for place, name in enumerate(contacts.names)
        if len(rows := np.flatnonzero((contacts.index == place) & others))
    }
    name = min(near, key=near.__getitem__, default="")
    return name, near.get(name, float("inf"))


def _off(computed: Array, others: NDArray[np.intp], row: int) -> float:
    """Compute the distance [m] of a row of ``computed`` (n, 3) [m] from the median of ``others``; NaN without any."""
    return float(np.linalg.norm(computed[row] - np.median(computed[others], axis=0))) if len(others) else float("nan")
