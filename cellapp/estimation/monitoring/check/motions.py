"""Rigid motions of tracker and bases, solved for by Gauss-Newton steps from the registration of the points.

A measured point p of an arm whose base moved by M, seen by a tracker whose frame moved by T, lies at T M p'; p' is
where the calibration expects it, up to changes of parameters, which enter linearly. An orientation turns with both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.station_location import FEWEST_POINTS
from cellapp.estimation.monitoring.check.linear import Moments, StopRows, twists
from cellapp.estimation.monitoring.check.model import LENGTH_M
from cellapp.estimation.monitoring.check.statistics import after, solved
from cellapp.ground.errors import NotConverged
from cellapp.robot.kinematics.transforms import (
    Array,
    apply,
    invert,
    register,
    rotation_from_vector,
    rotation_vectors,
    transform,
)

LARGE_M = 5e-4
"""Errors above this are registered first: a turn of that size leaves second-order errors below a micrometre."""
_STEPS = 9
"""Gauss-Newton steps at most; two to four are usual."""
_UNRESOLVED = 0.1, 1e-6
"""Rise of chi-squared, and share of it, that no reading resolves. Along a motion that K leaves free, as that of a
tracker that was set up anew, it is flat, and the second order of a step raises it by some thousandths."""
_SMALL = 1e-4
"""Change in steps of what has to be detected that ends them: 5 nm."""


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions (4, 4) of the tracker's frame and of a base, and the stops with both taken off."""

    tracker: Array
    base: Array
    stops: StopRows


def solve_motions(
    stops: StopRows,
    centre: Array,
    *,
    tracker: bool,
    base: NDArray[np.bool_] | None = None,
    linear: Sequence[int] = (),
) -> Motions:
    """The motions that explain the stops best.

    Parameters
    ----------
    stops : StopRows
    centre : array, shape (3,)
        About which steps turn [m].
    tracker : bool
        Whether the frame of the tracker moved.
    base : array, shape (m,), optional
        Points of the arm whose base moved.
    linear : sequence of int
        Directions that changed besides.

    Raises
    ------
    NotConverged
        If the steps do not end, or make chi-squared larger than at the start.
    """
    every = np.ones(len(stops.measured), dtype=np.bool_)
    own = every & False if base is None else base
    parts = [points for points, moves in ((every, tracker), (own, base is not None)) if moves]
    columns = twists(stops.expected - centre, ~stops.points)
    whole = [(columns * points[:, None, None]).reshape(-1, 6).T for points in parts]
    rows = np.concatenate([*whole, stops.rows[list(linear)]])
    count = 6 * len(parts)
    T, M = _registered(stops, tracker, own)
    first, size = math.inf, math.inf
    for _ in range(_STEPS):
        moments = Moments.of(replace(_without(stops, T, M, own), rows=rows, free=0))
        left = float(np.sum(after(moments, range(count, len(rows))).white ** 2))
        first = min(first, left + _UNRESOLVED[0] + _UNRESOLVED[1] * left)
        if size < _SMALL * LENGTH_M or not left <= first:
            break
        step = solved(moments, range(len(rows)))[0][:count]
        if tracker:
            T = T @ _small(step[:6], centre)
        if base is not None:
            M = M @ _small(step[-6:], centre)
        size = float(np.abs(step).max(initial=0.0))
    if not (size < _SMALL * LENGTH_M and left <= first):
        raise NotConverged.of("fit of motions to the stops", f"the last of at most {_STEPS} steps was {size:.1e} long")
    return Motions(T, M, _without(stops, T, M, own))


def _registered(stops: StopRows, tracker: bool, own: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Where the solution begins; other points than the moved arm's tell the tracker's motion if there are enough."""
    T, M = np.eye(4), np.eye(4)
    if float(np.abs(stops.left).max()) <= LARGE_M:
        return T, M
    own, others = own & stops.points, ~own & stops.points
    if tracker:
        fixed = others if np.sum(others) >= FEWEST_POINTS else stops.points
        T = register(stops.measured[fixed], stops.expected[fixed])
    if np.sum(own) >= FEWEST_POINTS:
        M = register(apply(invert(T), stops.measured[own]), stops.expected[own])
    return T, M


def _without(stops: StopRows, T: Array, M: Array, own: NDArray[np.bool_]) -> StopRows:
    """The stops with both motions taken off."""
    measured = apply(invert(T), stops.measured)
    measured[own] = apply(invert(M), measured[own])
    if stops.turned is not None:
        left = scipy.spatial.transform.Rotation.from_rotvec(stops.measured[stops.turned]).as_matrix()
        moved = np.where(own[stops.turned, None, None], (T @ M)[:3, :3], T[:3, :3])
        measured[stops.turned] = rotation_vectors(moved.swapaxes(1, 2) @ left)
    return replace(stops, measured=measured)


def _small(twist: Array, centre: Array) -> Array:
    """A small motion (4, 4) by a twist about a centre."""
    rotation = rotation_from_vector(twist[3:])
    return transform(rotation, centre - rotation @ centre + twist[:3])
