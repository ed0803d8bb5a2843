"""Rows that no split and no fold may divide: repeats of one configuration, and neighbours along a line or on a grid.

A held-out row that stands beside a learnt one tests only the noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.readings.readings import Readings
from cellapp.ground.counting import counted
from cellapp.robot.kinematics.transforms import Array

SAME_RAD = 1e-3
"""Largest difference of joint positions within one configuration: encoders read 0.04 mrad more or less."""
NEIGHBOUR_RAD = 0.05
"""Largest difference of joint positions of neighbours: 3 degrees, far within the period of most errors of an arm. Rows
of a plan, or drawn at random, lie some 0.4 rad apart."""
_WIDE = 4.0
"""Radius of a neighbourhood, in distances of neighbours: most of its rows then have no neighbour outside it."""
_FEWEST = 10
"""Least number of neighbourhoods; they are smaller if the rows would give fewer."""
_NEAR = f"{np.degrees(NEIGHBOUR_RAD):.0f} degrees"
_MANY = 0.1
"""Share of held-out rows with a learnt neighbour from which a note says so."""

Groups = NDArray[np.intp]
"""Number of the group of each row (n,), counted in the order of the groups' first rows."""


def repeats(q: Array, within: float = SAME_RAD) -> Groups:
    """Group rows of joint positions (n, N) [rad] that agree with the first row of their group."""
    tree, group, count = scipy.spatial.KDTree(q), np.full(len(q), -1, dtype=np.intp), 0
    alone = tree.query(q, k=[2], p=np.inf)[0][:, 0] > within
    for row in range(len(q)):
        if group[row] < 0:
            if not alone[row]:
                near = np.array(tree.query_ball_point(q[row], within, p=np.inf), dtype=np.intp)
                group[near[group[near] < 0]] = count
            group[row] = count
            count += 1
    return group


def undivided(q: Array) -> Groups:
    """Group rows (n, N) [rad] for splits and folds: by configuration, or by neighbourhood if most have a neighbour."""
    group = repeats(q)
    single = q[np.unique(group, return_index=True)[1]]
    if not len(single) or np.mean(beside(single, single, itself=True)) <= 0.5:
        return group
    radius = _WIDE * NEIGHBOUR_RAD
    while (wide := repeats(q, radius)).max() + 1 < _FEWEST and radius > NEIGHBOUR_RAD:
        radius /= 2.0
    return wide


def beside(q: Array, learnt: Array, *, itself: bool = False) -> NDArray[np.bool_]:
    """Return a mask (n,) of the rows with a neighbour among ``learnt`` rows (m, N); ``itself``: these are the same."""
    count = 2 if itself else 1
    if len(learnt) < count:
        return np.zeros(len(q), dtype=np.bool_)
    distance, _ = scipy.spatial.KDTree(learnt).query(q, k=[count], p=np.inf)
    return np.asarray(distance[:, 0] <= NEIGHBOUR_RAD)


def folds_of(group: Groups, folds: int, generator: np.random.Generator) -> NDArray[np.int64]:
    """Draw a fold for each row (n,), the same for the rows of a group."""
    return np.asarray((generator.permutation(int(group.max()) + 1) % folds)[group], dtype=np.int64)


def first_stops(readings: Mapping[str, Readings]) -> tuple[dict[int, int], tuple[str, ...]]:
    """Return stop -> first stop of its group, by the joint positions of all arms; and a note on neighbourhoods."""
    numbers = np.unique(np.concatenate([its.configuration for its in readings.values()]))
    ends = np.cumsum([its.joints for its in readings.values()])
    q = np.zeros((len(numbers), ends[-1]))
    for end, its in zip(ends, readings.values(), strict=True):
        q[np.searchsorted(numbers, its.configuration), end - its.joints : end] = its.q
    group, count = undivided(q), int(repeats(q).max()) + 1
    first = numbers[np.unique(group, return_index=True)[1]][group]
    drawn = int(group.max()) + 1
    note = (
        f"most of the {counted(count, 'configuration')} have a neighbour within {_NEAR} in every joint, as along a line"
        f" or on a grid: rows were held out by whole neighbourhoods, of which there are {drawn}"
    )
    return dict(zip(numbers.tolist(), first.tolist(), strict=True)), (note,) if drawn < count else ()


def one_a_stop(readings: Readings) -> Readings:
    """Return the readings with one row for rows that repeat the one before them while the arm rests.

    It has their mean point and the other values of the first: a model that is wrong there is so once, not many times.
    """
    known = readings.time_s if readings.sequence is None else readings.sequence
    its = readings.take(np.argsort(known if np.isfinite(known).all() else readings.configuration, kind="stable"))
    group, others = repeats(its.q), its.approach[1:]
    moved = (others != 0) & (others != its.approach[:-1])
    if its.step is not None:
        moved = np.where(np.isfinite(its.step[1:]), np.abs(its.step[1:]) > SAME_RAD, moved)
    rests = (group[1:] == group[:-1]) & ~moved.any(axis=1)
    for words in (its.smr, its.station):
        rests &= words is None or np.array([one == other for one, other in pairwise(words)], dtype=np.bool_)
    if its.payload_kg is not None:
        rests &= ~(np.abs(np.diff(its.payload_kg)) > 0.0)
    if not rests.any():
        return readings
    first = np.concatenate([[True], ~rests])
    stop = np.cumsum(first) - 1
    mean = np.stack([np.bincount(stop, column) for column in its.p_M.T], axis=1) / np.bincount(stop)[:, None]
    return replace(its.take(first), p_M=mean)


def neighbours_words(readings: Readings) -> str:
    """Say how many held-out rows have a learnt neighbour, or repeat a learnt row; empty for few."""
    held_out = readings.q[readings.in_split("validate")]
    learnt = readings.q[np.concatenate([readings.in_split("identify"), readings.in_split("train")])]
    count = int(np.count_nonzero(beside(held_out, learnt)))
    if not count or count < _MANY * len(held_out):
        return ""
    return (
        f"{count} of {counted(len(held_out), 'held-out row')} stand within {_NEAR}, in every joint, of a row that was"
        " learnt from: held-out errors there say little about other poses; measure held-out rows away from the others"
    )
