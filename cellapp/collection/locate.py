"""Measure a few SMR points from the tracker's new station, one arm after the other, each predicted better than before.

The station is known roughly only: the first SMR is searched for around its prediction, by pointing the tracker at a
lattice of places that are as far apart as a tracker searches by itself. Every point found makes the station better
known, so that the next ones are found at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cellapp.calibration.station_location import (
    LEAST_PROBABILITY,
    ArmPoints,
    Cause,
    RoughStation,
    StationFit,
    fit_station,
    possible_causes,
    predicted_points,
    twist_columns,
)
from cellapp.collection.cell import Cell, open_cell
from cellapp.collection.collect import Opened
from cellapp.collection.locating_stops import LocatingStops
from cellapp.collection.measuring import mean_point
from cellapp.collection.motion import Confirm, MotionRefused, Mover, Vector
from cellapp.collection.supervision import hold_while_paused, reacting
from cellapp.control import JobControl
from cellapp.effects import MeasurementConditions
from cellapp.errors import HardwareError
from cellapp.kinematics.transforms import Array
from cellapp.model import CellModel
from cellapp.model.relocation import relocated
from cellapp.profile import Profile
from cellapp.progress import Listener, Progress, ignore
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from drivers.arms.protocol import ArmState
from drivers.trackers.protocol import Point, TargetLost, Unstable, WrongTarget

DIAGNOSTIC_POINTS = 4
"""Points of each arm from which a motion of its base, or of its SMR, can be told from that of the tracker."""
_ROUGH_M, _ROUGH_RAD = 0.05, np.radians(1.0)
"""Standard deviation of a station that was paced out, or of a stand that was kicked: coordinates and angles."""
_REACH = 3.0
"""An SMR is searched for within so many standard deviations of its prediction."""
_REACH_M = (0.05, 0.16)
"""Least and largest distance within which an SMR is searched for: beyond, the search would take too long."""
_LATTICE_M = 0.057
"""Spacing of the places that the tracker is pointed at: no place is farther than 50 mm from one of a cubic lattice, the
least distance within which a tracker's driver accepts an SMR."""
_REPEATS = 5
"""Measurements of each point: what scatters from one to the next falls below half."""
_RUN_UP_RAD = np.radians(2.0)
"""Last motion of each joint to a point: as short as most of a plan, and well beyond any play."""
_MISSED_AT_FIRST, _MISSED_LATER = 2, 3
"""So many SMRs that are not found one after the other end the job, before the first one is found and after it."""


@dataclass(frozen=True, eq=False)
class FoundPoint:
    """A measured point: its arm, the joint positions (N,) [rad] of its controller, by how much it was off [m].

    ``point`` is the mean of the measurements, whose positions are ``repeats_M`` (k, 3) [m].
    """

    arm: str
    q: Vector
    point: Point
    repeats_M: Array
    conditions: MeasurementConditions
    found_off_m: float


@dataclass(frozen=True, eq=False)
class LocatedStation:
    """The points, the station that explains them best, and if it does not explain them, other motions that might."""

    found: tuple[FoundPoint, ...]
    points: Mapping[str, ArmPoints]
    fit: StationFit
    causes: tuple[Cause, ...]
    notes: tuple[str, ...]

    @property
    def explained(self) -> bool:
        """Whether one motion of the tracker explains all points."""
        return self.fit.explains


@dataclass(frozen=True, eq=False)
class LocateTask:
    """What to measure.

    ``model`` is in the tracker frame of its calibration, ``rough_T`` (4, 4) maps that into a guess of the present one,
    ``candidates`` are as in ``LocatingStops``, ``excess_m`` as in ``fit_station``; ``points`` are wanted of all arms
    together. Up to ``still_m`` [m] of drift count as no motion.
    """

    profile: Profile
    model: CellModel
    rough_T: Array
    candidates: Mapping[str, Array]
    excess_m: Mapping[str, float]
    points: int
    still_m: float


def locate_station(
    task: LocateTask,
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    confirm: Confirm | None = None,
    opened: Callable[[Cell], object] = lambda cell: None,
    open_with: Opened | None = None,
) -> LocatedStation:
    """Measure the points, one arm at a time and the others at home; more of them where they do not fit together.

    ``opened`` is called with the open cell before anything moves; what it raises ends the job. ``confirm`` is asked
    before the first motion. ``open_with`` opens the cell.

    Raises
    ------
    HardwareError
        If a device fails, all arms have been stopped then; or if too few SMRs are found.
    InputError
        If the points that were found lie together or on one line.
    Stopped, Aborted
        On request; the arms have been braked.
    """
    control = control or JobControl()
    bodies = cell_bodies(task.profile, task.model)
    with (open_with or open_cell)(task.profile) as cell, reacting(cell, control) as reaction:
        opened(cell)
        cell.require_tracker()
        mover = Mover(task.profile, cell, bodies, reaction)
        mover.confirm_first(home_positions(task.profile), confirm)
        slow = task.profile.collection.slow_start
        mover.speed = slow.speed if task.profile.moves_hardware else 1.0

        def checkpoint() -> None:
            hold_while_paused(cell, control, reaction)

        mover.go_home()
        stops = LocatingStops(task.profile, task.model, bodies, task.candidates)
        measuring = _Measuring(task, mover, stops, checkpoint, listener)
        fit, causes = _explained(task, measuring)
        mover.go_home()
    listener(Progress("locate", len(measuring.found), len(measuring.found), "done"))
    return LocatedStation(tuple(measuring.found), measuring.points(), fit, causes, tuple(measuring.notes))


# -- inside -----------------------------------------------------------------------------------------------------------


def _explained(task: LocateTask, measuring: _Measuring) -> tuple[StationFit, tuple[Cause, ...]]:
    """Measure and fit; where one motion does not explain the points, measure more and see what does."""
    measuring.measure(_shares(list(task.candidates), task.points))
    fit = measuring.fit()
    if fit.explains:
        return fit, ()
    measuring.notes.append(
        f"one motion of the tracker does not explain the {len(measuring.found)} points (probability"
        f" {fit.probability:.1g}, at least {LEAST_PROBABILITY:g} is asked): more were measured to see what does"
    )
    measuring.measure({name: DIAGNOSTIC_POINTS for name in task.candidates})
    fit = measuring.fit()
    if fit.explains:
        return fit, ()
    points, start = measuring.points(), fit.T_new_old
    return fit, possible_causes(task.model, points, start, excess_m=task.excess_m, still_m=task.still_m)


def _shares(names: list[str], points: int) -> dict[str, int]:
    """Points of each arm, the first ones take what is left over."""
    return {name: points // len(names) + (k < points % len(names)) for k, name in enumerate(names)}


@dataclass(eq=False)
class _Measuring:
    task: LocateTask
    mover: Mover
    stops: LocatingStops
    checkpoint: Callable[[], None]
    listener: Listener
    found: list[FoundPoint] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _missed: int = 0
    _away: str = ""

    def __post_init__(self) -> None:
        sigma = np.array([_ROUGH_M] * 3 + [_ROUGH_RAD] * 3)
        self._rough = RoughStation(self.task.rough_T, np.diag(sigma**2))
        self._homes = home_positions(self.task.profile)
        self._so_far: tuple[Array, Array] = self._rough.T_new_old, self._rough.covariance

    def measure(self, wanted: Mapping[str, int]) -> None:
        """Measure until every arm has its number of points, or has no more to offer; other arms then measure more."""
        total = max(sum(wanted.values()), len(self.found))
        for name, count in wanted.items():
            self._measure_arm(name, count - self._count(name), total)
        for name in wanted:
            self._measure_arm(name, total - len(self.found), total)
        if len(self.found) < total:
            self.notes.append(f"{len(self.found)} of {total} points could be measured")

    def fit(self) -> StationFit:
        """The station from the points alone. Raises ``InputError`` if they do not fix it."""
        return fit_station(
            self.task.model,
            self.points(),
            self._so_far[0],
            excess_m=self.task.excess_m,
            seed=(self.task.profile.seed,),
        )

    def points(self) -> dict[str, ArmPoints]:
        """The points by arm, as the fit takes them."""
        found: dict[str, ArmPoints] = {}
        by_chance = _share_of_chance(self.found)
        for name in dict.fromkeys(one.arm for one in self.found):
            own = [one for one in self.found if one.arm == name]
            others = [other for other in self._homes if other != name]
            at_home = None
            if len(others) == 1:
                at_home = others[0], np.tile(self._homes[others[0]], (len(own), 1))
            found[name] = ArmPoints(
                q=np.array([one.q for one in own]),
                measured_M=np.array([one.point.p_M for one in own]),
                covariance_M=_covariances(own, by_chance),
                conditions=_joined([one.conditions for one in own]),
                other=at_home,
            )
        return found

    def _count(self, name: str) -> int:
        return sum(one.arm == name for one in self.found)

    def _measure_arm(self, name: str, count: int, total: int) -> None:
        """Measure so many points of one arm, as long as it can be moved to any that the tracker should see."""
        while count > 0:
            self.checkpoint()
            q = self.stops.best(name, self._so_far[0])
            if q is None:
                self.notes.append(f"arm {name}: no further joint positions are in the tracker's sight and within reach")
                return
            self.listener(Progress("locate", len(self.found), total, f"arm {name}"))
            if self._visit(name, q):
                count -= 1

    def _visit(self, name: str, q: Vector) -> bool:
        """Move to joint positions and measure there; a refused motion or an SMR that is not found is noted."""
        try:
            state = self._go(name, q)
        except MotionRefused as error:
            self.notes.append(f"arm {name}: {error}")
            return False
        found = self._search(name, state)
        if found is None:
            self._missed += 1
            if self._missed >= (_MISSED_LATER if self.found else _MISSED_AT_FIRST):
                raise HardwareError(self._lost_words(name))
            return False
        self._missed = 0
        self.found.append(found)
        fit = fit_station(
            self.task.model, self.points(), self._so_far[0], excess_m=self.task.excess_m, rough=self._rough
        )
        self._so_far = fit.T_new_old, fit.covariance
        self.stops.measured(name, state.q, fit.T_new_old)
        return True

    def _go(self, name: str, q: Vector) -> ArmState:
        """Move one arm, straight if it can return home from there, else via home; the one that was away goes home.

        Its last motion is short where the gate accepts that: effects that depend on the motion are known for such ones.
        """
        if self._away and self._away != name:
            self.mover.move({self._away: self._homes[self._away]})
        self._away = name
        self.mover.go_home_unless_clear(name, q)
        run_up = q - _RUN_UP_RAD * np.sign(q - self.mover.positions()[name])
        if not self.mover.refusal({name: run_up}, {name: q}):
            self.mover.move({name: run_up})
        return self.mover.move({name: q})[name]

    def _search(self, name: str, state: ArmState) -> FoundPoint | None:
        """Measure the SMR where it is predicted, or near there; None if it is not found."""
        conditions = self._conditions(name, state)
        T, covariance = self._so_far
        expected = self._expected(name, state.q, conditions, T)
        J = twist_columns(expected[None])[0]
        sigma_m = float(np.sqrt(np.linalg.eigvalsh(J @ covariance @ J.T)[-1]))
        reach_m = float(np.clip(_REACH * sigma_m, *_REACH_M))
        problem = ""
        for offset in _lattice(reach_m):
            self.checkpoint()
            try:
                point = self.mover.measure_at(expected + offset, f"arm {name}", reach_m + _LATTICE_M, tries=1)
                points = [point, *(self.mover.measure_at(point.p_M, f"arm {name}") for _ in range(_REPEATS - 1))]
            except (TargetLost, WrongTarget, Unstable) as error:
                problem = problem or str(error)
                continue
            off_m = float(np.linalg.norm(point.p_M - expected))
            repeats_M = np.array([one.p_M for one in points])
            return FoundPoint(name, state.q, mean_point(points), repeats_M, conditions, off_m)
        self.notes.append(f"arm {name}: no SMR within {reach_m * 1e3:.0f} mm of its prediction: {problem}")
        return None

    def _expected(self, name: str, q: Vector, conditions: MeasurementConditions, T: Array) -> Vector:
        """Where the SMR of an arm is predicted from the station ``T`` (4, 4), (3,) [m]."""
        own = ArmPoints(q[None], np.zeros((1, 3)), np.zeros((1, 3, 3)), conditions)
        return np.asarray(predicted_points(relocated(self.task.model, T), {name: own})[name][0])

    def _conditions(self, name: str, state: ArmState) -> MeasurementConditions:
        """What is known of the arm where it came to rest, one row."""
        step, rested_s = self.mover.step(name), self.mover.rested_s(name)
        averaging_s = self.task.profile.tracker.averaging
        return MeasurementConditions(
            approach=self.mover.approach(name)[None].astype(np.float64),
            step=None if step is None else step[None],
            dwell_s=None if rested_s is None else np.array([rested_s + 0.5 * averaging_s]),
            payload_kg=None if state.payload_kg is None else np.array([state.payload_kg]),
            joints_c=None if state.joint_temperature_c is None else state.joint_temperature_c[None],
        )

    def _lost_words(self, name: str) -> str:
        tried = f"{self._missed} SMRs in a row were not found, the last one of arm {name}"
        if self.found:
            return f"{tried}, although {len(self.found)} were: look for a covered or missing SMR; {self.notes[-1]}"
        return (
            f"{tried}: the tracker stands or looks elsewhere than assumed; give its pose in the cell to about 50 mm and"
            f" 1 deg with --tracker-pose. {self.notes[-1]}"
        )


def _share_of_chance(found: Sequence[FoundPoint]) -> float:
    """Share of the tracker's covariance that repeats scatter by, 0 to 1: only this share falls by averaging."""
    squares = 0.0
    for one in found:
        off = one.repeats_M - one.repeats_M.mean(axis=0)
        squares += float(np.einsum("ka,ab,kb->", off, np.linalg.inv(one.point.covariance_M), off))
    freedom = 3 * sum(len(one.repeats_M) - 1 for one in found)
    return min(squares / freedom, 1.0) if freedom else 0.0


def _covariances(found: Sequence[FoundPoint], by_chance: float) -> Array:
    """Covariances of the means of repeats (m, 3, 3) [m^2]."""
    left = [1.0 - by_chance * (1.0 - 1.0 / len(one.repeats_M)) for one in found]
    return np.array([part * one.point.covariance_M for part, one in zip(left, found, strict=True)])


def _lattice(reach_m: float) -> list[Vector]:
    """Offsets (3,) [m] of a cubic lattice within a distance, the nearest first."""
    count = int(reach_m / _LATTICE_M)
    steps = np.array(list(product(range(-count, count + 1), repeat=3)), dtype=np.float64) * _LATTICE_M
    distance = np.linalg.norm(steps, axis=1)
    order = np.argsort(distance, kind="stable")
    return [steps[row] for row in order.tolist() if distance[row] <= reach_m]


def _joined(rows: list[MeasurementConditions]) -> MeasurementConditions:
    """Conditions of single points as those of all; what one of them lacks is unknown for all."""

    def joined(values: Sequence[Array | NDArray[np.int8] | None]) -> Array | None:
        known = [np.asarray(value, dtype=np.float64) for value in values if value is not None]
        return np.concatenate(known) if len(known) == len(values) else None

    return MeasurementConditions(
        approach=joined([row.approach for row in rows]),
        step=joined([row.step for row in rows]),
        dwell_s=joined([row.dwell_s for row in rows]),
        payload_kg=joined([row.payload_kg for row in rows]),
        joints_c=joined([row.joints_c for row in rows]),
    )
