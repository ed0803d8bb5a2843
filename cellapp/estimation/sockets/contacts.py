"""Points that readings share, known distances between them, and the resulting residuals.

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
"""Distance below which two points count as one block [m]: the arm's errors are alike at both."""


def in_sockets(readings: Readings) -> bool:
    """Return whether these are readings of a ball in sockets."""
    return readings.point is not None


@dataclass(frozen=True, eq=False)
class Contacts:
    """Points that n readings share.

    Attributes
    ----------
    names : tuple of str, length P
        Names in order of occurrence.
    index : array, shape (n,)
        Index of each reading's point.
    pairs : array, shape (m, 2)
        Indices of two points whose distance is known.
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
        """Collect the points of readings in sockets; omit distances to points that do not occur."""
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
        """Compute the weighted means (P, 3) [m] of each point's computed ball centres (n, 3)."""
        weights = np.ones(len(self.index)) if weights is None else weights
        total = np.bincount(self.index, weights, minlength=len(self.names))
        sums = [np.bincount(self.index, weights * axis, minlength=len(self.names)) for axis in computed.T]
        return np.stack(sums, axis=1) / total[:, None]

    def placements(self, centres: Array) -> NDArray[np.intp]:
        """Return the placement index (P,) of each point, from 0. Two points are in one placement if their distance is
        known or short by ``centres`` (P, 3) [m]: they are in one block."""
        near = np.argwhere(np.linalg.norm(centres[:, None] - centres, axis=2) < _SAME_BLOCK_M)
        place = np.arange(len(self.names), dtype=np.intp)
        for a, b in (*self.pairs.tolist(), *near.tolist()):
            place[place == place[b]] = place[a]
        return np.asarray(np.unique(place, return_inverse=True)[1], dtype=np.intp)


def measured_positions(readings: Readings, computed: Array) -> Array:
    """Return reference positions (n, 3) [m] for ``computed`` ones (n, 3): measured, or the means of their points."""
    if not in_sockets(readings):
        return readings.p_M
    contacts = Contacts.of(readings)
    return contacts.centres(computed)[contacts.index]


def placed(readings: Readings, computed: Array) -> Readings:
    """Set the points of readings in sockets to the means of ``computed`` ball centres (n, 3) [m]; return other readings
    unchanged."""
    return replace(readings, p_M=measured_positions(readings, computed)) if in_sockets(readings) else readings


def gauge_errors(readings: Readings, computed: Array) -> Array:
    """Compute the errors (m,) [m] of known distances: by ``computed`` ball centres (n, 3) less the known values."""
    contacts = Contacts.of(readings)
    centres = contacts.centres(computed)
    first, second = contacts.pairs.T
    return np.asarray(np.linalg.norm(centres[first] - centres[second], axis=1) - contacts.distance_m)
