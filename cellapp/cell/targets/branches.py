"""Choose the inverse solution to command: within limits, accepted by the gate, visible if possible, near home.

The solutions of both arms of a cooperative target are chosen together: the gate judges both arms at their positions,
with the other arms at home.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.cell_bodies import clear_with_others, visible_with_others
from cellapp.cell.safety.gate import CellBodies, clear_alone
from cellapp.robot.kinematics.inverse import Inverted, sampled_configurations, shifted_into
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.inverse import REACHED

_TIE_DECIMALS = 6
"""Decimals to which motions [rad] are compared (1 µrad): branches often tie, and rounding must not decide."""
LARGEST_CORRECTION = 0.2
"""Largest joint difference [rad] between a calibrated solution and its nominal one; more means that a singularity is
close. Joint zeros are identified to some 0.02 rad, and away from singularities a pose needs no more."""

Positions = Mapping[str, Array]
"""Arm -> joint positions (n, N) [rad]."""
Solve = Callable[[NDArray[np.intp], Positions], Mapping[str, Inverted]]
"""Function that returns the calibrated solutions of some targets (rows), starting from nominal ones."""


@dataclass(frozen=True, eq=False)
class Branches:
    """Nominal solutions of one arm for n targets, at most K each; NaN where there are fewer.

    Attributes
    ----------
    q : array, shape (n, K, N)
        Joint positions [rad] within the limits, as near to home as whole turns allow.
    beyond : array, shape (n, K, N)
        Excess of joints over their limits [rad].
    motion : array, shape (2, n, K)
        Largest joint motion from home, and sum over the joints [rad].
    clear, seen : array, shape (n, K), bool
        Whether the arm is within limits and clear of all but other arms; whether the tracker sees it, others at home.
    """

    q: Array
    beyond: Array
    motion: Array
    clear: NDArray[np.bool_]
    seen: NDArray[np.bool_]

    @property
    def exists(self) -> NDArray[np.bool_]:
        """Mask of existing solutions, (n, K)."""
        return np.isfinite(self.q[:, :, 0])

    @property
    def within(self) -> NDArray[np.bool_]:
        """Mask of solutions within the limits, (n, K)."""
        return np.asarray(self.exists & np.all(self.beyond == 0.0, axis=2))


@dataclass(frozen=True, eq=False)
class Picked:
    """Chosen solutions for n targets.

    Attributes
    ----------
    accepted : array, shape (n,), bool
    nominal : mapping
        Arm -> joint positions (n, N) [rad]; for a refused target those tried first, NaN if there are none.
    compensated : mapping
        Arm -> calibrated solutions.
    """

    accepted: NDArray[np.bool_]
    nominal: dict[str, Array]
    compensated: dict[str, Inverted]


def judged_branches(cell: CellBodies, homes: Mapping[str, Array], name: str, solutions: Array) -> Branches:
    """Judge all solutions (n, K, N) [rad] of an arm for n targets."""
    n, K, _ = solutions.shape
    limits, home = cell.arms[name].limits, homes[name]
    q, beyond = shifted_into(solutions, limits, home)
    motion = np.abs(q - home)
    motion = np.stack([motion.max(axis=2), motion.sum(axis=2)]).round(_TIE_DECIMALS)
    rows, branch = np.nonzero(np.isfinite(q[:, :, 0]) & np.all(beyond == 0.0, axis=2))
    clear, seen = np.zeros((2, n, K), dtype=bool)
    flat = q[rows, branch]
    clear[rows, branch] = clear_alone(cell, place(cell.arms[name], flat))
    seen[rows, branch] = visible_with_others(cell, homes, name, {name: flat})
    return Branches(q, beyond, motion, clear, seen)


def admissible_configurations(cell: CellBodies, homes: Mapping[str, Array], name: str, seed: int) -> Array:
    """Sample configurations (m, N) [rad] of an arm that the gate accepts and the tracker sees, the others at home."""
    samples = sampled_configurations(cell.arms[name].limits, homes[name], seed)
    samples = samples[visible_with_others(cell, homes, name, {name: samples})]
    return np.asarray(samples[clear_with_others(cell, homes, {name: samples})])


def choose(cell: CellBodies, homes: Mapping[str, Array], branches: Mapping[str, Branches], solve: Solve) -> Picked:
    """Choose among the branches of each arm for n targets: visible ones first, then the nearest to home.

    Candidates are solved with the calibrated model one after the other, until the gate accepts both commands, the
    nominal and the compensated one.
    """
    order, count = preferred(branches)
    n = len(order)
    pick = list(product(*(range(one.q.shape[1]) for one in branches.values())))
    places = {name: np.array([entry[k] for entry in pick]) for k, name in enumerate(branches)}
    nominal = {name: np.full((n, one.q.shape[2]), np.nan) for name, one in branches.items()}
    unsolved = {
        name: Inverted(np.full(q.shape, np.nan), np.full(n, np.inf), np.full(n, np.inf), REACHED)
        for name, q in nominal.items()
    }
    chosen = Picked(np.zeros(n, dtype=bool), nominal, unsolved)
    for attempt in range(int(count.max(initial=0))):
        rows = np.flatnonzero(~chosen.accepted & (count > attempt))
        if not len(rows):
            break
        q = {name: one.q[rows, places[name][order[rows, attempt]]] for name, one in branches.items()}
        admitted = clear_with_others(cell, homes, q)
        if attempt == 0:
            _keep_nominal(chosen, rows, q)
        rows, q = rows[admitted], {name: one[admitted] for name, one in q.items()}
        if not len(rows):
            continue
        solved = solve(rows, q)
        good = _good(cell, homes, q, solved)
        kept = np.ones(len(rows), dtype=bool) if attempt == 0 else good
        _keep_nominal(chosen, rows[kept], {name: one[kept] for name, one in q.items()})
        for name, one in solved.items():
            chosen.compensated[name].put(rows[kept], one, kept)
        chosen.accepted[rows[good]] = True
    return chosen


def _keep_nominal(chosen: Picked, rows: NDArray[np.intp], q: Positions) -> None:
    for name, one in q.items():
        chosen.nominal[name][rows] = one


def _good(
    cell: CellBodies, homes: Mapping[str, Array], nominal: Positions, solved: Mapping[str, Inverted]
) -> NDArray[np.bool_]:
    """Return the mask (n,) of targets whose calibrated solutions are reached, near nominal and accepted by the gate."""
    good = np.ones(len(next(iter(nominal.values()))), dtype=bool)
    for name, one in solved.items():
        good &= one.reached & (np.abs(one.q - nominal[name]).max(axis=1) <= LARGEST_CORRECTION)
    good[good] = clear_with_others(cell, homes, {name: one.q[good] for name, one in solved.items()})
    return good


def preferred(branches: Mapping[str, Branches]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the order (n, C) of the combinations of all arms' branches for n targets, and how many are usable (n,)."""
    parts = list(branches.values())
    n = len(parts[0].q)
    usable, seen = np.ones((2, n, 1), dtype=bool)
    largest, total = np.zeros((2, n, 1))
    for one in parts:
        usable = (usable[:, :, None] & one.clear[:, None]).reshape(n, -1)
        seen = (seen[:, :, None] & one.seen[:, None]).reshape(n, -1)
        largest = np.maximum(largest[:, :, None], one.motion[0][:, None]).reshape(n, -1)
        total = (total[:, :, None] + one.motion[1][:, None]).reshape(n, -1)
    return np.lexsort((total, largest, ~seen, ~usable), axis=1), np.count_nonzero(usable, axis=1)
