"""Drive the tests of ISO 9283: find base and cube of each arm, visit the poses cycle by cycle, measure at rest.

Measurements are stored visit by visit in the caller's object, so that they can be evaluated even if the job is stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.driving_targets import Driver
from cellapp.cell.driving.iso9283.alignment import align_points, alignment_configurations, published_cell
from cellapp.cell.driving.iso9283.chosen_cube import choose_cube
from cellapp.cell.driving.iso9283.findings import IsoFindings
from cellapp.cell.driving.iso9283.path_tests import PathTests
from cellapp.cell.driving.iso9283.programme import (
    Visit,
    arm_programme,
    directional_visits,
    distance_visits,
    drift_visits,
    exercise_visits,
    paired_visits,
    pose_pairs,
    pose_visits,
)
from cellapp.cell.driving.iso9283.reach import CubeSearch
from cellapp.cell.driving.motion import Confirm, MotionRefused, Mover, Vector
from cellapp.cell.driving.reaction import StopReaction
from cellapp.cell.driving.supervision import Opened, attended_cell, hold_while_paused
from cellapp.cell.driving.tracked_path import PathDriver
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, remembered
from cellapp.estimation.iso9283.evaluate import ArmProgramme, Measured
from cellapp.estimation.iso9283.norm import POSES, IsoCommands, IsoTest, wanted_cycles
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Listener, Progress, ignore
from cellapp.robot.model import CellModel
from drivers.arms.protocol import ArmState
from drivers.trackers.protocol import NotReady, Point, TrackerError

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
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    confirm: Confirm | None = None,
    opened: Callable[[Cell], object] = lambda cell: None,
    open_with: Opened | None = None,
) -> None:
    """Make the tests one after the other, one arm at a time with the others at home; cooperative tests with two arms.

    Each visit is added to ``findings`` when it is measured. ``opened`` is called with the open cell before anything
    moves; its exception ends the job. ``confirm`` is called before the first motion. ``open_with`` opens the cell.

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
    profile, homes = task.profile, home_positions(task.profile)
    with attended_cell(profile, control, open_with) as (cell, reaction):
        cell = replace(cell, gate=remembered(cell.gate))
        opened(cell)
        cell.require_tracker()
        model = task.model or published_cell(profile, {})
        session = _Session(task, findings, cell, reaction, control, listener, homes)
        session.use(cell_bodies(profile, model))
        session.mover.confirm_first(homes, confirm)
        began_s = cell.clock.now_s()
        try:
            session.mover.go_home()
            findings.model = task.model or session.aligned()
            session.use(cell_bodies(profile, findings.model))
            session.prepare(findings.model)
            session.run()
            session.mover.go_home()
        finally:
            findings.seconds = cell.clock.now_s() - began_s
    listener(Progress("iso9283", session.total, session.total, "done"))


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Session:
    """Drives to the poses and measures in an open cell."""

    task: IsoTask
    findings: IsoFindings
    cell: Cell
    reaction: StopReaction
    control: JobControl
    listener: Listener
    homes: Mapping[str, Vector]
    total: int = 1
    _done: int = 0
    _missed: int = 0

    def use(self, bodies: CellBodies) -> None:
        """Use these bodies from now on; move slowly in a cell of real arms."""
        self.bodies = bodies
        self.mover = Mover(self.task.profile, self.cell, bodies, self.reaction)
        self.driver = Driver(self.mover, self.homes)
        slow = self.task.profile.collection.slow_start.speed
        self.mover.speed = min(slow, self.task.speed) if self.task.profile.moves_hardware else self.task.speed

    # -- before the tests ----------------------------------------------------------------------------------------------

    def aligned(self) -> CellModel:
        """Return the published geometry with bases and SMRs as found by measuring."""
        profile = self.task.profile
        rough = published_cell(profile, {})
        for name in self.task.arms:
            geometry = rough.arms[name].geometry
            q = alignment_configurations(self.bodies, self.homes, name, geometry, profile.seed)
            reached, points = [], []
            for done, target in enumerate(q):
                self.listener(Progress("find base", done, len(q), f"arm {name}"))
                self._hold()
                try:
                    state = self._drive({name: target})[name]
                    points.append(self._at_rest(name, state.q))
                    reached.append(state.q)
                except (MotionRefused, TrackerError) as error:
                    _raise_if_not_ready(error)
                    self.findings.notes.append(f"arm {name}: a position to find its base: {error}")
            self.findings.alignments[name] = align_points(profile, name, np.array(reached), points)
            self.mover.go_home([name])
        return published_cell(profile, self.findings.alignments)

    def prepare(self, model: CellModel) -> None:
        """Find the cube of each arm and compute its commands there."""
        profile, found = self.task.profile, self.findings
        for number, name in enumerate(self.task.arms):
            self._hold()
            self.listener(Progress("find cube", number, len(self.task.arms), f"arm {name}"))
            search = CubeSearch(self.bodies, self.homes, name, model.arms[name], profile.seed)
            chosen = choose_cube(search)
            if isinstance(chosen, str):
                found.refuse(name, self.task.tests, chosen)
                continue
            found.cubes[name] = chosen
            for kind in self.task.commands:
                programme = self._programme(name, kind)
                if isinstance(programme, str):
                    found.notes.append(f"arm {name}: no {kind} commands: {programme}")
                else:
                    found.programmes[name, kind] = programme
        for first, second in combinations(found.cubes, 2) if "cooperative" in self.task.tests else ():
            q = {name: found.cubes[name].q for name in (first, second)}
            pairs = found.pairs[first, second] = pose_pairs(self.bodies, self.homes, q)
            if len(pairs) < len(POSES):
                found.notes.append(
                    f"arms {first} and {second}: {len(pairs)} of {len(POSES)} pairs of poses can be measured"
                )

    def _programme(self, name: str, kind: IsoCommands) -> ArmProgramme | str:
        """Return an arm's commands in its cube, or why there are none."""
        assert self.findings.model is not None
        return arm_programme(
            self.findings.model,
            name,
            self.findings.cubes[name],
            kind,
            self.homes,
            rested_s=DWELL_S + 0.5 * self.task.profile.tracker.averaging,
            payload_kg=self.task.profile.arms[name].payload.mass,
            alignment=self.findings.alignments.get(name),
        )

    # -- the tests -----------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Run all requested tests; drift first, while the arms are cold."""
        tests = self.task.tests
        programmes = self.findings.programmes.values()
        self._rehearse([one for own in programmes for one in (*pose_visits(own, 1), *directional_visits(own, 1))])
        self.findings.also_speeds = self.task.also_speeds
        visits = self._visits()
        series = {share: self._poses_at(share) for share in self.task.also_speeds}
        self.total = max(len(visits) + sum(map(len, series.values())), 1)
        if "drift" in tests:
            for name in self.findings.cubes:
                self._drift(name)
        self._visit_all(visits)
        if "path" in tests:
            self._paths(self.task.speed)
        for share, own in series.items():
            self.mover.speed = share
            self._visit_all(own)
            if "path" in tests:
                self._paths(share, share)
        self.mover.speed = self.task.speed

    def _last_programme(self, name: str) -> ArmProgramme | None:
        """Return the commands of an arm, those of the calibrated model if available; None if there are none."""
        kinds = [kind for kind in self.task.commands if (name, kind) in self.findings.programmes]
        return self.findings.programmes[name, kinds[-1]] if kinds else None

    def _visit_all(self, visits: Sequence[Visit]) -> None:
        for visit in visits:
            self.listener(Progress("iso9283", self._done, self.total, "" if visit.place is None else str(visit.place)))
            self._visit(visit)
            self._done += 1

    def _poses_at(self, share: float) -> list[Visit]:
        """Return the visits of the pose test at another fraction of the speed."""
        if "pose" not in self.task.tests:
            return []
        found = [
            visit
            for programme in self.findings.programmes.values()
            for visit in pose_visits(programme, self.task.cycles, share)
        ]
        self.findings.wanted |= {visit.place: self.task.cycles for visit in found if visit.place is not None}
        return found

    def _paths(self, speed: float, series: float = 0.0) -> None:
        """Run the path tests of one arm after the other, the others at home."""
        model, names = self.findings.model, list(self.findings.cubes)
        assert model is not None
        paths = PathTests(
            profile=self.task.profile,
            model=model,
            paths=PathDriver(self.cell, self.mover, self.reaction, self.control),
            findings=self.findings,
            hold=self._hold,
            speed_share=speed,
            cycles=wanted_cycles("path", self.task.cycles),
            series=series,
        )
        for done, name in enumerate(names):
            self.listener(Progress("paths", done, len(names), f"arm {name}"))
            self.mover.go_home()
            paths.drive(name, self.task.commands)
        self.listener(Progress("paths", len(names), len(names), "done"))

    def _visits(self) -> list[Visit]:
        """Return the visits of all tests that are measured at rest, except drift."""
        found: list[Visit] = []
        makers = {"pose": pose_visits, "multidirectional": directional_visits, "distance": distance_visits}
        for programme in self.findings.programmes.values():
            for test, visits in makers.items():
                if test in self.task.tests:
                    found += visits(programme, self.task.cycles)
        if "cooperative" in self.task.tests:
            found += self._cooperative()
        self.findings.wanted |= {visit.place: self.task.cycles for visit in found if visit.place is not None}
        return found

    def _cooperative(self) -> Sequence[Visit]:
        found: list[Visit] = []
        for (first, second), pairs in self.findings.pairs.items():
            for kind in self.task.commands:
                both = [self.findings.programmes.get((name, kind)) for name in (first, second)]
                if both[0] is not None and both[1] is not None:
                    found += paired_visits(both[0], both[1], pairs, self.task.cycles)
        return found

    def _rehearse(self, visits: Sequence[Visit]) -> None:
        """Drive real arms slowly and without measuring, for a person to watch their first motions."""
        if self.task.profile.moves_hardware:
            self.mover.speed = min(self.task.profile.collection.slow_start.speed, self.task.speed)
            for visit in visits:
                self._visit(replace(visit, place=None))
        self.mover.speed = self.task.speed

    def _drift(self, name: str) -> None:
        """Measure groups of cycles over the requested time; between groups the arm keeps moving as in the cycles."""
        programme = self._last_programme(name)
        if programme is None:
            return
        cycles, limit_s = wanted_cycles("drift", self.task.cycles), self.task.drift_s
        self.findings.wanted[programme.place("drift", "P1")] = cycles
        began_s, group = self.cell.clock.now_s(), 0
        while True:
            for visit in drift_visits(programme, cycles):
                self._visit(visit, group)
            group += 1
            passed_s = self.cell.clock.now_s() - began_s
            self.listener(Progress("drift", int(min(passed_s, limit_s) / 60.0), int(limit_s / 60.0), f"arm {name}"))
            if passed_s >= limit_s and group > 1:
                return
            until_s = min(began_s + group * float(np.clip(limit_s / _GROUPS, *_INTERVAL_S)), began_s + limit_s)
            while self.cell.clock.now_s() < until_s:
                for visit in exercise_visits(programme):
                    self._visit(visit)

    # -- one visit -----------------------------------------------------------------------------------------------------

    def _visit(self, visit: Visit, group: int = 0) -> None:
        """Drive to a visit's targets; measure if it has a place; record why a measurement is missing."""
        self._hold()
        names = list(visit.targets)
        try:
            states = self._drive(visit.targets)
            if visit.place is None:
                return
            points = {name: self._at_rest(name, states[name].q) for name in names}
        except (MotionRefused, TrackerError) as error:
            _raise_if_not_ready(error)
            self._miss(visit, str(error))
            return
        self._keep(visit, points, group)

    def _keep(self, visit: Visit, points: Mapping[str, Point], group: int) -> None:
        self._missed = 0
        assert visit.place is not None
        first, share = points[visit.place.arms[0]], self.task.profile.tolerances.covariance_factor
        self.findings.measured.visits.append(
            Measured(
                place=visit.place,
                cycle=visit.cycle,
                p_M={name: point.p_M for name, point in points.items()},
                covariance_M={name: share * point.covariance_M for name, point in points.items()},
                time_s=first.time_s,
                temperature_c=first.temperature_c,
                group=group,
                turned={name: its for name, point in points.items() if (its := point.orientation) is not None},
            )
        )

    def _drive(self, targets: Mapping[str, Vector]) -> Mapping[str, ArmState]:
        return self.driver.to(list(targets), lambda name, start: targets[name], {})

    def _at_rest(self, name: str, q: Vector) -> Point:
        self.mover.rest(name, DWELL_S, self.control)
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

    def _hold(self) -> None:
        hold_while_paused(self.cell, self.control, self.reaction)


def _raise_if_not_ready(error: Exception) -> None:
    if isinstance(error, NotReady):
        raise HardwareError(str(error)) from error  # it would not measure at the next position either
