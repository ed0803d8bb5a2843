"""Compute the characteristics of each arm and each pair of arms from measured positions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellapp.estimation.iso9283.characteristics import (
    FEWEST_CYCLES,
    accuracy_vector,
    coverage_of_mean,
    distances,
    pose_accuracy,
    pose_repeatability,
)
from cellapp.estimation.iso9283.cube import DIRECTIONAL_POSES, DIRECTIONS, POSES
from cellapp.estimation.iso9283.norm import IsoCommands, IsoTest
from cellapp.estimation.iso9283.records import (
    DirectionalCharacteristics,
    DistanceCharacteristics,
    DriftCharacteristics,
    DriftGroup,
    OrientationCharacteristics,
    PoseCharacteristics,
)
from cellapp.estimation.iso9283.uncertainty import (
    Cycles,
    accuracy_value,
    directional_value,
    distance_values,
    drift_values,
    repeatability_value,
)
from cellapp.robot.kinematics.transforms import Array, rotation_vectors, rotations_of, xyz_of

_MINUTE_S = 60.0
_COVERAGE = 2.0
"""Coverage factor of expanded uncertainties."""


@dataclass(frozen=True)
class Place:
    """Key of what is measured at a visit; the positions of one place are evaluated together over all cycles.

    ``poses`` are those of ``arms`` in turn. ``approach`` is the direction of a multi-directional test.
    ``speed`` is the share of the profile's speed if the test is repeated at another speed, else 0.
    """

    test: IsoTest
    commands: IsoCommands
    arms: tuple[str, ...]
    poses: tuple[str, ...]
    approach: str = ""
    speed: float = 0.0

    def __str__(self) -> str:
        where = "+".join(self.poses) + (f" along {self.approach}" if self.approach else "")
        where += f", {self.speed:.0%} of the speed" if self.speed else ""
        return f"{self.test} of {' and '.join(self.arms)}, {self.commands} commands, {where}"


@dataclass(frozen=True, eq=False)
class ArmProgramme:
    """Commands of one arm with one kind of commands.

    Attributes
    ----------
    name : str
    commands : str
    position_M : mapping
        Name of a pose -> commanded SMR position (3,) [m].
    frame : mapping
        Name of a pose -> covariance (3, 3) of that position [m^2].
    rotation_M : mapping
        Name of a pose -> commanded orientation (3, 3) of its probe; empty if unknown.
    q : mapping
        (pose, previous pose) -> joint positions (N,) [rad]: with backlash in the model they depend on the approach.
    """

    name: str
    commands: IsoCommands
    position_M: Mapping[str, Array]
    frame: Mapping[str, Array]
    q: Mapping[tuple[str, str], Array]
    rotation_M: Mapping[str, Array] = field(default_factory=dict)

    def place(self, test: IsoTest, pose: str, approach: str = "", speed: float = 0.0) -> Place:
        """Return the place of a pose of this arm alone."""
        return Place(test, self.commands, (self.name,), (pose,), approach, speed)


@dataclass(frozen=True, eq=False)
class Measured:
    """One measured visit: arm -> SMR position (3,) [m] and its covariance (3, 3) [m^2] as the tracker states it.

    ``group`` is the index of the group in a drift test, ``time_s`` is on the cell's clock, ``temperature_c`` is that of
    the air. ``turned``: arm with a probe -> its quaternion (4,) and standard uncertainty [rad].
    """

    place: Place
    cycle: int
    p_M: Mapping[str, Array]
    covariance_M: Mapping[str, Array]
    time_s: float
    temperature_c: float | None
    group: int = 0
    turned: Mapping[str, tuple[Array, float]] = field(default_factory=dict)


@dataclass(eq=False)
class Measurements:
    """All measured visits, in order."""

    visits: list[Measured] = field(default_factory=list)

    def at(self, place: Place, group: int = 0) -> list[Measured]:
        """Return the visits of one place, one for each measured cycle."""
        return [one for one in self.visits if one.place == place and one.group == group]

    def groups(self, place: Place) -> list[int]:
        """Return the indices of the measured groups of a drift test."""
        return sorted({one.group for one in self.visits if one.place == place})


def pose_characteristics(
    arm: ArmProgramme,
    measured: Measurements,
    base_M: Array,
    rng: np.random.Generator,
    speed: float = 0.0,
) -> tuple[PoseCharacteristics, ...]:
    """Compute AP and RP at each pose measured twice or more; ``base_M`` (3, 3) is the rotation of the base in M.

    ``speed`` is as in ``Place``.
    """
    found = []
    for pose in POSES:
        visits = measured.at(arm.place("pose", pose, speed=speed))
        cycles = _cycles(arm, pose, visits)
        if cycles is not None:
            own = _pose(pose, cycles, base_M, rng)
            found.append(own.model_copy(update={"orientation": _orientation(arm, pose, visits, base_M)}))
    return tuple(found)


def directional_characteristics(
    arm: ArmProgramme, measured: Measurements, base_M: Array, rng: np.random.Generator
) -> tuple[DirectionalCharacteristics, ...]:
    """Compute vAP at each pose that was measured twice or more from every direction."""
    found = []
    for pose in DIRECTIONAL_POSES:
        each = {
            direction: _cycles(arm, pose, measured.at(arm.place("multidirectional", pose, direction)))
            for direction in DIRECTIONS
        }
        cycles = [one for one in each.values() if one is not None]
        if len(cycles) == len(each):
            errors = {
                direction: _mm(accuracy_vector(one.attained, one.commanded) @ base_M)
                for direction, one in zip(each, cycles, strict=True)
            }
            value = directional_value(cycles, rng)
            found.append(DirectionalCharacteristics(pose=pose, variation=value, errors_mm=errors))
    return tuple(found)


def distance_characteristics(
    arm: ArmProgramme, measured: Measurements, rng: np.random.Generator
) -> tuple[DistanceCharacteristics, ...]:
    """Compute AD and RD between P2 and P4 from cycles in which both were measured."""
    both = [{one.cycle: one for one in measured.at(arm.place("distance", pose))} for pose in ("P2", "P4")]
    common = sorted(both[0].keys() & both[1].keys())
    first, second = (_cycles(arm, pose, [one[c] for c in common]) for pose, one in zip(("P2", "P4"), both, strict=True))
    if first is None or second is None:
        return ()
    return (_distance(("P2", "P4"), first, second, rng),)


def drift_characteristics(
    arm: ArmProgramme, measured: Measurements, base_M: Array, rng: np.random.Generator
) -> DriftCharacteristics | None:
    """Compute dAP and dRP at P1; None with fewer than two groups."""
    place = arm.place("drift", "P1")
    visits = [measured.at(place, group) for group in measured.groups(place)]
    visits = [one for one in visits if len(one) >= FEWEST_CYCLES]
    if len(visits) < 2:
        return None
    cycles = [one for own in visits if (one := _cycles(arm, "P1", own)) is not None]
    began_s = visits[0][0].time_s
    groups = tuple(_group(one, own, began_s, base_M) for one, own in zip(cycles, visits, strict=True))
    accuracy, repeatability = drift_values(cycles, rng)
    means = np.array([one.attained.mean(axis=0) for one in cycles])
    return DriftCharacteristics(
        pose="P1",
        minutes=groups[-1].minutes,
        accuracy=accuracy,
        repeatability=repeatability,
        shift_mm=float(np.linalg.norm(means - means[0], axis=1).max()) * 1e3,
        groups=groups,
    )


def cooperative_characteristics(
    programmes: tuple[ArmProgramme, ArmProgramme], measured: Measurements, rng: np.random.Generator
) -> tuple[tuple[PoseCharacteristics, ...], tuple[DistanceCharacteristics, ...]]:
    """Compute accuracy and repeatability of the vector between two SMRs, and of its length, at each pair of poses."""
    first, second = programmes
    names = (first.name, second.name)
    places = dict.fromkeys(
        one.place
        for one in measured.visits
        if one.place.test == "cooperative" and one.place.arms == names and one.place.commands == first.commands
    )
    vectors, lengths = [], []
    for place in places:
        visits = [one for one in measured.at(place) if len(one.p_M) == 2]
        a, b = (_cycles(arm, pose, visits) for arm, pose in zip(programmes, place.poses, strict=True))
        if a is None or b is None:
            continue
        vector = Cycles(b.attained - a.attained, b.commanded - a.commanded, a.tracker + b.tracker, a.frame + b.frame)
        vectors.append(_pose("+".join(place.poses), vector, np.eye(3), rng))
        ends_of = f"{names[0]} {place.poses[0]}", f"{names[1]} {place.poses[1]}"
        lengths.append(_distance(ends_of, a, b, rng))
    return tuple(vectors), tuple(lengths)


def orientation_characteristics(
    attained: Sequence[Array], commanded_M: Array, base_M: Array, sigma_rad: Sequence[float]
) -> OrientationCharacteristics | None:
    """Compute accuracy and repeatability of orientation at one pose (7.2.1, 7.2.2); None with fewer than two cycles.

    The standard takes differences of three angles between attained and commanded orientation. Here they are the
    components of the rotation vector from the commanded to the attained orientation, about the axes of the arm's base.
    To first order this is the same, and no choice of angles can be singular at the commanded orientation.

    Parameters
    ----------
    attained : sequence of n arrays, shape (4,)
        Measured orientations of the probe in the tracker frame, unit quaternions, scalar first.
    commanded_M : array, shape (3, 3)
        Commanded orientation of the probe in the tracker frame.
    base_M : array, shape (3, 3)
        Rotation of the base in the tracker frame.
    sigma_rad : sequence of n float
        Standard uncertainty of each orientation about each axis [rad]; for the uncertainty of the accuracy, all of it
        is taken as common to the cycles.
    """
    n = len(attained)
    if n < FEWEST_CYCLES:
        return None
    off = rotation_vectors(rotations_of(attained) @ commanded_M.T) @ base_M
    scatter = off.std(axis=0, ddof=1)
    largest = float(scatter.max())
    accuracy = math.hypot(coverage_of_mean(n) * largest, _COVERAGE * float(np.mean(sigma_rad)))
    return OrientationCharacteristics(
        accuracy_mrad=xyz_of(1e3 * off.mean(axis=0)),
        accuracy_expanded_mrad=1e3 * accuracy,
        repeatability_mrad=xyz_of(3e3 * scatter),
        repeatability_expanded_mrad=_COVERAGE * 3e3 * largest / math.sqrt(2.0 * (n - 1)),
        n=n,
        deviations_mrad=tuple(xyz_of(1e3 * one) for one in off),
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _cycles(arm: ArmProgramme, pose: str, visits: Sequence[Measured]) -> Cycles | None:
    """Collect the cycles of one position; None with fewer than two."""
    own = [one for one in visits if arm.name in one.p_M]
    if len(own) < FEWEST_CYCLES:
        return None
    return Cycles(
        attained=np.array([one.p_M[arm.name] for one in own]),
        commanded=arm.position_M[pose],
        tracker=np.mean([one.covariance_M[arm.name] for one in own], axis=0),
        frame=arm.frame[pose],
    )


def _pose(pose: str, cycles: Cycles, axes_M: Array, rng: np.random.Generator) -> PoseCharacteristics:
    accuracy = accuracy_value(cycles, rng)
    repeatability, tracker = repeatability_value(cycles, rng)
    return PoseCharacteristics(
        pose=pose,
        error_mm=_mm(accuracy_vector(cycles.attained, cycles.commanded) @ axes_M),
        accuracy=accuracy,
        repeatability=repeatability,
        deviations_mm=tuple(_mm(one) for one in (cycles.attained - cycles.commanded) @ axes_M),
        tracker_rp_mm=tracker * 1e3,
    )


def _orientation(
    arm: ArmProgramme, pose: str, visits: Sequence[Measured], base_M: Array
) -> OrientationCharacteristics | None:
    turned = [one.turned[arm.name] for one in visits if arm.name in one.turned]
    if pose not in arm.rotation_M or not turned:
        return None
    attained, sigma_rad = zip(*turned, strict=True)
    return orientation_characteristics(attained, arm.rotation_M[pose], base_M, sigma_rad)


def _distance(
    between: tuple[str, str], first: Cycles, second: Cycles, rng: np.random.Generator
) -> DistanceCharacteristics:
    accuracy, repeatability = distance_values(first, second, rng)
    wanted = float(np.linalg.norm(second.commanded - first.commanded))
    errors = distances(first.attained, second.attained) - wanted
    return DistanceCharacteristics(
        between=between,
        commanded_mm=wanted * 1e3,
        accuracy=accuracy,
        repeatability=repeatability,
        errors_mm=tuple((errors * 1e3).tolist()),
    )


def _group(cycles: Cycles, visits: Sequence[Measured], began_s: float, base_M: Array) -> DriftGroup:
    air = [one.temperature_c for one in visits if one.temperature_c is not None]
    return DriftGroup(
        minutes=(visits[0].time_s - began_s) / _MINUTE_S,
        accuracy_mm=float(pose_accuracy(cycles.attained, cycles.commanded)) * 1e3,
        repeatability_mm=float(pose_repeatability(cycles.attained)) * 1e3,
        error_mm=_mm(accuracy_vector(cycles.attained, cycles.commanded) @ base_M),
        n=cycles.n,
        temperature_c=float(np.mean(air)) if air else None,
    )


def _mm(vector: Array) -> tuple[float, float, float]:
    return xyz_of(vector * 1e3)
