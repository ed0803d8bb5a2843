"""Find SMRs near their predictions although the tracker's station is known only roughly; each one found improves it.

The tracker is pointed at lattice positions around a prediction, spaced by the range of a tracker's own search. Every
SMR that is found improves the station, so that the next ones are found at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.driving.measuring import mean_point
from cellapp.cell.driving.motion import Mover, Vector
from cellapp.estimation.calibration.station_location import (
    ArmPoints,
    RoughStation,
    fit_station,
    predicted_points,
)
from cellapp.ground.profile import Profile
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array, twist_columns
from cellapp.robot.model import CellModel
from cellapp.robot.model.model import relocated
from drivers.arms.protocol import ArmState
from drivers.trackers.protocol import Point, TargetLost, Unstable, WrongTarget

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
APART_M = 0.4
"""Least distance [m] between SMRs that are present at the same time: more than twice the largest search radius, so that
none is mistaken for another."""


@dataclass(frozen=True, eq=False)
class FoundPoint:
    """Measured point with its arm and the joint positions (N,) [rad] of its controller.

    ``found_off_m`` is its distance from the prediction [m]. ``point`` is the mean of the measurements, whose positions
    are ``repeats_M`` (k, 3) [m]. ``others`` are the joint positions of the other arms at that time, name -> (N,) [rad].
    """

    arm: str
    q: Vector
    point: Point
    repeats_M: Array
    conditions: MeasurementConditions
    found_off_m: float
    others: Mapping[str, Vector] = field(default_factory=dict)


@dataclass(eq=False)
class SmrSearch:
    """Searches for SMRs and measures each ``repeats`` times.

    ``model`` is in the tracker frame of its calibration; ``rough_T`` (4, 4) maps that frame into a guess of the present
    one. ``excess_m`` is as in ``fit_station``. ``checkpoint`` is called before each measurement; it may wait.
    """

    profile: Profile
    model: CellModel
    mover: Mover
    rough_T: Array
    excess_m: Mapping[str, float]
    repeats: int
    checkpoint: Callable[[], None]
    found: list[FoundPoint] = field(default_factory=list)

    def __post_init__(self) -> None:
        sigma = np.array([_ROUGH_M] * 3 + [_ROUGH_RAD] * 3)
        self._rough = RoughStation(self.rough_T, np.diag(sigma**2))
        self._so_far: tuple[Array, Array] = self._rough.T_new_old, self._rough.covariance

    @property
    def T_new_old(self) -> Array:
        """Station (4, 4) as estimated from the points so far."""
        return self._so_far[0]

    def points(self) -> dict[str, ArmPoints]:
        """Return the points by arm, in the format of a fit."""
        return points_of(self.found)

    def measure(self, name: str, state: ArmState) -> FoundPoint | str:
        """Measure the SMR of an arm at rest at or near its prediction; return why if it is not found.

        A point that is found improves the station. Raise as ``Mover.measure`` and ``checkpoint``.
        """
        found = self._search(name, state)
        if isinstance(found, FoundPoint):
            self.found.append(found)
            # fit the station again, unless it predicted the point well enough already
            if found.found_off_m > _KNOWN_M or self._reach_m(found.point.p_M) > _REACH_M[0]:
                fit = fit_station(self.model, self.points(), self.T_new_old, excess_m=self.excess_m, rough=self._rough)
                self._so_far = fit.T_new_old, fit.covariance
        return found

    def _reach_m(self, p_M: Vector) -> float:
        """Return the search radius [m] around a predicted point (3,) [m]."""
        J = twist_columns(p_M[None])[0]
        sigma_m = float(np.sqrt(np.linalg.eigvalsh(J @ self._so_far[1] @ J.T)[-1]))
        return float(np.clip(_REACH * sigma_m, *_REACH_M))

    def _search(self, name: str, state: ArmState) -> FoundPoint | str:
        conditions = self._conditions(name, state)
        others = {other: q for other, q in self.mover.positions().items() if other != name}
        # predict the SMR of the arm with the station so far, (3,) [m]
        own = ArmPoints(state.q[None], np.zeros((1, 3)), np.zeros((1, 3, 3)), conditions, _only(others))
        expected = np.asarray(predicted_points(relocated(self.model, self.T_new_old), {name: own})[name][0])
        reach_m, problem = self._reach_m(expected), ""
        for offset in lattice(reach_m):
            self.checkpoint()
            try:
                point = self.mover.measure_at(expected + offset, f"arm {name}", reach_m + _LATTICE_M, tries=1)
                points = [point, *(self.mover.measure_at(point.p_M, f"arm {name}") for _ in range(self.repeats - 1))]
            except (TargetLost, WrongTarget, Unstable) as error:
                problem = problem or str(error)
                continue
            off_m = float(np.linalg.norm(point.p_M - expected))
            repeats_M = np.array([one.p_M for one in points])
            return FoundPoint(name, state.q, mean_point(points), repeats_M, conditions, off_m, others)
        return f"arm {name}: no SMR within {reach_m * 1e3:.0f} mm of its prediction: {problem}"

    def _conditions(self, name: str, state: ArmState) -> MeasurementConditions:
        """Return the known conditions of the arm at rest, one row."""
        step, rested_s = self.mover.step(name), self.mover.rested_s(name)
        averaging_s = self.profile.tracker.averaging
        return MeasurementConditions(
            approach=self.mover.approach(name)[None].astype(np.float64),
            step=None if step is None else step[None],
            dwell_s=None if rested_s is None else np.array([rested_s + 0.5 * averaging_s]),
            payload_kg=None if state.payload_kg is None else np.array([state.payload_kg]),
            joints_c=None if state.joint_temperature_c is None else state.joint_temperature_c[None],
        )


def points_of(found: Sequence[FoundPoint]) -> dict[str, ArmPoints]:
    """Return the points by arm, in the format of a fit."""
    points: dict[str, ArmPoints] = {}
    by_chance = share_of_chance(found)
    for name in dict.fromkeys(one.arm for one in found):
        own = [one for one in found if one.arm == name]
        beside = [_only(one.others) for one in own]
        known = [one for one in beside if one is not None]
        points[name] = ArmPoints(
            q=np.array([one.q for one in own]),
            measured_M=np.array([one.point.p_M for one in own]),
            covariance_M=covariances(own, by_chance),
            conditions=_joined([one.conditions for one in own]),
            other=(known[0][0], np.concatenate([q for _, q in known])) if len(known) == len(own) else None,
        )
    return points


# -- inside -----------------------------------------------------------------------------------------------------------


def _only(others: Mapping[str, Vector]) -> tuple[str, Array] | None:
    """Return the other arm of a cell of two, with its joint positions (1, K) [rad]; None in other cells."""
    return next(((name, q[None]) for name, q in others.items()), None) if len(others) == 1 else None


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
    left = [1.0 - by_chance * (1.0 - 1.0 / len(one.repeats_M)) for one in found]
    return np.array([part * one.point.covariance_M for part, one in zip(left, found, strict=True)])


def lattice(reach_m: float) -> list[Vector]:
    """Return the offsets (3,) [m] of a cubic lattice within a radius, nearest first."""
    count = int(reach_m / _LATTICE_M)
    steps = np.array(list(product(range(-count, count + 1), repeat=3)), dtype=np.float64) * _LATTICE_M
    distance = np.linalg.norm(steps, axis=1)
    order = np.argsort(distance, kind="stable")
    return [steps[row] for row in order.tolist() if distance[row] <= reach_m]


def _joined(rows: list[MeasurementConditions]) -> MeasurementConditions:
    """Concatenate the conditions of single points; a condition that one of them lacks is unknown for all."""

    def joined(values: Sequence[Array | NDArray[np.int8] | None]) -> Array | None:
        known = [np.asarray(value, dtype=np.float64) for value in values if value is not None]
        return np.concatenate(known) if len(known) == len(values) else None

    names = ("approach", "step", "dwell_s", "payload_kg", "joints_c")
    known: dict[str, Any] = {name: joined([getattr(row, name) for row in rows]) for name in names}
    return MeasurementConditions(**known)
