"""Measure references during a run: the arms at the first planned stop, and fixed nests. Their drift is limited."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.driving.measuring import SmrMeasurement
from cellapp.cell.driving.motion import Vector
from cellapp.cell.driving.supervision import Supervisor
from cellapp.cell.run import ReferenceRow, RunFile
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import ReferenceReport, Suspicion
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import pose_matrix
from drivers.trackers.protocol import Point, TargetLost, Unstable, WrongTarget


def nests_in_M(profile: Profile) -> dict[str, NDArray[np.float64]]:
    """Return the nests of a profile, name -> position (3,) [m] in the tracker frame M."""
    nests = profile.collection.reference.nests
    if not nests or profile.tracker.pose is None:
        return {}
    T_C_M = pose_matrix(profile.tracker.pose)
    return {name: (np.array(position) - T_C_M[:3, 3]) @ T_C_M[:3, :3] for name, position in nests.items()}


@dataclass
class References:
    """Measures the references of one session and compares them with their first measurements in the run.

    If ``accept_drift``, the first measurements of this session replace those of earlier ones.
    """

    run: RunFile
    session: int
    measurement: SmrMeasurement
    supervisor: Supervisor
    suspect: Callable[[Suspicion], None]
    accept_drift: bool = False
    carried: Mapping[str, str] = field(default_factory=dict)
    """Reference -> what its arm carries, in words, if that is not the first load. Such references are compared
    separately: an arm that sags more under another load does not drift."""
    _first_M: dict[str, Vector] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._watch = ReferenceWatch(self.run.profile.collection.reference.drift)
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
        points = self._points(states)
        arms = [f"arm {name}" for name in states]
        for suspicion in self._watch.at_reference({name: point.p_M for name, point in points.items()}, arms):
            self.suspect(suspicion)
        drift_mm = {}
        for reference, point in points.items():
            name = reference + self.carried.get(reference, "")
            first_M = self._first_M.setdefault(name, point.p_M)
            drift_mm[name] = float(np.linalg.norm(point.p_M - first_M)) * 1e3
            row = ReferenceRow(name, stops_done, point.time_s - began_s, point.p_M, self.session)
            self.run.add_reference(row)
        return ReferenceReport(drift_mm, self.run.profile.collection.reference.drift * 1e3)

    def _points(self, states: Mapping[str, Vector]) -> dict[str, Point]:
        """Measure the arms at ``states`` and the nests; record those that cannot be measured."""
        measure: dict[str, Callable[[], Point]] = {
            f"arm {name}": partial(self.measurement.at_arm, name, q) for name, q in states.items()
        }
        for name, expected_M in nests_in_M(self.run.profile).items():
            measure[f"nest {name}"] = partial(self.measurement.at_nest, name, expected_M)
        points: dict[str, Point] = {}
        for name, at_reference in measure.items():
            try:
                points[name] = at_reference()
            except (TargetLost, WrongTarget, Unstable) as error:
                self.supervisor.record("reference", f"{name}: not measured: {error}")
        return points


# -- Detect suspicions from reference measurements: fixed nests, and the arms at the reference stop -------------------


class ReferenceWatch:
    """Judges reference measurements, each against the previous one (a jump) and against the first one (drift).

    Drift of a reference is raised once until it is within the limit again.

    Parameters
    ----------
    limit_m : float
        Largest accepted displacement [m].
    """

    def __init__(self, limit_m: float) -> None:
        self._limit_m = limit_m
        self._first: dict[str, Array] = {}
        self._last: dict[str, Array] = {}
        self._drifted: set[str] = set()

    def at_reference(self, points_M: Mapping[str, Array], arms: Collection[str]) -> tuple[Suspicion, ...]:
        """Return suspicions from the references' positions (3,) [m]; names in ``arms`` are arms, the others nests."""
        jumps = self._beyond(points_M, self._last)
        beyond = {name: size for name, size in self._beyond(points_M, self._first).items() if name not in jumps}
        drifts = {name: size for name, size in beyond.items() if name not in self._drifted}
        self._drifted = (self._drifted - points_M.keys()) | beyond.keys()
        shared = len(self._last.keys() & points_M.keys())
        for name, point in points_M.items():
            if name in jumps or name not in self._first:  # raise a jump once: later points are relative to this one
                self._first[name] = point
            self._last[name] = point
        fixed = [name for name in jumps if name not in arms]
        if jumps and len(jumps) == shared and (fixed or len(jumps) > 1):
            text = f"all references moved by {_largest_mm(jumps)} since the last time: was the tracker touched?"
            return (Suspicion("tracker moved", text), *_drifts(drifts, arms))
        return (*(_jump(name, size, arms) for name, size in jumps.items()), *_drifts(drifts, arms))

    def _beyond(self, points_M: Mapping[str, Array], before: Mapping[str, Array]) -> dict[str, float]:
        away = {name: float(np.linalg.norm(point - before[name])) for name, point in points_M.items() if name in before}
        return {name: size for name, size in away.items() if size > self._limit_m}


def _jump(name: str, size: float, arms: Collection[str]) -> Suspicion:
    if name in arms:
        text = (
            f"{name}: its SMR at the reference stop moved by {size * 1e3:.2f} mm since the last time: check that it"
            " sits firmly"
        )
        return Suspicion("loose SMR", text, name.removeprefix("arm "))
    return Suspicion("loose SMR", f"{name} moved by {size * 1e3:.2f} mm since the last time: check it")


def _drifts(drifts: Mapping[str, float], arms: Collection[str]) -> tuple[Suspicion, ...]:
    if not drifts:
        return ()
    arm = next(iter(drifts)) if len(drifts) == 1 and next(iter(drifts)) in arms else None
    text = f"{', '.join(sorted(drifts))}: drifted by {_largest_mm(drifts)} since the first time: check warm-up and air"
    return (Suspicion("drift", text, None if arm is None else arm.removeprefix("arm ")),)


def _largest_mm(sizes: Mapping[str, float]) -> str:
    return f"{max(sizes.values()) * 1e3:.2f} mm"
