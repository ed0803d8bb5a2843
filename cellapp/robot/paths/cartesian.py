"""Desired path in space: positions and rotations by arc length, places where it stops."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from cellapp.robot.kinematics.transforms import Array

# -- Pieces of a Cartesian path, parametrised by arc length: lines, arcs, and curves that round a corner --------------


_BLEND_SAMPLES = 2049
"""Number of samples of a rounded corner: the interpolation error is about 1e-6 of the blend."""


class Piece(ABC):
    """A curve in space; ``x`` (n,) is the arc length from its beginning [m]."""

    @property
    @abstractmethod
    def length(self) -> float:
        """Arc length [m]."""

    @abstractmethod
    def positions(self, x: Array) -> Array:
        """Points (n, 3) [m]; beyond the ends the curve goes on."""

    @abstractmethod
    def tangents(self, x: Array) -> Array:
        """Unit tangents (n, 3)."""

    def along(self, x: Array) -> Array:
        """Fraction (n,) of the piece, 0 to 1, by which rotations are interpolated."""
        return np.asarray(x / self.length)


@dataclass(frozen=True, eq=False)
class Line(Piece):
    """The straight line from ``start`` to ``end`` (3,) [m]."""

    start: Array
    end: Array

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(np.linalg.norm(self.end - self.start))

    def positions(self, x: Array) -> Array:
        """Points (n, 3) [m]."""
        return np.asarray(self.start + np.multiply.outer(x, self.end - self.start) / self.length)

    def tangents(self, x: Array) -> Array:
        """Unit tangents (n, 3)."""
        return np.tile((self.end - self.start) / self.length, (len(x), 1))


@dataclass(frozen=True, eq=False)
class Arc(Piece):
    """The arc ``center + radius (cos(phi) u + sin(phi) v)``, phi from 0 to ``angle`` [rad]; u, v orthonormal."""

    center: Array
    radius: float
    u: Array
    v: Array
    angle: float

    @classmethod
    def through(cls, start: Array, via: Array, end: Array) -> Arc:
        """Build the arc from ``start`` through ``via`` to ``end`` (3,) [m], which must not be on one line."""
        a, b = via - start, end - start
        normal = np.cross(a, b)
        square = normal @ normal
        center = start + (np.cross(normal, a) * (b @ b) + np.cross(b, normal) * (a @ a)) / (2.0 * square)
        radius = float(np.linalg.norm(start - center))
        u = (start - center) / radius
        v = np.cross(normal / np.sqrt(square), u)
        last = np.arctan2((end - center) @ v, (end - center) @ u) % (2.0 * np.pi)
        return cls(center, radius, u, v, float(last))

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return self.radius * self.angle

    def positions(self, x: Array) -> Array:
        """Points (n, 3) [m]."""
        phi = x / self.radius
        return np.asarray(
            self.center
            + self.radius * (np.multiply.outer(np.cos(phi), self.u) + np.multiply.outer(np.sin(phi), self.v))
        )

    def tangents(self, x: Array) -> Array:
        """Unit tangents (n, 3)."""
        phi = x / self.radius
        return np.asarray(np.multiply.outer(np.cos(phi), self.v) - np.multiply.outer(np.sin(phi), self.u))


@dataclass(frozen=True, eq=False)
class PathPart(Piece):
    """The part of a piece from arc length ``begin`` to ``end`` [m]."""

    whole: Piece
    begin: float
    end: float

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return self.end - self.begin

    def positions(self, x: Array) -> Array:
        """Points (n, 3) [m]."""
        return self.whole.positions(x + self.begin)

    def tangents(self, x: Array) -> Array:
        """Unit tangents (n, 3)."""
        return self.whole.tangents(x + self.begin)


@dataclass(frozen=True, eq=False)
class Blend(Piece):
    """A Bezier curve of fifth degree that rounds a corner, with the corner's tangents and no curvature at its ends.

    Attributes
    ----------
    control : array, shape (6, 3)
        Control points [m].
    """

    control: Array

    @classmethod
    def between(cls, before: Piece, after: Piece, reach: float) -> Blend:
        """Build the curve from ``reach`` [m] before the end of a piece to as much after the start of the next."""
        here, there = np.array([before.length - reach]), np.array([reach])
        start, end = before.positions(here)[0], after.positions(there)[0]
        # two fifths of the reach: the rate of the parameter at the ends is then that along the pieces
        out, into = 0.4 * reach * before.tangents(here)[0], 0.4 * reach * after.tangents(there)[0]
        return cls(np.array([start, start + out, start + 2.0 * out, end - 2.0 * into, end - into, end]))

    @cached_property
    def _curve(self) -> scipy.interpolate.BPoly:
        return scipy.interpolate.BPoly(self.control[:, None, :], [0.0, 1.0])

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        """Parameters and the arc lengths [m] at them, by Simpson's rule in each interval."""
        u = np.linspace(0.0, 1.0, _BLEND_SAMPLES)
        middle = 0.5 * (u[:-1] + u[1:])
        rate, half = (np.linalg.norm(self._curve.derivative()(t), axis=1) for t in (u, middle))
        pieces = (rate[:-1] + 4.0 * half + rate[1:]) * np.diff(u) / 6.0
        return u, np.concatenate([[0.0], np.cumsum(pieces)])

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(self._table[1][-1])

    def along(self, x: Array) -> Array:
        """The parameter of the curve, 0 to 1."""
        u, lengths = self._table
        return np.interp(x, lengths, u)

    def positions(self, x: Array) -> Array:
        """Points (n, 3) [m]."""
        return np.asarray(self._curve(self.along(x)))

    def tangents(self, x: Array) -> Array:
        """Unit tangents (n, 3)."""
        rate = self._curve.derivative()(self.along(x))
        return np.asarray(rate / np.linalg.norm(rate, axis=1, keepdims=True))


_CORNER_RAD = 1e-3
"""Change of direction above which two pieces meet in a corner, at which the arm stops."""
_ROTATION_CORNER_RAD_M = 0.02
"""Change of the rotation per length that counts as a corner: 2 mrad/s at 100 mm/s."""


@dataclass(frozen=True, eq=False)
class Course:
    """A piece of the path with its rotations.

    Attributes
    ----------
    piece : Piece
    before, after : int
        Indices of the segments (from one given pose to the next) that it belongs to; different if it rounds a corner.
    sigma : tuple of two float
        Arc lengths of its ends along the path without rounded corners [m]; rotations are interpolated by them.
    """

    piece: Piece
    before: int
    after: int
    sigma: tuple[float, float]


@dataclass(frozen=True, eq=False)
class CartesianPath:
    """A path in the tracker frame M; ``s`` (n,) is the arc length from its beginning [m].

    Attributes
    ----------
    courses : tuple of Course
    begins : array, shape (k + 1,)
        Arc lengths at which the courses begin, and the length of the path [m].
    corners : array, shape (k + 1,)
        Arc lengths of the given poses on the path without rounded corners [m].
    rotations : array, shape (k + 1, 3, 3)
        Flange rotations of the given poses in M.
    speeds : array, shape (k,)
        Wanted speed of each segment [m/s].
    """

    courses: tuple[Course, ...]
    begins: Array
    corners: Array
    rotations: Array
    speeds: Array

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(self.begins[-1])

    def positions(self, s: Array) -> Array:
        """Points (n, 3) [m]."""
        found = np.empty((len(s), 3))
        for course, rows, x in self._on_courses(s):
            found[rows] = course.piece.positions(x)
        return found

    def poses(self, s: Array) -> tuple[Array, Array]:
        """Points (n, 3) [m] and flange rotations (n, 3, 3)."""
        rotated = np.empty((len(s), 3, 3))
        for course, rows, x in self._on_courses(s):
            rotated[rows] = self._rotations(course, course.piece.along(x))
        return self.positions(s), rotated

    def wanted_speed(self, s: Array) -> Array:
        """Wanted speed (n,) [m/s]."""
        found = np.empty(len(s))
        for course, rows, x in self._on_courses(s):
            second = course.piece.along(x) > 0.5
            found[rows] = np.where(second, self.speeds[course.after], self.speeds[course.before])
        return found

    @cached_property
    def stops(self) -> Array:
        """Arc lengths [m] of the beginning, the corners that are not rounded, and the end."""
        stops = [0.0]
        for number in range(1, len(self.courses)):
            if self._is_corner(self.courses[number - 1], self.courses[number]):
                stops.append(float(self.begins[number]))
        return np.array([*stops, self.length])

    def _on_courses(self, s: Array) -> list[tuple[Course, np.ndarray, Array]]:
        number = np.clip(np.searchsorted(self.begins, s, side="right") - 1, 0, len(self.courses) - 1)
        found = []
        for k in np.unique(number):
            rows = np.flatnonzero(number == k)
            found.append((self.courses[k], rows, s[rows] - self.begins[k]))
        return found

    def _rotations(self, course: Course, along: Array) -> Array:
        sigma = course.sigma[0] + along * (course.sigma[1] - course.sigma[0])
        first = self._of_segment(course.before, sigma)
        if course.before == course.after:
            return np.asarray(first.as_matrix())
        share = along**3 * (10.0 - along * (15.0 - 6.0 * along))  # both rates are continuous at the ends
        between = (first.inv() * self._of_segment(course.after, sigma)).as_rotvec()
        return np.asarray((first * scipy.spatial.transform.Rotation.from_rotvec(share[:, None] * between)).as_matrix())

    def _of_segment(self, number: int, sigma: Array) -> scipy.spatial.transform.Rotation:
        """Compute rotations of one segment, extended beyond its ends at its constant rate."""
        start = scipy.spatial.transform.Rotation.from_matrix(self.rotations[number])
        return start * scipy.spatial.transform.Rotation.from_rotvec(
            np.multiply.outer(sigma - self.corners[number], self._rotation_rate(number))
        )

    def _rotation_rate(self, number: int) -> Array:
        """Compute the rotation vector per length of a segment in the rotating frame, (3,) [rad/m]."""
        start, end = scipy.spatial.transform.Rotation.from_matrix(self.rotations[number : number + 2])
        return np.asarray((start.inv() * end).as_rotvec() / (self.corners[number + 1] - self.corners[number]))

    def _is_corner(self, before: Course, after: Course) -> bool:
        ends = before.piece.tangents(np.array([before.piece.length]))[0], after.piece.tangents(np.zeros(1))[0]
        if np.linalg.norm(ends[1] - ends[0]) > _CORNER_RAD:
            return True
        change = self._rotation_rate(after.before) - self._rotation_rate(before.after)
        return bool(np.linalg.norm(change) > _ROTATION_CORNER_RAD_M)


def cartesian_path(
    positions: Array, rotations: Array, vias: Sequence[Array | None], blends: Sequence[float], speeds: Array
) -> CartesianPath:
    """Build the path through given poses.

    Parameters
    ----------
    positions, rotations : arrays, shapes (k + 1, 3), (k + 1, 3, 3)
        Points [m] and flange rotations in M.
    vias : sequence of k arrays, shape (3,), or None
        Intermediate point of the arc to each pose but the first; None for a straight line.
    blends : sequence of k + 1 float
        Distance from each pose over which its corner is rounded [m]; those of the first and last pose are 0.
    speeds : array, shape (k,)
        Of each segment [m/s].
    """
    segments: list[Piece] = [
        Line(start, end) if via is None else Arc.through(start, via, end)
        for start, via, end in zip(positions[:-1], vias, positions[1:], strict=True)
    ]
    corners = np.concatenate([[0.0], np.cumsum([segment.length for segment in segments])])
    courses: list[Course] = []
    for number, segment in enumerate(segments):
        begin, end = blends[number], segment.length - blends[number + 1]
        at = corners[number]
        if end - begin > 0.0:
            courses.append(Course(PathPart(segment, begin, end), number, number, (at + begin, at + end)))
        if blends[number + 1] > 0.0:
            reach, corner = blends[number + 1], corners[number + 1]
            rounded = Blend.between(segment, segments[number + 1], reach)
            courses.append(Course(rounded, number, number + 1, (corner - reach, corner + reach)))
    begins = np.concatenate([[0.0], np.cumsum([course.piece.length for course in courses])])
    return CartesianPath(tuple(courses), begins, corners, rotations, np.asarray(speeds, dtype=np.float64))
