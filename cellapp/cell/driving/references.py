"""Measure references during a run: the arms at the first planned stop, and fixed nests. Their drift is limited."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.driving.measuring import SmrMeasurement
from cellapp.cell.driving.motion import Vector
from cellapp.cell.driving.reference_watch import ReferenceWatch
from cellapp.cell.driving.supervision import Supervisor
from cellapp.cell.run import ReferenceRow, RunFile
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import ReferenceReport, Suspicion
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
