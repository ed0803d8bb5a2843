"""Which readings share a point, which distances are known, and the residuals that follow.

The residual of a reading is its computed ball centre minus the mean of all readings of its point (with the sign of
measured minus computed). A known distance is compared with that of the two means.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.readings import Readings
from cellapp.robot.kinematics.transforms import Array

_SAME_BLOCK_M = 0.1
"""Points nearer to each other than this [m] stand in one block: an arm errs alike at both."""


def in_sockets(readings: Readings) -> bool:
    """Whether these are readings of a ball in sockets."""
    return readings.point is not None


@dataclass(frozen=True, eq=False)
class Contacts:
    """Points that n readings share.

    Attributes
    ----------
    names : tuple of str, length P
        In the order in which they occur.
    index : array, shape (n,)
        Point of each reading.
    pairs : array, shape (m, 2)
        Points whose distance is known, among those that occur.
    distance_m, sigma_m : array, shape (m,)
        That distance and its standard uncertainty [m].
    """

    names: tuple[str, ...]
    index: NDArray[np.intp]
    pairs: NDArray[np.intp]
    distance_m: Array
    sigma_m: Array

    @classmethod
    def of(cls, readings: Readings) -> Contacts:
        """Those of readings in sockets; distances to points that do not occur are not among them."""
        points = [name or "" for name in readings.point or ()]
        place = {name: number for number, name in enumerate(dict.fromkeys(points))}
        known = [one for one in readings.distances if one.point_a in place and one.point_b in place]
        return cls(
            names=tuple(place),
            index=np.array([place[name] for name in points], dtype=np.intp),
            pairs=np.array([(place[one.point_a], place[one.point_b]) for one in known], dtype=np.intp).reshape(-1, 2),
            distance_m=np.array([one.distance_m for one in known]),
            sigma_m=np.array([one.sigma_m for one in known]),
        )

    def centres(self, computed: Array, weights: Array | None = None) -> Array:
        """Weighted means (P, 3) [m] of the computed ball centres (n, 3) of each point."""
        weights = np.ones(len(self.index)) if weights is None else weights
        total = np.bincount(self.index, weights, minlength=len(self.names))
        sums = [np.bincount(self.index, weights * axis, minlength=len(self.names)) for axis in computed.T]
        return np.stack(sums, axis=1) / total[:, None]

    def placements(self, centres: Array) -> NDArray[np.intp]:
        """Number (P,) of the placement of each point, from 0: a known distance or a short one (``centres`` (P, 3) [m])
        between two points says that they stand in one block."""
        near = np.argwhere(np.linalg.norm(centres[:, None] - centres, axis=2) < _SAME_BLOCK_M)
        place = np.arange(len(self.names), dtype=np.intp)
        for a, b in (*self.pairs.tolist(), *near.tolist()):
            place[place == place[b]] = place[a]
        return np.asarray(np.unique(place, return_inverse=True)[1], dtype=np.intp)


def measured_positions(readings: Readings, computed: Array) -> Array:
    """Positions (n, 3) [m] that ``computed`` ones (n, 3) are compared with: measured, or the means of their points."""
    if not in_sockets(readings):
        return readings.p_M
    contacts = Contacts.of(readings)
    return contacts.centres(computed)[contacts.index]


def placed(readings: Readings, computed: Array) -> Readings:
    """Readings in sockets with the points where ``computed`` ball centres (n, 3) [m] have their means; others as they
    are."""
    return replace(readings, p_M=measured_positions(readings, computed)) if in_sockets(readings) else readings


def gauge_errors(readings: Readings, computed: Array) -> Array:
    """Computed less known distance (m,) [m] of points among ``readings`` with computed ball centres (n, 3)."""
    contacts = Contacts.of(readings)
    centres = contacts.centres(computed)
    first, second = contacts.pairs.T
    return np.asarray(np.linalg.norm(centres[first] - centres[second], axis=1) - contacts.distance_m)
