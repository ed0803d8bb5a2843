"""Invert a calibrated model: find joint positions at which geometry, effects and network together meet a target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellapp.ground.errors import NotConverged
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.inverse import Inverted, errors_and_jacobian, newton
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.model import ArmModel

_ROUNDS = 13
"""Maximum number of Newton iterates. The derivatives are those of the chain alone; effects and network change them by
a thousandth, so that close to the solution each iteration gains three decades."""
_SAME = 1e-10
"""Residual [m, rad] at which a target's iteration ends: far below any controller's resolution."""
REACHED = 5e-10
"""Largest residual [m, rad] of a target that counts as reached."""
_EFFECT_ROUNDS = 8
"""Fixed-point iterations for the effects' joint offsets; each contracts by the offsets' slope, about 1e-3."""
_SAME_RAD = 1e-12
"""Joint change [rad] at which that iteration ends: far below any controller's resolution."""
_SETTLED_RAD = 1e-8
"""Joint change [rad] up to which it counts as ended: less than any controller's resolution."""
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
    conditions = MeasurementConditions() if conditions is None else conditions
    free = np.isnan(rotation_M[:, 0, 0])
    wanted = np.where(free[:, None, None], np.eye(3), rotation_M)

    def errors(rows: NDArray[np.intp], q: Array) -> tuple[Array, Array]:
        return _errors(arm, position_M[rows], wanted[rows], q, conditions.take(rows))

    return newton(errors, start, free, rounds=_ROUNDS, same=_SAME, within=REACHED)


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
