"""Measure one SMR at a stop: repeat until the mean is precise enough, and wait while temporary causes prevent it.

Measure references during a run: the arms at the first planned stop, and fixed nests. Their drift is limited.

Find SMRs near their predictions although the tracker's station is known only roughly; each one found improves it.

The tracker is pointed at lattice positions around a prediction, spaced by the range of a tracker's own search. Every
SMR that is found improves the station, so that the next ones are found at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.driving.motion import Mover, PointAtRest, Vector, reading_of
from cellapp.cell.driving.supervision import CellSupervisor
from cellapp.cell.run import ReferenceRow, RunFile
from cellapp.estimation.calibration.station_location import RoughStation, beside, fit_station
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.readings import joined
from cellapp.ground.errors import HardwareError
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.progress import ReferenceReport, Suspicion
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array, mean_rotation, quaternions_of, rotations_of, twist_columns
from cellapp.robot.model import CellModel
from cellapp.robot.model.model import relocated
from cellapp.robot.model.nominal import pose_matrix
from drivers.arms.protocol import ArmState
from drivers.trackers.protocol import NotReady, TargetLost, Unstable, WrongTarget

Measure = Callable[[], PointAtRest]

_NO_POINT = (TargetLost, WrongTarget, Unstable)
"""Faults by which one measurement fails, not the tracker."""


def measured_at_arm(supervisor: CellSupervisor, name: str, q: Vector) -> PointAtRest:
    """Measure the SMR of an arm at rest at ``q`` (N,) [rad], with the repeats and waits of the profile.

    Raise as ``Mover.measure``.
    """
    return _precise(supervisor, f"arm {name}", lambda: supervisor.mover.measure(name, q))


def _precise(supervisor: CellSupervisor, what: str, measure: Measure) -> PointAtRest:
    """Repeat until the standard error of the mean is small enough, or the profile's maximum is reached."""
    points, repeat = [_patient(supervisor, what, measure)], supervisor.mover.profile.collection.repeat
    while repeat.precision is not None and len(points) < repeat.times:
        points.append(_patient(supervisor, what, measure))
        deviation = np.std([point.p_M for point in points], axis=0, ddof=1) / np.sqrt(len(points))
        if deviation.max() <= repeat.precision:
            break
    return mean_point(points)


def _patient(supervisor: CellSupervisor, what: str, measure: Measure) -> PointAtRest:
    """Measure; if the SMR is missed or the tracker is not ready, wait as the profile allows and try again."""
    found: list[PointAtRest] = []

    def ready() -> bool:
        try:
            found.append(measure())
        except (*_NO_POINT, NotReady):
            return False
        return True

    while True:
        try:
            return measure()
        except NotReady as error:
            if not supervisor.suspended("tracker_warm_up", str(error), supervisor.tracker_ready):
                raise HardwareError(f"{what}: {error}") from error
        except _NO_POINT as error:
            if not supervisor.suspended("target", f"{what}: {error}", ready):
                raise
            return found[0]


def mean_point(points: list[PointAtRest]) -> PointAtRest:
    """Return the mean of repeated measurements of a resting SMR.

    Its covariance is that of one measurement, because repeats do not reduce all of the tracker's errors (angles,
    scale).
    """
    if len(points) == 1:
        return points[0]
    positions = np.array([point.p_M for point in points])
    first, last = points[0], points[-1]
    return replace(
        first,
        p_M=positions.mean(axis=0),
        time_s=0.5 * (first.time_s + last.time_s),
        averaging_s=last.time_s - first.time_s + 0.5 * (first.averaging_s + last.averaging_s),
        quality=tuple(dict.fromkeys(warning for point in points for warning in point.quality)),
        quaternion_M=_mean_quaternion([point.quaternion_M for point in points]),
        q=first.q + np.mean([point.q - first.q for point in points], axis=0),
        q_spread=max(point.q_spread for point in points),
    )


def _mean_quaternion(measured: Sequence[Vector | None]) -> Vector | None:
    """Return the mean orientation; None if one is missing."""
    quaternions = [one for one in measured if one is not None]
    if len(quaternions) < len(measured):
        return None
    return quaternions_of(mean_rotation(rotations_of(quaternions)))


def nests_in_M(profile: Profile) -> dict[str, NDArray[np.float64]]:
    """Return the nests of a profile, name -> position (3,) [m] in the tracker frame M."""
    nests = profile.collection.reference.nests
    if not nests or profile.tracker.pose is None:
        return {}
    T_C_M = pose_matrix(profile.tracker.pose)
    return {name: (np.array(position) - T_C_M[:3, 3]) @ T_C_M[:3, :3] for name, position in nests.items()}


class ReferenceSmr(NamedTuple):
    """What is measured again and again during a run: the SMR of an arm at the reference stop, or one in a nest."""

    kind: Literal["arm", "nest"]
    name: str

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"


@dataclass
class References:
    """Measures the references of one session and compares them with their first measurements in the run.

    If ``accept_drift``, the first measurements of this session replace those of earlier ones.
    """

    run: RunFile
    session: int
    supervisor: CellSupervisor
    suspect: Callable[[Suspicion], None]
    accept_drift: bool = False
    carried: Mapping[str, str] = field(default_factory=dict)
    """Arm -> what it carries, in words, if that is not the first load. Its references are then compared separately: an
    arm that sags more under another load does not drift."""
    _first_M: dict[str, Vector] = field(default_factory=dict)
    _last_M: dict[ReferenceSmr, Vector] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.accept_drift:
            for row in self.run.references():
                self._first_M.setdefault(row.name, row.p_M)

    def check(self, states: Mapping[str, Vector], stops_done: int, began_s: float) -> ReferenceReport:
        """Measure all references with the arms at ``states`` (name -> q (N,) [rad]) and store them.

        If the drift is above the limit, suspend the job as the profile allows.

        Raises
        ------
        HardwareError
            If the drift stays above the limit and nobody attends the job.
        """
        limit_m = self.run.profile.collection.reference.drift
        report = self._measured(states, stops_done, began_s)
        worst = max(report.drift_mm, key=report.drift_mm.__getitem__, default=None)
        if worst is None or report.drift_mm[worst] <= limit_m * 1e3:
            return report
        latest = [report]

        def ready() -> bool:
            latest[0] = self._measured(states, stops_done, began_s)
            return max(latest[0].drift_mm.values(), default=0.0) <= limit_m * 1e3

        text = (
            f"reference {worst}: {report.drift_mm[worst]:.3f} mm from its first measurement, limit {limit_m * 1e3:g} mm"
        )
        if not self.supervisor.suspended("drift", text, ready):
            if not self.supervisor.hold(text):
                raise HardwareError(
                    f"{text}; look for a moved tracker, nest or SMR. If the change is understood, continue with"
                    " --resume --accept-drift, else start a new run"
                )
            self._first_M.clear()  # the person saw the drift and resumed: from now on drift is relative to here
            latest[0] = self._measured(states, stops_done, began_s)
        return latest[0]

    def _measured(self, states: Mapping[str, Vector], stops_done: int, began_s: float) -> ReferenceReport:
        points, limit_m = self._points(states), self.run.profile.collection.reference.drift
        now_M = {name: point.p_M for name, point in points.items()}
        for suspicion in reference_jumps(self._last_M, now_M, limit_m):
            self.suspect(suspicion)
        self._last_M |= now_M
        drift_mm = {}
        for reference, point in points.items():
            name = str(reference) + (self.carried.get(reference.name, "") if reference.kind == "arm" else "")
            first_M = self._first_M.setdefault(name, point.p_M)
            drift_mm[name] = float(np.linalg.norm(point.p_M - first_M)) * 1e3
            row = ReferenceRow(name, stops_done, point.time_s - began_s, point.p_M, self.session)
            self.run.add_reference(row)
        return ReferenceReport(drift_mm, limit_m * 1e3)

    def _points(self, states: Mapping[str, Vector]) -> dict[ReferenceSmr, PointAtRest]:
        """Measure the arms at ``states`` and the nests; record those that cannot be measured."""
        measure: dict[ReferenceSmr, Measure] = {
            ReferenceSmr("arm", name): partial(measured_at_arm, self.supervisor, name, q) for name, q in states.items()
        }
        for name, expected_M in nests_in_M(self.run.profile).items():
            nest = ReferenceSmr("nest", name)
            at_nest = partial(self.supervisor.mover.measure_at, expected_M, str(nest))
            measure[nest] = partial(_precise, self.supervisor, str(nest), at_nest)
        points: dict[ReferenceSmr, PointAtRest] = {}
        for reference, at_reference in measure.items():
            try:
                points[reference] = at_reference()
            except _NO_POINT as error:
                self.supervisor.record("reference", f"{reference}: not measured: {error}")
        return points


def reference_jumps(
    before_M: Mapping[ReferenceSmr, Array], now_M: Mapping[ReferenceSmr, Array], limit_m: float
) -> tuple[Suspicion, ...]:
    """Return suspicions from the references' positions (3,) [m] the last time and now."""
    moved = {one: float(np.linalg.norm(p_M - before_M[one])) for one, p_M in now_M.items() if one in before_M}
    jumps = {one: size for one, size in moved.items() if size > limit_m}
    if jumps and len(jumps) == len(moved) and (len(jumps) > 1 or not any(one.kind == "arm" for one in jumps)):
        size = f"{max(jumps.values()) * 1e3:.2f} mm"
        text = f"all references moved by {size} since the last time: was the tracker touched?"
        return (Suspicion("tracker moved", text),)
    return tuple(_jump(one, size) for one, size in jumps.items())


def _jump(reference: ReferenceSmr, size: float) -> Suspicion:
    how = f"moved by {size * 1e3:.2f} mm since the last time: check"
    if reference.kind == "nest":
        return Suspicion("loose SMR", f"{reference} {how} it")
    text = f"{reference}: its SMR at the reference stop {how} that it sits firmly"
    return Suspicion("loose SMR", text, reference.name)


_ROUGH_M, _ROUGH_RAD = 0.05, np.radians(1.0)
"""Standard deviation of a station that was paced out, or of a stand that was kicked: coordinates [m], angles [rad]."""
_REACH = 3.0
"""Search radius for an SMR, in standard deviations of its prediction."""
_REACH_M = (0.05, 0.16)
"""Limits of the search radius [m]: with a larger one the search would take too long."""
_LATTICE_M = 0.057
"""Spacing of the positions that the tracker is pointed at [m]: no point is farther than 50 mm from a point of this
cubic lattice, and every tracker's driver accepts an SMR within at least 50 mm."""
_KNOWN_M = 1e-3
"""Prediction error [m] below which the station is not fitted again: it is far within the smallest search radius."""
MOST_MISSED = {False: 2, True: 3}
"""Consecutive SMRs that are not found after which the search ends, by whether one was found before."""
APART_M = 0.4
"""Least distance [m] between SMRs that are present at the same time: more than twice the largest search radius, so that
none is mistaken for another."""


@dataclass(frozen=True, eq=False)
class FoundPoint:
    """Measured point with its arm.

    ``found_off_m`` is its distance from the prediction [m]. ``point`` is the mean of the measurements, whose positions
    are ``repeats_M`` (k, 3) [m]. ``other_q`` is as in ``Mover.other_q``, at that time.
    """

    arm: str
    point: PointAtRest
    repeats_M: Array
    conditions: MeasurementConditions
    found_off_m: float
    other_q: Array | None

    @property
    def q(self) -> Vector:
        """Joint positions (N,) of the arm [rad]."""
        return self.point.q


@dataclass(eq=False)
class SmrSearch:
    """Searches for SMRs and measures each ``repeats`` times.

    ``model`` is in the tracker frame of its calibration; ``rough_T`` (4, 4) maps that frame into a guess of the present
    one. ``excess_m`` is as in ``fit_station``. Before each measurement it waits while a person pauses.
    """

    model: CellModel
    mover: Mover
    rough_T: Array
    excess_m: Mapping[str, float]
    repeats: int
    found: list[FoundPoint] = field(default_factory=list)

    def __post_init__(self) -> None:
        sigma = np.array([_ROUGH_M] * 3 + [_ROUGH_RAD] * 3)
        self._rough = RoughStation(self.rough_T, np.diag(sigma**2))
        self._so_far: tuple[Array, Array] = self._rough.T_new_old, self._rough.covariance

    @property
    def T_new_old(self) -> Array:
        """Station (4, 4) as estimated from the points so far."""
        return self._so_far[0]

    def measure(self, name: str, state: ArmState) -> FoundPoint | str:
        """Measure the SMR of an arm at rest at or near its prediction; return why if it is not found.

        A point that is found improves the station. Raise as ``Mover.measure`` and ``Mover.hold``.
        """
        found = self._search(name, state)
        if isinstance(found, FoundPoint):
            self.found.append(found)
            # fit the station again, unless it predicted the point well enough already
            if found.found_off_m > _KNOWN_M or self._reach_m(found.point.p_M) > _REACH_M[0]:
                fit = fit_station(
                    self.model, points_of(self.found), self.T_new_old, excess_m=self.excess_m, rough=self._rough
                )
                self._so_far = fit.T_new_old, fit.covariance
        return found

    def _reach_m(self, p_M: Vector) -> float:
        """Return the search radius [m] around a predicted point (3,) [m]."""
        J = twist_columns(p_M[None])[0]
        sigma_m = float(np.sqrt(np.linalg.eigvalsh(J @ self._so_far[1] @ J.T)[-1]))
        return float(np.clip(_REACH * sigma_m, *_REACH_M))

    def _search(self, name: str, state: ArmState) -> FoundPoint | str:
        conditions = self.mover.conditions(name, state, 0.5 * self.mover.profile.tracker.averaging)
        model, other_q = relocated(self.model, self.T_new_old), self.mover.other_q(name)
        expected = model.arms[name].predict(state.q[None], beside(model, name, conditions, other_q))[0]
        reach_m, problem, at = self._reach_m(expected), "", (name, state.q)
        for offset in lattice(reach_m):
            self.mover.hold()
            try:
                point = self.mover.measure_at(expected + offset, f"arm {name}", reach_m + _LATTICE_M, 1, at)
                again = (self.mover.measure_at(point.p_M, f"arm {name}", at=at) for _ in range(self.repeats - 1))
                points = [point, *again]
            except _NO_POINT as error:
                problem = problem or str(error)
                continue
            off_m = float(np.linalg.norm(point.p_M - expected))
            repeats_M = np.array([one.p_M for one in points])
            return FoundPoint(name, mean_point(points), repeats_M, conditions, off_m, other_q)
        return f"arm {name}: no SMR within {reach_m * 1e3:.0f} mm of its prediction: {problem}"


def points_of(found: Sequence[FoundPoint]) -> dict[str, Readings]:
    """Return the points by arm, as a fit takes them."""
    by_chance, points = share_of_chance(found), {}
    for name, own in grouped((one.arm, one) for one in found).items():
        rows = joined([reading_of(one.point, one.conditions, other_q=one.other_q) for one in own])
        points[name] = replace(rows, covariance_M=covariances(own, by_chance))
    return points


# -- inside -----------------------------------------------------------------------------------------------------------


def share_of_chance(found: Sequence[FoundPoint]) -> float:
    """Return the fraction (0 to 1) of the tracker's covariance that repeats show: averaging reduces only this part."""
    squares = 0.0
    for one in found:
        off = one.repeats_M - one.repeats_M.mean(axis=0)
        squares += float(np.einsum("ka,ab,kb->", off, np.linalg.inv(one.point.covariance_M), off))
    freedom = 3 * sum(len(one.repeats_M) - 1 for one in found)
    return min(squares / freedom, 1.0) if freedom else 0.0


def covariances(found: Sequence[FoundPoint], by_chance: float) -> Array:
    """Return the covariances of the means of repeats (m, 3, 3) [m^2]."""
    kept = [1.0 - by_chance * (1.0 - 1.0 / len(one.repeats_M)) for one in found]
    return np.array([part * one.point.covariance_M for part, one in zip(kept, found, strict=True)])


def lattice(reach_m: float) -> list[Vector]:
    """Return the offsets (3,) [m] of a cubic lattice within a radius, nearest first."""
    count = int(reach_m / _LATTICE_M)
    steps = np.array(list(product(range(-count, count + 1), repeat=3)), dtype=np.float64) * _LATTICE_M
    distance = np.linalg.norm(steps, axis=1)
    order = np.argsort(distance, kind="stable")
    return [steps[row] for row in order.tolist() if distance[row] <= reach_m]
