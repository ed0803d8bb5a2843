"""Compensation: joint positions that bring the real arms to Cartesian targets, by inverting the calibrated model.

Every target gets two commands: one from the published geometry, as an uncalibrated program would send it, and the
compensated one. Of all inverse solutions the nearest to home is taken that the tracker sees and that is safe.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.compensation.goals import goals_of_arm
from cellapp.compensation.targets import Target
from cellapp.compensation.tolerance import predicted_verdict
from cellapp.errors import InputError
from cellapp.kinematics.inverse import solve_pose
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel, CellModel
from cellapp.profile import Profile
from cellapp.results import CompensateResult, TargetCommand
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from cellapp.safety.gate import CellBodies, refuse_stop, visible

_STARTS = 48
"""Random starts of the inverse for each target: a six-joint arm has at most 16 solutions, and each is met often."""
_EFFECT_ROUNDS = 8
"""Fixed-point rounds for the effects' joint offsets; they contract by the offsets' slope, about 1e-3 a round."""
_SAME_RAD = 1e-12
"""Joint change at which that iteration ends: far below any controller's resolution."""
_AIMING_ROUNDS = 5
"""Rounds of correcting the target for what the residual network adds; its slope makes each gain two decades."""
_TIE_DECIMALS = 6
"""Motions that agree to 1 urad are equal: a solution of the inverse is not known better."""
_SAME_M = 3e-10
"""Position error at which that iteration ends: far below the tracker's noise."""


@dataclass(frozen=True)
class Command:
    """The joint positions to send for one target.

    Attributes
    ----------
    target : Target
    arm : str
        The arm; a cooperative target has one command for each of its arms.
    q_nominal, q_compensated : array, shape (N,), or None
        Joint positions [rad] by the published and by the calibrated model; None where the target was refused.
    expected_M, nominal_M : array, shape (3,), or None
        Where the SMR should be measured [m]: the target relative to the calibrated and to the nominal base.
    refusal : str
        Why the target is not commanded; empty if it is.
    uncertainty_mm : float or None
        Standard uncertainty [mm] of a coordinate of the SMR at the compensated command; None where the target was
        refused or the model states none.
    within_mm : float or None
        Distance from the target that a measurement keeps with 95 % probability; None where it is not known.
    visible : bool or None
        Whether the tracker sees the SMR there; None where it is not known.
    approach : signs or None
        Sign of each joint's last motion for which the command was made; None: at the middle of both sides.
    """

    target: Target
    arm: str
    q_nominal: Array | None
    q_compensated: Array | None
    expected_M: Array | None
    nominal_M: Array | None
    refusal: str
    uncertainty_mm: float | None = None
    within_mm: float | None = None
    visible: bool | None = None
    approach: tuple[int, ...] | None = None


def compensate(profile: Profile, model: CellModel, targets: Sequence[Target]) -> tuple[Command, ...]:
    """Commands for all targets, in their order; targets out of reach, out of sight or unsafe carry the reason.

    Raises
    ------
    InputError
        If the profile does not say where arms and tracker stand, or the model is of other arms.
    """
    if set(model.arms) != set(profile.arms):
        known, asked = ", ".join(model.arms), ", ".join(profile.arms)
        raise InputError(f"the calibration is of arms {known}, the profile of arms {asked}; calibrate this run again")
    for name, arm in profile.arms.items():
        if arm.home is None:
            raise InputError(f"profile {profile.name}: arms.{name}.home is needed: an arm waits there for the others")
    commands: dict[str, Command] = {}
    for name in profile.arms:
        of_arm = [target for target in targets if target.arm == name]
        if of_arm:
            for command in _compensate_arm(profile, model, name, of_arm):
                commands[command.target.name] = command
    return tuple(commands[target.name] for target in targets)


def invert_model(arm: ArmModel, position_M: Array, rotation_M: Array, start: Array) -> tuple[Array, np.ndarray]:
    """Controller readings (n, N) [rad] at which the model puts the SMR at its targets, and which of them it reached.

    Positions (n, 3) [m] and flange rotations (n, 3, 3) are in the tracker frame. The joint offsets of effects are
    removed by ``without_effects``. What the model adds to the chain's position (a residual network) is compensated by
    shifting the target. The approach direction is not known here; backlash is taken at its middle.
    """
    aim, here = position_M, start
    for _ in range(_AIMING_ROUNDS):
        true = solve_pose(arm.geometry, aim, rotation_M, here)
        q = without_effects(arm, true.q, np.zeros(start.shape))
        off = np.where(true.reached[:, None], position_M - arm.predict(q), 0.0)
        if np.max(np.abs(off), initial=0.0) < _SAME_M:
            break
        aim, here = aim + off, true.q
    return q, true.reached


def without_effects(arm: ArmModel, true: Array, approach: Array) -> Array:
    """Controller readings (n, N) [rad] that put the real joints at ``true`` (n, N), approached from ``approach``.

    Fixed-point iteration, as the effects' offset depends on the configuration itself.
    """
    q = true
    for _ in range(_EFFECT_ROUNDS):
        before, q = q, true - (arm.true_joints(q, approach) - q)
        if np.max(np.abs(q - before), initial=0.0) < _SAME_RAD:
            break
    return q


def with_approach(arm: ArmModel, command: Array, here: Array) -> Array:
    """A compensated command (N,) corrected for the direction in which each joint approaches it from ``here`` (N,)."""
    true = arm.true_joints(command[None])
    return np.asarray(without_effects(arm, true, np.sign(command - here)[None])[0])


def compensate_result(commands: Sequence[Command], notes: Sequence[str] = ()) -> CompensateResult:
    """The object that ``compensate --json`` writes and that the run file keeps."""
    return CompensateResult(
        targets=tuple(
            TargetCommand(
                name=command.target.name,
                arm=command.arm,
                frame=command.target.frame,
                position=command.target.position,
                rpy=command.target.rpy,
                tolerance_mm=command.target.tolerance_mm,
                refusal=command.refusal,
                q_nominal=None if command.q_nominal is None else tuple(command.q_nominal.tolist()),
                q_compensated=None if command.q_compensated is None else tuple(command.q_compensated.tolist()),
                uncertainty_mm=command.uncertainty_mm,
                verdict=""
                if command.refusal
                else predicted_verdict(command.uncertainty_mm, command.target.tolerance_mm),
            )
            for command in commands
        ),
        notes=tuple(notes),
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _compensate_arm(profile: Profile, model: CellModel, name: str, targets: Sequence[Target]) -> list[Command]:
    arm = model.arms[name]
    goals = goals_of_arm(model, targets, name)
    nominal_M, expected_M = goals.nominal_position_M, goals.position_M
    cell = cell_bodies(profile, model)
    homes = home_positions(profile)
    solutions = _nominal_solutions(profile, arm, cell.arms[name].limits, nominal_M, goals.nominal_rotation_M)
    commands = []
    for k, target in enumerate(targets):
        nearest_first = _nearest_first(solutions[k], homes[name])
        command = Command(target, name, None, None, None, None, "out of reach")
        for q in solutions[k][nearest_first]:
            q_compensated, refusal = _compensated(cell, homes, name, arm, expected_M[k], goals.rotation_M[k], q)
            if not refusal:
                command = Command(target, name, q, q_compensated, expected_M[k], nominal_M[k], "")
                command = replace(command, uncertainty_mm=_uncertainty_mm(arm, q_compensated))
                break
            command = Command(target, name, None, None, None, None, refusal)
        commands.append(command)
    return commands


def _uncertainty_mm(arm: ArmModel, q: Array) -> float | None:
    """Standard uncertainty [mm] of a predicted coordinate at ``q`` (N,); None where the model states none."""
    return float(arm.uncertainty(q[None])[0]) * 1e3 or None


def _nearest_first(solutions: Array, home: Array) -> np.ndarray:
    """Order of solutions (m, N) [rad]: the smallest largest joint motion from ``home`` (N,) first, then the least sum.

    Mirrored branches often tie in the largest motion; rounding keeps rounding errors from choosing among them.
    """
    motion = np.abs(solutions - home)
    return np.lexsort((motion.sum(axis=1).round(_TIE_DECIMALS), motion.max(axis=1).round(_TIE_DECIMALS)))


def _nominal_solutions(
    profile: Profile, arm: ArmModel, limits: Array, position_M: Array, rotation_M: Array
) -> list[Array]:
    """Inverse solutions (k, N) [rad] of the published geometry within the joint limits, for each of n targets."""
    rng = np.random.default_rng([profile.seed, 0x7A6])
    middle = np.clip(0.0, limits[:, 0] + np.pi, limits[:, 1] - np.pi)  # one turn of each joint, or what it has of it
    low, high = np.maximum(limits[:, 0], middle - np.pi), np.minimum(limits[:, 1], middle + np.pi)
    starts = rng.uniform(low, high, size=(_STARTS, len(low)))
    n = len(position_M)
    target = np.repeat(np.arange(n), _STARTS)
    solved = solve_pose(arm.nominal, position_M[target], rotation_M[target], np.tile(starts, (n, 1)))
    q = _into_limits(solved.q, limits)
    good = solved.reached & np.all((q >= limits[:, 0]) & (q <= limits[:, 1]), axis=1)
    return [q[(target == k) & good] for k in range(n)]


def _compensated(
    cell: CellBodies,
    homes: dict[str, Array],
    name: str,
    arm: ArmModel,
    position_M: Array,
    rotation_M: Array,
    q: Array,
) -> tuple[Array, str]:
    """The compensated command (N,) near the nominal solution ``q`` (N,), and why it is refused (empty if it is not)."""
    others = {other: home for other, home in homes.items() if other != name}
    if not visible(cell, name, q[None], {other: home[None] for other, home in others.items()})[0]:
        return q, "the tracker does not see it"
    if refusal := refuse_stop(cell, {**others, name: q}):
        return q, refusal
    q_compensated, reached = invert_model(arm, position_M[None], rotation_M[None], q[None])
    if not reached[0]:
        return q, "the calibrated model does not reach it"
    return q_compensated[0], refuse_stop(cell, {**others, name: q_compensated[0]})


def _into_limits(q: Array, limits: Array) -> Array:
    """The same configurations (n, N) with every joint moved by whole turns into its limits where that is possible."""
    turns = np.ceil((limits[:, 0] - q) / (2.0 * np.pi))
    low = q + 2.0 * np.pi * turns
    near = np.asarray(q - 2.0 * np.pi * np.round(q / (2.0 * np.pi)), dtype=np.float64)
    return np.asarray(np.where((near >= limits[:, 0]) & (near <= limits[:, 1]), near, low))
