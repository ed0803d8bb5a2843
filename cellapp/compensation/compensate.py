"""The verb: joint positions that bring the real arm to its targets, by inverting the full calibrated model.

For every target two commands are computed: the one an uncalibrated program would use (published geometry) and the
compensated one. Of the ways to reach a target the first is taken that the tracker sees and that is safe to stand at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.compensation.targets import Target
from cellapp.errors import InputError
from cellapp.kinematics.inverse import solve_pose
from cellapp.kinematics.transforms import Array, rotation_zyx
from cellapp.model import ArmModel, CellModel
from cellapp.profile import Profile
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from cellapp.safety.gate import refuse_stop, visible

_STARTS = 48
_EFFECT_ROUNDS = 8
_SAME_RAD = 1e-12
_AIMING_ROUNDS = 5
_SAME_M = 3e-10


@dataclass(frozen=True)
class Command:
    """What to send for one target.

    Attributes
    ----------
    target : Target
    q_nominal, q_compensated : array, shape (N,), or None
        Joint positions [rad] by the published and by the calibrated model; None where the target was refused.
    expected_M, nominal_M : array, shape (3,), or None
        Where the SMR should be measured [m]: the target seen from the calibrated and from the nominal base.
    refusal : str
        Why it is not commanded; empty if it is.
    """

    target: Target
    q_nominal: Array | None
    q_compensated: Array | None
    expected_M: Array | None
    nominal_M: Array | None
    refusal: str


def compensate(profile: Profile, model: CellModel, targets: Sequence[Target]) -> tuple[Command, ...]:
    """Commands for all targets, in their order; targets out of reach, out of sight or unsafe carry the reason.

    Raises
    ------
    InputError
        If the profile does not say where arms and tracker stand, or the model is of other arms.
    """
    if set(model.arms) != set(profile.arms):
        known, asked = ", ".join(model.arms), ", ".join(profile.arms)
        raise InputError(f"the calibration is of arms {known}, the profile of arms {asked}; calibrate this run anew")
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
    """Controller readings (n, N) [rad] at which the calibrated model puts the SMR at its targets, and which it reached.

    Positions (n, 3) [m] and flange rotations (n, 3, 3) are in the tracker frame. Effects move the joints away from what
    the controller reads (``without_effects``); what the model adds to the chain's position, a residual network, is
    aimed off for. The side from which joints will arrive is not known here; backlash is taken in the middle.
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
    """Controller readings (n, N) [rad] at which the joints really stand at ``true`` (n, N), arriving from ``approach``.

    The effects' offset is subtracted and, as it depends on the posture, found again until it rests.
    """
    q = true
    for _ in range(_EFFECT_ROUNDS):
        before, q = q, true - (arm.true_joints(q, approach) - q)
        if np.max(np.abs(q - before), initial=0.0) < _SAME_RAD:
            break
    return q


def arriving(arm: ArmModel, command: Array, here: Array) -> Array:
    """A compensated command (N,) made good for the side from which each joint will arrive from ``here`` (N,)."""
    true = arm.true_joints(command[None])
    return without_effects(arm, true, np.sign(command - here)[None])[0]


def _compensate_arm(profile: Profile, model: CellModel, name: str, targets: Sequence[Target]) -> list[Command]:
    arm = model.arms[name]
    position_B = np.array([target.position for target in targets])
    rotation_B = np.array([rotation_zyx(target.rpy[2], target.rpy[1], target.rpy[0]) for target in targets])
    T_nominal, T_calibrated = arm.nominal.T_M_B(), arm.geometry.T_M_B()
    nominal_M = position_B @ T_nominal[:3, :3].T + T_nominal[:3, 3]
    expected_M = position_B @ T_calibrated[:3, :3].T + T_calibrated[:3, 3]

    cell = cell_bodies(profile, model)
    limits = cell.arms[name].limits
    rng = np.random.default_rng([profile.seed, 0x7A6])
    middle = np.clip(0.0, limits[:, 0] + np.pi, limits[:, 1] - np.pi)  # one turn of each joint, or what it has of it
    low, high = np.maximum(limits[:, 0], middle - np.pi), np.minimum(limits[:, 1], middle + np.pi)
    starts = rng.uniform(low, high, size=(_STARTS, len(low)))
    n = len(targets)
    every = np.repeat(np.arange(n), _STARTS)
    solved = solve_pose(arm.nominal, nominal_M[every], (T_nominal[:3, :3] @ rotation_B)[every], np.tile(starts, (n, 1)))
    q_all = _into_limits(solved.q, limits)
    homes = home_positions(profile)
    others = {other: q for other, q in homes.items() if other != name}
    commands = []
    for k, target in enumerate(targets):
        ways = q_all[(every == k) & solved.reached]
        ways = ways[np.all((ways >= limits[:, 0]) & (ways <= limits[:, 1]), axis=1)]
        command = Command(target, None, None, None, None, "out of reach")
        for q in ways[np.argsort(np.abs(ways - homes[name]).max(axis=1), kind="stable")]:
            seen = visible(cell, name, q[None], {other: value[None] for other, value in others.items()})[0]
            refusal = "the tracker does not see it" if not seen else refuse_stop(cell, {**others, name: q})
            if not refusal:
                q_compensated, reached = invert_model(
                    arm, expected_M[k : k + 1], T_calibrated[None, :3, :3] @ rotation_B[k : k + 1], q[None]
                )
                if reached[0]:
                    refusal = refuse_stop(cell, {**others, name: q_compensated[0]})
                else:
                    refusal = "the calibrated model does not reach it"
                if not refusal:
                    command = Command(target, q, q_compensated[0], expected_M[k], nominal_M[k], "")
                    break
            command = Command(target, None, None, None, None, refusal)
        commands.append(command)
    return commands


def _into_limits(q: Array, limits: Array) -> Array:
    """The same postures with every joint turned by whole turns into its limits where that is possible."""
    turns = np.ceil((limits[:, 0] - q) / (2.0 * np.pi))
    low = q + 2.0 * np.pi * turns
    near = q - 2.0 * np.pi * np.round(q / (2.0 * np.pi))
    return np.where((near >= limits[:, 0]) & (near <= limits[:, 1]), near, low)


def as_dict(commands: Sequence[Command]) -> Mapping[str, object]:
    """The object that ``--json`` writes."""
    return {
        "schema": "cellapp-compensate",
        "version": 1,
        "targets": [
            {
                "name": command.target.name,
                "arm": command.target.arm,
                "refusal": command.refusal,
                "q_nominal": None if command.q_nominal is None else command.q_nominal.tolist(),
                "q_compensated": None if command.q_compensated is None else command.q_compensated.tolist(),
            }
            for command in commands
        ],
    }
