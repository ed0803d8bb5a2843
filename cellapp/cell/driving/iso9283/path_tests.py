"""The test paths of ISO 9283 (6.8), the diagonal P2 to P4 and circles, driven while the tracker follows the SMR."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cellapp.cell.driving.iso9283.chosen_cube import ChosenCube
from cellapp.cell.driving.iso9283.findings import IsoFindings
from cellapp.cell.driving.motion import MotionRefused
from cellapp.cell.driving.tracked_path import INTERVAL_S, PathDriver
from cellapp.cell.targets.path_file import PathPose, PathSpec
from cellapp.cell.targets.plan_path import RUN_UP_RAD, PathPlan, plan_path
from cellapp.estimation.discovery.plan_forecast import tracker_covariance
from cellapp.estimation.iso9283.evaluate import PathRuns, PathTrack
from cellapp.estimation.iso9283.norm import LARGE_CIRCLE, SMALL_CIRCLE, IsoCommands, circle_positions
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array, rpy_of, xyz_of
from cellapp.robot.model import CellModel
from cellapp.robot.paths.cartesian import CartesianPath
from cellapp.robot.paths.joint_path import Trajectory
from drivers.arms.protocol import PathFollower
from drivers.trackers.protocol import TrackerError, stream_of

PATH_SPEED = 0.25
"""Speed of the SMR along the paths at 100 % [m/s]. It stands for the standard's rated path velocity, which profiles do
not state: collaborative arms may move so fast beside people, and most joints can follow."""
_TOLERANCE_M = 1e-3
"""Allowed distance of the model's joint path from the commanded path [m]; the plan itself stays below some 10 um."""
_PLACES = 50
"""Number of positions along each path where it is evaluated; the standard requires at least ten."""
_ENDS = 0.02
"""Fraction of the path left out at each end: the arm is at rest there, and no plane is crossed."""


@dataclass(frozen=True, eq=False)
class PathTests:
    """Drives the paths of one arm after the other in an open cell; ``hold`` is called between motions.

    ``series`` is as in ``PathRuns``.
    """

    profile: Profile
    model: CellModel
    paths: PathDriver
    findings: IsoFindings
    hold: Callable[[], None]
    speed_share: float
    cycles: int
    series: float = 0.0

    def drive(self, name: str, commands: tuple[IsoCommands, ...]) -> None:
        """Drive all paths of an arm with each kind of commands; record why one cannot be driven."""
        refusal = self._refusal(name)
        specs = refusal or path_specs(name, self.findings.cubes[name], self.speed_share)
        if isinstance(specs, str):
            self.findings.refuse(name, ["path"], specs)
            return
        arm = self.paths.cell.arms[name]
        assert isinstance(arm, PathFollower)
        for spec in specs:
            plan = plan_path(self.profile, self.model, spec, arm.path_period_s)
            for kind in commands:
                reason = self._drive(spec, plan, kind)
                if reason:
                    self.findings.refuse(name, ["path"], f"{spec.name}, {kind} commands: {reason}")

    @property
    def _interval_s(self) -> float:
        """Interval of points [s], inversely proportional to the speed: each path has as many points at each speed."""
        return INTERVAL_S / self.speed_share

    def _refusal(self, name: str) -> str:
        """Return why no path of an arm can be measured; empty if paths can."""
        if stream_of(self.paths.cell.tracker) is None:
            return "this tracker's driver cannot measure a moving SMR"
        if not isinstance(self.paths.cell.arms[name], PathFollower):
            return f"the driver of arm {name} cannot follow a stream of joint positions"
        return ""

    def _drive(self, spec: PathSpec, plan: PathPlan, kind: IsoCommands) -> str:
        """Drive one path over all cycles; return why not, empty if it was driven."""
        chosen = _chosen(plan, kind)
        if isinstance(chosen, str):
            return chosen
        trajectory, path = chosen
        s, commanded, tangents = places_along(path)
        tracker = tracker_covariance(self.profile.tracker, path.positions(np.zeros(1)))[0]
        programme = self.findings.programmes.get((spec.arm, kind))
        runs = PathRuns(
            arm=spec.arm,
            commands=kind,
            name=spec.name,
            speed=spec.speed,
            length=path.length,
            commanded_M=commanded,
            tangents_M=tangents,
            s=s,
            tracks=[],
            tracker=self.profile.tolerances.covariance_factor * tracker,
            frame=np.zeros((3, 3)) if programme is None else programme.frame["P1"],
            wanted=self.cycles,
            slowed=trajectory.slowed,
            series=self.series,
        )
        self.findings.paths.append(runs)
        try:
            for _ in range(self.cycles):
                runs.tracks.append(self._run(spec.arm, trajectory, path))
        except (MotionRefused, TrackerError) as error:
            runs.problems.append(str(error))
        return ""

    def _run(self, name: str, trajectory: Trajectory, path: CartesianPath) -> PathTrack:
        def begin() -> None:
            self.hold()
            for q in (_run_up(trajectory.q), trajectory.q[0]):
                self.paths.mover.go_home_unless_clear(name, q)
                self.paths.mover.move({name: q})

        found = self.paths.drive(name, trajectory, begin, path.positions(np.zeros(1))[0], self._interval_s)
        return PathTrack(found.track.time_s, found.track.p_M, found.lost_beams)


def _run_up(q: Array) -> Array:
    """Return a position (N,) before the first row of ``q`` (m, N) [rad], against each joint's direction of motion."""
    moved = np.abs(q - q[0]) > 1e-5
    first = np.argmax(moved, axis=0)
    ahead = q[first, np.arange(q.shape[1])] - q[0]
    return np.asarray(q[0] - RUN_UP_RAD * np.where(ahead < 0.0, -1.0, 1.0))


def _chosen(plan: PathPlan, kind: IsoCommands) -> tuple[Trajectory, CartesianPath] | str:
    """Return what is driven with one kind of commands, or why nothing is."""
    if plan.refusal:
        return plan.refusal
    trajectory, path = plan.trajectory, plan.path
    if kind == "nominal":
        trajectory, path = plan.nominal, plan.nominal_path
    if trajectory is None or path is None:
        return "the published geometry cannot be driven along it"
    if plan.unseen_m is not None:
        return f"the tracker does not see the SMR at {plan.unseen_m * 1e3:.0f} mm"
    return trajectory, path


def path_specs(name: str, cube: ChosenCube, speed_share: float) -> list[PathSpec] | str:
    """Return the test paths of an arm in its base, or why it cannot drive them."""
    if not np.isfinite(cube.rotation_B).all():
        return "paths need an arm that can hold its rotation, with six joints or more"
    rpy = rpy_of(cube.rotation_B)
    at = cube.position_B
    shapes = {
        "line P2 to P4": (PathPose(position=xyz_of(at["P2"]), rpy=rpy), PathPose(position=xyz_of(at["P4"]))),
        "large circle": _round(circle_positions(at, cube.edge, LARGE_CIRCLE), rpy),
        "small circle": _round(circle_positions(at, cube.edge, SMALL_CIRCLE), rpy),
    }
    return [
        PathSpec(name=words, arm=name, tolerance=_TOLERANCE_M, speed=PATH_SPEED * speed_share, poses=poses)
        for words, poses in shapes.items()
    ]


def places_along(path: CartesianPath) -> tuple[Array, Array, Array]:
    """Return arc lengths (m,) [m], positions (m, 3) [m] and unit tangents (m, 3) where a path is evaluated."""
    s = path.length * np.linspace(_ENDS, 1.0 - _ENDS, _PLACES)
    half = 1e-4 * path.length
    chord = path.positions(s + half) - path.positions(s - half)
    return s, path.positions(s), chord / np.linalg.norm(chord, axis=1, keepdims=True)


def _round(points: Array, rpy: tuple[float, float, float]) -> tuple[PathPose, ...]:
    return (
        PathPose(position=xyz_of(points[0]), rpy=rpy),
        PathPose(position=xyz_of(points[2]), via=xyz_of(points[1])),
        PathPose(position=xyz_of(points[4]), via=xyz_of(points[3])),
    )
