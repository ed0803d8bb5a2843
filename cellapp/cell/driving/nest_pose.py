"""Determine the orientation of a flange at rest from several SMRs: measure the arm's SMR, then the further nests."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.driving.motion import Mover, Vector
from cellapp.cell.driving.nests import Nests
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.nests import has_nests, nest_offsets, nest_stops
from cellapp.cell.safety.gate import CellBodies
from cellapp.estimation.nests import NestShape, poses
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import quaternions_of, rotation_from_vector
from cellapp.robot.model import CellModel
from drivers.trackers.protocol import Point, TargetLost, Unstable, WrongTarget

_FITS = 5.0
"""Largest misfit between shape and measured nests, in standard deviations of a coordinate. Above it no orientation is
stated: a nest was moved, or another SMR was measured."""


@dataclass(frozen=True, eq=False)
class NestPoses:
    """Measures arms at rest, with the orientation if the nests of an arm have a known shape.

    ``shapes`` are by arm; ``nests`` tells which nests the tracker sees, and where.
    """

    shapes: Mapping[str, NestShape]
    nests: Nests

    @classmethod
    def of(
        cls, profile: Profile, model: CellModel | None, bodies: CellBodies, found: Mapping[str, NestShape]
    ) -> NestPoses:
        """Use the shapes ``found`` from the readings of ``model``'s calibration, else the profile's nests."""
        shapes, offsets = {}, {}
        for name, arm in profile.arms.items():
            if len(arm.smr.names) < 3:
                continue
            geometry = None if model is None else model.arms[name].geometry
            if geometry is not None and name in found and geometry.probe is not None:
                shape = found[name]
                offsets_F = geometry.tool + shape.points_S @ rotation_from_vector(geometry.probe).T
            else:
                offsets_F = nest_offsets(arm.smr)
                shape = NestShape(arm.smr.names, offsets_F - offsets_F[0], float("nan"))
            if np.isfinite(offsets_F).all() and shape.spans:
                shapes[name], offsets[name] = shape, dict(zip(arm.smr.names, offsets_F, strict=True))
        return cls(shapes, Nests.of(profile, bodies, offsets))

    def measure(self, mover: Mover, name: str, q: Vector) -> Point:
        """Measure the SMR of an arm at rest at ``q`` (N,) [rad], then its nests. Raise as ``Mover.measure``."""
        return self.turned(mover, name, q, mover.measure(name, q))

    def turned(self, mover: Mover, name: str, q: Vector, point: Point) -> Point:
        """Measure the nests of an arm at rest at ``q`` (N,) [rad]; return ``point`` with the resulting orientation."""
        shape = self.shapes.get(name)
        if shape is None or point.quaternion_M is not None:
            return point
        measured = {shape.names[0]: point}
        for nest, expected_M in self.nests.in_order(name, {**mover.positions(), name: q}):
            with suppress(TargetLost, WrongTarget, Unstable):
                measured[nest] = mover.measure_at(expected_M, f"nest {nest} of arm {name}")
        return turned_by(shape, measured)


def nest_shapes(run: RunFile) -> dict[str, NestShape]:
    """Return the shapes of nests, by arm, of a run with readings of several nests that determine one."""
    own = {name: run.rows(name) for name in run.arms()}
    found = {name: nest_stops(run.profile, name, rows).shape for name, rows in own.items() if has_nests(rows)}
    return {name: shape for name, shape in found.items() if shape is not None}


def turned_by(shape: NestShape, measured: Mapping[str, Point]) -> Point:
    """Return the point of the first nest with the orientation of the shape, if three measured nests fit it.

    Its standard uncertainty is that about the least certain axis.
    """
    point = measured[shape.names[0]]
    if len(measured) < 3:
        return point
    p_M, information = np.full((1, len(shape.names), 3), np.nan), np.zeros((1, len(shape.names), 3, 3))
    for place, nest in enumerate(shape.names):
        if nest in measured:
            p_M[0, place] = measured[nest].p_M
            information[0, place] = np.linalg.inv(measured[nest].covariance_M)
    rotation, origin, covariance = poses(shape.points_S, p_M, information)
    if np.isfinite(shape.noise_m):  # NaN if no readings show the scatter of the shape
        left = np.nan_to_num(p_M[0] - origin[0] - shape.points_S @ rotation[0].T)
        square = float(np.einsum("ka,kab,kb->", left, information[0], left))
        noise_m = np.sqrt(np.mean([np.trace(one.covariance_M) for one in measured.values()]) / 3.0)
        worse = max(shape.noise_m / noise_m, 1.0)
        if square > 3.0 * len(measured) * (_FITS * worse) ** 2:
            return replace(point, quality=(*point.quality, "the nests do not stand as at the calibration"))
    return replace(
        point,
        quaternion_M=quaternions_of(rotation[0]),
        sigma_rad=float(np.sqrt(np.linalg.eigvalsh(covariance[0, 3:, 3:])[-1])),
    )
