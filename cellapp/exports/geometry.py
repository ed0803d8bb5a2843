"""An identified geometry in other programs' words: URDF joint origins, and UR's own D-H deltas with what they lose."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellapp.kinematics.chain import Geometry, smr_positions
from cellapp.kinematics.transforms import Array, rotation_x, rotation_y, rotation_z, transform, zyx_angles
from cellapp.model.model import CellModel


def geometry_export(model: CellModel) -> dict[str, Any]:
    """The object that ``export --geometry`` writes: every arm as URDF values and as UR deltas."""
    return {
        "schema": "cellapp-geometry",
        "version": 1,
        "arms": {
            name: {
                "urdf": urdf_joints(arm.geometry),
                "ur_deltas": ur_deltas(arm.nominal, arm.geometry),
                "smr_in_flange_m": arm.geometry.tool.tolist(),
                "not_exported": [term.slug for term in arm.effects]
                + (["residual network"] if arm.network is not None else []),
            }
            for name, arm in model.arms.items()
        },
    }


def urdf_joints(geometry: Geometry) -> list[dict[str, Any]]:
    """Origins of URDF joints, each turning about its own z, and of the fixed flange behind the last.

    A URDF joint is ``trans(xyz) rot_z(yaw) rot_y(pitch) rot_x(roll) rot_z(q)``; a row's part behind its joint, with the
    next joint's theta, is the next joint's origin. Exact for any row, beta included.
    """
    behind = np.eye(4)
    joints = []
    for number, (theta, d, a, alpha, beta) in enumerate(geometry.rows, start=1):
        joints.append(_origin(f"joint_{number}", "revolute", behind @ transform(rotation_z(theta), np.zeros(3))))
        behind = transform(rotation_x(alpha) @ rotation_y(beta), [a, 0.0, d])
    joints.append(_origin("flange", "fixed", behind))
    return joints


def _origin(name: str, kind: str, T: Array) -> dict[str, Any]:
    yaw, pitch, roll = zyx_angles(T[:3, :3])
    return {"name": name, "type": kind, "xyz_m": T[:3, 3].tolist(), "rpy_rad": [roll, pitch, yaw], "axis": [0, 0, 1]}


def ur_deltas(nominal: Geometry, identified: Geometry) -> dict[str, Any]:
    """``delta_theta``, ``delta_a``, ``delta_d``, ``delta_alpha`` as in UR's calibration file, and what they lose.

    Those tables have no beta. ``lost`` names each beta and how far the SMR goes astray without it: root mean square and
    maximum over 2000 random configurations of one turn a joint [mm].
    """
    delta = identified.rows - nominal.rows
    vector = identified.vector()
    vector[6:-3].reshape(-1, 5)[:, 4] = 0.0
    without = identified.with_vector(vector)
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (2000, identified.joints))
    off = np.linalg.norm(smr_positions(without, q) - smr_positions(identified, q), axis=1) * 1e3
    return {
        "delta_theta_rad": delta[:, 0].tolist(),
        "delta_a_m": delta[:, 2].tolist(),
        "delta_d_m": delta[:, 1].tolist(),
        "delta_alpha_rad": delta[:, 3].tolist(),
        "lost": {
            "beta_rad": {f"beta{i + 1}": beta for i, beta in enumerate(identified.rows[:, 4].tolist()) if beta != 0.0},
            "position_mm": {"rms": float(np.sqrt(np.mean(off**2))), "max": float(off.max())},
            "reason": "a plain D-H table has no rotation about y; between parallel axes it cannot say this",
        },
    }
