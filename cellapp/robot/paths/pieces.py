"""Pieces of a Cartesian path, parametrised by arc length: lines, arcs, and curves that round a corner."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.interpolate import BPoly

from cellapp.robot.kinematics.transforms import Array

_BLEND_SAMPLES = 2049
"""Number of samples of a rounded corner: the interpolation error is about 1e-6 of the blend."""


class Piece(Protocol):
    """A curve in space; ``x`` (n,) is the arc length from its beginning [m]."""

    @property
    def length(self) -> float:
        """Arc length [m]."""

    def positions(self, x: Array) -> Array:
        """Points (n, 3) [m]; beyond the ends the curve goes on."""

    def tangents(self, x: Array) -> Array:
        """Unit tangents (n, 3)."""

    def along(self, x: Array) -> Array:
        """Fraction (n,) of the piece, 0 to 1, by which rotations are interpolated."""


@dataclass(frozen=True, eq=False)
class Line:
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

    def along(self, x: Array) -> Array:
        """Share of the course."""
        return np.asarray(x / self.length)


@dataclass(frozen=True, eq=False)
class Arc:
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

    def along(self, x: Array) -> Array:
        """Share of the course."""
        return np.asarray(x / self.length)


@dataclass(frozen=True, eq=False)
class Part:
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

    def along(self, x: Array) -> Array:
        """Share of the course."""
        return np.asarray(x / self.length)


@dataclass(frozen=True, eq=False)
class Blend:
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
    def _curve(self) -> BPoly:
        return BPoly(self.control[:, None, :], [0.0, 1.0])

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
