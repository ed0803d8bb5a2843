"""Balance of the planned factors: posture functions, balanced random blocks, levels without correlations.

If a factor correlates with posture, time or another factor, their effects cannot be separated. Levels are therefore not
only drawn at random: they are changed, one at a time, until the largest correlation is small.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.gate import CellBodies
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import frame_poses
from cellapp.robot.kinematics.statics import gravity_loads
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import bodies_of

_UP_C = np.array([0.0, 0.0, 1.0])
_CONSTANT = 1e-6
"""A column whose standard deviation is below this share of the largest one's counts as constant."""
_POWER = 6
"""Power of the correlations in the sum that is minimised: high enough that the largest ones dominate."""
_BLOCK_DRAWS = 50
"""Number of random assignments of blocks, of which the best balanced is taken."""
_CANDIDATES = 32
"""Number of level changes whose effect is computed exactly: those with the largest gain to first order."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Variables (n, p) of n stops with mean 0 and standard deviation 1, and their names."""

    names: tuple[str, ...]
    values: Array

    def first(self, count: int) -> Columns:
        """Return the first ``count`` columns."""
        return Columns(self.names[:count], self.values[:, :count])

    def with_(self, *others: Columns) -> Columns:
        """Return these columns and the others, side by side."""
        return side_by_side((self, *others))


def side_by_side(columns: Iterable[Columns]) -> Columns:
    """Concatenate columns side by side."""
    every = tuple(columns)
    return Columns(sum((one.names for one in every), ()), np.concatenate([one.values for one in every], axis=1))


def standardised(names: tuple[str, ...], values: Array) -> Columns:
    """Standardise the columns of ``values`` (n, p) to mean 0 and standard deviation 1; leave out constant ones."""
    centred = values - values.mean(axis=0)
    spread = np.sqrt(np.mean(centred**2, axis=0))
    varies = spread > _CONSTANT * max(float(spread.max(initial=0.0)), 1e-300)
    kept = tuple(name for name, one in zip(names, varies.tolist(), strict=True) if one)
    return Columns(kept, np.asarray(centred[:, varies] / spread[varies]))


def posture_functions(profile: Profile, cell: CellBodies, name: str, q: Array) -> Columns:
    """Compute sine, cosine and gravity torque of each joint at configurations ``q`` (n, N) [rad] of an arm.

    Effects that depend on posture are, to first order, combinations of these. Constant ones are left out.
    """
    arm = cell.arms[name]
    torques = gravity_loads(frame_poses(arm.geometry, q), bodies_of(profile.arms[name]), _UP_C).joint_torques()
    groups = (("sin q{}", np.sin(q)), ("cos q{}", np.cos(q)), ("gravity torque {}", torques))
    return side_by_side(
        standardised(tuple(f"{text.format(j + 1)} of {name}" for j in range(q.shape[1])), values)
        for text, values in groups
    )


def time_and_blocks(time: Array, block: NDArray[np.intp]) -> Columns:
    """Return time, and for each block an indicator against the others."""
    numbers = np.unique(block)
    blocks = (block[:, None] == numbers).astype(np.float64) if len(numbers) > 1 else np.zeros((len(block), 0))
    names = ("time", *(f"block {number + 1}" for number in range(blocks.shape[1])))
    return standardised(names, np.column_stack([time, blocks]))


def fair_blocks(features: Array, sizes: NDArray[np.intp], rng: np.random.Generator) -> NDArray[np.intp]:
    """Assign a block (n,) to each stop at random, so that each block gets its share of similar stops.

    Within each group of similar stops, the block of each is drawn at random (a randomised block design); of many draws
    the one whose blocks have the most equal means is taken (rerandomisation: Morgan, Rubin, Annals of Statistics 40
    (2012) 1263).

    Parameters
    ----------
    features : array, shape (n, p)
        Functions of posture with mean 0; similar stops have similar ones.
    sizes : array, shape (B,)
        Number of stops of each block, at most one apart; their sum is n.
    rng : numpy.random.Generator
    """
    count, longer = len(sizes), np.flatnonzero(sizes > sizes.min())
    groups = _similar(features, count)
    best, least = np.zeros(len(features), dtype=np.intp), np.inf
    for _ in range(_BLOCK_DRAWS if count > 1 else 0):
        block = np.empty(len(features), dtype=np.intp)
        for rows in groups:  # an incomplete group goes to the blocks that have one stop more
            block[rows] = rng.permutation(count if len(rows) == count else longer)
        unfair = float(np.sum(((np.arange(count)[:, None] == block) @ features / sizes[:, None]) ** 2))
        if unfair < least:
            best, least = block, unfair
    return best


def _similar(features: Array, size: int) -> list[NDArray[np.intp]]:
    """Split the stops into groups of ``size`` similar ones, by repeated halving along the direction of largest spread.

    The last group is smaller if the number of stops is no multiple of ``size``.
    """
    found, waiting = [], [np.arange(len(features))]
    while waiting:
        rows = waiting.pop()
        if len(rows) <= size:
            found.append(rows)
            continue
        centred = features[rows] - features[rows].mean(axis=0)
        along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
        cut = size * max(1, round(len(rows) / (2 * size)))
        ranked = rows[np.argsort(along, kind="stable")]
        waiting += [ranked[:cut], ranked[cut:]]
    return found


def balanced_levels(
    levels: Array, allowed: NDArray[np.bool_], against: Array, rng: np.random.Generator, goal: float
) -> NDArray[np.intp]:
    """Choose a level for each of n stops, balanced and with small correlations; return the indices of the levels (n,).

    Random levels are changed one at a time, each time by the change that most reduces the sum of the sixth powers of
    the correlations, until the largest is at most ``goal`` or nothing improves.

    Parameters
    ----------
    levels : array, shape (L,)
        Values of the levels, all different.
    allowed : array, shape (n, L), bool
        Levels that each stop may have, at least one.
    against : array, shape (n, p)
        Variables with mean 0 and standard deviation 1; a column of ones balances the levels themselves.
    rng : numpy.random.Generator
    goal : float
        Largest correlation that is small enough.
    """
    n = len(allowed)
    if n == 0 or len(levels) < 2:
        return np.asarray(np.argmax(allowed, axis=1))
    score = (levels - levels.mean()) / levels.std()
    chosen = np.argmax(allowed * rng.random(allowed.shape), axis=1)
    correlation = against.T @ score[chosen] / n
    for _ in range(n * len(levels)):
        if np.abs(correlation).max(initial=0.0) <= goal:
            break
        change = np.where(allowed, score - score[chosen][:, None], 0.0) / n
        gain = change * (against @ correlation ** (_POWER - 1))[:, None]
        likely = np.argpartition(gain, min(_CANDIDATES, gain.size - 1), axis=None)[:_CANDIDATES]
        stop, level = np.unravel_index(likely, gain.shape)
        after = correlation + change[stop, level][:, None] * against[stop]
        total = np.sum(after**_POWER, axis=1)
        best = int(np.argmin(total))
        if total[best] >= np.sum(correlation**_POWER):
            break
        chosen[stop[best]], correlation = level[best], after[best]
    return np.asarray(chosen)
