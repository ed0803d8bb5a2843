"""The factory calibration of an arm: D-H rows of its axes as measured at the factory.

The factory sees the true axis lines with small errors of its own. Plain D-H rows go from common normal to common
normal. Common normals of nearly parallel axes lie far from the arm: rows of a UR arm have lengths d of hundreds of
metres with opposite signs (docs.ros.org, "ur_calibration").
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.mechanism import Mechanism, with_errors
from drivers.plant.plant import Plant

_LEAST_SINE = 1e-7
"""Axes closer to parallel than this [rad] count as parallel: the position of their common normal is undefined."""


@dataclass(frozen=True, eq=False)
class FactoryCalibration:
    """D-H rows (N, 4) theta, d, a, alpha [rad, m] that a controller computes with, and a checksum of each joint."""

    rows: Array
    checksums: tuple[int, ...]

    @property
    def checksum(self) -> str:
        """The checksums as one text, in the format of the UR arm's driver."""
        return "-".join(f"{value:08x}" for value in self.checksums)


def factory_calibration(plant: Plant, name: str) -> FactoryCalibration | None:
    """Return the calibration in the controller of an arm; None if controllers have the published rows.

    The flange is assumed to sit straight on the last axis.
    """
    config = plant.config
    if config.factory is None:
        return None
    number = plant.names.index(name)
    rng = np.random.default_rng([config.seed, 0xFAC, number])
    rows = rows_of_axes(with_errors(plant.true_mechanism(name), config.factory, rng), config.arms[number].rows)
    return FactoryCalibration(rows, tuple(zlib.crc32(row.tobytes()) for row in rows))


def rows_of_axes(mechanism: Mechanism, nominal: Array) -> Array:
    """Return plain D-H rows (N, 4) of the axes of a mechanism, each next to its published row (N, 4).

    The base frame has its z on the first axis. Its x and its origin make theta and d of the first row equal to the
    published ones; the same holds for every axis without a common normal to the next one.
    """
    directions, flange = mechanism.directions, mechanism.frames[-1]
    z, x, origin = directions[0], mechanism.frames[0][:3, 0], mechanism.points[0]
    x = _square(x, z)
    origin = origin + z * (z @ (mechanism.frames[0][:3, 3] - origin))
    rows = np.zeros((len(directions), 4))
    for i, row in enumerate(nominal):
        if i + 1 < len(directions):
            z_next = directions[i + 1]
            normal, foot, foot_next = _common_normal(z, origin, z_next, mechanism.points[i + 1], row, x)
        else:  # no axis follows: use the flange's x, as in the published row
            z_next, normal = z, _square(flange[:3, 0], z)
            foot = foot_next = origin + z * (z @ (flange[:3, 3] - origin))
        theta = np.arctan2(z @ np.cross(x, normal), x @ normal)
        alpha = np.arctan2(normal @ np.cross(z, z_next), z @ z_next)
        rows[i] = theta, z @ (foot - origin), normal @ (foot_next - foot), alpha
        x, z, origin = normal, z_next, foot_next
    rows[:, 0] += mechanism.zeros
    rows[:, [0, 3]] -= 2.0 * np.pi * np.round((rows[:, [0, 3]] - nominal[:, [0, 3]]) / (2.0 * np.pi))
    return rows


def _square(vector: Array, z: Array) -> Array:
    """Return the unit vector perpendicular to ``z`` that is nearest to ``vector``."""
    square = vector - z * (z @ vector)
    unit: Array = square / np.linalg.norm(square)
    return unit


def _common_normal(
    z: Array, origin: Array, z_next: Array, point: Array, row: Array, x: Array
) -> tuple[Array, Array, Array]:
    """Return the direction of the common normal of two axes, and its intersection with each.

    Of the two directions, choose the one nearer to the x axis after the rotation of the published ``row``. For parallel
    axes, take the normal at the published d.
    """
    side = np.cos(row[0]) * x + np.sin(row[0]) * np.cross(z, x)
    cross, between = np.cross(z, z_next), point - origin
    sine = np.linalg.norm(cross)
    if sine < _LEAST_SINE:
        foot = origin + row[1] * z
        across = point + z_next * (z_next @ (foot - point)) - foot
        far = np.linalg.norm(across)
        normal = side if far < _LEAST_SINE else across / far
        if normal @ side < 0.0:
            normal = -normal
        return normal, foot, foot + across
    normal = cross / sine
    if normal @ side < 0.0:
        normal = -normal
    along = np.cross(between, z_next) @ cross / sine**2
    along_next = np.cross(between, z) @ cross / sine**2
    return normal, origin + along * z, point + along_next * z_next
