"""Export all arms to one JSON file: URDF joint origins, and differences of the D-H rows with the error they leave.

``formats`` has a format for each program, including exact UR deltas; this file is kept for programs that read it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from cellapp.cell.exports.urdf import joint_origins
from cellapp.ground.results import Record, Result
from cellapp.robot.kinematics.chain import Geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array, rpy_of, xyz_of
from cellapp.robot.model.model import CellModel

_CONFIGURATIONS = 2000
"""Number of random configurations for the error of UR's deltas: they give its rms to 2 %."""


class UrdfJoint(Record):
    """Origin of one URDF joint: position [m], roll, pitch, yaw [rad], rotation axis."""

    name: str
    type: Literal["revolute", "fixed"]
    xyz_m: tuple[float, float, float]
    rpy_rad: tuple[float, float, float]
    axis: tuple[int, int, int] = (0, 0, 1)


class LostError(Record):
    """Position error [mm] of the SMR over random configurations."""

    rms: float
    max: float


class LostParameters(Record):
    """Parameters that differences row by row cannot hold, and the position error without them."""

    beta_rad: Mapping[str, float]
    position_mm: LostError
    reason: str = "a plain D-H row has no rotation about y; 'cellapp export --as ur-calibration' converts it exactly"


class UrDeltas(Record):
    """Differences of the D-H rows, and what they lose without the Hayati angles."""

    delta_theta_rad: tuple[float, ...]
    delta_a_m: tuple[float, ...]
    delta_d_m: tuple[float, ...]
    delta_alpha_rad: tuple[float, ...]
    lost: LostParameters


class ArmGeometry(Record):
    """One arm as URDF values and as UR deltas; ``not_exported`` are model parts that neither can hold."""

    urdf: tuple[UrdfJoint, ...]
    ur_deltas: UrDeltas
    smr_in_flange_m: tuple[float, float, float]
    not_exported: tuple[str, ...]


class GeometryExport(Result, schema="cellapp-geometry"):
    """The file of ``export --geometry``."""

    arms: Mapping[str, ArmGeometry]


def geometry_export(model: CellModel, published: Mapping[str, Array]) -> GeometryExport:
    """Return every arm of a calibrated cell as URDF values and as UR deltas to its ``published`` rows (N, 4)."""
    return GeometryExport(
        arms={
            name: ArmGeometry(
                urdf=urdf_joints(arm.geometry),
                ur_deltas=ur_deltas(published[name], arm.geometry),
                smr_in_flange_m=xyz_of(arm.geometry.tool),
                not_exported=(
                    *(term.slug for term in arm.effects),
                    *(["residual network"] if arm.network is not None else []),
                ),
            )
            for name, arm in model.arms.items()
        }
    )


def urdf_joints(geometry: Geometry) -> tuple[UrdfJoint, ...]:
    """Return the origins of URDF joints, each rotating about its own z, and of the fixed flange after the last joint.

    A URDF joint is ``trans(xyz) rot_z(yaw) rot_y(pitch) rot_x(roll) rot_z(q)``.
    """
    *joints, flange = joint_origins(geometry)
    return (
        *(_origin(f"joint_{number}", "revolute", origin) for number, origin in enumerate(joints, start=1)),
        _origin("flange", "fixed", flange),
    )


def _origin(name: str, kind: Literal["revolute", "fixed"], T: Array) -> UrdfJoint:
    return UrdfJoint(name=name, type=kind, xyz_m=xyz_of(T[:3, 3]), rpy_rad=rpy_of(T[:3, :3]))


def ur_deltas(published: Array, identified: Geometry) -> UrDeltas:
    """Return ``delta_theta``, ``delta_a``, ``delta_d``, ``delta_alpha`` as in UR's calibration file, and their loss.

    They are relative to ``published`` rows (N, 4): theta, d, a, alpha [rad, m].

    UR's tables have no Hayati angle beta. ``lost`` states each beta and the position error without them, over random
    configurations within one turn of each joint.
    """
    delta = identified.rows[:, :4] - published
    rows = identified.rows.copy()
    rows[:, 4] = 0.0
    without = replace(identified, rows=rows)
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (_CONFIGURATIONS, identified.joints))
    off = np.linalg.norm(smr_positions(without, q) - smr_positions(identified, q), axis=1) * 1e3
    betas = {f"beta{i + 1}": beta for i, beta in enumerate(identified.rows[:, 4].tolist()) if beta != 0.0}
    return UrDeltas(
        delta_theta_rad=tuple(delta[:, 0].tolist()),
        delta_a_m=tuple(delta[:, 2].tolist()),
        delta_d_m=tuple(delta[:, 1].tolist()),
        delta_alpha_rad=tuple(delta[:, 3].tolist()),
        lost=LostParameters(
            beta_rad=betas,
            position_mm=LostError(rms=float(np.sqrt(np.mean(off**2))), max=float(off.max())),
        ),
    )
