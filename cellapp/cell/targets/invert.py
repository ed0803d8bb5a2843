"""Invert a calibrated model: find joint positions at which geometry, effects and network together meet a target."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.cell_bodies import clear_with_others, visible_with_others
from cellapp.cell.safety.gate import CellBodies, clear_alone
from cellapp.ground.errors import NotConverged
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.inverse import (
    Inverted,
    damped_step,
    errors_and_jacobian,
    sampled_configurations,
    shifted_into,
)
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

_ROUNDS = 12
"""Maximum number of Newton iterations. The derivatives are those of the chain alone; effects and network change them by
a thousandth, so that close to the solution each iteration gains three decades."""
_SAME = 1e-10
"""Residual [m, rad] at which a target's iteration ends: far below any controller's resolution."""
_REACHED = 5e-10
"""Largest residual [m, rad] of a target that counts as reached."""
_EFFECT_ROUNDS = 8
"""Fixed-point iterations for the effects' joint offsets; each contracts by the offsets' slope, about 1e-3."""
_SAME_RAD = 1e-12
"""Joint change [rad] at which that iteration ends: far below any controller's resolution."""
_SETTLED_RAD = 1e-8
"""Joint change [rad] up to which it counts as ended: less than any controller's resolution."""
_FREE_DAMPING = 1e-12
"""Damping [m^2] of a step to a position with free rotation: far below the squared lever arms."""
STEP_BACK_RAD = float(np.radians(1.0))
"""Step back of a joint that must arrive from a side [rad]: well beyond any backlash, short enough to stay clear."""
_SHIFTED_M = 1e-8
"""Shift of the SMR [m] by a change of approach above which the joints correct it: a hundredth of the allowed error."""


def invert(
    arm: ArmModel, position_M: Array, rotation_M: Array, start: Array, conditions: MeasurementConditions | None = None
) -> Inverted:
    """Find controller readings at which the model puts the SMR at ``position_M`` and the flange in ``rotation_M``.

    Parameters
    ----------
    arm : ArmModel
    position_M : array, shape (n, 3)
        SMR centre in the tracker frame [m].
    rotation_M : array, shape (n, 3, 3)
        Flange rotation; NaN if it is free: then the joints move as little as possible.
    start : array, shape (n, N)
        Initial readings [rad]; they select the branch.
    conditions : MeasurementConditions, optional
        Conditions of the n targets. Without approach signs, backlash is taken at its middle.

    Notes
    -----
    Newton iteration on the whole model, with the Jacobian of its chain at the true joint positions. The flange rotates
    by the effects' joint offsets and, if the arm was calibrated with orientations, also with elastic links and base.
    Otherwise effects that shift the SMR change only its position, as a network of positions does.
    """
    n = len(start)
    conditions = MeasurementConditions() if conditions is None else conditions
    free = np.isnan(rotation_M[:, 0, 0])
    wanted = np.where(free[:, None, None], np.eye(3), rotation_M)
    q, best = start.copy(), start.copy()
    error = np.full((n, 6), np.inf)
    active = np.arange(n)
    for rounds in reversed(range(_ROUNDS + 1)):
        errors, J = _errors(arm, position_M[active], wanted[active], q[active], conditions.take(active))
        errors[free[active], 3:] = 0.0
        better = np.abs(errors).max(axis=1) < np.abs(error[active]).max(axis=1)
        best[active[better]], error[active[better]] = q[active[better]], errors[better]
        going = ~(np.abs(errors).max(axis=1) < _SAME)
        active, errors, J = active[going], errors[going], J[going]
        if not (rounds and len(active)):
            break
        q[active] += _step(J, errors, free[active])
    rotated = np.where(free, np.nan, np.linalg.norm(error[:, 3:], axis=1))
    return Inverted(best, np.linalg.norm(error[:, :3], axis=1), rotated, _REACHED)


def without_effects(arm: ArmModel, true: Array, conditions: MeasurementConditions) -> Array:
    """Return controller readings (n, N) [rad] that put the real joints at ``true`` (n, N) under ``conditions``.

    Fixed-point iteration, as the effects' offsets depend on the configuration. Raise ``NotConverged`` if it does not
    settle.
    """
    q = true
    for _ in range(_EFFECT_ROUNDS):
        before, q = q, true - (arm.true_joints(q, conditions) - q)
        changed = np.max(np.abs(q - before), initial=0.0)
        if changed < _SAME_RAD:
            break
    if not changed < _SETTLED_RAD:
        raise NotConverged.of("inverse of an arm's effects", f"joints still change by {changed:.1e} rad")
    return q


def with_approach(arm: ArmModel, command: Array, here: Array, conditions: MeasurementConditions | None = None) -> Array:
    """Correct a compensated command (N,) [rad] for the motions by which its joints arrive from ``here`` (N,).

    ``conditions``, of one row, are those that the command was computed for; if None, the middle of both sides.
    """
    made = MeasurementConditions() if conditions is None else conditions
    step = (command - here)[None]
    driven = replace(made, approach=np.sign(step), step=step)
    true = arm.true_joints(command[None], conditions=made)
    q = without_effects(arm, true, driven)
    wanted = arm.predict(command[None], conditions=made)
    if np.linalg.norm(arm.predict(q, conditions=driven) - wanted) > _SHIFTED_M:
        found = invert(arm, wanted, arm.flange(command[None], made)[0], q, driven)
        q = found.q if found.reached[0] else q
    return np.asarray(q[0])


# -- inside -----------------------------------------------------------------------------------------------------------


def _errors(
    arm: ArmModel, position_M: Array, rotation_M: Array, q: Array, conditions: MeasurementConditions
) -> tuple[Array, Array]:
    """Return errors (n, 6) [m, rad] of the model's pose at ``q`` (n, N), and the Jacobian (n, 6, N) of its chain."""
    aim, true = position_M, q
    if arm.effects:
        moved = arm.effect_displacement(q, conditions=conditions)
        aim, true = aim - moved.shift_M, q + moved.joints
    if arm.rotates_flange and arm.geometry.probe is not None:
        rotation_M = arm.rotations(q, conditions).swapaxes(1, 2) @ rotation_M
    if arm.network is not None:
        aim = aim - arm.network.correct(q) @ arm.geometry.T_M_B()[:3, :3].T
    return errors_and_jacobian(arm.geometry, aim, rotation_M, true)


def _step(J: Array, errors: Array, free: NDArray[np.bool_]) -> Array:
    """Return the step (n, N) [rad]: damped least squares to poses, least motion to positions with free rotation."""
    step = np.empty((len(J), J.shape[2]))
    if not free.all():
        step[~free] = damped_step(J[~free], errors[~free])
    if free.any():
        J_p = J[free, :3]
        A = J_p @ J_p.transpose(0, 2, 1) + _FREE_DAMPING * np.eye(3)
        step[free] = np.einsum("nij,ni->nj", J_p, np.linalg.solve(A, errors[free, :3, None])[:, :, 0])
    return step


# -- Choose the inverse solution to command: within limits, accepted by the gate, visible if possible, near home ------
#
# The solutions of both arms of a cooperative target are chosen together: the gate judges both arms at their positions,
# with the other arms at home.


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
        name: Inverted(np.full(q.shape, np.nan), np.full(n, np.inf), np.full(n, np.inf), _REACHED)
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
