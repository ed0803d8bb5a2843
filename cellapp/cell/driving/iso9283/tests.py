"""Drive the tests of ISO 9283: find base and cube of each arm, visit the poses cycle by cycle, measure at rest.

Measurements are stored visit by visit in the caller's object, so that they can be evaluated even if the job is stopped.

The test paths of ISO 9283 (6.8), the diagonal P2 to P4 and circles, driven while the tracker follows the SMR.

Findings while the tests are driven, and the results made from them, complete or not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.iso9283.programme import (
    Alignment,
    ChosenCube,
    CubeSearch,
    Visit,
    align,
    alignment_configurations,
    arm_programme,
    choose_cube,
    directional_visits,
    distance_visits,
    drift_visits,
    exercise_visits,
    paired_visits,
    pose_pairs,
    pose_visits,
    published_cell,
)
from cellapp.cell.driving.motion import Confirm, MotionRefused, Mover, Vector
from cellapp.cell.driving.supervision import moving_cell
from cellapp.cell.driving.sweeping import INTERVAL_S, drive_path
from cellapp.cell.driving.target_visit import drive_to
from cellapp.cell.planning.planned_stops import tell_time, visits_s
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.targets.path import RUN_UP_RAD, PathPlan, PathPose, PathSpec, plan_path
from cellapp.estimation.discovery.plan_forecast import tracker_covariance
from cellapp.estimation.iso9283.characteristics import LARGE_CIRCLE, POSES, SMALL_CIRCLE, circle_positions
from cellapp.estimation.iso9283.evaluate import (
    ArmProgramme,
    IsoPlace,
    MeasuredVisit,
    Measurements,
    PathRuns,
    cooperative_characteristics,
    directional_characteristics,
    distance_characteristics,
    drift_characteristics,
    path_characteristics,
    pose_characteristics,
)
from cellapp.estimation.iso9283.norm import IsoCommands, IsoTest, wanted_cycles
from cellapp.estimation.iso9283.records import (
    ArmIso9283,
    BaseAlignment,
    CommandedTests,
    PairIso9283,
    PathCharacteristics,
    SpeedSeries,
)
from cellapp.ground.control import JobControl
from cellapp.ground.counting import counted
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array, rpy_of, xyz_of
from cellapp.robot.model import CellModel
from cellapp.robot.paths.cartesian import CartesianPath
from cellapp.robot.paths.joint_path import Trajectory
from drivers.arms.protocol import PathFollower
from drivers.trackers.protocol import NotReady, Point, TrackerError, stream_of

_ENDED = "the job ended before"
_NO_PAIR = "there are no two poses at which both arms are clear and seen together"


@dataclass(eq=False)
class IsoFindings:
    """Measurements, refusals and notes so far."""

    model: CellModel | None = None
    measured: Measurements = field(default_factory=Measurements)
    alignments: dict[str, Alignment] = field(default_factory=dict)
    cubes: dict[str, ChosenCube] = field(default_factory=dict)
    programmes: dict[tuple[str, IsoCommands], ArmProgramme] = field(default_factory=dict)
    pairs: dict[tuple[str, str], list[tuple[str, str]]] = field(default_factory=dict)
    refused: dict[str, dict[str, str]] = field(default_factory=dict)
    wanted: dict[IsoPlace, int] = field(default_factory=dict)
    missed: dict[IsoPlace, str] = field(default_factory=dict)
    paths: list[PathRuns] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def refuse(self, name: str, tests: Iterable[IsoTest], reason: str) -> None:
        """Record why an arm's tests are not made, or not completely."""
        reasons = self.refused.setdefault(name, {})
        for test in tests:
            reasons[test] = f"{reasons[test]}; {reason}" if test in reasons else reason


def arm_results(task: IsoTask, found: IsoFindings, rng: np.random.Generator) -> dict[str, ArmIso9283]:
    """Return cube, base and characteristics of each arm that was to be tested."""
    results = {}
    for name in task.arms:
        kinds = [kind for arm, kind in found.programmes if arm == name]
        tests = {kind: _commanded(task, found, name, kind, rng) for kind in kinds}
        results[name] = ArmIso9283(
            payload_kg=task.profile.arms[name].payload.mass,
            cube=found.cubes[name].record() if name in found.cubes else None,
            base=_base(found, name),
            tests={kind: one for kind, one in tests.items() if one != CommandedTests()},
            refused=found.refused.get(name, {}),
        )
    return results


def pair_results(found: IsoFindings, rng: np.random.Generator) -> tuple[PairIso9283, ...]:
    """Return the characteristics of each pair of arms whose cooperative test was requested."""
    return tuple(_pair(found, pair, rng) for pair in found.pairs)


def missing_words(found: IsoFindings, tests: Sequence[IsoTest]) -> tuple[str, ...]:
    """Return places and paths with too few cycles, and arms and pairs that were not tested at all, with reasons.

    ``tests`` are the requested ones. If a cell can make some tests but not another, that one is refused, not missing.
    """
    words = []
    for place, wanted in found.wanted.items():
        groups = found.measured.groups(place) or [0]
        n = min(len(found.measured.at(place, group)) for group in groups)
        if n < wanted:
            words.append(f"{place}: {n} of {counted(wanted, 'cycle')}: {found.missed.get(place, _ENDED)}")
    for where, runs in _runs_of_paths(found):
        if (n := len(runs.tracks)) < runs.wanted:
            words.append(f"{where}: {n} of {counted(runs.wanted, 'cycle')}: {'; '.join(runs.problems) or _ENDED}")
    for name, refused in found.refused.items():
        if set(tests) - {"cooperative"} <= set(refused):
            words += [f"arm {name}: {reason}" for reason in dict.fromkeys(refused.values())]
    words += [f"cooperative of {' and '.join(pair)}: {_NO_PAIR}" for pair, poses in found.pairs.items() if not poses]
    return tuple(words)


def lost_beam_words(found: IsoFindings) -> tuple[str, ...]:
    """Return the paths on which the beam broke, and what was done."""
    lost = ((where, sum(track.lost_beams for track in runs.tracks)) for where, runs in _runs_of_paths(found))
    return tuple(
        f"{where}: the beam broke {counted(count, 'time')}; these cycles were driven again from their beginning"
        for where, count in lost
        if count
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _runs_of_paths(found: IsoFindings) -> Iterator[tuple[str, PathRuns]]:
    """Yield every path that was to be driven, with its name."""
    for runs in found.paths:
        at = f", {runs.series:.0%} of the speed" if runs.series else ""
        yield f"path of {runs.arm}, {runs.commands} commands, {runs.name}{at}", runs


def _commanded(
    task: IsoTask, found: IsoFindings, name: str, kind: IsoCommands, rng: np.random.Generator
) -> CommandedTests:
    arm, measured, base_M = found.programmes[name, kind], found.measured, _base_rotation(found, name, kind)
    series = [
        SpeedSeries(
            speed_share=share,
            pose=pose_characteristics(arm, measured, base_M, rng, share),
            path=_paths(found, name, kind, rng, share),
        )
        for share in task.also_speeds
    ]
    return CommandedTests(
        pose=pose_characteristics(arm, measured, base_M, rng),
        multidirectional=directional_characteristics(arm, measured, base_M, rng),
        distance=distance_characteristics(arm, measured, rng),
        drift=drift_characteristics(arm, measured, base_M, rng),
        path=_paths(found, name, kind, rng),
        series=tuple(one for one in series if one.pose or one.path),
    )


def _paths(
    found: IsoFindings, name: str, kind: IsoCommands, rng: np.random.Generator, series: float = 0.0
) -> tuple[PathCharacteristics, ...]:
    own = [runs for runs in found.paths if (runs.arm, runs.commands, runs.series) == (name, kind, series)]
    return tuple(one for runs in own if (one := path_characteristics(runs, rng)) is not None)


def _base_rotation(found: IsoFindings, name: str, kind: IsoCommands) -> Array:
    """Return the rotation (3, 3) of the base in M that the commands assume."""
    assert found.model is not None
    arm = found.model.arms[name]
    return np.asarray((arm.nominal if kind == "nominal" else arm.geometry).T_M_B()[:3, :3])


def _base(found: IsoFindings, name: str) -> BaseAlignment | None:
    alignment = found.alignments.get(name)
    if alignment is None:
        return None
    frames = [frame for (arm, _), one in found.programmes.items() if arm == name for frame in one.frame.values()]
    variance = float(np.mean([np.trace(frame) / 3.0 for frame in frames])) if frames else 0.0
    return BaseAlignment(n=alignment.n, rms_mm=alignment.rms_m * 1e3, uncertainty_mm=float(np.sqrt(variance)) * 1e3)


def _pair(found: IsoFindings, pair: tuple[str, str], rng: np.random.Generator) -> PairIso9283:
    first, second = pair
    vector, distance = {}, {}
    for (name, kind), programme in found.programmes.items():
        other = found.programmes.get((second, kind))
        if name != first or other is None:
            continue
        vectors, lengths = cooperative_characteristics((programme, other), found.measured, rng)
        if vectors:
            vector[kind], distance[kind] = vectors, lengths
    return PairIso9283(arms=pair, vector=vector, distance=distance, refused="" if found.pairs[pair] else _NO_PAIR)


PATH_SPEED = 0.25
"""Speed of the SMR along the paths at 100 % [m/s]. It stands for the standard's rated path velocity, which profiles do
not state: collaborative arms may move so fast beside people, and most joints can follow."""
_TOLERANCE_M = 1e-3
"""Allowed distance of the model's joint path from the commanded path [m]; the plan itself stays below some 10 um."""


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


def _round(points: Array, rpy: tuple[float, float, float]) -> tuple[PathPose, ...]:
    return (
        PathPose(position=xyz_of(points[0]), rpy=rpy),
        PathPose(position=xyz_of(points[2]), via=xyz_of(points[1])),
        PathPose(position=xyz_of(points[4]), via=xyz_of(points[3])),
    )


DWELL_S = 1.0
"""Rest before each measurement [s]: arms of this size have stopped swinging by then."""
_MISSED_IN_A_ROW = 3
"""Consecutive visits without a measurement after which the job ends: the SMR is probably covered."""
_GROUPS = 12
_INTERVAL_S = (300.0, 1800.0)
"""Number of groups of a drift test, and limits of the time between them [s]: several groups fall in the first hour."""


@dataclass(frozen=True, eq=False)
class IsoTask:
    """Settings of the tests.

    The tracker of ``profile`` is at its true pose if the cell is simulated. ``model`` is the calibrated one; if None,
    base and SMR of each arm are found first. ``cycles`` is the requested number, ``speed`` the fraction of the
    profile's speed, ``drift_s`` the duration of the drift test [s]. Pose and path tests are repeated at
    ``also_speeds``.
    """

    profile: Profile
    model: CellModel | None
    commands: tuple[IsoCommands, ...]
    tests: tuple[IsoTest, ...]
    arms: tuple[str, ...]
    cycles: int
    speed: float
    drift_s: float
    also_speeds: tuple[float, ...] = ()


def drive_tests(
    task: IsoTask,
    findings: IsoFindings,
    control: JobControl | None = None,
    *,
    confirm: Confirm | None = None,
    opened: Callable[[Cell], object] = lambda cell: None,
) -> None:
    """Make the tests one after the other, one arm at a time with the others at home; cooperative tests with two arms.

    Each visit is added to ``findings`` when it is measured. ``opened`` is called with the open cell before anything
    moves; its exception ends the job. ``confirm`` is called before the first motion.

    Raises
    ------
    InputError
        If base and SMR of an arm cannot be found.
    HardwareError
        If a device fails (all arms have been stopped), or if consecutive measurements are missing.
    Stopped, Aborted
        On request; the arms have been braked.
    """
    control = control or JobControl()
    profile, model = task.profile, task.model or published_cell(task.profile, {})
    with moving_cell(
        profile, model, control, confirm=confirm, opened=opened, slow_visits=None, full_speed=task.speed
    ) as mover:
        session = _Session(task, findings, mover)
        try:
            findings.model = task.model or session.aligned()
            mover.bodies = cell_bodies(profile, findings.model)
            session.prepare(findings.model)
            session.run()
            mover.go_home()
        finally:
            findings.seconds = mover.cell.clock.now_s() - mover.began_s
    control.tell("iso9283", session.total, session.total, "done")


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Session:
    """Drives to the poses and measures in an open cell."""

    task: IsoTask
    findings: IsoFindings
    mover: Mover
    total: int = 1
    _missed: int = 0

    # -- before the tests ----------------------------------------------------------------------------------------------

    def aligned(self) -> CellModel:
        """Return the published geometry with bases and SMRs as found by measuring."""
        profile = self.task.profile
        rough = published_cell(profile, {})
        for name in self.task.arms:
            geometry = rough.arms[name].geometry
            q = alignment_configurations(self.mover.bodies, self.mover.homes, name, geometry, profile.seed)
            reached, points = [], []
            for done, target in enumerate(q):
                self.mover.control.tell("find base", done, len(q), f"arm {name}")
                self.mover.hold()
                try:
                    state = drive_to(self.mover, {name: target}, {})[name]
                    points.append(self._at_rest(name, state.q))
                    reached.append(state.q)
                except (MotionRefused, TrackerError) as error:
                    _raise_if_not_ready(error)
                    self.findings.notes.append(f"arm {name}: a position to find its base: {error}")
            self.findings.alignments[name] = align(profile, name, np.array(reached), points)
            self.mover.go_home([name])
        return published_cell(profile, self.findings.alignments)

    def prepare(self, model: CellModel) -> None:
        """Find the cube of each arm and compute its commands there."""
        profile, found = self.task.profile, self.findings
        for number, name in enumerate(self.task.arms):
            self.mover.hold()
            self.mover.control.tell("find cube", number, len(self.task.arms), f"arm {name}")
            search = CubeSearch(self.mover.bodies, self.mover.homes, name, model.arms[name], profile.seed)
            chosen = choose_cube(search)
            if isinstance(chosen, str):
                found.refuse(name, self.task.tests, chosen)
                continue
            found.cubes[name] = chosen
            for kind in self.task.commands:
                programme = arm_programme(
                    model,
                    name,
                    chosen,
                    kind,
                    self.mover.homes,
                    rested_s=DWELL_S + 0.5 * profile.tracker.averaging,
                    payload_kg=profile.arms[name].payload.mass,
                    alignment=found.alignments.get(name),
                )
                if isinstance(programme, str):
                    found.notes.append(f"arm {name}: no {kind} commands: {programme}")
                else:
                    found.programmes[name, kind] = programme
        for first, second in combinations(found.cubes, 2) if "cooperative" in self.task.tests else ():
            q = {name: found.cubes[name].q for name in (first, second)}
            pairs = found.pairs[first, second] = pose_pairs(self.mover.bodies, self.mover.homes, q)
            if len(pairs) < len(POSES):
                found.notes.append(
                    f"arms {first} and {second}: {len(pairs)} of {len(POSES)} pairs of poses can be measured"
                )

    # -- the tests -----------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Run all requested tests; drift first, while the arms are cold."""
        tests = self.task.tests
        programmes = self.findings.programmes.values()
        self._rehearse([one for own in programmes for one in (*pose_visits(own, 1), *directional_visits(own, 1))])
        series = {0.0: self._visits()} | {share: self._poses_at(share) for share in self.task.also_speeds}
        every = [visit for visits in series.values() for visit in visits]
        self.findings.wanted |= {visit.place: self.task.cycles for visit in every if visit.place is not None}
        self.total = max(len(every), 1)
        tell_time(self.mover.control, "iso9283", self.task.profile, self._seconds(series), 0, self.total)
        if "drift" in tests:
            for name in self.findings.cubes:
                self._drift(name)
        done = 0
        for share, visits in series.items():
            self.mover.speed = share or self.task.speed
            for visit in visits:
                place = "" if visit.place is None else str(visit.place)
                self.mover.control.tell("iso9283", done, self.total, place)
                self._visit(visit)
                done += 1
            if "path" in tests:
                self._paths(share)
        self.mover.speed = self.task.speed

    def _seconds(self, series: Mapping[float, Sequence[Visit]]) -> float:
        """Estimate the time of all tests [s]; paths at the commanded speed, motions at that of the profile.

        ``series`` are the visits at each speed as in ``PathRuns.series``.
        """
        profile, tests, edges = self.task.profile, self.task.tests, [cube.edge for cube in self.findings.cubes.values()]
        total = len(edges) * self.task.drift_s if "drift" in tests else 0.0
        path_m = sum(edges) * (np.sqrt(2.0) + np.pi * (LARGE_CIRCLE + SMALL_CIRCLE)) * len(self.task.commands)
        path_s = wanted_cycles("path", self.task.cycles) * path_m / PATH_SPEED if "path" in tests else 0.0
        for share, visits in series.items():
            moving_s = visits_s(profile, [one.targets for one in visits], DWELL_S)
            total += moving_s + path_s / (share or self.task.speed)
        return float(total)

    def _poses_at(self, share: float) -> list[Visit]:
        """Return the visits of the pose test at another fraction of the speed."""
        programmes = self.findings.programmes.values() if "pose" in self.task.tests else ()
        return [visit for programme in programmes for visit in pose_visits(programme, self.task.cycles, share)]

    def _paths(self, series: float) -> None:
        """Run the path tests of one arm after the other, the others at home; ``series`` is as in ``PathRuns``."""
        names = list(self.findings.cubes)
        for done, name in enumerate(names):
            self.mover.control.tell("paths", done, len(names), f"arm {name}")
            self.mover.go_home()
            self._paths_of(name, series)
        self.mover.control.tell("paths", len(names), len(names), "done")

    def _paths_of(self, name: str, series: float) -> None:
        """Drive all paths of an arm with each kind of commands; record why one cannot be driven."""
        model, arm = self.findings.model, self.mover.cell.arms[name]
        assert model is not None
        specs = path_specs(name, self.findings.cubes[name], series or self.task.speed)
        if stream_of(self.mover.cell.tracker) is None:
            specs = "this tracker's driver cannot measure a moving SMR"
        elif not isinstance(arm, PathFollower):
            specs = f"the driver of arm {name} cannot follow a stream of joint positions"
        if isinstance(specs, str) or not isinstance(arm, PathFollower):
            self.findings.refuse(name, ["path"], str(specs))
            return
        for spec in specs:
            plan = plan_path(self.task.profile, model, spec, arm.path_period_s)
            for kind in self.task.commands:
                chosen = _chosen(plan, kind)
                if isinstance(chosen, str):
                    self.findings.refuse(name, ["path"], f"{spec.name}, {kind} commands: {chosen}")
                else:
                    self._drive_path(spec, kind, *chosen, series)

    def _drive_path(
        self, spec: PathSpec, kind: IsoCommands, trajectory: Trajectory, path: CartesianPath, series: float
    ) -> None:
        """Drive one path over all cycles."""
        start_M = path.positions(np.zeros(1))
        programme = self.findings.programmes.get((spec.arm, kind))
        runs = PathRuns(
            arm=spec.arm,
            commands=kind,
            name=spec.name,
            speed=spec.speed,
            path=path,
            tracker=self.task.profile.tolerances.covariance_factor
            * tracker_covariance(self.task.profile.tracker, start_M)[0],
            frame=np.zeros((3, 3)) if programme is None else programme.frame["P1"],
            wanted=wanted_cycles("path", self.task.cycles),
            slowed=trajectory.slowed,
            series=series,
        )
        self.findings.paths.append(runs)

        def begin() -> None:
            self.mover.hold()
            for q in (_run_up(trajectory.q), trajectory.q[0]):
                self.mover.go_home_unless_clear(spec.arm, q)
                self.mover.move({spec.arm: q})

        interval_s = INTERVAL_S / (series or self.task.speed)  # as many points at each speed
        try:
            for _ in range(runs.wanted):
                runs.tracks.append(drive_path(self.mover, spec.arm, trajectory, begin, start_M[0], interval_s))
        except (MotionRefused, TrackerError) as error:
            runs.problems.append(str(error))

    def _visits(self) -> list[Visit]:
        """Return the visits of all tests that are measured at rest, except drift."""
        found: list[Visit] = []
        makers = {"pose": pose_visits, "multidirectional": directional_visits, "distance": distance_visits}
        for programme in self.findings.programmes.values():
            for test, visits in makers.items():
                if test in self.task.tests:
                    found += visits(programme, self.task.cycles)
        if "cooperative" not in self.task.tests:
            return found
        for (first, second), pairs in self.findings.pairs.items():
            for kind in self.task.commands:
                both = [self.findings.programmes.get((name, kind)) for name in (first, second)]
                if both[0] is not None and both[1] is not None:
                    found += paired_visits(both[0], both[1], pairs, self.task.cycles)
        return found

    def _rehearse(self, visits: Sequence[Visit]) -> None:
        """Drive real arms slowly and without measuring, for a person to watch their first motions."""
        if self.task.profile.moves_hardware:
            self.mover.slow_start()
            for visit in visits:
                self._visit(replace(visit, place=None))
        self.mover.speed = self.task.speed

    def _drift(self, name: str) -> None:
        """Measure groups of cycles over the requested time; between groups the arm keeps moving as in the cycles."""
        kinds = [kind for kind in self.task.commands if (name, kind) in self.findings.programmes]
        if not kinds:
            return
        programme = self.findings.programmes[name, kinds[-1]]  # of the calibrated model if there are any
        cycles, limit_s = wanted_cycles("drift", self.task.cycles), self.task.drift_s
        self.findings.wanted[programme.place("drift", "P1")] = cycles
        began_s, group = self.mover.cell.clock.now_s(), 0
        while True:
            for visit in drift_visits(programme, cycles):
                self._visit(visit, group)
            group += 1
            passed_s = self.mover.cell.clock.now_s() - began_s
            self.mover.control.tell("drift", int(min(passed_s, limit_s) / 60.0), int(limit_s / 60.0), f"arm {name}")
            if passed_s >= limit_s and group > 1:
                return
            until_s = min(began_s + group * float(np.clip(limit_s / _GROUPS, *_INTERVAL_S)), began_s + limit_s)
            while self.mover.cell.clock.now_s() < until_s:
                for visit in exercise_visits(programme):
                    self._visit(visit)

    # -- one visit -----------------------------------------------------------------------------------------------------

    def _visit(self, visit: Visit, group: int = 0) -> None:
        """Drive to a visit's targets; measure if it has a place; record why a measurement is missing."""
        self.mover.hold()
        try:
            states = drive_to(self.mover, visit.targets, {})
            if visit.place is None:
                return
            points = {name: self._at_rest(name, states[name].q) for name in visit.targets}
        except (MotionRefused, TrackerError) as error:
            _raise_if_not_ready(error)
            self._miss(visit, str(error))
            return
        self._missed = 0
        first, share = points[visit.place.arms[0]], self.task.profile.tolerances.covariance_factor
        self.findings.measured.visits.append(
            MeasuredVisit(
                place=visit.place,
                cycle=visit.cycle,
                p_M={name: point.p_M for name, point in points.items()},
                covariance_M={name: share * point.covariance_M for name, point in points.items()},
                time_s=first.time_s,
                temperature_c=first.temperature_c,
                group=group,
                orientations={name: its for name, point in points.items() if (its := point.orientation) is not None},
            )
        )

    def _at_rest(self, name: str, q: Vector) -> Point:
        self.mover.rest(name, DWELL_S)
        return self.mover.measure(name, q)

    def _miss(self, visit: Visit, reason: str) -> None:
        self._missed += 1
        if visit.place is not None:
            self.findings.missed.setdefault(visit.place, reason)
        if self._missed >= _MISSED_IN_A_ROW:
            raise HardwareError(
                f"iso9283: {self._missed} visits in a row without a measurement, the last one: {reason}; look for a"
                " covered SMR or a closed way, then repeat the test"
            )


def _raise_if_not_ready(error: Exception) -> None:
    if isinstance(error, NotReady):
        raise HardwareError(str(error)) from error  # it would not measure at the next position either
