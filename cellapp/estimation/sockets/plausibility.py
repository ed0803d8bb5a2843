"""Search for readings and distances that contradict the published arm: swapped sockets, distances in another unit.

A published arm predicts a ball within some 15 mm. Names of points and distances that are off by much more are mistakes
of the person who wrote them down. If the ball's offset is unknown, it is fitted first, with weights 1 / |r|, so that a
minority of wrong rows does not bias it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from cellapp.estimation.readings import Distance, Readings
from cellapp.estimation.sockets.contacts import Contacts, gauge_errors
from cellapp.robot.kinematics.chain import Geometry, flange_poses, smr_positions
from cellapp.robot.kinematics.transforms import Array, apply, register

_ROUNDS = 25
"""Rounds of the robust fit of the ball; its weights settle to a few per cent."""
_LEAST_M = 1e-3
"""Residual below which all weights are equal [m]."""
_OWN_M = 0.02
"""Distance of a reading from its own point above which it is mistaken [m]: a published arm is off by less."""
_OTHER = 0.5
"""Share of that distance within which a mistaken reading must lie at another point to belong there."""
_DISTANCE_M, _DISTANCE_SHARE = 0.02, 0.05
"""Error of a known distance by a published arm from which the distance is mistaken: a constant [m] plus this share."""


def with_ball(geometry: Geometry, readings: Readings, *, unknown: bool) -> Geometry:
    """Fit the ball robustly if its offset is ``unknown``; return the geometry with it."""
    if not unknown:
        return geometry
    contacts = Contacts.of(readings)
    rotations, origins = flange_poses(replace(geometry, tool=np.zeros(3)), readings.q)
    tool: Array = np.zeros(3)
    weights: Array = np.ones(len(readings))
    for _ in range(_ROUNDS):
        columns = np.stack([_from_centres(contacts, rotations[:, :, axis], weights) for axis in range(3)], axis=2)
        off = _from_centres(contacts, origins, weights)
        root = np.sqrt(weights)[:, None]
        rows, left = (columns * root[:, :, None]).reshape(-1, 3), -(off * root).ravel()
        tool = np.asarray(np.linalg.lstsq(rows, left, rcond=None)[0], dtype=np.float64)
        weights = 1.0 / np.maximum(np.linalg.norm(off + columns @ tool, axis=1), _LEAST_M)
    return replace(geometry, tool=tool)


def misplaced_readings(geometry: Geometry, readings: Readings) -> Iterator[tuple[int, str]]:
    """Yield rows that lie far from the others of their point and near another point, with a message."""
    contacts = Contacts.of(readings)
    computed = smr_positions(geometry, readings.q)
    places = range(len(contacts.names))
    centres = np.array([np.median(computed[contacts.index == place], axis=0) for place in places])
    away = np.linalg.norm(computed[:, None] - centres, axis=2)
    own = away[np.arange(len(computed)), contacts.index]
    nearest = np.argmin(away, axis=1)
    for row in np.flatnonzero((own > _OWN_M) & (away.min(axis=1) < _OTHER * own)).tolist():
        yield (
            row,
            f"'{contacts.names[contacts.index[row]]}' is {own[row] * 1e3:.0f} mm from the ball's place by the published"
            f" arm, '{contacts.names[nearest[row]]}' {away[row, nearest[row]] * 1e3:.0f} mm; are the two swapped?",
        )


def swapped_between_arms(geometries: Sequence[Geometry], readings: Sequence[Readings]) -> Iterator[tuple[int, str]]:
    """Yield rows of the second arm at sockets that the first arm found elsewhere, if exchanging two names explains it,
    with a message. At least three sockets must be common."""
    names, first, second = _common_centres(geometries, readings)
    if len(names) < 3 or (own := _misfit_m(first, second)) <= _OWN_M:
        return
    tried = {}
    for a, b in combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[a, b]] = b, a
        tried[a, b] = _misfit_m(first, second[order])
    (a, b), left = min(tried.items(), key=lambda one: one[1])
    if left > min(_OTHER * own, _OWN_M):
        return
    for name, other in ((names[a], names[b]), (names[b], names[a])):
        row = (readings[1].point or ()).index(name)
        yield (
            row,
            f"'{name}' is not where the other arm touched it: common sockets differ by {own * 1e3:.0f} mm, with"
            f" '{name}' and '{other}' exchanged by {left * 1e3:.0f} mm; are the two swapped?",
        )


def wrong_between_arms(
    geometries: Sequence[Geometry], readings: Sequence[Readings], known: Iterable[Distance]
) -> Iterator[tuple[Distance, str]]:
    """Yield known distances between sockets of two arms that the published arms contradict, with a message.

    The relative pose of the bases follows from common sockets: with fewer than three, nothing is judged.
    """
    names, first, second = _common_centres(geometries, readings)
    if len(names) < 3:
        return
    T = np.asarray(register(first, second))
    places = [_centres(one, its) for one, its in zip(geometries, readings, strict=True)]
    places[1] = {name: apply(T, at) for name, at in places[1].items()}
    for one in known:
        ends = [next(place[point] for place in places if point in place) for point in (one.point_a, one.point_b)]
        computed = float(np.linalg.norm(ends[0] - ends[1]))
        if _contradicted(one.distance_m, computed):
            yield one, _contradiction(one.point_a, one.point_b, one.distance_m, f"arms find {computed:.3f} m")


def _centres(geometry: Geometry, readings: Readings) -> dict[str, Array]:
    """Compute the median (3,) [m] of each point's computed ball centres, in the arm's base frame."""
    contacts, computed = Contacts.of(readings), smr_positions(geometry.with_T_M_B(np.eye(4)), readings.q)
    return {name: np.median(computed[contacts.index == k], axis=0) for k, name in enumerate(contacts.names)}


def _common_centres(geometries: Sequence[Geometry], readings: Sequence[Readings]) -> tuple[list[str], Array, Array]:
    """Return the names of the points that both arms touched, and their positions (C, 3) [m] in each base frame."""
    first, second = (_centres(one, its) for one, its in zip(geometries, readings, strict=True))
    names = [name for name in first if name in second]
    at = [np.array([one[name] for name in names]).reshape(-1, 3) for one in (first, second)]
    return names, at[0], at[1]


def _misfit_m(first: Array, second: Array) -> float:
    """Compute the rms distance [m] of points (C, 3) [m] after registration of the second ones to the first."""
    return float(np.sqrt(np.mean(np.sum((apply(register(first, second), second) - first) ** 2, axis=1))))


def wrong_distances(geometry: Geometry, readings: Readings) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield pairs of points whose known distance the published arm contradicts, with a message."""
    contacts = Contacts.of(readings)
    errors = gauge_errors(readings, smr_positions(geometry, readings.q))
    for (a, b), known, error in zip(contacts.pairs.tolist(), contacts.distance_m.tolist(), errors.tolist()):
        computed, ends = known + error, (contacts.names[a], contacts.names[b])
        if _contradicted(known, computed):
            yield ends, _contradiction(*ends, known, f"arm finds {computed:.3f} m")


def _contradicted(known: float, computed: float) -> bool:
    """Return whether computed and known distance [m] differ by more than the error of a published arm."""
    return abs(computed - known) > _DISTANCE_M + _DISTANCE_SHARE * min(known, computed)


def _contradiction(a: str, b: str, known: float, found: str) -> str:
    return (
        f"{known:g} m from '{a}' to '{b}', but the published {found}; check the unit, and whether the names of sockets"
        " are swapped"
    )


def _from_centres(contacts: Contacts, vectors: Array, weights: Array) -> Array:
    """Subtract from vectors (n, 3) the weighted mean of those of the same point."""
    return np.asarray(vectors - contacts.centres(vectors, weights)[contacts.index])
