"""Read and check path files (YAML): poses joined by straight lines and arcs, with speeds.

Plan one path: the branch of the arm, its joint path and timing, and all checks before anything moves.

Result of ``compensate`` for a path file: each path as the model drives it.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from cellapp.cell.profile.loader import read_yaml, validated
from cellapp.cell.profile.messages import PlacedError, YamlDocument
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions, require_arms, visible_with_others
from cellapp.cell.safety.gate import CellBodies, refuse_motion, refuse_path
from cellapp.cell.targets.goals import goals_of_arm
from cellapp.cell.targets.ranges import load_centers
from cellapp.cell.targets.target_csv import is_csv
from cellapp.cell.targets.targets import Target, WorkFrame, WorkingConditions
from cellapp.ground.profile import CellPoint, Profile
from cellapp.ground.results import Record, Result
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
from drivers.quantities import Acceleration, Length, Speed, Turn
from drivers.settings import Section

_SCHEMA = "cellapp-paths"
_SHORTEST_M = 1e-4
"""Shortest piece [m]; a shorter one is a mistake, because the tracker cannot distinguish its ends."""
_FASTEST_M_S = 3.0
"""Highest tool speed that a UR controller accepts [m/s]; a plain number above it was meant in mm/s."""
_COLLINEAR = 1e-3
"""Height of an arc relative to its chord below which its three points count as collinear."""


def _speed(value: float) -> float:
    if not 0.0 < value <= _FASTEST_M_S:
        raise ValueError(
            f"expected a speed above 0 and at most {_FASTEST_M_S:g} m/s, got {value:g} m/s; is it '{value:g} mm/s'?"
        )
    return value


PathSpeed = Annotated[Speed, AfterValidator(_speed)]


class PathPose(Section):
    """One pose of a path: SMR position and flange rotation ``rot_z(yaw) rot_y(pitch) rot_x(roll)``.

    Attributes
    ----------
    position : three numbers
        SMR centre [m].
    rpy : three numbers or None
        Roll, pitch, yaw [rad]; None: as at the pose before.
    speed : float or None
        Of the SMR on the way to this pose [m/s]; None: that of the path.
    via : three numbers or None
        A point [m] on the way, which is an arc through it then; None: a straight line.
    blend : float
        Distance [m] before and after this pose over which its corner is rounded; 0: the arm stops at a corner.
    """

    position: CellPoint
    rpy: tuple[Turn, Turn, Turn] | None = None
    speed: PathSpeed | None = None
    via: CellPoint | None = None
    blend: Annotated[Length, Field(ge=0.0, le=1.0)] = 0.0


class PathSpec(Section):
    """One path of one arm; the frames are those of a target list.

    Attributes
    ----------
    tolerance : float
        How far the true SMR may be from the path [m].
    speed, acceleration : float
        Of the SMR along the path, where a pose does not say otherwise [m/s]; its largest acceleration [m/s^2].
    poses : tuple of PathPose
        The first is where the path begins.
    """

    name: Annotated[str, Field(min_length=1)]
    arm: str
    frame: str = "base"
    work_frame: WorkFrame | None = None
    tolerance: Annotated[Length, Field(gt=0.0, le=0.01)]
    speed: PathSpeed
    acceleration: Annotated[Acceleration, Field(gt=0.0, le=10.0)] = 0.5
    conditions: WorkingConditions = WorkingConditions()
    poses: Annotated[tuple[PathPose, ...], Field(min_length=2)]

    @model_validator(mode="after")
    def _poses_make_a_path(self) -> Self:
        _require_path(self.poses)
        if self.work_frame is not None and self.frame != self.work_frame.name:
            raise ValueError(f"frame: '{self.frame}' is not the work frame '{self.work_frame.name}'")
        return self

    def targets(self) -> tuple[Target, ...]:
        """Return poses, each after the point of its arc if it has one, as targets to find in the tracker frame."""
        common: dict[str, Any] = {"arm": self.arm, "frame": self.frame, "work_frame": self.work_frame}
        found, rpy = list[Target](), self.poses[0].rpy
        for pose in self.poses:
            rpy = pose.rpy or rpy
            places = [pose.position] if pose.via is None else [pose.via, pose.position]
            found += [Target(name=self.name, position=place, rpy=rpy, **common) for place in places]
        return tuple(found)


class PathList(Section):
    """A file of paths."""

    schema_: Literal["cellapp-paths"] = Field(alias="schema")  # as _SCHEMA
    version: Literal[1]
    paths: Annotated[tuple[PathSpec, ...], Field(min_length=1)]


def holds_paths(path: Path) -> bool:
    """Return whether a file is a path file: YAML that says so in its key ``schema``."""
    return not is_csv(path) and _document(path).data.get("schema") == _SCHEMA


def load_paths(path: Path, profile: Profile) -> tuple[PathSpec, ...]:
    """Read a path file (YAML). Raise ``InputError`` with the file, the line and the path."""
    document = _document(path)
    listed = validated(PathList, document)
    for index, spec in enumerate(listed.paths):
        if problem := _misfit(spec, listed.paths[:index], profile):
            raise PlacedError(document.places["paths", index], f"path '{spec.name}'{problem}")
    return listed.paths


# -- inside -----------------------------------------------------------------------------------------------------------


def _misfit(spec: PathSpec, others: tuple[PathSpec, ...], profile: Profile) -> str:
    """Return why a path does not fit the cell or the other paths, to follow its name; empty if it does."""
    arms = ", ".join(profile.arms)
    if spec.arm not in profile.arms:
        return f": no arm '{spec.arm}'; arms are {arms}"
    frames = ("base", "tracker", *profile.arms)
    if spec.work_frame is None and spec.frame not in frames:
        return f": no frame '{spec.frame}'; frames are {', '.join(frames)}, or that of 'work_frame'"
    if spec.work_frame is not None and spec.work_frame.parent not in ("tracker", *profile.arms):
        return f": work_frame: no parent '{spec.work_frame.parent}'; parents are tracker, {arms}"
    if any(other.name == spec.name for other in others):
        return " is listed twice; give every path its own name"
    return ""


def _document(path: Path) -> YamlDocument:
    return read_yaml(path, PathList, "give a path file (YAML)")


def _pose_problem(pose: int, text: str) -> ValueError:
    return ValueError(f"poses[{pose}]: {text}")


def _require_path(poses: tuple[PathPose, ...]) -> None:
    """Raise an error placed at the wrong pose if poses do not make a path."""
    first, last = poses[0], len(poses) - 1
    if first.rpy is None:
        raise _pose_problem(0, "'rpy' is needed: a path begins with a full pose")
    if first.via is not None or first.blend or first.speed is not None:
        raise _pose_problem(0, "'via', 'blend' and 'speed' belong to a pose that is reached from another one")
    if poses[last].blend:
        raise _pose_problem(last, "'blend' at the end of a path rounds no corner")
    for number, (before, pose) in enumerate(itertools.pairwise(poses), start=1):
        if problem := _piece_problem(before, pose):
            raise _pose_problem(number, problem)
    lengths = np.linalg.norm(np.diff([pose.position for pose in poses], axis=0), axis=1).tolist()
    for number, pose in enumerate(poses[1:-1], start=1):
        shortest = min(lengths[number - 1], lengths[number])
        if pose.blend > 0.5 * shortest:
            raise _pose_problem(
                number,
                f"blend {pose.blend * 1e3:g} mm is more than half of {shortest * 1e3:.1f} mm, the distance to the next"
                " pose or from the one before",
            )


def _piece_problem(before: PathPose, pose: PathPose) -> str:
    a, b = np.array(before.position), np.array(pose.position)
    chord = float(np.linalg.norm(b - a))
    if pose.via is None:
        return "" if chord >= _SHORTEST_M else f"the way to it is {chord * 1e3:.3f} mm long; at least 0.1 mm are needed"
    via = np.array(pose.via) - a
    longest = max(chord, float(np.linalg.norm(via)))
    if longest < _SHORTEST_M:
        return f"its arc is {longest * 1e3:.3f} mm long; at least 0.1 mm are needed"
    if chord < _SHORTEST_M:
        return "an arc cannot end where it begins; divide a full circle into two arcs"
    height = float(np.linalg.norm(np.cross(via, b - a))) / chord
    if height < _COLLINEAR * longest:
        return "the three points of its arc lie on one line; leave 'via' out for a straight line"
    return ""


class PathReversal(Record):
    """A joint that reverses: place, play crossed there as displacement of the SMR, and way in which it is crossed.

    ``window_mm`` is 0 where the arm stands meanwhile.
    """

    joint: int
    at_mm: float
    jump_mm: float
    window_mm: float


class PathRecord(Record):
    """One path. Where ``refusal`` says why it cannot be driven, figures that do not exist are None.

    Attributes
    ----------
    length_mm, duration_s, period_ms, samples : numbers or None
        Arc length, time from beginning to end, controller's period and number of joint positions.
    deviation_mm, deviation_at_mm : float or None
        Largest distance of the SMR from the wanted path by the model, and where.
    uncertainty_mm : float or None
        Largest standard uncertainty of a coordinate along the path by the model; None where it states none.
    at_speed : float or None
        Share of the length at the wanted speed; ``slowed`` says where a limit leaves the least of it.
    """

    name: str
    arm: str
    frame: str
    tolerance_mm: float
    refusal: str = ""
    length_mm: float | None = None
    duration_s: float | None = None
    period_ms: float | None = None
    samples: int | None = None
    deviation_mm: float | None = None
    deviation_at_mm: float | None = None
    uncertainty_mm: float | None = None
    at_speed: float | None = None
    slowed: str = ""
    reversals: tuple[PathReversal, ...] = ()


class PathResult(Result, schema="cellapp-path"):
    """``compensate`` of a path file: every path; ``files`` hold the joint positions."""

    paths: tuple[PathRecord, ...]
    notes: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    def complaints(self) -> list[str]:
        """Return which paths were refused, and why; empty if none."""
        return [f"path {path.name} refused {path.refusal}" for path in self.paths if path.refusal]


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
    require_arms(profile, model)
    homes = home_positions(profile)
    arm, cell = model.arms[spec.arm], cell_bodies(profile, model)
    path, nominal_path = paths_of(model, spec)
    limits = cell.arms[spec.arm].limits
    branches = follow_branches(arm.geometry, path, limits, homes[spec.arm], profile.seed)
    refusals = [] if branches else ["its beginning, at 0 mm, is out of reach"]
    drive = _Drive(profile, cell, homes, arm, spec, period_s)
    for branch in branches:
        if branch.failure:
            refusals.append(_placed(branch.failure, branch.failed_m))
            break
        plan = drive.on_branch(path, branch)
        if not plan.refusal:
            return replace(plan, nominal_path=nominal_path, nominal=drive.nominal(nominal_path, branch))
        refusals.append(plan.refusal)
    return PathPlan(spec, refusals[0], path, nominal_path)


def paths_of(model: CellModel, spec: PathSpec) -> tuple[CartesianPath, CartesianPath]:
    """Return the wanted path in M relative to the calibrated bases, and relative to the nominal ones."""
    goals = goals_of_arm(model, spec.targets(), spec.arm)
    poses = np.cumsum([1 + (pose.via is not None) for pose in spec.poses]) - 1
    vias = [None if pose.via is None else k - 1 for k, pose in zip(poses[1:], spec.poses[1:], strict=True)]
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
    driven: dict[str, Any] = {}
    if trajectory is not None and joints is not None:
        rows = np.linspace(0, len(trajectory.q) - 1, _UNCERTAIN_AT).astype(int)
        driven = {
            "duration_s": trajectory.duration_s,
            "period_ms": trajectory.period_s * 1e3,
            "samples": len(trajectory.q),
            "deviation_mm": joints.deviation_m * 1e3,
            "deviation_at_mm": joints.deviation_at_m * 1e3,
            "uncertainty_mm": float(model.arms[spec.arm].uncertainty(trajectory.q[rows]).max()) * 1e3 or None,
            "at_speed": trajectory.at_speed,
            "slowed": trajectory.slowed,
            "reversals": tuple(
                PathReversal(
                    joint=one.joint, at_mm=one.at_m * 1e3, jump_mm=one.jump_m * 1e3, window_mm=one.window_m * 1e3
                )
                for one in sorted(joints.reversals, key=lambda one: one.at_m)
            ),
        }
    return PathRecord.like(
        spec,
        tolerance_mm=spec.tolerance * 1e3,
        refusal=plan.refusal,
        length_mm=None if plan.path is None else plan.path.length * 1e3,
        **driven,
    )


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Drive:
    """What every way to drive a path has in common: the cell, the arm, the path's own settings, time of a sample."""

    profile: Profile
    cell: CellBodies
    homes: Mapping[str, Array]
    arm: ArmModel
    spec: PathSpec
    period_s: float

    @property
    def others(self) -> dict[str, Array]:
        """The other arms at home."""
        return {name: q for name, q in self.homes.items() if name != self.spec.arm}

    @property
    def rates(self) -> Rates:
        """The limits of the arm's joints at the profile's share, and the path's own acceleration."""
        return Rates(*joint_rates(self.profile.arms[self.spec.arm]), self.spec.acceleration)

    def on_branch(self, path: CartesianPath, branch: Branch) -> PathPlan:
        """Return the plan on one branch of the inverse kinematics."""
        spec, cell, rates, others = self.spec, self.cell, self.rates, self.others
        cross_s = float(np.sqrt(5.774 / (_CROSS_SHARE * rates.acceleration.min())))
        try:
            joints = joint_path(self.arm, path, branch, _conditions(self.profile, spec), spec.tolerance, cross_s)
            trajectory = timed(path, joints, rates, self.period_s)
        except PathError as error:
            return PathPlan(spec, _placed(str(error), error.at_m), path)
        if joints.deviation_m > spec.tolerance:
            place = _placed(f"{joints.deviation_m * 1e3:.3f} mm off by the model", joints.deviation_at_m)
            return PathPlan(spec, place, path)
        run_up = np.clip(trajectory.q[0] - RUN_UP_RAD * joints.stretches[0].signs, *cell.arms[spec.arm].limits.T)
        if refusal := refuse_path(cell, spec.arm, trajectory.q, others, trajectory.s):
            return PathPlan(spec, refusal, path)
        home = self.homes[spec.arm]
        for start, end in ((home, run_up), (run_up, trajectory.q[0]), (trajectory.q[-1], home)):
            if refusal := refuse_motion(cell, {**others, spec.arm: start}, {**others, spec.arm: end}):
                return PathPlan(spec, f"on the way between home and the path: {refusal}", path)
        unseen = _unseen(cell, self.homes, spec.arm, trajectory)
        return PathPlan(spec, "", path, joints=joints, trajectory=trajectory, run_up=run_up, unseen_m=unseen)

    def nominal(self, path: CartesianPath, branch: Branch) -> Trajectory | None:
        """Return the path as the published geometry drives it on the same branch; None if it cannot be driven."""
        published = replace(self.arm, geometry=self.arm.nominal, effects=(), network=None, posterior=None)
        on = Branch(branch.s / branch.s[-1] * path.length, branch.q)  # both paths have the same shape
        conditions = _conditions(self.profile, self.spec)
        try:
            joints = joint_path(published, path, on, conditions, self.spec.tolerance, cross_s=0.0)
            trajectory = timed(path, joints, self.rates, self.period_s)
        except PathError:
            return None
        refusal = refuse_path(self.cell, self.spec.arm, trajectory.q, self.others, trajectory.s)
        return None if refusal else trajectory


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


def _unseen(cell: CellBodies, homes: Mapping[str, Array], name: str, trajectory: Trajectory) -> float | None:
    """Return the first arc length [m] where the tracker does not see the SMR; None if it sees the whole path."""
    count = max(2, int(np.ceil(trajectory.s[-1] / _SEEN_EVERY_M)) + 1)
    rows = np.unique(np.searchsorted(trajectory.s, np.linspace(0.0, trajectory.s[-1], count)))
    rows = np.clip(rows, 0, len(trajectory.s) - 1)
    seen = visible_with_others(cell, homes, name, {name: trajectory.q[rows]})
    return None if seen.all() else float(trajectory.s[rows[int(np.argmin(seen))]])


def _placed(reason: str, at_m: float) -> str:
    return f"at {at_m * 1e3:.0f} mm: {reason}"
