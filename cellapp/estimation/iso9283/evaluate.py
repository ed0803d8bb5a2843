"""Compute the characteristics of each arm and each pair of arms from measured positions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from cellapp.estimation.iso9283.characteristics import (
    DIRECTIONAL_POSES,
    DIRECTIONS,
    FEWEST_CYCLES,
    POSES,
    Cycles,
    accuracy_value,
    accuracy_vector,
    coverage_of_mean,
    directional_value,
    distance_values,
    distances,
    drift_values,
    path_values,
    plane_crossings,
    pose_accuracy,
    pose_repeatability,
    repeatability_value,
    speeds,
    velocity_accuracy,
    velocity_fluctuation,
    velocity_repeatability,
)
from cellapp.estimation.iso9283.norm import IsoCommands, IsoTest
from cellapp.estimation.iso9283.records import (
    DirectionalCharacteristics,
    DistanceCharacteristics,
    DriftCharacteristics,
    DriftGroup,
    OrientationCharacteristics,
    PathCharacteristics,
    PathVelocity,
    PoseCharacteristics,
)
from cellapp.estimation.uncertainty.budget import COVERAGE
from cellapp.robot.kinematics.transforms import Array, quaternions_of, rotation_vectors, rotations_of, xyz_of
from cellapp.robot.paths.cartesian import CartesianPath

_MINUTE_S = 60.0


@dataclass(frozen=True)
class IsoPlace:
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

    def place(self, test: IsoTest, pose: str, approach: str = "", speed: float = 0.0) -> IsoPlace:
        """Return the place of a pose of this arm alone."""
        return IsoPlace(test, self.commands, (self.name,), (pose,), approach, speed)


@dataclass(frozen=True, eq=False)
class MeasuredVisit:
    """One measured visit: arm -> SMR position (3,) [m] and its covariance (3, 3) [m^2] as the tracker states it.

    ``group`` is the index of the group in a drift test, ``time_s`` is on the cell's clock, ``temperature_c`` is that of
    the air. ``orientations``: arm with a probe -> its quaternion (4,) and standard uncertainty [rad].
    """

    place: IsoPlace
    cycle: int
    p_M: Mapping[str, Array]
    covariance_M: Mapping[str, Array]
    time_s: float
    temperature_c: float | None
    group: int = 0
    orientations: Mapping[str, tuple[Array, float]] = field(default_factory=dict)


@dataclass(eq=False)
class Measurements:
    """All measured visits, in order."""

    visits: list[MeasuredVisit] = field(default_factory=list)

    def at(self, place: IsoPlace, group: int = 0) -> list[MeasuredVisit]:
        """Return the visits of one place, one for each measured cycle."""
        return [one for one in self.visits if one.place == place and one.group == group]

    def groups(self, place: IsoPlace) -> list[int]:
        """Return the indices of the measured groups of a drift test."""
        return sorted({one.group for one in self.visits if one.place == place})


def pose_characteristics(
    arm: ArmProgramme, measured: Measurements, base_M: Array, rng: np.random.Generator, speed: float = 0.0
) -> tuple[PoseCharacteristics, ...]:
    """Compute AP and RP at each pose measured twice or more; ``base_M`` (3, 3) is the rotation of the base in M.

    ``speed`` is as in ``IsoPlace``.
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
    accuracy = math.hypot(coverage_of_mean(n) * largest, COVERAGE * float(np.mean(sigma_rad)))
    return OrientationCharacteristics(
        accuracy_mrad=xyz_of(1e3 * off.mean(axis=0)),
        accuracy_expanded_mrad=1e3 * accuracy,
        repeatability_mrad=xyz_of(3e3 * scatter),
        repeatability_expanded_mrad=COVERAGE * 3e3 * largest / math.sqrt(2.0 * (n - 1)),
        n=n,
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _cycles(arm: ArmProgramme, pose: str, visits: Sequence[MeasuredVisit]) -> Cycles | None:
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
        tracker_rp_mm=tracker * 1e3,
    )


def _orientation(
    arm: ArmProgramme, pose: str, visits: Sequence[MeasuredVisit], base_M: Array
) -> OrientationCharacteristics | None:
    orientations = [one.orientations[arm.name] for one in visits if arm.name in one.orientations]
    if pose not in arm.rotation_M or not orientations:
        return None
    attained, sigma_rad = zip(*orientations, strict=True)
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


def _group(cycles: Cycles, visits: Sequence[MeasuredVisit], began_s: float, base_M: Array) -> DriftGroup:
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


# -- Compute the characteristics of a path, AT, RT and velocity, from points measured along it ------------------------

_SAME_STRETCH_M = 0.02
"""Distance up to which a crossing belongs to its point: no arm is farther off, but the far side of a closed path is."""
_MIDDLE = (0.25, 0.75)
"""Shares of a path's length between which the velocity is evaluated: no ramp reaches there."""
_SAMPLES = 200
_PLACES = 50
"""Number of positions along each path where it is evaluated; the standard requires at least ten."""
_ENDS = 0.02
"""Fraction of the path left out at each end: the arm is at rest there, and no plane is crossed."""


@dataclass(frozen=True, eq=False)
class PathTrack:
    """Measured points of one cycle along a path: times (k,) [s] and positions (k, 3) [m], in order.

    ``lost_beams`` is the number of earlier attempts at the cycle that ended because the beam broke.
    """

    time_s: Array
    p_M: Array
    lost_beams: int = 0


@dataclass(frozen=True, eq=False)
class PathRuns:
    """Path that was driven several times.

    Attributes
    ----------
    arm, commands, name : str
    speed : float
        Commanded speed [m/s].
    path : CartesianPath
        The commanded path.
    tracker, frame : array, shape (3, 3)
        Covariances as in ``Cycles`` [m^2].
    wanted : int
        Requested number of cycles.
    slowed : str
        Why the planned motion does not keep the commanded speed; empty if it does.
    series : float
        Share of the profile's speed if the test is repeated at another speed, else 0.
    tracks : list of PathTrack
        One for each cycle.
    problems : list of str
        Why fewer cycles were driven.
    """

    arm: str
    commands: IsoCommands
    name: str
    speed: float
    path: CartesianPath
    tracker: Array
    frame: Array
    wanted: int
    slowed: str = ""
    series: float = 0.0
    tracks: list[PathTrack] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    @cached_property
    def places(self) -> tuple[Array, Array, Array]:
        """Arc lengths (m,) [m], positions (m, 3) [m] and unit tangents (m, 3) where the path is evaluated."""
        length = self.path.length
        s, half = length * np.linspace(_ENDS, 1.0 - _ENDS, _PLACES), 1e-4 * length
        chord = self.path.positions(s + half) - self.path.positions(s - half)
        return s, self.path.positions(s), chord / np.linalg.norm(chord, axis=1, keepdims=True)


def path_characteristics(runs: PathRuns, rng: np.random.Generator) -> PathCharacteristics | None:
    """Compute velocity, and AT and RT over the points whose planes every cycle crossed; None with fewer than
    two cycles."""
    if len(runs.tracks) < FEWEST_CYCLES:
        return None
    points = [np.column_stack([one.p_M, one.time_s]) for one in runs.tracks]
    _, commanded_M, tangents_M = runs.places
    crossed = np.stack([plane_crossings(one, commanded_M, tangents_M, _SAME_STRETCH_M) for one in points], axis=1)
    kept = np.isfinite(crossed).all(axis=(1, 2))
    if not kept.any():
        return None
    places = crossed[kept, :, :3]
    accuracy, repeatability = path_values(places, commanded_M[kept], runs.tracker, runs.frame, rng)
    return PathCharacteristics(
        path=runs.name,
        speed_mm_s=runs.speed * 1e3,
        length_mm=runs.path.length * 1e3,
        points=int(kept.sum()),
        accuracy=accuracy,
        repeatability=repeatability,
        velocity=_velocity(runs, crossed[:, :, 3].T, rng),
        slowed=runs.slowed,
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _velocity(runs: PathRuns, times: Array, rng: np.random.Generator) -> PathVelocity | None:
    """Compute AV, RV and FV over the middle half of a path; None if a plane there was not crossed."""
    s, _, tangents_M = runs.places
    middle = (s >= _MIDDLE[0] * runs.path.length) & (s <= _MIDDLE[1] * runs.path.length)
    if middle.sum() < 3 or not np.isfinite(times[:, middle]).all():
        return None
    n, s = len(times), s[middle]
    found = speeds(times[:, middle], s)
    sigma_m = float(np.sqrt(np.einsum("ma,ab,mb->m", tangents_M, runs.tracker, tangents_M).mean()))
    noise_s = sigma_m / runs.speed * rng.standard_normal((_SAMPLES, 1, len(s)))
    even = (s - s[0]) / runs.speed
    alone = [velocity_fluctuation(speeds(even + noise, s)) for noise in noise_s]
    scatter = velocity_repeatability(found, runs.speed) / 3.0
    return PathVelocity(
        accuracy_percent=1e2 * velocity_accuracy(found, runs.speed),
        expanded_percent=1e2 * coverage_of_mean(n) * scatter,
        repeatability_percent=3e2 * scatter,
        fluctuation_mm_s=1e3 * velocity_fluctuation(found),
        tracker_fluctuation_mm_s=1e3 * float(np.mean(alone)),
        n=n,
    )


# Table of every measured point of the tests with its time, from which another program can compute the same results.
#
# A row is ``commanded``, the target position of an SMR, or ``measured``. Commanded positions appear once for each
# place of a test. Those of a path are its evaluation points, in order, with the direction of the path: the normal of
# the plane whose crossing is evaluated. Measured points of a path are all points of each cycle in order of time.

_WHERE = ("row", "test", "commands", "arm", "place", "approach", "speed_percent", "group", "cycle", "time_s")
_VECTORS = ("x_m", "y_m", "z_m", "direction_x", "direction_y", "direction_z", "quat_w", "quat_x", "quat_y", "quat_z")
HEADER = (*_WHERE, *_VECTORS)
"""Positions are in the tracker frame [m], times on the cell's clock [s]; ``cycle`` and ``group`` count from 1.
``speed_percent`` is the share of the profile's speed if a test was repeated at another speed, else empty.
Quaternions are those of a 6-D probe in the tracker frame; empty without a measured orientation."""
Row = tuple[str, ...]


def raw_rows(
    programmes: Mapping[tuple[str, IsoCommands], ArmProgramme], measured: Measurements, paths: Sequence[PathRuns]
) -> Iterator[Row]:
    """Yield all rows: commanded and measured positions at rest, then paths."""
    for place in dict.fromkeys(one.place for one in measured.visits):
        for name, pose in zip(place.arms, place.poses, strict=True):
            arm = programmes[name, place.commands]
            quaternion = quaternions_of(arm.rotation_M[pose]) if pose in arm.rotation_M else None
            yield _row("commanded", _place_cells(place, name), arm.position_M[pose], quaternion=quaternion)
    for one in measured.visits:
        for name, p_M in one.p_M.items():
            counted = (str(one.group + 1), str(one.cycle + 1), repr(float(one.time_s)))
            quaternion = one.orientations[name][0] if name in one.orientations else None
            yield _row("measured", _place_cells(one.place, name), p_M, counted, quaternion=quaternion)
    for runs in paths:
        where = ("path", runs.commands, runs.arm, runs.name, "", _percent(runs.series))
        for _, place_M, tangent_M in zip(*runs.places, strict=True):
            yield _row("commanded", where, place_M, direction=tangent_M)
        for number, track in enumerate(runs.tracks, start=1):
            for time_s, p_M in zip(track.time_s, track.p_M, strict=True):
                yield _row("measured", where, p_M, ("1", str(number), repr(float(time_s))))


def _row(
    kind: str,
    where: Row,
    p_M: Array,
    counted: Row = ("", "", ""),
    direction: Array | None = None,
    quaternion: Array | None = None,
) -> Row:
    return (kind, *where, *counted, *_numbers(p_M, 3), *_numbers(direction, 3), *_numbers(quaternion, 4))


def _place_cells(place: IsoPlace, name: str) -> tuple[str, ...]:
    return place.test, place.commands, name, "+".join(place.poses), place.approach, _percent(place.speed)


def _percent(share: float) -> str:
    return f"{100.0 * share:g}" if share else ""


def _numbers(vector: Array | None, count: int) -> Row:
    """Return the cells of numbers with all their digits; empty ones for None."""
    return ("",) * count if vector is None else tuple(repr(float(value)) for value in vector)
