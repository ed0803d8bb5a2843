"""Drive planned paths and, with verification, measure the distances of the SMR from them, moving and at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.motion import Confirm, MotionRefused, Mover
from cellapp.cell.driving.moving_cell import moving_cell
from cellapp.cell.driving.tracked_path import PathDriver, TrackedPath
from cellapp.cell.targets.path_file import PathSpec
from cellapp.cell.targets.path_records import DrivenPath, PathLag, PathTime
from cellapp.cell.targets.plan_path import RUN_UP_RAD, PathPlan, path_rates, plan_path
from cellapp.estimation.calibration.evaluation import summarise
from cellapp.estimation.uncertainty.decision import Judge
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Listener, Progress, ignore
from cellapp.ground.results import ErrorSummary
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import CellModel
from cellapp.robot.paths.cartesian import CartesianPath
from cellapp.robot.paths.lag import Lag, lag, rehearsed
from cellapp.robot.paths.progress import Followed, followed
from cellapp.robot.paths.timing import Trajectory
from drivers.arms.protocol import PathFollower
from drivers.trackers.protocol import TrackerError

_FEWEST_AT_REST = 12
_AT_REST_EVERY_M = 0.05
"""Minimum number, and spacing [m], of the positions along a path where the SMR is measured at rest."""


def follow(
    profile: Profile,
    model: CellModel,
    plans: Sequence[PathPlan],
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    verify: bool,
    rehearse: bool = False,
    judge: Judge | None = None,
    confirm: Confirm | None = None,
    opened: Callable[[Cell], object] = lambda cell: None,
) -> list[tuple[PathPlan, DrivenPath | None]]:
    """Drive every path that is not refused, with the other arms at home; if ``verify``, measure it.

    If ``rehearse``, drive each path once before, and correct it by the observed following errors of the joints.

    A path is planned again if the arm's controller has another rate. ``opened`` is called with the open cell before
    anything moves; an exception from it ends the job. ``confirm`` is called before the first motion. ``judge`` decides
    on tolerances; if None, by the profile alone.

    Raises
    ------
    InputError
        If none of the paths can be driven.
    HardwareError
        If an arm or the tracker fails; all arms have been stopped.
    Stopped, Aborted
        On request; the arms have been braked.
    """
    control = control or JobControl()
    if all(plan.refusal for plan in plans):
        raise InputError(f"follow: none of the paths can be driven: {plans[0].refusal}")
    found: list[tuple[PathPlan, DrivenPath | None]] = []
    with moving_cell(
        profile, model, control, confirm=confirm, opened=opened, measures=verify, slow_visits=None
    ) as moving:
        cell, mover = moving.cell, moving.mover
        for done, plan in enumerate(plans):
            moving.hold()
            listener(Progress("follow", done, len(plans), plan.spec.name))
            plan = _at_rate_of_arm(profile, model, plan, cell)
            paths = PathDriver(cell, mover, moving.reaction, control)
            driver = _Driver(profile, mover, paths, model, plan.spec, judge or Judge(profile))
            found.append((plan, None if plan.refusal else driver.drive(plan, verify=verify, rehearse=rehearse)))
            mover.go_home()
    listener(Progress("follow", len(plans), len(plans), "done"))
    return found


def _at_rate_of_arm(profile: Profile, model: CellModel, plan: PathPlan, cell: Cell) -> PathPlan:
    """Return the plan with samples at the rate of the arm's controller."""
    arm = cell.arms[plan.spec.arm]
    if plan.refusal:
        return plan
    if not isinstance(arm, PathFollower):
        return replace(plan, refusal=f"arm {plan.spec.arm}: its driver cannot follow a stream of joint positions")
    if plan.trajectory is not None and plan.trajectory.period_s == arm.path_period_s:
        return plan
    return plan_path(profile, model, plan.spec, arm.path_period_s)


@dataclass(frozen=True)
class _Driver:
    """Drives the paths of one arm in an open cell."""

    profile: Profile
    mover: Mover
    paths: PathDriver
    model: CellModel
    spec: PathSpec
    judge: Judge

    def drive(self, plan: PathPlan, *, verify: bool, rehearse: bool) -> DrivenPath:
        """Drive one path; if ``verify``, also at rest, and with the commands of the published geometry."""
        assert plan.path is not None
        assert plan.nominal_path is not None
        assert plan.trajectory is not None
        notes: list[str] = []
        try:
            trajectory = self._rehearsed(plan.trajectory, plan.path, notes) if rehearse else plan.trajectory
            found = self._run(trajectory, plan.path, measure=verify)
        except (MotionRefused, TrackerError) as error:
            return DrivenPath(note=str(error))
        late = lag(self.model.arms[self.spec.arm], plan.trajectory, found.arm.time_s, found.arm.q)
        driven = DrivenPath(
            lag=_lag_record(late),
            rehearsed=trajectory is not plan.trajectory,
            note="; ".join(notes),
            lost_beams=found.lost_beams,
        )
        points = None
        if found.track is not None:
            points = found.track.p_M
            in_time = _time_record(followed(plan.path, plan.trajectory, found.track.time_s - found.began_s, points))
            driven = driven.model_copy(update={"in_time": in_time})
        return self._verified(plan, driven, points) if verify else driven

    def _rehearsed(self, trajectory: Trajectory, path: CartesianPath, notes: list[str]) -> Trajectory:
        """Drive the path once and return the corrected trajectory; the original and a note if it exceeds a limit."""
        arm = self._run(trajectory, path, measure=False).arm
        corrected = rehearsed(trajectory, arm.time_s, arm.q, path_rates(self.profile, self.spec))
        if corrected is None:
            notes.append("its rehearsal is not used: the corrected joints would exceed their limits")
            return trajectory
        return corrected

    def _verified(self, plan: PathPlan, driven: DrivenPath, points: Array | None) -> DrivenPath:
        """Add the distances from the path: as driven, at rest, and with the published geometry."""
        assert plan.path is not None
        assert plan.nominal_path is not None
        assert plan.trajectory is not None
        notes, nominal, at_rest = [driven.note] if driven.note else [], None, None
        lost_beams = driven.lost_beams
        try:
            at_rest = _summary(plan.path, self._at_rest(plan.trajectory))
            if plan.nominal is None:
                notes.append("the published geometry cannot be driven along this path")
            else:
                found = self._run(plan.nominal, plan.nominal_path, measure=True)
                there = self._at_rest(plan.nominal) if found.track is None else found.track.p_M
                nominal = _summary(plan.nominal_path, there)
                lost_beams += found.lost_beams
        except (MotionRefused, TrackerError) as error:
            notes.append(str(error))
        if points is None:
            notes.append("this tracker's driver cannot measure a moving SMR yet; the path was verified at rest")
        moving = None if points is None else _summary(plan.path, points)
        judged = moving or at_rest
        value = None if judged is None else judged.p95
        places_M = plan.path.positions(np.linspace(0.0, float(plan.trajectory.s[-1]), _FEWEST_AT_REST))
        farthest_M = places_M[np.argmax(np.linalg.norm(places_M, axis=1))]
        expanded = self.judge.expanded_mm({self.spec.arm: farthest_M}, {})
        return driven.model_copy(
            update={
                "moving": moving,
                "at_rest": at_rest,
                "nominal": nominal,
                "lost_beams": lost_beams,
                "judged": "" if judged is None else "moving" if moving is not None else "at rest",
                "expanded_mm": None if judged is None else expanded,
                "rule": self.judge.rule,
                "verdict": self.judge.verdict(value, expanded, self.spec.tolerance * 1e3),
                "note": "; ".join(notes),
            }
        )

    def _run(self, trajectory: Trajectory, path: CartesianPath, *, measure: bool) -> TrackedPath:
        """Drive to the beginning and along the path, as ``PathDriver.drive``."""

        def begin() -> None:
            self._go(run_up(trajectory.q))
            self._go(trajectory.q[0])

        start_M = path.positions(np.zeros(1))[0] if measure else None
        return self.paths.drive(self.spec.arm, trajectory, begin, start_M)

    def _at_rest(self, trajectory: Trajectory) -> Array:
        """Measure points (n, 3) [m] at rest along the path, each approached in the path's direction of motion."""
        length = float(trajectory.s[-1])
        count = max(_FEWEST_AT_REST, int(np.ceil(length / _AT_REST_EVERY_M)) + 1)
        rows = np.clip(np.searchsorted(trajectory.s, np.linspace(0.0, length, count)), 1, len(trajectory.s) - 1)
        points = []
        for row in np.unique(rows):
            self._go(run_up(trajectory.q[row - 1 :]))
            self._go(trajectory.q[row])
            points.append(self.mover.measure(self.spec.arm, trajectory.q[row]).p_M)
        return np.array(points)

    def _go(self, q: Array) -> None:
        """Move straight, or via home if the gate refuses that."""
        self.mover.go_home_unless_clear(self.spec.arm, q)
        self.mover.move({self.spec.arm: q})


def run_up(q: Array) -> Array:
    """Return a position (N,) before the first row of ``q`` (m, N) [rad], against each joint's direction of motion."""
    moved = np.abs(q - q[0]) > 1e-5
    first = np.argmax(moved, axis=0)
    ahead = q[first, np.arange(q.shape[1])] - q[0]
    return np.asarray(q[0] - RUN_UP_RAD * np.where(ahead < 0.0, -1.0, 1.0))


def _lag_record(found: Lag | None) -> PathLag | None:
    if found is None:
        return None
    return PathLag(delay_ms=found.delay_s * 1e3, late_mm=found.late_m * 1e3, cut_mm=found.cut_m * 1e3)


def _time_record(found: Followed | None) -> PathTime | None:
    if found is None:
        return None
    speed = found.speed
    return PathTime(
        delay_ms=found.delay_s * 1e3,
        delay_expanded_ms=2e3 * found.delay_error_s,
        rms_mm=found.rms_m * 1e3,
        largest_mm=found.largest_m * 1e3,
        speed_mm_s=None if speed is None else speed.wanted * 1e3,
        mean_mm_s=None if speed is None else speed.mean * 1e3,
        expanded_mm_s=None if speed is None else 2e3 * speed.standard_error,
        fluctuation_mm_s=None if speed is None else speed.fluctuation * 1e3,
    )


def _summary(path: CartesianPath, points: Array) -> ErrorSummary | None:
    return summarise(path.distances(points)) if len(points) else None
