"""Plan one path: the branch of the arm, its joint path and timing, and all checks before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, refuse_motion, refuse_path, visible
from cellapp.cell.targets.goals import goals_of_arm
from cellapp.cell.targets.path_file import PathSpec
from cellapp.cell.targets.path_records import PathRecord, PathReversal
from cellapp.cell.targets.targets import WorkingConditions
from cellapp.cell.targets.working_conditions import load_centers
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.nominal import joint_rates
from cellapp.robot.paths.cartesian import CartesianPath, cartesian_path
from cellapp.robot.paths.joint_path import (
    Branch,
    Conditions,
    JointPath,
    PathError,
    Rates,
    Trajectory,
    follow_branches,
    joint_path,
    timed,
)

RUN_UP_RAD = 5e-3
"""Run-up of every joint before the path [rad], in its direction of motion there: several times a usual backlash."""
_CROSS_SHARE = 0.2
"""Fraction of a joint's acceleration used for crossing its backlash."""
_SEEN_EVERY_M = 0.02
_UNCERTAIN_AT = 50
"""Number of positions along a path at which the model's uncertainty is evaluated: it changes slowly."""


@dataclass(frozen=True, eq=False)
class PathPlan:
    """Path that can be driven, or the reason why it cannot.

    Attributes
    ----------
    spec : PathSpec
    refusal : str
        Why it is not driven, with the position; empty if it may be.
    path, nominal_path : CartesianPath or None
        Paths in M, relative to the calibrated and to the nominal base.
    joints : JointPath or None
    trajectory, nominal : Trajectory or None
        Positions for the controller; ``nominal`` from the published geometry, None if that cannot follow the path.
    run_up : array, shape (N,), or None
        Position of the arm before the beginning [rad].
    unseen_m : float or None
        First arc length at which the tracker does not see the SMR [m]; None if it sees the whole path.
    """

    spec: PathSpec
    refusal: str
    path: CartesianPath | None = None
    nominal_path: CartesianPath | None = None
    joints: JointPath | None = None
    trajectory: Trajectory | None = None
    nominal: Trajectory | None = None
    run_up: Array | None = None
    unseen_m: float | None = None


def plan_path(profile: Profile, model: CellModel, spec: PathSpec, period_s: float) -> PathPlan:
    """Plan one path with the other arms at home. Nothing moves. A path that cannot be driven has a reason.

    ``period_s`` is that of the arm's controller [s]. Raise ``InputError`` if the profile lacks what planning needs, or
    the model is of other arms.
    """
    if set(model.arms) != set(profile.arms):
        known, asked = ", ".join(model.arms), ", ".join(profile.arms)
        raise InputError(f"the calibration is of arms {known}, the profile of arms {asked}; calibrate this run again")
    homes = home_positions(profile)
    if missing := [name for name in profile.arms if name not in homes]:
        raise InputError(f"profile {profile.name}: arms.{missing[0]}.home is needed: a path begins and ends there")
    arm, cell = model.arms[spec.arm], cell_bodies(profile, model)
    path, nominal_path = paths_of(model, spec)
    limits = cell.arms[spec.arm].limits
    branches = follow_branches(arm.geometry, path, limits, homes[spec.arm], profile.seed)
    if not branches:
        return PathPlan(spec, "its beginning, at 0 mm, is out of reach", path, nominal_path)
    if branches[0].failure:
        return PathPlan(spec, _placed(branches[0].failure, branches[0].failed_m), path, nominal_path)
    refusals = []
    for branch in branches:
        if branch.failure:
            break
        plan = _on_branch(profile, cell, homes, arm, spec, path, branch, period_s)
        if not plan.refusal:
            nominal = _nominal(profile, arm, spec, nominal_path, branch, period_s, cell, homes)
            return replace(plan, nominal_path=nominal_path, nominal=nominal)
        refusals.append(plan.refusal)
    return PathPlan(spec, refusals[0], path, nominal_path)


def paths_of(model: CellModel, spec: PathSpec) -> tuple[CartesianPath, CartesianPath]:
    """Return the wanted path in M relative to the calibrated bases, and relative to the nominal ones."""
    goals = goals_of_arm(model, spec.targets(), spec.arm)
    names = [target.name for target in spec.targets()]
    poses = [k for k, name in enumerate(names) if name.startswith("pose")]
    vias = [k - 1 if pose.via is not None else None for k, pose in zip(poses[1:], spec.poses[1:], strict=True)]
    speeds = np.array([pose.speed or spec.speed for pose in spec.poses[1:]])
    blends = [pose.blend for pose in spec.poses]
    first, second = (
        cartesian_path(
            position[poses], rotation[poses], [None if k is None else position[k] for k in vias], blends, speeds
        )
        for position, rotation in (
            (goals.position_M, goals.rotation_M),
            (goals.nominal_position_M, goals.nominal_rotation_M),
        )
    )
    return first, second


def path_record(model: CellModel, plan: PathPlan) -> PathRecord:
    """Return a planned path as a record of the result."""
    spec, trajectory, joints = plan.spec, plan.trajectory, plan.joints
    head = PathRecord(
        name=spec.name,
        arm=spec.arm,
        frame=spec.frame,
        tolerance_mm=spec.tolerance * 1e3,
        refusal=plan.refusal,
        length_mm=None if plan.path is None else plan.path.length * 1e3,
    )
    if trajectory is None or joints is None:
        return head
    rows = np.linspace(0, len(trajectory.q) - 1, _UNCERTAIN_AT).astype(int)
    uncertainty_mm = float(model.arms[spec.arm].uncertainty(trajectory.q[rows]).max()) * 1e3
    return head.model_copy(
        update={
            "duration_s": trajectory.duration_s,
            "period_ms": trajectory.period_s * 1e3,
            "samples": len(trajectory.q),
            "deviation_mm": joints.deviation_m * 1e3,
            "deviation_at_mm": joints.deviation_at_m * 1e3,
            "uncertainty_mm": uncertainty_mm or None,
            "at_speed": trajectory.at_speed,
            "slowed": trajectory.slowed,
            "reversals": tuple(
                PathReversal(
                    joint=one.joint, at_mm=one.at_m * 1e3, jump_mm=one.jump_m * 1e3, window_mm=one.window_m * 1e3
                )
                for one in sorted(joints.reversals, key=lambda one: one.at_m)
            ),
        }
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _on_branch(
    profile: Profile,
    cell: CellBodies,
    homes: Mapping[str, Array],
    arm: ArmModel,
    spec: PathSpec,
    path: CartesianPath,
    branch: Branch,
    period_s: float,
) -> PathPlan:
    """Return the plan on one branch of the inverse kinematics."""
    rates = _rates(profile, spec)
    cross_s = float(np.sqrt(5.774 / (_CROSS_SHARE * rates.acceleration.min())))
    try:
        joints = joint_path(arm, path, branch, _conditions(profile, spec), spec.tolerance, cross_s)
        trajectory = timed(path, joints, rates, period_s)
    except PathError as error:
        return PathPlan(spec, _placed(str(error), error.at_m), path)
    if joints.deviation_m > spec.tolerance:
        place = _placed(f"{joints.deviation_m * 1e3:.3f} mm off by the model", joints.deviation_at_m)
        return PathPlan(spec, place, path)
    run_up = np.clip(trajectory.q[0] - RUN_UP_RAD * joints.stretches[0].signs, *cell.arms[spec.arm].limits.T)
    others = {name: q for name, q in homes.items() if name != spec.arm}
    if refusal := refuse_path(cell, spec.arm, trajectory.q, others, trajectory.s):
        return PathPlan(spec, refusal, path)
    ways = ((homes[spec.arm], run_up), (run_up, trajectory.q[0]), (trajectory.q[-1], homes[spec.arm]))
    for start, end in ways:
        if refusal := refuse_motion(cell, {**others, spec.arm: start}, {**others, spec.arm: end}):
            return PathPlan(spec, f"on the way between home and the path: {refusal}", path)
    unseen = _unseen(cell, spec.arm, trajectory, others)
    return PathPlan(spec, "", path, joints=joints, trajectory=trajectory, run_up=run_up, unseen_m=unseen)


def _nominal(
    profile: Profile,
    arm: ArmModel,
    spec: PathSpec,
    path: CartesianPath,
    branch: Branch,
    period_s: float,
    cell: CellBodies,
    homes: Mapping[str, Array],
) -> Trajectory | None:
    """Return the path as the published geometry drives it on the same branch; None if it cannot be driven."""
    published = replace(arm, geometry=arm.nominal, effects=(), network=None, posterior=None)
    share = branch.s / branch.s[-1] * path.length  # both paths have the same shape
    try:
        joints = joint_path(
            published, path, Branch(share, branch.q), _conditions(profile, spec), spec.tolerance, cross_s=0.0
        )
        trajectory = timed(path, joints, _rates(profile, spec), period_s)
    except PathError:
        return None
    others = {name: q for name, q in homes.items() if name != spec.arm}
    return None if refuse_path(cell, spec.arm, trajectory.q, others, trajectory.s) else trajectory


def _rates(profile: Profile, spec: PathSpec) -> Rates:
    """Return the limits of the arm's joints at the profile's share, and the path's own acceleration."""
    return Rates(*joint_rates(profile.arms[spec.arm]), spec.acceleration)


def _conditions(profile: Profile, spec: PathSpec) -> Conditions:
    """Return conditions along the path: as stated, else the profile's payload; a moving arm has no rest."""
    stated: WorkingConditions = spec.conditions
    payload = profile.arms[spec.arm].payload.mass if stated.payload is None else stated.payload
    center_F = load_centers(profile.arms[spec.arm], [payload])

    def of(approach: Array) -> MeasurementConditions:
        n = len(approach)
        temperature = stated.temperature
        return MeasurementConditions(
            approach=approach,
            payload_kg=np.full(n, payload),
            payload_center_F=None if center_F is None else np.tile(center_F, (n, 1)),
            time_s=None if stated.time is None else np.full(n, stated.time),
            air_c=None if temperature is None else np.full(n, temperature),
            joints_c=None if temperature is None else np.full(approach.shape, temperature),
        )

    return of


def _unseen(cell: CellBodies, name: str, trajectory: Trajectory, others: Mapping[str, Array]) -> float | None:
    """Return the first arc length [m] where the tracker does not see the SMR; None if it sees the whole path."""
    count = max(2, int(np.ceil(trajectory.s[-1] / _SEEN_EVERY_M)) + 1)
    rows = np.unique(np.searchsorted(trajectory.s, np.linspace(0.0, trajectory.s[-1], count)))
    rows = np.clip(rows, 0, len(trajectory.s) - 1)
    seen = visible(cell, name, trajectory.q[rows], {other: np.tile(q, (len(rows), 1)) for other, q in others.items()})
    return None if seen.all() else float(trajectory.s[rows[int(np.argmin(seen))]])


def _placed(reason: str, at_m: float) -> str:
    return f"at {at_m * 1e3:.0f} mm: {reason}"
