"""Invert a calibrated model: find joint positions at which geometry, effects and network together meet a target."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.ground.errors import NotConverged
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.inverse import damped_step, errors_and_jacobian
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
_SHIFTED_M = 1e-8
"""Shift of the SMR [m] by a change of approach above which the joints correct it: a hundredth of the allowed error."""


@dataclass(frozen=True, eq=False)
class Inverted:
    """Commands for n targets.

    Attributes
    ----------
    q : array, shape (n, N)
        Joint positions as the controller reports them [rad].
    residual_m, residual_rad : array, shape (n,)
        Distance and angle by which the model misses the targets there; the angle is NaN if the rotation is free.
    """

    q: Array
    residual_m: Array
    residual_rad: Array

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Mask (n,) of targets that are reached."""
        return (self.residual_m < _REACHED) & ~(self.residual_rad >= _REACHED)

    def take(self, rows: NDArray[np.intp]) -> Inverted:
        """Return the commands of some rows."""
        return Inverted(self.q[rows], self.residual_m[rows], self.residual_rad[rows])

    def put(self, rows: NDArray[np.intp], of: Inverted, kept: NDArray[np.bool_]) -> None:
        """Replace the commands of ``rows`` by the ``kept`` ones of ``of``."""
        self.q[rows], self.residual_m[rows], self.residual_rad[rows] = (
            of.q[kept],
            of.residual_m[kept],
            of.residual_rad[kept],
        )


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
    Otherwise effects that shift the SMR change only its position, as the network does.
    """
    n = len(start)
    conditions = MeasurementConditions() if conditions is None else conditions
    free = np.isnan(rotation_M[:, 0, 0])
    wanted = np.where(free[:, None, None], np.eye(3), rotation_M)
    q, best = start.copy(), start.copy()
    error = np.full((n, 6), np.inf)
    active = np.arange(n)
    for left in reversed(range(_ROUNDS + 1)):
        errors, J = _errors(arm, position_M[active], wanted[active], q[active], conditions.take(active))
        errors[free[active], 3:] = 0.0
        better = np.abs(errors).max(axis=1) < np.abs(error[active]).max(axis=1)
        best[active[better]], error[active[better]] = q[active[better]], errors[better]
        going = ~(np.abs(errors).max(axis=1) < _SAME)
        active, errors, J = active[going], errors[going], J[going]
        if not (left and len(active)):
            break
        q[active] += _step(J, errors, free[active])
    turned = np.where(free, np.nan, np.linalg.norm(error[:, 3:], axis=1))
    return Inverted(best, np.linalg.norm(error[:, :3], axis=1), turned)


def invert_model(arm: ArmModel, position_M: Array, rotation_M: Array, start: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the controller readings (n, N) [rad] of ``invert``, and the mask (n,) of reached targets."""
    found = invert(arm, position_M, rotation_M, start)
    return found.q, found.reached


def without_effects(
    arm: ArmModel,
    true: Array,
    approach: Array | None = None,
    conditions: MeasurementConditions | None = None,
) -> Array:
    """Return controller readings (n, N) [rad] that put the real joints at ``true`` (n, N), arriving as ``approach``.

    ``conditions`` replaces ``approach``. Fixed-point iteration, as the effects' offsets depend on the configuration.
    Raise ``NotConverged`` if it does not settle.
    """
    q = true
    for _ in range(_EFFECT_ROUNDS):
        before, q = q, true - (arm.true_joints(q, approach, conditions=conditions) - q)
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
    q = without_effects(arm, true, conditions=driven)
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
        if arm.geometry.probe is not None:
            rotation_M = arm.turns(q, conditions).swapaxes(1, 2) @ rotation_M
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
